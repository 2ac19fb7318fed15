"""One run, on either clock: launches the agents, steps the world beside them, and brings all to rest at the end."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Protocol

import msgspec

from koordgen.runtime.trace.schema import End, Mark, TraceRecord, Violation
from targets.sim.base.bodies import BodyState
from targets.sim.base.scenario import Scenario
from targets.sim.physics.world import STEP
from targets.sim.run.crew import Agent, Conduct
from targets.sim.run.progress import Progress
from targets.sim.run.stage import Closest
from targets.sim.trace.files import Poses


class Companion(Protocol):
    """Goes along with a run: `Run.companions`. Raises nothing but OSError, which ends the run."""

    def launched(self, run: Run) -> None:
        """All is made, agents are about to start. `run.stage` has the bodies and devices, `run.conduct.agents` the
        agents with their `crash`, `restart`, `freeze` and `monitors`, `run.mark` takes what belongs into the trace."""
        ...

    def step(self, at: float, states: list[BodyState]) -> None:
        """Each physics step: the truth at `at`, by pid. That is on the run's clock; t is `run.t(at)`, None as long as
        round 1 has not been heard of. What is changed here counts from the next step on."""
        ...

    def heard(self, agent: Agent, records: list[TraceRecord]) -> None:
        """Every 0.05 s, for an agent that has traced something: its records in their order."""
        ...

    def end(self, at: float) -> None:
        """All robots are at rest, and nothing more will come; `mark` still takes what was found."""
        ...


POSE_RATE = 20.0  # poses a second, unless the setting `pose_rate` says otherwise
LOOK_EVERY = 0.05  # seconds between two looks at the agents
REST_WITHIN = 20.0  # seconds from the end of the mission until every agent must have ended
SETTLE = 0.5  # seconds that the world goes on after the last agent
START_TIMEOUT = 90.0


@dataclass(slots=True)
class Outcome:
    """How a run went. `zero` is the time of t = 0 on the run's clock: round 1's start, or without one the launch.
    `ended` says why the mission ended: completed, stopped (all agents ended by themselves), died (before the start),
    timeout (no start), interrupted, idle (see idle.py). Times of `marks` and `closest` are t."""

    started: bool
    ended: str
    zero: float
    duration: float  # of the mission, seconds
    marks: list[Mark]
    closest: Closest | None
    real_time_factor: float
    late_steps: int
    steps: int
    late_in_mission: int = 0  # of the late steps: at a start and an end processes need more than in between
    waiting: dict[str, str] = field(default_factory=dict)  # robot -> what it waited for, when there was no start
    last_lines: dict[str, list[str]] = field(default_factory=dict)  # of those that failed
    statuses: dict[str, int | None] = field(default_factory=dict)
    shares: dict[str, float] = field(default_factory=dict)  # of the processor's time, by part, in lockstep
    host_waits: dict[str, float] = field(default_factory=dict)  # see host_load.HostLoad.totals

    @property
    def violations(self) -> list[Violation]:
        return [mark for mark in self.marks if isinstance(mark, Violation)]


class Run:
    """`folder` gets what the run writes: poses, and a folder of each robot under `robots/`. All times here are those of
    the run's clock, `conduct.now`; `zero` is when round 1 began, None before. Owns `conduct` and `stage`."""

    def __init__(self, scenario: Scenario, conduct: Conduct, folder: Path, duration: float, progress: Progress) -> None:
        self.scenario = scenario
        self.conduct = conduct
        self.companions: list[Companion] = []
        self.zero: float | None = None
        self.poses_file = folder / "poses.jsonl"
        self._duration = duration
        self._progress = progress
        self._interrupts = 0
        self._finished = ""  # why the mission was ended by a companion
        self._steps = 0
        self._pose_every = max(1, round(1 / (STEP * scenario.number("pose_rate", POSE_RATE))))
        self._late = 0  # steps of the world, during the mission
        self._marks: list[Mark] = []  # with times of the run's clock
        self._next_look = 0.0
        self._left: set[str] = set()  # robots that came to rest unasked
        self._noted: set[tuple[int, str]] = set()  # contacts in logs: the pid, and what it touched
        self._failed: dict[str, tuple[float, str]] = {}  # robot -> when and how its agent failed
        try:
            self.stage = conduct.stage()
            self._poses = Poses(self.poses_file)
        except BaseException:
            conduct.close()
            raise

    def mark(self, mark: Mark) -> None:
        """What belongs into the merged trace; its `t` is a time of the run's clock here."""
        self._marks.append(mark)

    @property
    def marks(self) -> Sequence[Mark]:
        """What companions marked so far, with times of the run's clock."""
        return self._marks

    @property
    def interrupted(self) -> bool:
        """True if a signal has asked the run to end."""
        return self._interrupts > 0

    def finish(self, why: str) -> None:
        """End the mission: `Outcome.ended` will say why."""
        self._finished = why

    def t(self, at: float) -> float | None:
        """Seconds since the start of round 1, None before that is known."""
        return None if self.zero is None else at - self.zero

    def execute(self) -> Outcome:
        """From launch to rest. Raises OSError when the surroundings give way; the agents are gone then, too."""
        try:
            with self._interruptible():
                return self._execute()
        finally:
            self.conduct.close()
            self.stage.close()
            self._poses.close()

    def _execute(self) -> Outcome:
        agents, count = self.conduct.agents, len(self.conduct.agents)
        for companion in self.companions:
            companion.launched(self)
        launched = self.conduct.now()
        self.conduct.launch(self.stage)
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
        self._rest(ended)
        now = self.conduct.now()
        for companion in self.companions:
            companion.end(now)
        return self._outcome(ended, zero, end, waiting)

    def _before_start(self, now: float, timeout: float) -> str:
        if self._interrupts:
            return "interrupted"
        starts = [agent.first_round_start for agent in self.conduct.agents if agent.first_round_start is not None]
        if starts:
            self.zero = min(starts)
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
        """Go on until `done` says why not; "" when that is the mission's start."""
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
        """One step of the world."""
        states = self.stage.step(at)
        if self._steps % self._pose_every == 0:
            self._poses.write(at, states)
        self._steps += 1
        for companion in self.companions:
            companion.step(at, states)

    def _note_contacts(self) -> None:
        """Write each first contact into the logs of the robots that touched: a real robot would not know of it."""
        agents, watch = self.conduct.agents, self.stage.watch
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
        for agent in self.conduct.agents:
            self._hear(agent)
            name = agent.robot.name
            if agent.resting and name not in self._left:
                self._left.add(name)
                self._progress.say(f"{name} comes to rest by itself: {agent.resting.detail}")
            failure = agent.failure()
            if failure and name not in self._failed:
                since = agent.resting.time if agent.resting and not agent.killed else now
                self._failed[name] = (since, failure)
                self._progress.say(f"{name} {failure}")
        self._progress.show(now, self.zero, self._duration, self.conduct.agents, self.stage.watch, self.conduct.factor)

    def _hear(self, agent: Agent) -> bool:
        """Take what an agent has traced; whether there was anything."""
        records = agent.look()
        if records:
            for companion in self.companions:
                companion.heard(agent, records)
        return bool(records)

    def _rest(self, ended: str) -> None:
        """Tell the agents to come to rest, and give them the world and the time for it."""
        if ended == "completed":
            self._progress.step("the mission is over, robots come to rest")
        else:
            self._progress.say(f"{ended}: ending")
        for agent in self.conduct.agents:
            self._hear(agent)
            agent.tell_end()
        deadline = self.conduct.now() + REST_WITHIN
        hurry = self._interrupts + 1

        def rested(now: float) -> str:
            over = now >= deadline or self._interrupts >= hurry
            return "yes" if over or not any(agent.alive for agent in self.conduct.agents) else ""

        self._until(rested)
        for agent in self.conduct.agents:
            agent.kill()
            while self._hear(agent):
                pass
        settled = self.conduct.now() + SETTLE
        self._until(lambda now: "yes" if now >= settled else "")

    def _outcome(self, ended: str, zero: float, end: float, waiting: dict[str, str]) -> Outcome:
        now = self.conduct.now()
        watch = self.stage.watch
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
        for pid, agent in enumerate(self.conduct.agents):
            fault = agent.first_fault
            if fault is not None:
                marks.append(Violation(t(fault.time), "fault", (agent.robot.name,), agent.fault_text()))
            ended_itself = agent.robot.name not in self._failed and not agent.crashed
            if ended_itself and not self.stage.standing(pid):
                detail = "still moved or was in the air when its agent had ended"
                marks.append(Violation(t(now), "unrest", (agent.robot.name,), detail))
        found = watch.closest
        closest = None if len(names) < 2 else Closest(found.distance, t(found.time), found.pids)
        return Outcome(
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
            waiting=waiting,
            last_lines={a.robot.name: a.last_lines(5) for a in self.conduct.agents if a.robot.name in self._failed},
            statuses={a.robot.name: a.status for a in self.conduct.agents},
            shares=self.conduct.shares,
        )

    @contextmanager
    def _interruptible(self) -> Iterator[None]:
        """Ctrl-C and SIGTERM end the run in order; a second one does not wait for robots to come to rest, a third
        for nothing: in lockstep a user's code may be what it hangs in. Raises KeyboardInterrupt then."""

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
