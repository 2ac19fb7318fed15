"""One run on either clock: launch of the agents, steps of the world, safe stop of all robots."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Protocol, TypeVar

import msgspec

from koordgen.runtime.trace.schema import End, Mark, TraceRecord, Violation
from targets.sim.base.bodies import BodyState
from targets.sim.base.fleets import SimulatedFleet, fleets_of
from targets.sim.base.scenario import Scenario
from targets.sim.physics.world import STEP
from targets.sim.run.progress import Progress
from targets.sim.run.run_interface import AgentHandle, AgentsAndClock, WatchedRun
from targets.sim.run.scene import Closest
from targets.sim.trace.files import Poses

R = TypeVar("R", bound=WatchedRun, contravariant=True)


class Companion(Protocol[R]):
    """Observer or injector beside a run (`Run.companions`). May raise only OSError, which ends the run.

    R: what it needs to see of the run: a Run, or a WatchedRun if it judges one fleet only."""

    def launched(self, run: R) -> None:
        """Called before the agents start.

        `run.scene` has the bodies and devices, `run.conduct.agents` the agent handles, `run.mark` adds records to the
        trace."""
        ...

    def step(self, at: float, states: list[BodyState]) -> None:
        """Called at each physics step with the true states by pid at time `at` of the run's clock.

        t is `run.t(at)`, None before round 1. Changes take effect at the next step."""
        ...

    def heard(self, agent: AgentHandle, records: list[TraceRecord]) -> None:
        """Called every 0.05 s for each agent that has traced something, with its records in order."""
        ...

    def end(self, at: float) -> None:
        """Called after the safe stop of all robots. `mark` may still be used."""
        ...


POSES = "poses.jsonl"
POSE_RATE = 20.0  # poses a second, unless the setting `pose_rate` says otherwise
LOOK_EVERY = 0.05  # seconds between two checks of the agents
STOP_WITHIN = 20.0  # seconds from the end of the mission within which every agent must end
SETTLE = 0.5  # seconds for which the world continues after the last agent
START_TIMEOUT = 90.0


@dataclass(slots=True)
class RunResult:
    """Result of a run, or of one fleet in it. Times of `marks` and `closest` are t (s since round 1).

    `zero`: time of t = 0 on the run's clock: start of round 1, or the launch if round 1 did not begin. `ended`: why the
    mission ended: completed, stopped (all agents ended by themselves), died (before the start), timeout (no start),
    interrupted, idle (see idle.py)."""

    started: bool
    ended: str
    zero: float
    duration: float  # of the mission, seconds
    marks: list[Mark]
    closest: Closest | None
    real_time_factor: float
    late_steps: int
    steps: int
    names: tuple[str, ...] = ()  # of all physical robots, by the numbers in `closest`; empty: those of the trace
    late_in_mission: int = 0  # late steps within the mission; start and end load the host more
    waiting: dict[str, str] = field(default_factory=dict)  # robot -> its phase, if round 1 did not begin
    last_lines: dict[str, list[str]] = field(default_factory=dict)  # of robots that failed
    statuses: dict[str, int | None] = field(default_factory=dict)
    shares: dict[str, float] = field(default_factory=dict)  # shares of the processor's time, by part, in lockstep
    host_waits: dict[str, float] = field(default_factory=dict)  # see host_load.HostLoad.totals

    @property
    def violations(self) -> list[Violation]:
        return [mark for mark in self.marks if isinstance(mark, Violation)]


def poses_file(folder: Path, fleet: SimulatedFleet) -> Path:
    """Return the file with the poses of a fleet in the folder of a run."""
    return folder / fleet.name / POSES


class Run:
    """A run. Owns `conduct` and `scene`.

    `folder` receives poses, a folder for each robot under `robots/`, and a folder for each inner fleet. All times are
    those of the run's clock, `conduct.now`. `zero` is the start of the outer fleet's round 1, None before."""

    def __init__(
        self, scenario: Scenario, conduct: AgentsAndClock, folder: Path, duration: float, progress: Progress
    ) -> None:
        self.scenario = scenario
        self.conduct = conduct
        self.companions: list[Companion[Run]] = []
        self.zero: float | None = None
        self.folder = folder
        self.fleets = fleets_of(scenario)
        self._duration = duration
        self._progress = progress
        self._interrupts = 0
        self._finished = ""  # a companion's reason for ending the mission
        self._steps = 0
        self._pose_every = max(1, round(1 / (STEP * scenario.number("pose_rate", POSE_RATE))))
        self._late = 0  # late steps during the mission
        self._marks: list[Mark] = []  # with times of the run's clock
        self._next_look = 0.0
        self._left: set[str] = set()  # robots that stopped safely without a command
        self._noted: set[tuple[int, str]] = set()  # contacts written to logs: pid, and the object touched
        self._failed: dict[str, tuple[float, str]] = {}  # robot -> time and text of its agent's failure
        try:
            self.scene = conduct.scene()
            self._poses = [(fleet, Poses(poses_file(folder, fleet))) for fleet in self.fleets]
        except BaseException:
            conduct.close()
            raise

    def mark(self, mark: Mark) -> None:
        """Add a record to the merged trace; its `t` is a time of the run's clock here."""
        self._marks.append(mark)

    @property
    def marks(self) -> Sequence[Mark]:
        """Records added by companions so far, with times of the run's clock."""
        return self._marks

    @property
    def interrupted(self) -> bool:
        """True if a signal has requested the end of the run."""
        return self._interrupts > 0

    def finish(self, why: str) -> None:
        """End the mission with this reason (`Outcome.ended`)."""
        self._finished = why

    def agents_of(self, fleet: SimulatedFleet) -> list[AgentHandle]:
        """Return the agents of a fleet by pid."""
        agents, squads = self.conduct.agents, self.conduct.squads
        return [
            squads[name] if fleet.is_squad(pid) else agents[own[0]]
            for pid, (name, own) in enumerate(zip(fleet.names, fleet.bodies, strict=True))
        ]

    def zero_of(self, fleet: SimulatedFleet) -> float | None:
        """Return the start of a fleet's round 1 on the run's clock; None before."""
        starts = [agent.first_round_start for agent in self.agents_of(fleet)]
        return min([start for start in starts if start is not None], default=None)

    @property
    def handles(self) -> list[AgentHandle]:
        """Agents of all physical robots, then those of squads."""
        return [*self.conduct.agents, *self.conduct.squads.values()]

    def t(self, at: float) -> float | None:
        """Return the seconds since the start of round 1; None before it."""
        return None if self.zero is None else at - self.zero

    def execute(self) -> RunResult:
        """Run from launch to safe stop. Raises OSError for a failure of the host, after ending all agents."""
        try:
            with self._interruptible():
                return self._execute()
        finally:
            self.conduct.close()
            self.scene.close()
            for _, poses in self._poses:
                poses.close()

    def _execute(self) -> RunResult:
        agents, count = self.conduct.agents, len(self.conduct.agents)
        for companion in self.companions:
            companion.launched(self)
        launched = self.conduct.now()
        self.conduct.launch(self.scene)
        timeout = launched + self.scenario.number("start_timeout", START_TIMEOUT)
        self._progress.step("1 robot is starting" if count == 1 else f"{count} robots are starting")
        ended = self._until(lambda now: self._before_start(now, timeout))
        zero = launched if self.zero is None else self.zero
        waiting = {agent.robot.name: agent.waiting_for() for agent in agents} if ended else {}
        if not ended:
            self._progress.step(f"round 1 began {zero - launched:.1f} s after the launch")
            before = self.conduct.late
            ended = self._until(lambda now: self._during_mission(now, zero))
            self._late = self.conduct.late - before
        end = self.conduct.now()
        self._stop_safely(ended)
        now = self.conduct.now()
        for companion in self.companions:
            companion.end(now)
        return self._result(ended, zero, end, waiting)

    def _before_start(self, now: float, timeout: float) -> str:
        if self._interrupts:
            return "interrupted"
        self.zero = self.zero_of(self.fleets[0])
        if self.zero is not None:
            return "started"
        if self._failed or not all(agent.alive for agent in self.conduct.agents):
            return "died"
        return "timeout" if now >= timeout else ""

    def _during_mission(self, now: float, zero: float) -> str:
        if self._interrupts:
            return "interrupted"
        if self._finished:
            return self._finished
        if now - zero >= self._duration:
            return "completed"
        return "" if any(agent.alive or agent.crashed for agent in self.conduct.agents) else "stopped"

    def _until(self, done: Callable[[float], str]) -> str:
        """Advance until `done` returns a reason. Return it, or "" for the mission's start."""
        while True:
            self.conduct.go_on(self._step)
            now = self.conduct.now()
            if now >= self._next_look:
                self._next_look = now + LOOK_EVERY
                self._look(now)
                why = done(now)
                if why:
                    return "" if why == "started" else why

    def _step(self, at: float) -> None:
        """Simulate one step of the world."""
        states = self.scene.step(at)
        if self._steps % self._pose_every == 0:
            for fleet, poses in self._poses:
                members = [(pid, name, states[place]) for pid, name, place in fleet.members]
                poses.write(at, fleet.states(states), members)
        self._steps += 1
        for companion in self.companions:
            companion.step(at, states)

    def _note_contacts(self) -> None:
        """Write each first contact into the logs of the robots concerned: a real robot would not notice it."""
        agents, watch = self.conduct.agents, self.scene.watch
        found = [(pid, f"obstacle {number}", at) for (pid, number), at in watch.bumps.items()]
        for (i, j), at in watch.collisions.items():
            found += [(i, agents[j].robot.name, at), (j, agents[i].robot.name, at)]
        for pid, what, at in found:
            if (pid, what) not in self._noted:
                self._noted.add((pid, what))
                when = "" if self.zero is None else f" at {at - self.zero:.2f} s"
                agents[pid].note(f"simulator: {agents[pid].robot.name} touched {what}{when}")

    def _look(self, now: float) -> None:
        self._note_contacts()
        for agent in self.handles:
            self._hear(agent)
            name = agent.robot.name
            if agent.stopping and name not in self._left:
                self._left.add(name)
                self._progress.show_line(f"{name} stops safely by itself: {agent.stopping.detail}")
            failure = agent.failure()
            if failure and name not in self._failed:
                since = agent.stopping.time if agent.stopping and not agent.killed else now
                self._failed[name] = (since, failure)
                self._progress.show_line(f"{name} {failure}")
        self._progress.show(now, self.zero, self._duration, self.conduct.agents, self.scene.watch, self.conduct.factor)

    def _hear(self, agent: AgentHandle) -> bool:
        """Pass an agent's new records to the companions. Return whether there were any."""
        records = agent.look()
        if records:
            for companion in self.companions:
                companion.heard(agent, records)
        return bool(records)

    def _stop_safely(self, ended: str) -> None:
        """Command the agents to stop safely, and advance the world until they have."""
        if ended == "completed":
            self._progress.step("the mission is over, robots stop safely")
        else:
            self._progress.show_line(f"{ended}: ending")
        for agent in self.handles:
            self._hear(agent)
            agent.request_end()
        deadline = self.conduct.now() + STOP_WITHIN
        hurry = self._interrupts + 1

        def are_stopped(now: float) -> str:
            over = now >= deadline or self._interrupts >= hurry
            return "yes" if over or not any(agent.alive for agent in self.conduct.agents) else ""

        self._until(are_stopped)
        for agent in self.handles:
            agent.kill()
            while self._hear(agent):
                pass
        settled = self.conduct.now() + SETTLE
        self._until(lambda now: "yes" if now >= settled else "")

    def _result(self, ended: str, zero: float, end: float, waiting: dict[str, str]) -> RunResult:
        now = self.conduct.now()
        watch = self.scene.watch
        names = [robot.name for robot in self.scenario.robots]

        def t(time: float) -> float:
            return round(time - zero, 6)

        marks: list[Mark] = [End(t(end), ended)]
        marks += [msgspec.structs.replace(mark, t=t(mark.t)) for mark in self._marks]
        for (i, j), close in watch.too_close.items():
            detail = f"{close.distance:.3f} m apart, less than {watch.min_separation:g} m"
            marks.append(Violation(t(close.time), "separation", (names[i], names[j]), detail))
        for (i, j), at in watch.collisions.items():
            marks.append(Violation(t(at), "collision", (names[i], names[j]), "their bodies touched"))
        for (i, number), at in watch.bumps.items():
            marks.append(Violation(t(at), "collision", (names[i],), f"touched obstacle {number}"))
        for name, (at, failure) in self._failed.items():
            marks.append(Violation(t(at), "ended", (name,), failure))
        is_composed = bool(self.scenario.applications or self.scenario.fleets)
        for agent in self.handles:
            for application, first in agent.first_faults.items():
                named, who = application if is_composed else "", (agent.robot.name,)
                marks.append(Violation(t(first.time), "fault", who, str(first.fault), application=named))
        for pid, agent in enumerate(self.conduct.agents):
            ended_itself = agent.robot.name not in self._failed and not agent.crashed
            if ended_itself and not self.scene.standing(pid):
                detail = "still moved or was in the air when its agent had ended"
                marks.append(Violation(t(now), "not_stopped", (agent.robot.name,), detail))
        found = watch.closest
        closest = None if len(names) < 2 else Closest(found.distance, t(found.time), found.pids)
        return RunResult(
            started=self.zero is not None,
            ended=ended,
            zero=zero,
            duration=round(max(0.0, end - zero), 3),
            marks=sorted(marks, key=lambda mark: mark.t),
            closest=closest,
            real_time_factor=round(self.conduct.factor, 4),
            late_steps=self.conduct.late,
            late_in_mission=self._late,
            steps=self.conduct.steps,
            names=tuple(names),
            waiting=waiting,
            last_lines={a.robot.name: a.last_lines(5) for a in self.conduct.agents if a.robot.name in self._failed},
            statuses={a.robot.name: a.status for a in self.conduct.agents},
            shares=self.conduct.shares,
        )

    @contextmanager
    def _interruptible(self) -> Iterator[None]:
        """Context manager in which signals end the run.

        The first Ctrl-C or SIGTERM ends the mission, the second does not wait for the safe stop, the third raises
        KeyboardInterrupt: in lockstep, the user's code may hang."""

        def count(number: int, frame: FrameType | None) -> None:
            self._interrupts += 1
            if self._interrupts > 2:
                raise KeyboardInterrupt

        before = {number: signal.signal(number, count) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
