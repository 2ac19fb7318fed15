"""Watcher: judges the properties of an application over the true states of a run.

Invariants must hold at every observation, and so must guarantees about one state; port assumptions over each round of
each robot; guarantees about a step between the values before and after each write. After a robot has left the model (it
landed by itself, died, or was removed), no property is judged on its behaviour.

A round's observations are the physics steps from its start to the start of the next round. At each, bodies have their
positions at that step, all other values those after the round's events (before them at the step where both rounds
meet). They are judged once all robots have recorded the next round."""

from __future__ import annotations

import math
import sys
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from koordgen.runtime.program.extern import BadExtern
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.property import (
    UNKNOWN,
    Assumption,
    Known,
    Outcome,
    Properties,
    judged,
)
from koordgen.runtime.trace.schema import InitRecord, Phase, Round, TraceRecord, Verdict, ViewRecord, Violation
from koordgen.runtime.values.points import Point, Pose
from targets.sim.base.bodies import BodyState
from targets.sim.base.programs import load_programs, with_outer
from targets.sim.judging.batch import Batch
from targets.sim.judging.guarantees import StepGuarantees, WatchedApplication
from targets.sim.judging.judge import JudgedProperty, Of, all_of
from targets.sim.judging.windows import Came, Windows
from targets.sim.run.run_interface import AgentHandle, WatchedRun
from targets.sim.trace.store_names import qualified_name
from targets.sim.trace.truth import Truth

PATIENCE = 3.0  # seconds after a round's end for which its records are awaited
MOST_KEPT = 4800  # number of physics steps that are kept before round 1 begins
GENERATED = ("program", "properties", "applications", "squad")  # modules of bundles; of applications `program_NAME`
_PORTS: dict[str, Callable[[BodyState], Any]] = {
    "position": lambda state: Point(*state.position),
    "velocity": lambda state: Point(*state.velocity),
    "pose": lambda state: Pose(Point(*state.position), state.yaw),
}
_CAME: dict[Outcome, Came] = {"held": "h", "violated": "v", "no value": "n", "unknown": "u"}


def load_fleet(root: Path, robots: int, driven: Collection[str] = (), outer: int = 0) -> list[WatchedApplication]:
    """Return all applications of the sim bundle at `root`, or of one fleet in it.

    `driven`: modules served by the user's own drivers. `outer`: number of robots of the outer fleet."""
    with _imports_from(root):
        program, found = load_programs(root, driven)
        fleet = program if isinstance(program, FleetProgram) else FleetProgram.alone(program, robots)
        fleet = with_outer(root, fleet, outer)
        for application in fleet.applications:
            if application.program.library is not None:
                with suppress(BadExtern):  # the robots report the error; a property that calls the library has no value
                    application.program.library.load()
        all_found = [found] if isinstance(found, Properties) else list(found.values())
        return [WatchedApplication(fleet, number, own) for number, own in enumerate(all_found)]


@contextmanager
def _imports_from(root: Path) -> Iterator[None]:
    """Context in which programs and properties are imported from `root`, also if those of another bundle were."""
    sys.path.insert(0, str(root))
    try:
        for name in [name for name in sys.modules if name.partition("_")[0] in GENERATED]:
            sys.modules.pop(name, None)
        yield
    finally:
        sys.path.remove(str(root))


@dataclass(slots=True)
class _Observation:
    at: float
    states: list[BodyState]
    ports: dict[str, list[Any]] = field(default_factory=dict)  # measured ports, computed on demand


class Watcher:
    """Companion that judges the properties of an application in a run.

    `names`: names of all robots. `seconds`: time of the host that judging took. With `windows`, it judges all windows
    of all robots, also after an assumption was violated; the verdicts are the same. Without `of`, the fleet has only
    one application. Robots are numbered by their pids in the application, unless a name says `robot`."""

    def __init__(
        self,
        found: Properties,
        names: tuple[str, ...],
        delta: float,
        windows: Windows | None = None,
        of: WatchedApplication | None = None,
    ) -> None:
        self.seconds = 0.0
        self._windows = windows
        self._of = of or WatchedApplication.only(found, len(names))
        self._members, self._robots = self._of.members, len(names)
        self._found, self._delta, self._n = found, delta, len(self._members)
        self._names = tuple([names[robot] for robot in self._members])
        self._watched = all_of(found, self._n, self._of.name)
        self._steps = StepGuarantees(self._watched, found, self._of, names)
        self._truth = Truth(self._of.fleet, self._of.number, self._steps.variables)
        self._known = found.fleet(self._n, None)
        self._step = found.step(self._n, None)
        self._observations: deque[_Observation] = deque()
        self._out: dict[int, float] = {}  # robot -> time when it left the model
        self._view = ViewRecord(0, 0, (0,) * self._robots)
        self._began = False
        self._arrays: dict[str, NDArray[Any]] = {}  # measured arrays of the present round
        self._stopped: set[int] = set()  # instances that have stopped, by their numbers
        self._until = math.inf  # the mission's end: robots were told to stop safely, or all have stopped
        self._loops: dict[int, tuple[Violation, str]] = {}  # false loop invariants by line; with the event

    @property
    def moving(self) -> set[str]:
        """Lines ("app.koord:12") of the properties that read positions of bodies."""
        return {watched.line for watched in self._watched if watched.moving}

    def launched(self, run: WatchedRun) -> None:
        self._run = run

    def step(self, at: float, states: list[BodyState]) -> None:
        began = time.perf_counter()
        if at <= self._until:
            if any(agent.asked_to_end for agent in self._run.conduct.agents):
                self._until = at
            self._observations.append(_Observation(at, [states[robot] for robot in self._members]))
            if self._run.zero is None and len(self._observations) > MOST_KEPT:
                self._observations.popleft()
        self.seconds += time.perf_counter() - began

    def heard(self, agent: AgentHandle, records: list[TraceRecord]) -> None:
        began = time.perf_counter()
        robot, own = agent.robot.pid, self._of.name
        for record in records:
            match record:
                case InitRecord() | Round():
                    self._truth.hear(robot, record)
                    if not own or record.application == own:
                        self._note_loops(agent.robot.name, record)
                    if record.stopped:
                        self._stopped.add(self._truth.number(robot, record))
                case Phase(phase="stopping") if not agent.asked_to_end:
                    self._rests(robot, record.time)
                case ViewRecord() if record.number > self._view.number:
                    self._view = record
                case _:
                    pass
        for other in self._run.conduct.agents:
            if not other.alive and not other.asked_to_end:
                self._out.setdefault(other.robot.pid, self._run.conduct.now())
        self._judge(self._ready)
        self.seconds += time.perf_counter() - began

    def _note_loops(self, robot: str, record: InitRecord | Round) -> None:
        """Mark each loop invariant that was false in a robot's event, once."""
        where = f"the event {record.event}" if isinstance(record, Round) else "init"
        for line in record.violated:
            if line not in self._loops and record.time <= self._until:
                why = f"in {where} of {robot} it was false or had no value"
                named, at = qualified_name(self._of.name, f"line {line}"), f"{self._found.program.source}:{line}"
                text = f"loop invariant {named} does not hold: {why}"
                violation = Violation(
                    record.time, "property", (robot,), text, f"line {line}", at, application=self._of.name
                )
                self._loops[line] = violation, why
                self._run.mark(violation)

    def _rests(self, robot: int, at: float) -> None:
        """Handle a safe stop that was not commanded.

        If all instances on all robots have stopped, it is the mission's end. Otherwise the robot leaves the model."""
        if all(i.number in self._stopped or i.robot in self._out for i in self._of.fleet.instances):
            self._until = min(self._until, at)
        else:
            self._out.setdefault(robot, at)

    def end(self, at: float) -> None:
        began = time.perf_counter()
        self._judge(lambda round_: True)
        at = min(at, self._until)
        lost = ", ".join(self._names[pid] for pid in self._lost(at))
        application = self._of.name
        for watched in self._watched:
            self._run.mark(watched.verdict(at, self._run.zero, lost))
        for found, why in self._loops.values():
            since = None if self._run.zero is None else round(found.t - self._run.zero, 6)
            judged_as = Verdict(at, "loop invariant", found.name, found.line, "violated", since, found.robots, why)
            self._run.mark(replace(judged_as, application=application))
        for left in self._found.unchecked:
            line = f"{self._found.program.source}:{left.line}"
            verdict = Verdict(at, left.kind, left.name, line, "unchecked", detail=left.why, application=application)
            self._run.mark(verdict)
        self.seconds += time.perf_counter() - began

    def _ready(self, round_: int) -> bool:
        """Return whether all records of a round have arrived, or were awaited long enough."""
        zero = self._run.zero
        if zero is not None and self._observations[-1].at - zero > round_ * self._delta + PATIENCE:
            return True
        return all(self._truth.last_recorded(r) >= round_ or self._absent(r, round_) for r in range(self._robots))

    def _absent(self, robot: int, round_: int) -> bool:
        return robot in self._out or (self._view.members[robot] < 0 and self._view.since <= round_)

    def _judge(self, ready: Callable[[int], bool]) -> None:
        """Judge all rounds whose observations are complete and whose next round is recorded."""
        zero = self._run.zero
        while len(self._observations) > 1 and self._observations[-1].at > self._until:
            self._observations.pop()
        while zero is not None and self._observations:
            end = zero + max(0, self._truth.round + 1) * self._delta
            if self._observations[-1].at < end or not ready(self._truth.round + 2):
                return
            self._window(zero, end)

    def _window(self, zero: float, end: float) -> None:
        """Judge the next round. Its observations are those up to `end`, both ends included."""
        if not self._began:
            self._began = True
            self._truth.begin()
            while len(self._observations) > 1 and self._observations[1].at <= zero:
                self._observations.popleft()
            self._fleet("initially", [self._observations[0]])
        self._truth.advance()
        self._arrays = {}
        observations = [self._observations.popleft()]
        while self._observations and self._observations[0].at <= end:
            observations.append(self._observations.popleft())
        self._observations.appendleft(observations[-1])  # the next round begins at this observation
        self._fleet("invariant", observations)
        self._fleet("guarantee", observations)
        for violation in self._steps.judge(self._truth, observations[0].at, self._removed()):
            self._run.mark(violation)
        if self._truth.round > 0:
            self._assumptions(observations)

    def _removed(self) -> set[int]:
        """Return the numbers of instances of robots that the fleet has removed before the present round."""
        view = self._view
        gone = {robot for robot in range(self._robots) if view.members[robot] < 0 and view.since <= self._truth.round}
        return {instance.number for instance in self._of.fleet.instances if instance.robot in gone}

    def _fleet(self, of: Of, observations: list[_Observation]) -> None:
        asked = [w for w in self._watched if w.of == of and not w.is_step and not w.decided]
        if not asked:
            return
        self._known.put(self._truth.values)
        due = self._due(asked, observations)
        lost: list[int] = []
        for k in sorted(due):
            observation = observations[k]
            if lost != (lost := self._lost(observation.at)):
                self._known.put(self._without(lost))
            self._known.put(self._ports(observation))
            for watched in due[k]:
                if not watched.decided:
                    outcome, why = judged(watched.what.holds, self._known)
                    self._note(watched, outcome, observation.at, why, self._known)

    def _due(self, asked: list[JudgedProperty], observations: list[_Observation]) -> dict[int, list[JudgedProperty]]:
        """Return the properties to evaluate one by one, by observation.

        A property that reads positions is evaluated at all observations, except those at which its screening shows that
        it holds."""
        due: dict[int, list[JudgedProperty]] = {}
        batch: Batch | None = None
        for watched in asked:
            which = list(range(len(observations))) if watched.moving else [0]
            screening = watched.screening
            if watched.moving and screening is not None and not self._lost(observations[-1].at):
                batch = batch or Batch(len(observations), self._n, self._measured(observations), self._truth.values)
                which = batch.unsure(screening)
                watched.observations += len(observations) - len(which)
            for k in which:
                due.setdefault(k, []).append(watched)
        return due

    def _measured(self, observations: list[_Observation]) -> dict[str, NDArray[Any]]:
        """Return the positions and velocities of a round, for a Batch."""
        if not self._arrays:
            for name in self._found.measured:
                kind = name.rpartition(".")[2]
                if kind in ("position", "velocity"):
                    rows = [[getattr(state, kind) for state in observation.states] for observation in observations]
                    self._arrays[name] = np.array(rows)
        return self._arrays

    def _without(self, lost: list[int]) -> dict[str, list[Any]]:
        """Return the values of ports, UNKNOWN for robots that are out of the model."""
        values = self._truth.values
        ports = [p.name for p in self._found.program.ports if p.name in values]
        return {name: [UNKNOWN if pid in lost else v for pid, v in enumerate(values[name])] for name in ports}

    def _assumptions(self, observations: list[_Observation]) -> None:
        if self._windows is not None:
            self._record_movement(self._windows, observations)
        for watched in [w for w in self._watched if w.of == "assume" and (self._windows or not w.decided)]:
            due = self._due_of_each(watched, observations)
            for pid in range(self._n):
                if self._windows is not None:
                    looked = [observations[k] for k in due[pid]]
                    self._windows.put(pid, self._assumption(watched, pid, observations[0], looked) if looked else "h")
                elif due[pid] and not watched.decided:
                    self._assumption(watched, pid, observations[0], [observations[k] for k in due[pid]])

    def _record_movement(self, windows: Windows, observations: list[_Observation]) -> None:
        windows.begin(self._truth.round)
        targets = self._truth.values.get(windows.goal)
        if targets is not None:
            places, velocities = (
                np.array([[getattr(state, kind) for state in observation.states] for observation in observations])
                for kind in ("position", "velocity")
            )
            windows.moved(places, velocities, targets, self._lost(observations[-1].at))

    def _due_of_each(self, watched: JudgedProperty, observations: list[_Observation]) -> list[list[int]]:
        """Return by pid the observations at which an assumption must be evaluated, as `_due` does."""
        what, last = watched.what, len(observations) - 1
        assert isinstance(what, Assumption)
        sampled = bool(self._sampled(what))
        if what.screening is None or sampled or not watched.moving or self._lost(observations[last].at):
            return [[last] if sampled or not watched.moving else list(range(last + 1))] * self._n
        measured = {f"{name}'": places for name, places in self._measured(observations).items()}
        values = {**self._truth.values, **self._ports(observations[0])}
        values |= {f"{p.name}'": values[p.name] for p in self._found.program.ports if p.direction == "actuator"}
        unsure = Batch(last + 1, self._n, measured, values).unsure_of(what.screening)
        watched.observations += 0 if watched.decided else (last + 1) * self._n - len(unsure)
        return [[k for k, p in unsure if p == pid] for pid in range(self._n)]

    def _assumption(
        self, watched: JudgedProperty, pid: int, first: _Observation, observations: list[_Observation]
    ) -> Came:
        """Evaluate an assumption of one robot in one round.

        Unprimed ports have their values right after the program's step, primed ones those of each observation, until
        the assumption does not hold."""
        assumption, step, values = watched.what, self._step, self._truth.values
        assert isinstance(assumption, Assumption)
        if self._is_out(pid, observations[-1].at):
            watched.left = observations[-1].at if watched.left is None else watched.left
            return "o"
        before = self._ports(first)
        ports = [name for name in step.one if not name.endswith("'")]
        step.pid, step.asked = pid, self._truth.calls(pid)
        step.put({name: before[name][pid] if name in before else values[name][pid] for name in ports})
        actuators = {p.name for p in self._found.program.ports if p.direction == "actuator"}
        step.put({f"{name}'": values[name][pid] for name in ports if name in actuators})
        others = {n: self._truth.sensed(pid, n, self._truth.round + 1) for n in self._sampled(assumption)}
        if UNKNOWN in others.values():
            return "u"
        step.put({f"{name}'": value for name, value in others.items()})
        came: Came = "h" if assumption.asked(step) else "-"
        for observation in observations:
            step.put({f"{name}'": held[pid] for name, held in self._ports(observation).items()})
            outcome, why = judged(assumption.holds_of_calls, step)
            if not watched.decided:
                self._note(watched, outcome, observation.at, why, step)
            if outcome in ("violated", "no value"):
                return _CAME[outcome]
            came = _CAME[outcome] if outcome == "unknown" else came
        return came

    def _sampled(self, assumption: Assumption) -> list[str]:
        """Return the sensors that an assumption reads primed and only the robot measures.

        Known at its next round."""
        primed = [name[:-1] for name in assumption.reads if name.endswith("'")]
        sensors = {p.name for p in self._found.program.ports if p.direction == "sensor"}
        return [name for name in primed if name in sensors and name not in self._found.measured]

    def _ports(self, observation: _Observation) -> dict[str, list[Any]]:
        """Return the true values of the measured ports."""
        if not observation.ports:
            lost = self._lost(observation.at)
            for name in self._found.measured:
                measure = _PORTS[name.rpartition(".")[2]]
                observation.ports[name] = [
                    UNKNOWN if pid in lost else measure(state) for pid, state in enumerate(observation.states)
                ]
        return observation.ports

    def _lost(self, at: float) -> list[int]:
        """Return the pids of robots that are out of the model."""
        if not self._out and min(self._view.members) >= 0:
            return []
        return [pid for pid in range(self._n) if self._is_out(pid, at)]

    def _is_out(self, pid: int, at: float) -> bool:
        robot = self._members[pid]
        since = self._out.get(robot)
        if since is not None and at >= since:
            return True
        zero = self._run.zero
        removed = self._view.members[robot] < 0 and zero is not None
        return removed and at >= (zero or 0.0) + (self._view.since - 1) * self._delta

    def _note(self, watched: JudgedProperty, outcome: Outcome, at: float, why: str, known: Known) -> None:
        violation = watched.note(outcome, at, why, known, self._names, bool(self._lost(at)))
        if violation is not None:
            self._run.mark(violation)
