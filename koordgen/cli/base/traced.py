"""Program of a trace: named by an option or found in the run's folder, and checked by its hash."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path
from typing import Any

from koordgen.cli.base.building import params
from koordgen.cli.base.console import USAGE, WRONG, Failure
from koordgen.lang.ir.decl import Program

SOURCE, PARAMS = "source", "params.json"  # paths in a run's folder; koordgen/build/bundle/plan.py writes them


def program_of(options: Namespace, trace: Path, program_hash: str) -> tuple[Program, Path | None]:
    """Return the program of the trace at `trace`, and its file of extern functions or None.

    `program_hash`: the hash in the trace; "" for a trace that is a counterexample. Raises Rejected, Failure."""
    from koordgen.build.bundle.functions import functions_file
    from koordgen.build.emit.program import program_hash as hashed
    from koordgen.build.pipeline import check_file, fleet_params
    from koordgen.lang.analyze.params import BadParam, with_params
    from koordgen.lang.ir.verify import verify

    place, beside = _place(options, trace)
    checked = check_file(str(place))
    try:
        given = {**fleet_params(options.fleet, checked, str(place)), **beside, **params(options.param)}
        program = with_params(checked.program, given)
    except BadParam as error:
        raise Failure(USAGE, str(error)) from None
    verify(program)
    functions = functions_file(program, place.parent, options.functions)
    if not program_hash:
        help = "counterexamples were run when they were found; `koordgen report` shows them"
        raise Failure(WRONG, f"{trace} is a counterexample, not the trace of a run", help)
    its = hashed(program, functions.read_bytes() if functions and functions.is_file() else b"")
    if its != program_hash:
        raise Failure(
            WRONG, f"{trace} is the trace of a program with the hash {program_hash}, but {place} has {its}",
            "program, params or extern functions have changed: name those of the run with --program, --fleet, "
            "--param and --functions",
        )  # fmt: skip
    return program, functions


def _place(options: Namespace, trace: Path) -> tuple[Path, dict[str, Any]]:
    """Return the program's path, and values of its params.

    Without --program, both are those in the run's folder: the trace's own folder, or one of two folders above it.
    """
    if options.program is not None:
        return Path(options.program), {}
    for folder in (trace.parent, *trace.absolute().parents[1:3]):
        programs = sorted((folder / SOURCE).glob("*.koord"))
        if len(programs) == 1:
            params = folder / SOURCE / PARAMS
            try:
                return programs[0], dict(json.loads(params.read_bytes())) if params.is_file() else {}
            except ValueError as error:
                raise Failure(WRONG, f"{params}: {error}") from None
        if any((folder / SOURCE).glob("*/*.koord")):
            help = "the run's verdicts are in its summary.txt; `koordgen show` and `koordgen export` read the trace"
            raise Failure(USAGE, f"{trace} has several applications, which this command cannot run again yet", help)
    raise Failure(USAGE, f"there is no folder {SOURCE}/ beside {trace}", "name the program with --program")
