"""Steps of the environment of a system: one body for each robot, whose ports its applications share.

The values of an environment belong to robots, by their places in the fleet file. The assumptions of all applications of
a robot hold together, each with its own pid and number of members.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product
from typing import Any

from koordgen.fleet.yaml_reader import Report
from koordgen.lang.ir import decl
from koordgen.lang.node import replace
from koordgen.lang.semantics.composition import System
from koordgen.lang.semantics.values import Value
from koordgen.lang.source import Source
from koordgen.verify.explore.environment import (
    Environment,
    is_allowed,
    nearby,
    possible_answers,
    seen_from_position,
)
from koordgen.verify.explore.environment_file import check_completeness, environment
from koordgen.verify.explore.machine import Answer, Packed
from koordgen.verify.explore.system.machine import SystemMachine
from koordgen.verify.replay.functions import semantic_value


def body(system: System) -> decl.Program:
    """Return a program that declares all ports of all applications, and their records, and nothing else."""
    found: dict[str, decl.Module] = {}
    for application in system.applications:
        for module in application.program.modules:
            known = found.get(module.name)
            ports = {} if known is None else {port.name: port for port in known.ports}
            ports |= {port.name: port for port in module.ports if port.name not in ports}
            found[module.name] = replace(known or module, ports=tuple(ports.values()), assumptions=())
    records = {record.type.name: record for a in system.applications for record in a.program.records}
    return replace(
        system.applications[0].program, records=tuple(records.values()), modules=tuple(found.values()), params=(),
        shared=(), locals=(), locks=(), events=(), properties=(), exports=(), imports=(),
    )  # fmt: skip


def system_environment(system: System, source: Source | None, report: Report) -> Environment | None:
    """Return the environment that the file `source` describes for a system; None if the file has a mistake.

    Its `robots` are places in the fleet file. Raises MissingEnvironment; see `environment` of one program."""
    found = environment(body(system), system.robots, source, report)
    if found is None:
        return None
    for application in system.applications:
        for robot in application.members:
            check_completeness(found.of(robot), application.program)
    return found


def answers(system: System, environment: Environment) -> list[Answer]:
    """Return the function that computes the possible answers of callable ports, for each application."""
    found = []
    for application in system.applications:
        pids = {pid: environment.of(robot) for pid, robot in enumerate(application.members)}
        own = environment._replace(robots=pids)
        found.append(possible_answers(own, application.program, len(application.members)))
    return found


class SystemEnvironmentSteps:
    """Steps of the environment: the possible changes of the sensor values of all robots at the end of a round."""

    def __init__(self, machine: SystemMachine, environment: Environment) -> None:
        self.machine, self._body = machine, body(machine.system)
        robots = range(machine.system.robots)
        self._domains = [environment.of(robot).domains for robot in robots]
        self._on = [[n for n, each in enumerate(machine.instances) if each.robot == robot] for robot in robots]
        applications = [[machine.units[number][0] for number in on] for on in self._on]
        self._sensors = [
            tuple(dict.fromkeys([name for a in indices for name in machine.machines[a].sensors]))
            for indices in applications
        ]
        self._moves: dict[tuple[int, Packed], list[Packed]] = {}

    def starts(self) -> Iterator[tuple[dict[str, Value], ...]]:
        """Yield all combinations of sensor values with which a mission may begin: a dict for each robot.

        The caller must check the `initially` properties of the programs."""
        return product(*[self._starts(robot) for robot in range(self.machine.system.robots)])

    def _starts(self, robot: int) -> list[dict[str, Value]]:
        domains, names, unset = self._domains[robot], self._sensors[robot], self.machine.unset(robot)
        pools: list[tuple[Value, ...]] = []
        for name in names:
            values, _, starts, _ = domains[name]
            pools.append((True,) if name in unset else values if starts is None else starts)
        return [self._looked(robot, dict(zip(names, values, strict=True))) for values in product(*pools)]

    def _looked(self, robot: int, sensors: dict[str, Value]) -> dict[str, Value]:
        return seen_from_position(self._domains[robot], self._body, sensors)

    def moved(self, fleet: Packed) -> Iterator[Packed]:
        """Yield every state of the system that is possible after the environment's step from the state `fleet`.

        Raises MissingEnvironment if an assumption cannot be evaluated."""
        if not any(self._sensors):
            yield fleet
            return
        places = self.machine.own_places
        for each in product(*[self.moves(robot, fleet) for robot in range(len(self._on))]):
            made = list(fleet)
            for numbers, owns in zip(self._on, each, strict=True):
                for number, own in zip(numbers, owns, strict=True):
                    made[places[number]] = own
            yield tuple(made)

    def moves(self, robot: int, fleet: Packed) -> list[Packed]:
        """Return the private states that the instances of a robot can have after the environment's step.

        Each result has one number for each instance of the robot, in their order."""
        owns = tuple([fleet[self.machine.own_places[number]] for number in self._on[robot]])
        found = self._moves.get((robot, owns))
        if found is None:
            found = self._moves[robot, owns] = [
                moved for new in self._candidates(robot, owns) if (moved := self._changed(robot, owns, new)) is not None
            ]
        return found

    def _candidates(self, robot: int, owns: Packed) -> Iterator[dict[str, Value]]:
        """Yield the values that a robot's sensors can have after a round, if no assumption is considered."""
        sensors, unset = dict[str, Value](), set[str]()
        for number, own in zip(self._on[robot], owns, strict=True):
            machine = self.machine.machines[self.machine.units[number][0]]
            held = machine.owns.values[own]
            sensors |= {name: semantic_value(value, machine.types[name]) for name, value in held.sensors.items()}
            unset |= held.unset
        names, domains = self._sensors[robot], self._domains[robot]
        pools = [[True] if name in unset else nearby(domains[name], sensors[name]) for name in names]
        for values in product(*pools):
            yield self._looked(robot, dict(zip(names, values, strict=True)))

    def _changed(self, robot: int, owns: Packed, new: Mapping[str, Any]) -> Packed | None:
        """Return the private states of a robot's instances with new sensor values; None if an assumption forbids it."""
        made = []
        for number, own in zip(self._on[robot], owns, strict=True):
            a, pid = self.machine.units[number]
            machine = self.machine.machines[a]
            held = machine.owns.values[own]
            sensors = {name: new[name] for name in machine.sensors}
            if not is_allowed(machine, pid, held, sensors):
                return None
            made.append(machine.own(held._replace(sensors={n: machine.taken(n, v) for n, v in sensors.items()})))
        return tuple(made)
