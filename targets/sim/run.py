"""One run: launches the agents, steps the world in real time beside them, and brings everything to rest at the end."""

from __future__ import annotations

import os
import secrets
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

from targets.sim.pace import Pace
from targets.sim.progress import Progress
from targets.sim.scenario import Scenario
from targets.sim.stage import Closest, Stage
from targets.sim.supervise import Agent, free_ports, overrides
from targets.sim.trace import End, Poses, Violation
from targets.sim.world import STEP

POSE_EVERY = 12  # steps: 20 poses a second
LOOK_EVERY = 0.05  # seconds between two looks at agents
REST_WITHIN = 20.0  # seconds from the end of the mission until every agent must have ended
SETTLE = 0.5  # seconds that the world goes on after the last agent
START_TIMEOUT = 90.0


@dataclass(slots=True)
class Outcome:
    """How a run went. `zero` is the host time of t = 0: round 1's start, or without one the launch. `ended` says why
    the mission ended: completed, stopped (all agents ended by themselves), died (before the start), timeout (no
    start), interrupted. Times of `marks` and `closest` are t."""

    started: bool
    ended: str
    zero: float
    duration: float  # of the mission, seconds
    marks: list[Violation | End]
    closest: Closest | None
    real_time_factor: float
    late_steps: int
    steps: int
    waiting: dict[str, str] = field(default_factory=dict)  # robot -> what it waited for, when there was no start
    last_lines: dict[str, list[str]] = field(default_factory=dict)  # of those that failed
    statuses: dict[str, int | None] = field(default_factory=dict)

    @property
    def violations(self) -> list[Violation]:
        return [mark for mark in self.marks if isinstance(mark, Violation)]


class Run:
    """`folder` gets what the run writes: key, poses, and a folder of each robot under `robots/`."""

    def __init__(
        self, scenario: Scenario, root: Path, folder: Path, seed: int, duration: float, progress: Progress
    ) -> None:
        self._scenario = scenario
        self._folder = folder
        self._duration = duration
        self._progress = progress
        self._interrupts = 0
        self._key_file = folder / "fleet.key"
        key = secrets.token_bytes(32)
        with open(os.open(self._key_file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(key)
        self.agents: list[Agent] = []
        for robot in scenario.robots:
            own = folder / "robots" / robot.name
            own.mkdir(parents=True)
            self.agents.append(Agent(robot, root / robot.bundle, own))
        self.poses_file = folder / "poses.jsonl"
        self._poses = Poses(self.poses_file)
        try:
            self._stage = Stage(scenario, seed, key)
        except BaseException:
            self._give_up_files()
            raise
        self._pace = Pace(0.0, STEP)
        self._zero: float | None = None
        self._next_look = 0.0
        self._left: set[str] = set()  # robots that came to rest unasked
        self._failed: dict[str, tuple[float, str]] = {}  # robot -> host time and how its process failed

    def execute(self) -> Outcome:
        """From launch to rest. Raises OSError when the surroundings give way; the agents are gone then, too."""
        try:
            with self._interruptible():
                return self._execute()
        finally:
            for agent in self.agents:
                agent.kill()
            self._stage.close()
            self._give_up_files()

    def _give_up_files(self) -> None:
        self._key_file.unlink(missing_ok=True)
        self._poses.close()

    def _execute(self) -> Outcome:
        count = len(self.agents)
        free = free_ports(2 * count)
        ports, controls = free[:count], free[count:]
        launched = time.monotonic()
        robots = self._scenario.robots
        for agent, actor, control in zip(self.agents, self._stage.actors, controls, strict=True):
            laid_over = overrides(robots, ports, control, actor.overrides, self._key_file, agent.trace_file)
            agent.launch(laid_over, self._scenario.delta)
        self._pace = Pace(time.monotonic(), STEP)
        timeout = launched + self._scenario.number("start_timeout", START_TIMEOUT)
        self._progress.say("1 robot is starting" if len(robots) == 1 else f"{len(robots)} robots are starting")
        ended = self._until(lambda now: self._before_start(now, timeout))
        zero = launched if self._zero is None else self._zero
        waiting = {agent.robot.name: agent.waiting_for() for agent in self.agents} if ended else {}
        if not ended:
            self._progress.say(f"round 1 began {zero - launched:.1f} s after the launch")
            ended = self._until(lambda now: self._during_mission(now, zero))
        end = time.monotonic()
        self._rest(ended)
        return self._outcome(ended, zero, end, waiting)

    def _before_start(self, now: float, timeout: float) -> str:
        if self._interrupts:
            return "interrupted"
        starts = [agent.first_round_start for agent in self.agents if agent.first_round_start is not None]
        if starts:
            self._zero = min(starts)
            return "started"
        if self._failed or not all(agent.alive for agent in self.agents):
            return "died"
        return "timeout" if now >= timeout else ""

    def _during_mission(self, now: float, zero: float) -> str:
        if self._interrupts:
            return "interrupted"
        if now - zero >= self._duration:
            return "completed"
        return "" if any(agent.alive for agent in self.agents) else "stopped"

    def _until(self, done: Callable[[float], str]) -> str:
        """Go on until `done` says why not; "" when that is the mission's start."""
        while True:
            now = time.monotonic()
            self._advance(now)
            if now >= self._next_look:
                self._next_look = now + LOOK_EVERY
                self._look(now)
                why = done(now)
                if why:
                    return "" if why == "started" else why
            time.sleep(max(0.0, self._pace.tick(self._pace.done) - time.monotonic()))

    def _advance(self, now: float) -> None:
        first = self._pace.done
        for k in range(first, first + self._pace.due(now)):
            at = self._pace.tick(k)
            states = self._stage.step(at)
            if k % POSE_EVERY == 0:
                self._poses.write(at, states)

    def _look(self, now: float) -> None:
        for agent in self.agents:
            agent.look()
            name = agent.robot.name
            if agent.resting and name not in self._left:
                self._left.add(name)
                self._progress.say(f"{name} comes to rest by itself: {agent.resting.detail}")
            failure = agent.failure()
            if failure and name not in self._failed:
                since = agent.resting.time if agent.resting and not agent.killed else now
                self._failed[name] = (since, failure)
                self._progress.say(f"{name} {failure}")
        self._progress.show(now, self._zero, self._duration, self.agents, self._stage.watch, self._pace.factor(now))

    def _rest(self, ended: str) -> None:
        """Tell the agents to come to rest, and give them the world and the time for it."""
        self._progress.say({"completed": "the mission is over, robots come to rest"}.get(ended, f"{ended}: ending"))
        for agent in self.agents:
            agent.look()
            agent.tell_end()
        deadline = time.monotonic() + REST_WITHIN
        hurry = self._interrupts + 1

        def rested(now: float) -> str:
            over = now >= deadline or self._interrupts >= hurry
            return "yes" if over or not any(agent.alive for agent in self.agents) else ""

        self._until(rested)
        for agent in self.agents:
            agent.kill()
            while agent.look():
                pass
        settled = time.monotonic() + SETTLE
        self._until(lambda now: "yes" if now >= settled else "")

    def _outcome(self, ended: str, zero: float, end: float, waiting: dict[str, str]) -> Outcome:
        now = time.monotonic()
        watch = self._stage.watch
        names = [robot.name for robot in self._scenario.robots]

        def t(host_time: float) -> float:
            return round(host_time - zero, 6)

        marks: list[Violation | End] = [End(t(end), ended)]
        for (i, j), close in watch.too_close.items():
            detail = f"{close.distance:.3f} m apart, less than {watch.min_separation:g} m"
            marks.append(Violation(t(close.time), "separation", (names[i], names[j]), detail))
        for (i, j), at in watch.collisions.items():
            marks.append(Violation(t(at), "collision", (names[i], names[j]), "their bodies touched"))
        for (i, number), at in watch.bumps.items():
            marks.append(Violation(t(at), "collision", (names[i],), f"touched obstacle {number}"))
        for name, (at, failure) in self._failed.items():
            marks.append(Violation(t(at), "ended", (name,), failure))
        for pid, agent in enumerate(self.agents):
            fault = agent.first_fault
            if fault is not None:
                marks.append(Violation(t(fault.time), "fault", (agent.robot.name,), agent.fault_text()))
            if agent.robot.name not in self._failed and not self._stage.standing(pid):
                detail = "still moved or was in the air when its agent had ended"
                marks.append(Violation(t(now), "unrest", (agent.robot.name,), detail))
        found = watch.closest
        closest = None if len(names) < 2 else Closest(found.distance, t(found.time), found.pids)
        return Outcome(
            started=self._zero is not None,
            ended=ended,
            zero=zero,
            duration=round(max(0.0, end - zero), 3),
            marks=sorted(marks, key=lambda mark: mark.t),
            closest=closest,
            real_time_factor=round(self._pace.factor(now), 4),
            late_steps=self._pace.late,
            steps=self._pace.done,
            waiting=waiting,
            last_lines={a.robot.name: a.last_lines(5) for a in self.agents if a.robot.name in self._failed},
            statuses={a.robot.name: a.status for a in self.agents},
        )

    @contextmanager
    def _interruptible(self) -> Iterator[None]:
        """Ctrl-C and SIGTERM end the run in order; a second one does not wait for the robots to come to rest."""

        def count(number: int, frame: FrameType | None) -> None:
            self._interrupts += 1

        before = {number: signal.signal(number, count) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
