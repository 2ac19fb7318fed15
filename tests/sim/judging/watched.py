"""A fleet of agents on a simulated clock, in a world of first-order robots, with a Watcher beside it: everything but
physics and processes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from benchmarks.fixtures.fleet import NAMES, Fleet
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.trace import schema
from koordgen.runtime.trace.schema import Mark, Phase, Round, TraceRecord, Verdict, Violation
from targets.sim.base.bodies import BodyState
from targets.sim.judging import watch
from targets.sim.judging.windows import Windows
from targets.sim.run.run import Companion
from tests.sim.run.fake_fleet import beside

STEP = 1 / 240
LOOK = 12  # steps

# Robot 1 keeps itself between its neighbours, all count together, each in turn.
LINE = """\
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target
  assume distance(position', target) <= distance(position, target) + 0.3
  assume reached or distance(position, target) > 0.01
allread:
  Point x[N_SYS]
  int turns[N_SYS]
allwrite: int sum
local: int mine
init:
  x[pid] = Motion.position
Add:
  pre: mine < 6 and mine <= pid + 4
  eff: atomic:
    sum += 1
    mine += 1
Go:
  pre: pid == 1 and N_SYS > 2
  eff:
    Motion.target = (x[0] + x[2]) / 2
    x[pid] = Motion.position
    turns[pid] += 1
"""


@dataclass
class Agent:
    """What a Watcher wants to know of one."""

    robot: Any
    asked_to_end: bool = False
    alive: bool = True
    stopping: Phase | None = None
    read: int = 0


@dataclass
class Run:
    """Stands for a `run.Run`."""

    agents: list[Agent]
    fleet: Fleet
    zero: float | None = None
    marks: list[Mark] = field(default_factory=list)
    finished: str = ""

    @property
    def conduct(self) -> Any:
        return SimpleNamespace(agents=self.agents, now=lambda: self.fleet.time.time)

    def mark(self, mark: Mark) -> None:
        self.marks.append(mark)

    def finish(self, why: str) -> None:
        self.finished = self.finished or why


class Watched:
    """`run` goes on for so many seconds; `moved` may put bodies elsewhere than the robots believe; `told`: of all
    windows."""

    def __init__(
        self, root: Path, text: str, n: int = 3, seed: int = 1, conditions: Conditions | None = None, told: bool = False
    ) -> None:
        beside(root, text)
        self.found = watch.load_fleet(root, 1)[0].properties
        program = self.found.program
        self.fleet = Fleet(n, seed, conditions, program, clocks=lambda pid, base: base).boot_all()
        self.files = {pid: robot.file for pid, robot in self.fleet.robots.items()}
        robots = [SimpleNamespace(name=name, target="none", sim=SimpleNamespace(fidelity="made")) for name in NAMES[:n]]
        scenario: Any = SimpleNamespace(app="a", program_hash="0", delta=self.fleet.delta, robots=robots)
        self.windows = Windows(self.found, scenario, seed) if told else None
        self.watcher = watch.Watcher(self.found, NAMES[:n], self.fleet.delta, self.windows)
        agents = [Agent(SimpleNamespace(pid=pid, name=NAMES[pid])) for pid in range(n)]
        self.run_ = Run(agents, self.fleet)
        self.companions: list[Companion[Any]] = [self.watcher]
        self.moved: Callable[[int, float, Any], Any] = lambda pid, t, place: place
        self.watcher.launched(self.run_)
        self._steps = 0

    def run(self, seconds: float) -> Watched:
        for _ in range(round(seconds / STEP)):
            self.fleet.run(STEP)
            now, zero = self.fleet.time.time, self.run_.zero
            t = -1.0 if zero is None else now - zero
            places = [self.moved(pid, t, r.platform.position) for pid, r in sorted(self.fleet.robots.items())]
            states = [BodyState((p.x, p.y, p.z), (0.0, 0.0, 0.0), 0.0, 0.0) for p in places]
            for companion in self.companions:
                companion.step(now, states)
            self._steps += 1
            if self._steps % LOOK == 0:
                self.look()
            if self.run_.finished:
                break
        return self

    def look(self) -> None:
        for agent in self.run_.agents:
            data = self.files[agent.robot.pid].getvalue()
            end = data.rfind(b"\n") + 1
            lines, agent.read = data[agent.read : end].splitlines(), end
            records = [r for line in lines if b'"header"' not in line[:40] and (r := schema.decoded(line)) is not None]
            self._take(agent, records)
            for companion in self.companions:
                companion.heard(agent, records)  # type: ignore[arg-type]

    def _take(self, agent: Agent, records: list[TraceRecord]) -> None:
        for record in records:
            if isinstance(record, Round) and self.run_.zero is None:
                self.run_.zero = record.time - record.late - (record.round - 1) * self.fleet.delta
            if isinstance(record, Phase) and record.phase == "stopping" and not agent.asked_to_end:
                agent.stopping = record
        agent.alive = agent.alive and not self.fleet.robots[agent.robot.pid].agent.done

    def end(self) -> dict[str, Verdict]:
        """All verdicts, by name, or by what they are of."""
        self.look()
        for agent in self.run_.agents:
            agent.asked_to_end = True
        for companion in self.companions:
            companion.end(self.fleet.time.time)
        return {mark.name or mark.of: mark for mark in self.run_.marks if isinstance(mark, Verdict)}

    def violations(self) -> list[Violation]:
        return [mark for mark in self.run_.marks if isinstance(mark, Violation)]

    def t(self, mark: Violation) -> float:
        assert self.run_.zero is not None
        return mark.t - self.run_.zero
