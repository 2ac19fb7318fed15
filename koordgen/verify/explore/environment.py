"""Finite environment: values of sensors initially and after each round, and answers of callable ports."""

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
from koordgen.verify.replay.functions import meant_value

STRAIGHT: Final = "straight"  # answer of a planner: the path from `position` straight to the goal


class SensorDomain(NamedTuple):
    """Values of one sensor.

    `near`: whether a value may follow another one within a round; None: any may. `starts`: values at the beginning;
    None: all. `seen_from`: computes the value from the robot's position."""

    values: tuple[Value, ...]
    near: Callable[[Value, Value], bool] | None = None
    starts: tuple[Value, ...] | None = None
    seen_from: Callable[[Any], Value] | None = None


class MissingEnvironment(Exception):
    """An environment is needed for a port, but missing or unusable; the message names the port."""


class Environment(NamedTuple):
    """Finite environment. Ports are named "Module.port".

    `domains`: values of sensors; `answers`: possible answers of callable ports, values or STRAIGHT; `robots`:
    environments of single robots, which replace this one; `params`: values that the environment sets."""

    domains: Mapping[str, SensorDomain]
    answers: Mapping[str, tuple[Any, ...]]
    robots: Mapping[int, Environment] = {}
    params: Mapping[str, Any] = {}

    def of(self, pid: int) -> Environment:
        """Return the environment of one robot."""
        return self.robots.get(pid, self)


def possible_answers(environment: Environment, program: decl.Program, n_sys: int) -> Answer:
    """Return a function that yields the possible answers of a robot's callable ports.

    They depend on the values of its sensors. The function raises MissingEnvironment if the assumptions allow no
    answer."""
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
    """Return the assumptions that read only a port's answer, and sensors at the time of the call."""
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
    """Return the sensors on which answers depend: those in assumptions, and the robot's position."""
    found = {f"{n.module}.{n.port}" for rule in rules for n in walk(rule.formula) if isinstance(n, PortRead)}
    return tuple(sorted(found | {position_beside(program, port)}))


class EnvironmentSteps:
    """Steps of the environment from fleets of one machine."""

    def __init__(self, machine: Machine, environment: Environment) -> None:
        self.machine = machine
        self.domains = [environment.of(pid).domains for pid in range(machine.n_sys)]
        own = next(iter(environment.robots), None)
        self.apart = "" if own is None else f"the environment's values for robot {own}"
        self._moves: dict[tuple[int, int], tuple[int, ...]] = {}
        self._news: dict[Hashable, list[dict[str, Value]]] = {}

    def starts(self) -> Iterator[tuple[dict[str, Value], ...]]:
        """Yield all sensors' values when a mission begins. `initially` is not checked here."""
        return product(*[self._starts(domains) for domains in self.domains])

    def _starts(self, domains: Mapping[str, SensorDomain]) -> list[dict[str, Value]]:
        pools: list[tuple[Value, ...]] = []
        for name in self.machine.sensors:
            values, _, starts, _ = domains[name]
            pools.append((True,) if name in self.machine.unset else values if starts is None else starts)
        return [self._looked(domains, values) for values in product(*pools)]

    def _looked(self, domains: Mapping[str, SensorDomain], values: tuple[Value, ...]) -> dict[str, Value]:
        """Return values of sensors by name, including those computed from the robot's position."""
        found = dict(zip(self.machine.sensors, values, strict=True))
        for name in found:
            look = domains[name].seen_from
            if look is not None:
                found[name] = look(found[position_beside(self.machine.program, name)])
        return found

    def moved(self, fleet: Packed) -> Iterator[Packed]:
        """Yield every fleet after the environment's step.

        Raises MissingEnvironment if an assumption has no value."""
        if not self.machine.sensors:
            yield fleet
            return
        n_sys = self.machine.n_sys
        rest = fleet[n_sys:]
        for owns in product(*[self.moves(pid, fleet[pid]) for pid in range(n_sys)]):
            yield owns + rest

    def moves(self, pid: int, own: int) -> tuple[int, ...]:
        """Return the possible private states of one robot after the environment's step."""
        found = self._moves.get((pid, own))
        if found is None:
            robot = self.machine.owns.values[own]
            key = (pid, self.machine.ports_key(robot))  # assumptions read ports only
            if key not in self._news:
                domains = self.domains[pid]
                pools = [
                    [True] if name in robot.unset else self._nearby(domains[name], robot.sensors[name])
                    for name in self.machine.sensors
                ]
                news = [self._looked(domains, values) for values in product(*pools)]
                self._news[key] = [new for new in news if self._allowed(pid, robot, new)]
            moved = [self.machine.own(robot._replace(sensors=new)) for new in self._news[key]]
            found = self._moves[pid, own] = tuple(moved)
        return found

    def _nearby(self, domain: SensorDomain, now: Value) -> list[Value]:
        return [v for v in domain.values if domain.near is None or domain.near(now, v)]

    def _allowed(self, pid: int, robot: PrivateState, new: Mapping[str, Any]) -> bool:
        """Return whether the assumptions allow one robot's sensors to change to these values."""
        program, types = self.machine.program, self.machine.types
        before = {n: meant_value(v, types[n]) for n, v in {**robot.sensors, **robot.actuators}.items()}
        after = {**before, **new}
        for module in program.modules:
            for assumption in module.assumptions:
                try:
                    held = holds_assumption(
                        assumption, program, before, after, pid, self.machine.n_sys, self.machine.params
                    )
                except Discarded as error:
                    raise MissingEnvironment(f"{module.name}: an assumption has no value: {error}") from None
                except NoMeaning as error:
                    raise MissingEnvironment(f"{module.name}: an assumption cannot be evaluated: {error}") from None
                if not held:
                    return False
        return True
