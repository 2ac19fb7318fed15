"""Comparison of an outer run with the traces of its squads, for `koordgen replay` and `koordgen audit`."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from koordgen.build.bundle.squad_budget import OUTER
from koordgen.cli.base.console import Failure
from koordgen.cli.base.traced import fleet_of
from koordgen.lang.ir.decl import Program
from koordgen.runtime.trace.schema import BadTrace
from koordgen.verify.audit.history import FleetMission, RobotHistory, mission, of_application
from koordgen.verify.audit.shared_store import AuditedFleet
from koordgen.verify.audit.squad_states import SquadStates
from koordgen.verify.audit.squads import LevelDifference, SquadComparison
from koordgen.verify.audit.trace_files import read_trace_file
from koordgen.verify.replay.functions import CannotCall, externs
from koordgen.verify.replay.hosted import provider_of
from koordgen.verify.replay.trace import header_of

MOST_PRINTED = 20  # largest number of differences of one squad that are printed
LONGEST = 200  # longest text of a value that is printed, in characters


class ComparedSquad(NamedTuple):
    """Result of the comparison of an outer robot with its squad.

    `outer`, `inner`: the two merged traces. `unread`: reason why the squad's trace was not compared, or empty."""

    robot: str
    outer: Path
    inner: Path
    readings: int = 0
    commands: int = 0
    unchecked: int = 0
    differences: Sequence[LevelDifference] = ()
    unread: str = ""

    @property
    def difference_lines(self) -> Iterator[str]:
        """Differences as text for users, one a line."""
        for each in self.differences[:MOST_PRINTED]:
            yield self._text(each)
        if len(self.differences) > MOST_PRINTED:
            yield f"... and {len(self.differences) - MOST_PRINTED} more"

    @property
    def summary(self) -> str:
        """Result as one line of text for users."""
        if self.unread:
            return f"{self.inner}: squad {self.robot} was not compared: {self.unread}"
        count = len(self.differences)
        found = f"{count} difference{'s' * (count != 1)} from" if count else "no differences from"
        unchecked = f", {self.unchecked} not compared because values are not recorded" if self.unchecked else ""
        what = f"{self.readings} readings and {self.commands} commands of {self.robot}{unchecked}"
        return f"{self.inner}: {what}: {found} the squad"

    @property
    def document(self) -> dict[str, Any]:
        """Result as data for JSON."""
        return {
            "robot": self.robot,
            "trace": str(self.inner),
            "readings": self.readings,
            "commands": self.commands,
            "unchecked": self.unchecked,
            "unread": self.unread or None,
            "differences": [each._asdict() for each in self.differences],
        }

    def _text(self, found: LevelDifference) -> str:
        when = f"round {found.outer_round}" if found.outer_round else "init"
        return (
            f"{self.outer}:{found.outer_line}: {when}, robot {self.robot}: {found.what} is {_shown(found.outer)}; "
            f"in round {found.inner_round} of the squad ({self.inner}:{found.inner_line}) it is {_shown(found.inner)}: "
            f"{found.why}"
        )


def _shown(value: Any) -> str:
    text = "nothing" if value is None else json.dumps(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."


def compared_squads(trace: Path, program: Program, whole: FleetMission | None = None) -> list[ComparedSquad]:
    """Compare each robot of a run that is a squad with the squad's trace, if that is beside the run's merged trace.

    `trace`: the run's trace. `program`: the outer program. `whole`: the outer mission, None to read it."""
    names = [name for name in _names(trace) if _is_squad(trace.parent / name / trace.name)]
    if not names:
        return []
    try:
        whole = mission([read_trace_file(trace)]) if whole is None else whole
    except BadTrace as error:
        return [ComparedSquad(name, trace, trace.parent / name / trace.name, unread=str(error)) for name in names]
    return [_compared(trace, program, whole, history) for history in whole.histories if history.name in names]


def _names(trace: Path) -> list[str]:
    """Return the names of the robots in a merged trace; none in the trace of one robot."""
    robots = _header(trace).get("robots", ())
    return [Path(str(robot["name"])).name for robot in robots]  # so that no header leads out of the run's folder


def _is_squad(trace: Path) -> bool:
    return [*_header(trace).get("applications", ())][-1:] == [OUTER]


def _header(trace: Path) -> Mapping[str, Any]:
    try:
        return header_of(trace) or {}
    except (BadTrace, OSError):
        return {}


def _compared(trace: Path, program: Program, outer: FleetMission, history: RobotHistory) -> ComparedSquad:
    name = history.name
    path = trace.parent / name / trace.name
    try:
        comparison = SquadComparison(program, history, outer.name, _states(path), outer.log.header.get("geofence"))
        found = comparison.differences()
    except Failure as failure:
        return ComparedSquad(name, trace, path, unread=str(failure))
    except (BadTrace, CannotCall) as error:
        return ComparedSquad(name, trace, path, unread=str(error))
    counts = comparison.readings, comparison.commands, comparison.unchecked
    return ComparedSquad(name, trace, path, *counts, found)


def _states(path: Path) -> SquadStates:
    """Return the states in the trace of a squad. Raises BadTrace, Failure, CannotCall."""
    whole = mission([read_trace_file(path)])
    options = Namespace(fleet=None, program=None, functions=None, param=[])
    fleet = fleet_of(options, path, whole.log.header)
    missions = tuple([of_application(whole, each) for each in fleet.system.applications])
    provider = provider_of(fleet.system)
    functions = externs(fleet.system.applications[provider].program, fleet.functions[provider])
    return SquadStates(AuditedFleet(fleet.system, missions), functions)
