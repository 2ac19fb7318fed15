"""Agents of a composition over a network in memory, compared with the executable semantics round by round."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from types import ModuleType
from typing import Any, NamedTuple

import pytest

from benchmarks.fixtures.fleet import FakePlatform, Fleet
from koordgen.build.emit.program import program_text
from koordgen.build.emit.property import properties_text
from koordgen.build.emit.system import applications_text, module_of, with_sizes
from koordgen.lang.semantics.composition import System
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.system import InstanceStep, SystemState, initial_system, run_inits, system_round, view
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.property import Properties
from koordgen.runtime.program.runner import FAULT, LOST_CONTENTION, NO_EVENT, STOPPED, name_of
from koordgen.runtime.replication.log import Logged
from koordgen.runtime.replication.state_machine import StateMachine
from koordgen.runtime.trace.writer import RoundRecord
from koordgen.runtime.values.points import Point

QUIET = Conditions(delay=0.001, jitter=0.004)
RAN = {"", NO_EVENT, FAULT, STOPPED, LOST_CONTENTION}  # how a round ends that the runtime did not make a robot skip


def fleet_program(system: System) -> FleetProgram:
    """Return the generated programs of a composition, as the agents of its bundles load them."""
    sized = with_sizes(system)
    for application in sized.applications:
        name = f"program_{module_of(application)}"
        module = sys.modules[name] = ModuleType(name)
        vars(module)["__file__"] = f"{name}.py"
        exec(compile(program_text(application.program), f"{name}.py", "exec"), vars(module))
    scope: dict[str, Any] = {}
    exec(compile(applications_text(sized), "applications.py", "exec"), scope)
    fleet: FleetProgram = scope["FLEET"]
    return fleet


def properties_of(system: System) -> dict[str, Properties]:
    """Return the generated properties of each application. Call `fleet_program` first, which loads the programs."""
    found = {}
    for application in with_sizes(system).applications:
        module = f"program_{module_of(application)}"
        name = f"properties_{module_of(application)}"
        scope = vars(sys.modules.setdefault(name, ModuleType(name)))
        exec(compile(properties_text(application.program, (), module), f"{name}.py", "exec"), scope)
        found[application.name] = scope["PROPERTIES"]
    return found


class Applied(NamedTuple):
    """Instances whose events reached the other robots in a round, and those whose events counted."""

    arrived: frozenset[int] = frozenset()
    counted: frozenset[int] = frozenset()


class AppliedRounds(dict[int, Applied]):
    """The events of each round as the robots of a fleet applied it in the newest view.

    `of`: function that returns whether a robot's store is one of this fleet."""

    def __init__(self, of: Callable[[StateMachine], bool] = lambda state: True) -> None:
        super().__init__()
        self._of = of
        self._views: dict[int, int] = {}  # number of each view -> its first round

    def add(self, state: StateMachine, entries: Sequence[Logged], through: int) -> None:
        """Add the round that a robot has just applied. A robot that does not know a later view yet does not count."""
        view = state.view
        if not self._of(state) or any(n > view.number and since <= through for n, since in self._views.items()):
            return
        if view.number not in self._views:
            self._views[view.number] = view.since
            for round_ in [r for r in self if r >= view.since]:
                del self[round_]
        arrived = frozenset([e.instance for logged in entries for e in logged.events if e.acted])
        self[through] = Applied(arrived, frozenset([n for n in arrived if state.acted[n] == through]))


@contextmanager
def observing(rounds: AppliedRounds) -> Iterator[None]:
    """Record the events of each round as the robots apply it."""
    apply = StateMachine._apply

    def applied(state: StateMachine, entries: Sequence[Logged], through: int) -> None:
        apply(state, entries, through)
        rounds.add(state, entries, through)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(StateMachine, "_apply", applied)
        yield


class CountedEvents:
    """Events that a fleet counted, compared with the executable semantics.

    records: record of each instance (by its number) and round.
    applied: the events of each round as the robots applied it.
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self.records: dict[tuple[int, int], RoundRecord] = {}
        self.applied = AppliedRounds()

    def follow(self, rounds: int) -> Counter[str]:
        """Compare each event with that of the semantics. Return how often each kind of end of a round occurred.

        An instance that the runtime made skip a round takes no step in the semantics either. Without a record, because
        the agent was killed, the event of an instance took place if the other robots counted it."""
        state, _ = run_inits(self.system, initial_system(self.system))
        seen = Counter[str]()
        numbers = range(len(self.system.instances()))
        for round_ in range(1, rounds + 1):
            records = [self.records.get((number, round_)) for number in numbers]
            applied = self.applied.get(round_, Applied())
            skipping = {number for number in numbers if self._is_skipped(number, records[number], applied)}
            seen.update("none" if r is None else name_of(r.skipped or "event") for r in records)
            self._compare_stores(state, records, round_)
            state, steps = system_round(self.system, state, skipping)
            ran = {step.instance for step in steps if isinstance(step.step.outcome, Writes)}
            assert ran == applied.counted, (round_, ran, applied, [r and (r.event, r.skipped) for r in records])
            for step in steps:
                record = records[step.instance]
                if record is not None and step.instance not in skipping:
                    self._compare(record, step)
        return seen

    def _is_skipped(self, number: int, record: RoundRecord | None, applied: Applied) -> bool:
        """Return whether the runtime made an instance skip a round, or its event never reached the others."""
        if record is None:
            return number not in applied.arrived
        why = name_of(record.skipped or "")
        return why not in RAN or (why == LOST_CONTENTION and number not in applied.arrived)

    def _compare(self, record: RoundRecord, step: InstanceStep) -> None:
        """Compare the record of an instance with its step by the semantics."""
        effects, outcome = record.effects, step.step.outcome
        assert (effects is not None) == isinstance(outcome, Writes), (step, record)
        assert (record.skipped == FAULT) == (isinstance(outcome, Discarded)), (step, record)
        if effects is None or not isinstance(outcome, Writes):
            return
        assert record.event == step.step.event, (step, record)
        assert effects.locals == outcome.locals, (step, record)
        assert effects.shared == {**outcome.slots, **outcome.cells}, (step, record)
        assert effects.stopped == outcome.stopped, (step, record)

    def _compare_stores(self, state: SystemState, records: list[RoundRecord | None], round_: int) -> None:
        """Each instance that ran an event saw the semantics' view of the state at the round's start."""
        for number, instance in enumerate(self.system.instances()):
            record = records[number]
            if record is None or record.frame is None:
                continue
            seen = view(self.system, state, instance.application)
            meant: Mapping[str, Any] = {**seen.store.slots, **seen.store.cells}
            assert dict(record.frame.shared) == meant, (round_, number)
            assert dict(record.frame.locals) == dict(seen.robots[instance.pid].locals), (round_, number)
            assert (record.frame.pid, record.frame.n_sys) == (instance.pid, len(seen.robots))


class ComposedAgents(CountedEvents):
    """Agents of all robots of a composition. `files`: traces of each robot, one for each start."""

    def __init__(self, system: System, seed: int = 1, conditions: Conditions = QUIET) -> None:
        super().__init__(system)
        self.program = fleet_program(system)
        self.fleet = Fleet(n=system.robots, seed=seed, program=self.program, conditions=conditions)
        self.files: dict[int, list[Any]] = {robot: [] for robot in range(system.robots)}
        for robot in range(system.robots):
            self.boot(robot)

    def boot(self, robot: int) -> None:
        """Start or restart a robot's agent."""
        self.files[robot].append(self.fleet.boot(robot, FakePlatform(Point())).file)
        numbers = {
            self.program.applications[i.application].name if self.program.is_composed else "": i.number
            for i in self.program.of_robot(robot)
        }
        watch = partial(self._keep, numbers)
        self.fleet.robots[robot].agent._journal.watch(watch)

    def _keep(self, numbers: Mapping[str, int], record: RoundRecord) -> None:
        self.records[numbers[record.application], record.round] = record

    def kill(self, robot: int) -> None:
        """End a robot's agent at once, as if its process had died."""
        self.fleet.robots[robot].agent.done = True

    def run(self, rounds: int) -> ComposedAgents:
        """Run until each robot has recorded so many rounds. A robot without instances records nothing."""

        def has_recorded(robot: int) -> bool:
            own = [i.number for i in self.program.of_robot(robot)]
            agent = self.fleet.robots[robot].agent
            return agent.done or (agent.round > rounds and all((number, rounds) in self.records for number in own))

        with observing(self.applied):
            self.fleet.run(60 + rounds * self.fleet.delta, until=lambda: all(map(has_recorded, self.fleet.robots)))
        assert all(map(has_recorded, self.fleet.robots)), [r.lines[-3:] for r in self.fleet.robots.values()]
        return self
