"""Agents of a composition over a network in memory, compared with the executable semantics round by round."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Mapping
from types import ModuleType
from typing import Any

from benchmarks.fixtures.fleet import FakePlatform, Fleet
from koordgen.build.emit.program import program_text
from koordgen.build.emit.system import applications_text, module_of, with_sizes
from koordgen.lang.semantics.composition import System
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.system import SystemState, initial_system, run_inits, system_round, view
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.runner import FAULT, LOST_CONTENTION, NO_EVENT, STOPPED, name_of
from koordgen.runtime.trace.writer import RoundRecord
from koordgen.runtime.values.points import Point

QUIET = Conditions(delay=0.001, jitter=0.004)
RAN = {None, NO_EVENT, FAULT, STOPPED, LOST_CONTENTION}  # how a round ends that the runtime did not make a robot skip


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


class ComposedAgents:
    """Agents of all robots, after so many rounds: `records[application][pid][round]`, with `init` left out."""

    def __init__(self, system: System, rounds: int, seed: int = 1, conditions: Conditions = QUIET) -> None:
        self.system, self.program = system, fleet_program(system)
        self.fleet = Fleet(n=system.robots, seed=seed, program=self.program, conditions=conditions)
        for robot in range(system.robots):
            self.fleet.boot(robot, FakePlatform(Point()))
        self.fleet.run(60 + rounds * self.fleet.delta, until=lambda: self._recorded(rounds))
        assert self._recorded(rounds), [robot.lines[-3:] for robot in self.fleet.robots.values()]
        self.records = [
            [self._of(application.name, robot) for robot in application.members] for application in system.applications
        ]

    def _of(self, name: str, robot: int) -> dict[int, RoundRecord]:
        own = name if self.program.is_composed else ""
        return {r.round: r for r in self.fleet.robots[robot].records if r.application == own}

    def _recorded(self, rounds: int) -> bool:
        return all(
            (robot.agent.done or robot.agent.round > rounds + 3) if not self.program.of_robot(place)
            else robot.agent.done or (robot.records and robot.records[-1].round > rounds + 1)
            for place, robot in self.fleet.robots.items()
        )  # fmt: skip

    def follow(self, rounds: int) -> Counter[str]:
        """Compare each event with that of the semantics. Count how the rounds of all instances ended.

        An instance that the runtime made skip a round takes no step in the semantics either."""
        state, _ = run_inits(self.system, initial_system(self.system))
        seen = Counter[str]()
        for round_ in range(1, rounds + 1):
            records = [r.get(round_) for of_members in self.records for r in of_members]
            seen.update("event" if r is None or r.skipped is None else name_of(r.skipped) for r in records)
            skipping = {k for k, r in enumerate(records) if r is None or (r.skipped and name_of(r.skipped) not in RAN)}
            self._compare_stores(state, records, round_)
            state, steps = system_round(self.system, state, skipping)
            for step in steps:
                record, outcome = records[step.instance], step.step.outcome
                if record is None or step.instance in skipping:
                    continue
                ran = record.effects
                assert (ran is not None) == isinstance(outcome, Writes), (round_, step, record)
                if ran is not None and isinstance(outcome, Writes):
                    assert record.event == step.step.event, (round_, step, record)
                    added = {i.pid for i in self._program(step.instance).imports}
                    assert {k: v for k, v in ran.locals.items() if k not in added} == {
                        k: v for k, v in outcome.locals.items() if k not in added
                    }, (round_, step, record)  # fmt: skip
                    assert dict(ran.shared) == {**outcome.slots, **outcome.cells}, (round_, step, record)
                    assert ran.stopped == outcome.stopped
        return seen

    def _program(self, number: int) -> Any:
        return self.system.applications[self.system.instances()[number].application].program

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
