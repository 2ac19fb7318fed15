"""Commands `koordgen report`, `koordgen export` and `koordgen show`, which make documents of a finished run."""

from __future__ import annotations

import sys
from argparse import Namespace

from koordgen.cli.base import console
from koordgen.lang import resources


def afterwards(options: Namespace) -> int:
    """Execute `report`, `export` or `show` with the code of the simulator, and print the result. Return 0."""
    sys.path.insert(0, str(resources.targets().parent))
    from koordgen.runtime.trace.schema import FORMAT, BadTrace
    from targets.sim.view import commands
    from targets.sim.view.data.failures import CannotMake

    try:
        if options.command == "report":
            made: object = commands.report(options.trace, options.out)
        elif options.command == "show":
            made = commands.show(options.trace, options.at, options.format)
        elif options.to == FORMAT:
            made, old = commands.upgrade(options.trace, options.out)
            if old == FORMAT:
                console.notify(f"note: {options.trace} already has the format {FORMAT}; the new file is a copy")
        else:
            made = commands.export(options.trace, options.to, options.out)
    except CannotMake as error:
        raise console.Failure(console.SURROUNDINGS, str(error), error.hint) from None
    except BadTrace as error:
        raise console.Failure(
            console.WRONG, str(error), "give the folder of a run, or the file trace.jsonl in this folder"
        ) from None
    except OSError as error:
        raise console.Failure(
            console.SURROUNDINGS,
            f"{error.filename or getattr(options, 'out', None) or options.trace}: {error.strerror or error}",
        ) from None
    print(made)
    return console.HOLDS
