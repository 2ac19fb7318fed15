"""Finite environment of an exploration: the possible values of sensors and answers of callable ports."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping
from itertools import product
from typing import Any, Final, NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir.expr import PortCall, PortRead
from koordgen.lang.ir.ports import position_beside
from koordgen.lang.ir.tree import walk
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import NoMeaning
from koordgen.lang.semantics.property import Asked, holds_assumption
from koordgen.lang.semantics.step import initial
from koordgen.lang.semantics.values import Value
from koordgen.verify.explore.machine import Answer, Machine, Packed, PrivateState
from koordgen.verify.replay.functions import semantic_value

# marks the straight path from the robot's position to the goal as a possible answer of a path planner
STRAIGHT: Final = "straight"


class SensorDomain(NamedTuple):
    """Possible values of one sensor.

    `values`: all possible values.
    `near`: function that returns whether the sensor can change from one value to another within a round; None if every
        change is possible.
    `starts`: the possible values at the start of a mission; None for all of `values`.
    `seen_from`: function that computes the value from the robot's position; None for a sensor that does not depend on
        the position.
    """

    values: tuple[Value, ...]
    near: Callable[[Value, Value], bool] | None = None
    starts: tuple[Value, ...] | None = None
    seen_from: Callable[[Any], Value] | None = None


class MissingEnvironment(Exception):
    """Raised if values or answers of a port are missing or unusable.

    The message names the port or its module."""


class Environment(NamedTuple):
    """Finite environment of a fleet. Ports are named "Module.port".

    `domains`: the possible values of each sensor.
    `answers`: the possible answers of each callable port. An answer is a value or STRAIGHT.
    `robots`: pid -> environment of this robot, for robots whose environment differs from the common one.
    `params`: values of the program's params that the environment sets."""

    domains: Mapping[str, SensorDomain]
    answers: Mapping[str, tuple[Any, ...]]
    robots: Mapping[int, Environment] = {}
    params: Mapping[str, Any] = {}

    def of(self, pid: int) -> Environment:
        """Return the environment of robot `pid`: its entry in `robots`, otherwise this environment."""
        return self.robots.get(pid, self)


def possible_answers(environment: Environment, program: decl.Program, n_sys: int) -> Answer:
    """Return a function that computes all possible answers to a robot's call of a port.

    The function leaves out answers that the program's assumptions forbid; they can depend on the robot's sensors. It
    raises MissingEnvironment if no answer is left."""
    params = initial(program, 1).params
    deciding = {port: _answer_assumptions(program, port) for port in environment.answers}
    read = {port: _sensors(program, rules, port) for port, rules in deciding.items()}
    known: dict[Hashable, tuple[Any, ...]] = {}

    def allowed(pid: int, sensors: Mapping[str, Any], asked: Asked) -> bool:
        return all(
            holds_assumption(rule, program, sensors, sensors, pid, n_sys, params, asked=[asked])
            for rule in deciding[asked.port]
        )

    def answers(pid: int, sensors: Mapping[str, Any], port: str, args: tuple[Any, ...]) -> tuple[Any, ...]:
        key = (pid, port, repr(args), repr([sensors.get(name) for name in read[port]]))
        if key not in known:
            known[key] = asked_anew(pid, sensors, port, args)
        return known[key]

    def asked_anew(pid: int, sensors: Mapping[str, Any], port: str, args: tuple[Any, ...]) -> tuple[Any, ...]:
        given = [
            (sensors[position_beside(program, port)], args[0]) if answer == STRAIGHT else answer
            for answer in environment.of(pid).answers[port]
        ]
        kept = tuple([answer for answer in given if allowed(pid, sensors, Asked(port, args, answer))])
        if not kept:
            asked = ", ".join(map(str, args))
            raise MissingEnvironment(
                f"{port}({asked}) of robot {pid}: the program's assumptions allow none of its answers"
            )
        return kept

    return answers


def _answer_assumptions(program: decl.Program, port: str) -> list[decl.Assumption]:
    """Return the assumptions about the answers of a port that can be evaluated when the port is called.

    The sensors in such an assumption have their values at the time of the call, not at the end of the round."""
    sensors = {(m.name, p.name) for m in program.modules for p in m.ports if p.direction == "sensor"}
    found = []
    for assumption in [a for m in program.modules for a in m.assumptions]:
        read = list(walk(assumption.formula))
        if any(isinstance(n, PortCall) and f"{n.module}.{n.port}" == port for n in read) and all(
            (n.module, n.port) in sensors and not n.primed for n in read if isinstance(n, PortRead)
        ):
            found.append(assumption)
    return found


def _sensors(program: decl.Program, rules: list[decl.Assumption], port: str) -> tuple[str, ...]:
    """Return the sensors on which a port's answers depend.

    These are the sensors in the assumptions `rules`, and the position sensor in the port's module."""
    found = {f"{n.module}.{n.port}" for rule in rules for n in walk(rule.formula) if isinstance(n, PortRead)}
    return tuple(sorted(found | {position_beside(program, port)}))


class EnvironmentSteps:
    """Steps of the environment: the possible changes of all sensor values at the end of a round."""

    def __init__(self, machine: Machine, environment: Environment) -> None:
        self.machine = machine
        self.domains = [environment.of(pid).domains for pid in range(machine.n_sys)]
        own = next(iter(environment.robots), None)
        self.apart = "" if own is None else f"the environment's values for robot {own}"
        self._moves: dict[tuple[int, int], tuple[int, ...]] = {}
        self._next_sensors: dict[Hashable, list[dict[str, Value]]] = {}

    def starts(self) -> Iterator[tuple[dict[str, Value], ...]]:
        """Yield all combinations of sensor values with which a mission may begin: a dict for each robot.

        The caller must check the `initially` properties of the program."""
        return product(*[self._starts(domains) for domains in self.domains])

    def _starts(self, domains: Mapping[str, SensorDomain]) -> list[dict[str, Value]]:
        pools: list[tuple[Value, ...]] = []
        for name in self.machine.sensors:
            values, _, starts, _ = domains[name]
            pools.append((True,) if name in self.machine.unset else values if starts is None else starts)
        return [self._looked(domains, values) for values in product(*pools)]

    def _looked(self, domains: Mapping[str, SensorDomain], values: tuple[Value, ...]) -> dict[str, Value]:
        """Return the values of a robot's sensors by name, from a list in the order of `Machine.sensors`.

        The values of sensors with `seen_from` are computed from the robot's position instead."""
        return seen_from_position(domains, self.machine.program, dict(zip(self.machine.sensors, values, strict=True)))

    def moved(self, fleet: Packed) -> Iterator[Packed]:
        """Yield every state of the fleet that is possible after the environment's step from the state `fleet`.

        Raises MissingEnvironment if an assumption cannot be evaluated."""
        if not self.machine.sensors:
            yield fleet
            return
        n_sys = self.machine.n_sys
        rest = fleet[n_sys:]
        for owns in product(*[self.moves(pid, fleet[pid]) for pid in range(n_sys)]):
            yield owns + rest

    def moves(self, pid: int, own: int) -> tuple[int, ...]:
        """Return the numbers of all private states that a robot can have after the environment's step."""
        found = self._moves.get((pid, own))
        if found is None:
            robot = self.machine.owns.values[own]
            # assumptions read only ports, so private states with equal ports have the same possible sensor values
            key = (pid, self.machine.ports_key(robot))
            if key not in self._next_sensors:
                domains = self.domains[pid]
                pools = [
                    [True] if name in robot.unset else nearby(domains[name], robot.sensors[name])
                    for name in self.machine.sensors
                ]
                news = [self._looked(domains, values) for values in product(*pools)]
                self._next_sensors[key] = [new for new in news if self._allowed(pid, robot, new)]
            moved = [self.machine.own(robot._replace(sensors=new)) for new in self._next_sensors[key]]
            found = self._moves[pid, own] = tuple(moved)
        return found

    def _allowed(self, pid: int, robot: PrivateState, new: Mapping[str, Any]) -> bool:
        return is_allowed(self.machine, pid, robot, new)


def nearby(domain: SensorDomain, now: Value) -> list[Value]:
    """Return the values that a sensor with the value `now` can have after a round."""
    return [v for v in domain.values if domain.near is None or domain.near(now, v)]


def seen_from_position(
    domains: Mapping[str, SensorDomain], program: decl.Program, sensors: dict[str, Value]
) -> dict[str, Value]:
    """Return the values of a robot's sensors, after those with `seen_from` were computed from the robot's position."""
    for name in sensors:
        look = domains[name].seen_from
        if look is not None:
            sensors[name] = look(sensors[position_beside(program, name)])
    return sensors


def is_allowed(machine: Machine, pid: int, robot: PrivateState, new: Mapping[str, Any]) -> bool:
    """Return whether a program's assumptions allow the sensors of a robot to change to the values `new`."""
    program, types = machine.program, machine.types
    before = {n: semantic_value(v, types[n]) for n, v in {**robot.sensors, **robot.actuators}.items()}
    after = {**before, **new}
    for module in program.modules:
        for assumption in module.assumptions:
            try:
                held = holds_assumption(assumption, program, before, after, pid, machine.n_sys, machine.params)
            except Discarded as error:
                raise MissingEnvironment(f"{module.name}: an assumption has no value: {error}") from None
            except NoMeaning as error:
                raise MissingEnvironment(f"{module.name}: an assumption cannot be evaluated: {error}") from None
            if not held:
                return False
    return True
