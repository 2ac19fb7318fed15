"""What a run that follows a counterexample is to do, as koordgen/verify/follow/plan.py writes it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec

from targets.sim.base.scenario import BadScenario

Values = dict[str, Any]  # by name, in JSON
Calls = dict[int, list[tuple[str, list[Any], Any]]]  # by pid: port, arguments, answer


class State(msgspec.Struct, frozen=True):
    """A fleet at a round's start: of each robot locals, ports ("Module.port") and whether it has stopped; the shared
    store, of an allread variable by pid."""

    locals: list[Values]
    ports: list[Values]
    stopped: list[bool]
    shared: Values


class Round(msgspec.Struct, frozen=True):
    """A round of the agents, part of the trace's round `of`; `line` is where that says so. `events` by pid: who has
    none skips. `free`: each does what it wants."""

    of: int
    line: int
    events: dict[int, str]
    free: bool
    state: State
    calls: Calls = {}


class Ending(msgspec.Struct, frozen=True):
    """What the trace says is violated. `event` of robot `pid` has no result, where there is one."""

    name: str
    line: str
    detail: str
    pid: int = -1
    event: str = ""


class Plan(msgspec.Struct, frozen=True):
    """`initial`: robots begin with their `init`, not in the first round's state. The ending must be found after the
    events of round `found` (0: after init), with `environment` after the environment's step behind it. `cut`: from
    which line on the trace cannot be read, or 0. `calls` are those of init."""

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
        """As traces of such a run say it."""
        return "run" if self.initial else "step"


def load(path: Path, program_hash: str, n_sys: int) -> Plan:
    """Raises BadScenario."""
    try:
        plan = msgspec.convert(json.loads(path.read_text(encoding="utf-8")), Plan, strict=False)
    except (OSError, ValueError, RecursionError, msgspec.ValidationError) as error:
        told = getattr(error, "strerror", None) or error
        raise BadScenario(f"{path}: {told}", "`koordgen sim --follow TRACE` makes such a file") from None
    if plan.program_hash != program_hash or any(len(each.state.stopped) != n_sys for each in plan.rounds):
        raise BadScenario(f"{path}: it is for another program or fleet", "`koordgen sim --follow TRACE` makes it anew")
    return plan
