"""Plan of a run that replays a counterexample, as koordgen/verify/follow/plan.py writes it.

Instances have their numbers in FleetProgram: with one application on all robots, the pids of the robots."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec

from targets.sim.base.scenario import BadScenario

Values = dict[str, Any]  # by name, in JSON
Calls = dict[int, list[tuple[str, list[Any], Any]]]  # by instance: port, arguments, answer


class FleetState(msgspec.Struct, frozen=True):
    """State of a fleet at a round's start.

    By instance: locals, and whether it has stopped. By robot: ports ("Module.port"). `shared`: the shared store, by the
    names of the store; an allread variable has its values by the pids of its application."""

    locals: list[Values]
    ports: list[Values]
    stopped: list[bool]
    shared: Values


class Round(msgspec.Struct, frozen=True):
    """A round of the agents, which is part of the trace's round `of`; `line` is its line in the trace.

    `events` by instance; an instance without one skips the round. `free`: each may execute any enabled event."""

    of: int
    line: int
    events: dict[int, str]
    free: bool
    state: FleetState
    calls: Calls = {}


class Ending(msgspec.Struct, frozen=True):
    """Violation at the trace's end. If `event` is set, this event of an instance has no result.

    `application`: the application that has the property; "" if the fleet has only one."""

    name: str
    line: str
    detail: str
    instance: int = -1
    event: str = ""
    application: str = ""


class ReplayPlan(msgspec.Struct, frozen=True):
    """Plan of a replayed counterexample.

    `initial`: robots begin with their `init` instead of the first round's state. The ending must be found after the
    events of round `found` (0: after init); with `environment`, after the environment's step that follows. `cut`: first
    line of the trace that cannot be read, or 0. `calls`: calls of init."""

    trace: str
    program_hash: str
    initial: bool
    cut: int
    ending: Ending | None
    found: int
    environment: bool
    calls: Calls
    rounds: list[Round]

    @property
    def kind(self) -> str:
        """Name of the plan's kind in traces of such a run."""
        return "run" if self.initial else "step"


def load(path: Path, program_hash: str, robots: int) -> ReplayPlan:
    """Read a plan and check that it fits the programs and the number of robots. Raises BadScenario."""
    try:
        plan = msgspec.convert(json.loads(path.read_text(encoding="utf-8")), ReplayPlan, strict=False)
    except (OSError, ValueError, RecursionError, msgspec.ValidationError) as error:
        told = getattr(error, "strerror", None) or error
        raise BadScenario(f"{path}: {told}", "create the file with `koordgen sim --follow TRACE`") from None
    if plan.program_hash != program_hash or any(len(each.state.ports) != robots for each in plan.rounds):
        raise BadScenario(
            f"{path}: the plan is for another program or fleet", "create it again with `koordgen sim --follow TRACE`"
        )
    return plan
