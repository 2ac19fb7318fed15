"""`koordgen replay`: options, output and exit status."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path
from typing import Any

from koordgen.cli.base.alarm import alarm
from koordgen.cli.base.console import HOLDS, INCONCLUSIVE, VIOLATED, WRONG, Failure, notify
from koordgen.cli.base.traced import fleet_of
from koordgen.cli.verify.squads import compared_squads
from koordgen.lang.semantics.deadline import OutOfTime
from koordgen.runtime.trace.schema import BadTrace
from koordgen.verify.replay.fleet import replay_trace
from koordgen.verify.replay.functions import CannotCall, externs
from koordgen.verify.replay.robot import Counts, Difference, Unreplayable
from koordgen.verify.replay.trace import TraceParts, open_trace

MOST_PRINTED = 20  # largest number of differences that are printed
LONGEST = 200  # longest text of a value that is printed, in characters


def replay(options: Namespace) -> int:
    """Run `koordgen replay`, and return the exit status."""
    path = Path(options.trace)
    path = path / "trace.jsonl" if path.is_dir() else path
    counts, found, ended = Counts(), list[Difference](), False
    try:
        trace = open_trace(path)
        path = trace.path
        fleet = fleet_of(options, trace.path, trace.header)
        parts = zip(fleet.programs.applications, fleet.functions, strict=False)
        again = replay_trace(
            fleet.system, [*(externs(a.program, file) for a, file in parts), *[None] * fleet.is_squad], trace, counts
        )
        try:
            with alarm(options.seconds):
                for difference in again:
                    found.append(difference)
        except OutOfTime:
            ended = True
    except BadTrace as error:
        raise Failure(WRONG, str(error), "give the trace of a robot or a run, such as trace.jsonl") from None
    except Unreplayable as error:
        raise Failure(
            WRONG, f"{trace.place(error.number)}: {error.why}", "the trace does not contain enough values to replay it"
        ) from None
    except CannotCall as error:
        raise Failure(WRONG, str(error), "name the file of the extern functions with --functions") from None
    for difference in found[:MOST_PRINTED]:
        notify(_difference_text(difference, trace))
    if len(found) > MOST_PRINTED:
        notify(f"... and {len(found) - MOST_PRINTED} more")
    late = f", not compared: {counts.late} that took too long" if counts.late else ""
    if counts.violated:
        where = f"{_count(counts.violated, 'event')}"
        notify(f"note: the program violated a loop invariant in {where}; `koordgen audit` names the invariant")
    robots = 1 if trace.own else len(trace.robots)
    what = f"{_count(robots, 'robot')}, {_count(counts.rounds, 'round')}, {_count(counts.events, 'event')}{late}"
    if trace.cut:
        notify(f"note: {trace.place(trace.cut)}: the trace is cut off here; the part before was replayed")
    if trace.since:
        notify(f"note: rounds before {trace.since} are unknown: the parts of the trace that record them are missing")
    if ended:
        notify(f"note: ended by --seconds {options.seconds:g}: the rest of the trace was not replayed")
    squads = compared_squads(path, fleet.system.applications[0].program) if not (trace.own or ended) else []
    for squad in squads:
        for line in squad.difference_lines:
            notify(line)
    status = _told(path, what, found, ended, options.seconds, "program" + "s" * fleet.is_composed)
    for squad in squads:
        print(squad.summary)
    return VIOLATED if any(squad.differences for squad in squads) else status


def _told(path: Path, what: str, found: list[Difference], ended: bool, seconds: float, programs: str) -> int:
    """Print the result of a replay. Return its exit status."""
    if found:
        print(f"{path}: {what}: {_count(len(found), 'difference')}")
        return VIOLATED
    if ended:
        print(f"{path}: {what}: not decided: ended by --seconds {seconds:g}, no difference found before")
        return INCONCLUSIVE
    print(f"{path}: {what}: no differences from the {programs}")
    return HOLDS


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"


def _difference_text(found: Difference, trace: TraceParts) -> str:
    name = trace.robots[found.pid]
    when = f"round {found.round}" if found.round else "init"
    whose = f", application {found.application}" if found.application else ""
    return (
        f"{trace.place(found.number)}: {when}, robot {name}{whose}: {found.what} is "
        f"{_shown(found.recorded)} in the trace, {_shown(found.computed)} by the program"
    )


def _shown(value: Any) -> str:
    text = "nothing" if value is None else value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."
