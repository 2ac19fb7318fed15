"""`koordgen report` and `koordgen export`: what is made of a run that is over."""

from __future__ import annotations

import sys
from argparse import Namespace

from koordgen import cli, resources


def afterwards(options: Namespace) -> int:
    """The harness that left the run knows how."""
    sys.path.insert(0, str(resources.targets().parent))
    from targets.sim.trace import BadTrace
    from targets.sim.view import commands

    try:
        if options.command == "report":
            made = commands.report(options.trace, options.out)
        else:
            made = commands.export(options.trace, options.to, options.out)
    except commands.CannotMake as error:
        raise cli.Failure(cli.SURROUNDINGS, str(error), error.hint) from None
    except BadTrace as error:
        raise cli.Failure(cli.WRONG, str(error), "a run's folder is expected, or the trace.jsonl in it") from None
    except OSError as error:
        raise cli.Failure(
            cli.SURROUNDINGS, f"{error.filename or options.out or options.trace}: {error.strerror or error}"
        ) from None
    print(made)
    return cli.HOLDS
