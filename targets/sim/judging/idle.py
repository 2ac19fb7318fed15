"""Idle detection: ends a run in which no robot makes progress although the robots have not stopped.

Tasks that no robot can do are so reported instead of waited for. There is progress when a robot moves, writes an
actuator, streams a value, stops, or changes the value of a variable. Numbers and positions count as changed from SAME
on: measured positions vary a little all the time."""

from __future__ import annotations

import math
from typing import Any

import msgspec

from koordgen.runtime.trace.schema import InitRecord, Round, StreamLine, TraceRecord, Violation
from targets.sim.base.bodies import BodyState, Vector
from targets.sim.run.run_interface import AgentHandle, WatchedRun

SAME = 0.2
IDLE_TIMEOUT = 60.0  # seconds
EVERY = 24  # steps between two checks of positions


class Idle:
    """Companion that ends an idle run. `timeout` in seconds; 0: never."""

    def __init__(self, names: tuple[str, ...], timeout: float) -> None:
        self._names, self._timeout = names, timeout
        self._since = math.inf  # time of the last progress
        self._places: list[Vector] = []
        self._values: dict[tuple[int, str, str], Any] = {}  # by pid, application and name
        self._last: dict[int, dict[str, str]] = {}  # pid -> event or skip of each application in its last round
        self._stopped: dict[int, set[str]] = {}  # pid -> applications that have stopped
        self._steps = 0

    def launched(self, run: WatchedRun) -> None:
        self._run = run

    def step(self, at: float, states: list[BodyState]) -> None:
        self._steps += 1
        zero = self._run.zero
        if self._steps % EVERY or zero is None:
            return
        if self._since == math.inf:
            self._since = max(zero, at)
        places = [state.position for state in states]
        moved = not self._places or any(math.dist(a, b) >= SAME for a, b in zip(places, self._places, strict=True))
        if moved:
            self._places, self._since = places, at
        if self._timeout and at - self._since >= self._timeout and self._left():
            self._report(at)

    def heard(self, agent: AgentHandle, records: list[TraceRecord]) -> None:
        if not self._timeout:
            return
        for record in records:
            match record:
                case InitRecord() | Round():
                    if self._has_effect(agent.robot.pid, record):
                        self._since = max(self._since, record.time) if self._since < math.inf else self._since
                case StreamLine():
                    self._since = max(self._since, record.time) if self._since < math.inf else self._since
                case _:
                    pass

    def end(self, at: float) -> None:
        pass

    def _left(self) -> list[int]:
        """Return the pids of robots that run and have not stopped."""
        agents = self._run.conduct.agents
        return [a.robot.pid for a in agents if a.alive and a.stopping is None and not self._has_stopped(a.robot.pid)]

    def _has_stopped(self, pid: int) -> bool:
        """Return whether all applications that have run on a robot have stopped."""
        return self._stopped.get(pid, set()) >= self._last.get(pid, {"": ""}).keys()

    def _has_effect(self, pid: int, record: InitRecord | Round) -> bool:
        if record.stopped:
            self._stopped.setdefault(pid, set()).add(record.application)
        last = self._last.setdefault(pid, {})
        if isinstance(record, Round):
            last[record.application] = record.event or record.skipped or "nothing"
        else:
            last.setdefault(record.application, "no round")
        has_effect = bool(record.stopped or record.actuators)
        for values in (record.locals, record.shared):
            for name, raw in values.items():
                value = msgspec.json.decode(raw)
                key = (pid, record.application, name)
                if not same(self._values.get(key), value):
                    self._values[key] = value
                    has_effect = True
        return has_effect

    def _report(self, at: float) -> None:
        self._timeout = 0.0  # an idle run is reported once
        robots = tuple(self._names[pid] for pid in self._left())
        doing = "; ".join(f"{self._names[pid]}: {self._doing(pid)}" for pid in self._left())
        detail = f"no robot made progress for {at - self._since:.0f} s, and the program has not stopped ({doing})"
        self._run.mark(Violation(self._since, "idle", robots, detail))
        self._run.finish("idle")

    def _doing(self, pid: int) -> str:
        """Return the last event or skip of a robot; of several applications that of each."""
        last = self._last.get(pid) or {"": "no round"}
        if len(last) == 1:
            return next(iter(last.values()))
        return ", ".join(f"{application} {what}" for application, what in last.items())


def same(a: Any, b: Any) -> bool:
    """Return whether two JSON values are equal up to small changes of numbers that are not ints."""
    match a, b:
        case bool(), bool():
            return a == b
        case float(), float():
            return abs(a - b) < SAME
        case list(), list():
            return len(a) == len(b) and all(map(same, a, b))
        case _:
            return type(a) is type(b) and bool(a == b)
