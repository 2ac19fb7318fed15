"""Run of one fleet of several in one world: what its watchers see, and its result.

Each fleet has its own round 1, so its own t = 0, and a trace and properties of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import msgspec

from koordgen.runtime.trace.schema import Cause, Mark, TraceRecord, Verdict, Violation
from targets.sim.base.bodies import BodyState
from targets.sim.base.fleets import SimulatedFleet
from targets.sim.run.run import Companion, Run, RunResult
from targets.sim.run.run_interface import AgentHandle, AgentsAndClock, WatchedRun

OF_PROPERTIES = ("property", "idle")  # kinds of violations that the watchers of a fleet report
T = TypeVar("T")


class FleetAgents(NamedTuple):
    """Agents of one fleet by pid, and the clock of the run. See AgentsAndClock."""

    agents: Sequence[AgentHandle]
    clock: AgentsAndClock

    def now(self) -> float:
        return self.clock.now()


class FleetRun:
    """Companion of a run that shows one of its fleets to companions of that fleet. Implements WatchedRun for them."""

    def __init__(self, fleet: SimulatedFleet, companions: Sequence[Companion[WatchedRun]]) -> None:
        self.fleet, self.companions = fleet, companions
        self._marks: list[Mark] = []  # with times of the run's clock
        self._zero: float | None = None

    def launched(self, run: Run) -> None:
        """See Companion."""
        self._run = run
        self.conduct = FleetAgents(run.agents_of(self.fleet), run.conduct)
        for companion in self.companions:
            companion.launched(self)

    def step(self, at: float, states: list[BodyState]) -> None:
        """See Companion."""
        own = self.fleet.states(states)
        for companion in self.companions:
            companion.step(at, own)

    def heard(self, agent: AgentHandle, records: list[TraceRecord]) -> None:
        """See Companion."""
        if agent in self.conduct.agents:
            for companion in self.companions:
                companion.heard(agent, records)

    def end(self, at: float) -> None:
        """See Companion."""
        for companion in self.companions:
            companion.end(at)

    @property
    def zero(self) -> float | None:
        """Start of the fleet's round 1 on the run's clock; None before."""
        if not self.fleet.name:
            return self._run.zero
        if self._zero is None:
            self._zero = self._run.zero_of(self.fleet)
        return self._zero

    def mark(self, mark: Mark) -> None:
        """Add a record to the fleet's merged trace; its `t` is a time of the run's clock here."""
        if self.fleet.name:
            self._marks.append(mark)
        else:
            self._run.mark(mark)

    def finish(self, why: str) -> None:
        """End the mission of all fleets with this reason."""
        self._run.finish(why)

    def result(self, whole: RunResult, explained: Callable[[Sequence[Mark]], Sequence[Mark]] = list) -> RunResult:
        """Return the result of this fleet, given that of the run, which is the outer fleet's.

        `explained`: function that sets `host` in violations that the host caused, at times of the run's clock."""
        if not self.fleet.name:
            return whole
        zero = self.zero
        since = whole.zero if zero is None else zero
        marks = [msgspec.structs.replace(mark, t=round(mark.t - since, 6)) for mark in explained(self._marks)]
        for mark in whole.marks:
            if self._concerns(mark):
                marks.append(msgspec.structs.replace(mark, t=round(mark.t + whole.zero - since, 6)))
        return RunResult(
            started=zero is not None,
            ended=whole.ended,
            zero=since,
            duration=round(whole.duration + whole.zero - since, 3),
            marks=sorted(map(self._named, marks), key=lambda mark: mark.t),
            closest=None,
            real_time_factor=whole.real_time_factor,
            late_steps=whole.late_steps,
            steps=whole.steps,
            late_in_mission=whole.late_in_mission,
            waiting=self._of_members(whole.waiting),
            last_lines=self._of_members(whole.last_lines),
            statuses=self._of_members(whole.statuses),
            shares=whole.shares,
            host_waits=whole.host_waits,
        )

    def _concerns(self, mark: Mark) -> bool:
        """Return whether a record of the outer fleet also belongs to the trace of this fleet."""
        match mark:
            case Verdict():
                return False
            case Violation():
                return mark.what not in OF_PROPERTIES and not set(mark.robots).isdisjoint(self.fleet.names)
            case Cause():
                return not mark.robots or not set(mark.robots).isdisjoint(self.fleet.names)
            case _:
                return True

    def _named(self, mark: Mark) -> Mark:
        """Return a record with the robots' names in this fleet."""
        if isinstance(mark, Cause | Violation | Verdict):
            return msgspec.structs.replace(mark, robots=tuple(map(self.fleet.own_name, mark.robots)))
        return mark

    def _of_members(self, values: dict[str, T]) -> dict[str, T]:
        return {self.fleet.own_name(name): value for name, value in values.items() if name in self.fleet.names}
