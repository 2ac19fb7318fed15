"""Base of the live views: a companion that passes on records during a run, with times since round 1.

Before round 1 times count from the launch. When round 1 has begun, `_reset` is called, and all records passed on before
are void."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import msgspec

from koordgen.runtime.trace.schema import (
    Header,
    InitRecord,
    MemberPose,
    Phase,
    PoseRecord,
    Round,
    TraceRecord,
    Violation,
)
from targets.sim.base.bodies import BodyState
from targets.sim.run.run_interface import AgentHandle
from targets.sim.trace.store_names import StoreNames

if TYPE_CHECKING:
    from targets.sim.run.run import Run

POSE_EVERY = 12  # steps, as in the trace


class Feed(ABC):
    """Observer of a run that passes the trace records on. It adds nothing to the trace."""

    def __init__(self, header: Header) -> None:
        self._header = header
        self._stored = StoreNames(header)
        self._steps = 0
        self._marks_sent = 0  # number of the run's marks passed on
        self._seen: set[tuple[str, tuple[int, int]]] = set()  # findings of the separation monitor passed on
        self._begun = False
        # records received before the start of round 1 was known
        self._early: list[tuple[AgentHandle, list[TraceRecord]]] = []

    @abstractmethod
    def _add(self, record: TraceRecord, t: float) -> None:
        """Pass on one record. `t` overrides the record's own time."""

    @abstractmethod
    def _reset(self) -> None:
        """Discard what was passed on: round 1 has begun."""

    @abstractmethod
    def _send(self) -> None:
        """Send the collected records if it is time."""

    def launched(self, run: Run) -> None:
        """See Companion."""
        self._run = run
        self._launched = run.conduct.now()
        self._fleet = run.fleets[0]
        self._agents = run.agents_of(self._fleet)

    def step(self, at: float, states: list[BodyState]) -> None:
        """Pass on poses at the rate of the trace."""
        self._steps += 1
        if self._steps % POSE_EVERY != 1:
            return
        if not self._begun and self._run.zero is not None:
            self._begin()
        self._poses(at, states)
        self._marks()
        self._send()

    def show(self, at: float, states: list[BodyState]) -> None:
        """Pass on the present poses and all collected records at once."""
        if states:
            self._poses(at, states)
        self._marks()
        self.flush()

    def _poses(self, at: float, states: list[BodyState]) -> None:
        """Pass on the poses of the outer fleet's robots and of the members of squads."""
        t = self._t(at)
        for pid, state in enumerate(self._fleet.states(states)):
            self._add(PoseRecord(pid, state.position, state.yaw), t)
        for pid, name, place in self._fleet.members:
            self._add(MemberPose(pid, name, states[place].position, states[place].yaw), t)

    @abstractmethod
    def flush(self) -> None:
        """Send the collected records, as far as possible without waiting."""

    def heard(self, agent: AgentHandle, records: list[TraceRecord]) -> None:
        """Pass on the records of the outer fleet. See Companion."""
        if agent not in self._agents:
            return
        if not self._begun:
            self._early.append((agent, [r for r in records if isinstance(r, (InitRecord, Round))]))
        for record in records:
            if not isinstance(record, (Header, Violation)) and hasattr(record, "pid"):
                own = msgspec.structs.replace(record, pid=agent.robot.pid)
                self._add(self._stored.of(own), self._t(getattr(record, "time", 0.0)))

    def end(self, at: float) -> None:
        """See Companion."""
        self._marks()
        self.flush()

    def _t(self, at: float) -> float:
        """Return the seconds since round 1; before it, since the launch."""
        t = self._run.t(at) if self._begun else None
        return at - self._launched if t is None else t

    def _begin(self) -> None:
        """Switch to times since round 1, and pass on the early records again."""
        self._begun = True
        self._reset()
        for agent in self._agents:
            self._add(Phase(agent.phase.phase, agent.phase.detail, pid=agent.robot.pid), 0.0)
        for agent, records in self._early:
            self.heard(agent, records)
        self._early.clear()

    def _marks(self) -> None:
        """Pass on new violations of the separation monitor and new marks of companions."""
        watch = self._run.scene.watch
        for (i, j), close in watch.too_close.items():
            if self._new("separation", (i, j)):
                detail = f"{close.distance:.3f} m apart, less than {watch.min_separation:g} m"
                self._violation(close.time, "separation", (i, j), detail)
        for (i, j), at in watch.collisions.items():
            if self._new("collision", (i, j)):
                self._violation(at, "collision", (i, j), "their bodies touched")
        for (i, number), at in watch.bumps.items():
            if self._new("bump", (i, number)):
                self._violation(at, "collision", (i,), f"touched obstacle {number}")
        marks = self._run.marks
        for mark in marks[self._marks_sent :]:
            self._add(self._stored.of(mark), self._t(mark.t))
        self._marks_sent = len(marks)

    def _new(self, what: str, who: tuple[int, int]) -> bool:
        known = (what, who) in self._seen
        self._seen.add((what, who))
        return not known

    def _violation(self, at: float, what: str, pids: tuple[int, ...], detail: str) -> None:
        t, robots = self._t(at), self._run.scenario.robots
        self._add(Violation(t, what, tuple(robots[place].name for place in pids), detail), t)
