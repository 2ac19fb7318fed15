"""`koordgen replay`: what is asked, what is printed, and the exit status."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path
from typing import Any

from koordgen.cli import HOLDS, USAGE, VIOLATED, WRONG, Failure, _params, _say
from koordgen.ir.decl import Program
from koordgen.replay.fleet import replayed
from koordgen.replay.functions import CannotCall, externs
from koordgen.replay.robot import Counts, Difference, Unreplayable
from koordgen.replay.trace import BadTrace, Trace, opened

SOURCE, PARAMS = "source", "params.json"  # as bundle/plan.py and the harness leave them
MOST_TOLD = 20
LONGEST = 200  # characters of a value


def replay(options: Namespace) -> int:
    """The whole command."""
    path = Path(options.trace)
    path = path / "trace.jsonl" if path.is_dir() else path
    counts = Counts()
    try:
        trace = opened(path)
        program, functions = _program(options, trace)
        found = list(replayed(program, externs(program, functions), trace, counts))
    except BadTrace as error:
        raise Failure(WRONG, str(error), "a trace of robots is expected: trace.jsonl") from None
    except Unreplayable as error:
        raise Failure(WRONG, f"{path}: {error}", "what this trace says is not enough to replay it") from None
    except CannotCall as error:
        raise Failure(WRONG, str(error), "name it with --functions") from None
    for difference in found[:MOST_TOLD]:
        _say(_told(difference, trace))
    if len(found) > MOST_TOLD:
        _say(f"... and {len(found) - MOST_TOLD} more")
    late = f", {counts.late} that overran left aside" if counts.late else ""
    robots = 1 if trace.own else len(trace.robots)
    what = f"{robots} robot{'s' if robots != 1 else ''}, {counts.rounds} rounds, {counts.events} events{late}"
    if trace.cut:
        _say(f"note: {path}:{trace.cut}: the trace is cut off here; what stands before was replayed")
    if found:
        print(f"{path}: {what}: {len(found)} difference{'s' if len(found) != 1 else ''}")
        return VIOLATED
    print(f"{path}: {what}: as the program means")
    return HOLDS


def _told(found: Difference, trace: Trace) -> str:
    name = trace.robots[found.pid]
    when = f"round {found.round}" if found.round else "init"
    return (
        f"{trace.path}:{found.number}: {when}, robot {name}: {found.what} is {_shown(found.told)} in the trace, "
        f"{_shown(found.meant)} by the program"
    )


def _shown(value: Any) -> str:
    text = "nothing" if value is None else value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."


def _program(options: Namespace, trace: Trace) -> tuple[Program, Path | None]:
    """The program that the trace is of, and the file of its extern functions. Raises Rejected, Failure."""
    from koordgen.bundle.functions import functions_file
    from koordgen.check.params import BadParam, with_params
    from koordgen.emit.program import program_hash
    from koordgen.ir.verify import verify
    from koordgen.pipeline import check_file, fleet_params

    place, beside = _place(options, trace)
    checked = check_file(str(place))
    try:
        given = {**fleet_params(options.fleet, checked, str(place)), **beside, **_params(options.param)}
        program = with_params(checked.program, given)
    except BadParam as error:
        raise Failure(USAGE, str(error)) from None
    verify(program)
    functions = functions_file(program, place.parent, options.functions)
    its = program_hash(program, functions.read_bytes() if functions and functions.is_file() else b"")
    if its != trace.program_hash:
        raise Failure(
            WRONG, f"{trace.path} is of a program with the hash {trace.program_hash}; {place} has {its}",
            "another version of the program, other params or other extern functions: name the right ones "
            "(--program, --fleet, --param, --functions)",
        )  # fmt: skip
    return program, functions


def _place(options: Namespace, trace: Trace) -> tuple[Path, dict[str, Any]]:
    """Where the program is, and the values of its params that stand beside it: in the folder that the run left, which
    may be this robot's run's, if none was named."""
    if options.program is not None:
        return Path(options.program), {}
    for folder in (trace.path.parent, *trace.path.absolute().parents[1:3]):
        programs = sorted((folder / SOURCE).glob("*.koord"))
        if len(programs) == 1:
            params = folder / SOURCE / PARAMS
            try:
                return programs[0], dict(json.loads(params.read_bytes())) if params.is_file() else {}
            except ValueError as error:
                raise Failure(WRONG, f"{params}: {error}") from None
    raise Failure(USAGE, f"there is no folder {SOURCE}/ beside {trace.path}", "name the program with --program")
