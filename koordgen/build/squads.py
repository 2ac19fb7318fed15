"""Checks of squads: whether the fleets that are robots of an outer fleet fit it, and serve its program (ADR 0056).

Each error points into the file that the user should change, and names the other file.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from collections.abc import Sequence as Several

from koordgen.build.bundle.squad_budget import OUTER
from koordgen.build.composition import ApplicationProgram
from koordgen.fleet.address import Address, control_port, outer_port
from koordgen.fleet.applications import MOST_INSTANCES
from koordgen.fleet.file import Fleet
from koordgen.fleet.robots import FleetRobot
from koordgen.fleet.squads import SquadEntry
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.ir.decl import Module, Port, Program, Provided
from koordgen.lang.ir.printer import capacities
from koordgen.lang.ir.types import ExternType, MapOf, RecordType, Sequence, TupleOf, Type
from koordgen.lang.node import Node, replace
from koordgen.lang.source import Source, Span

LEAST_ROUNDS = 3  # inner rounds in an outer one: an inner commit takes two, and an outer event waits for one
_KINDS = {"sensor": "a sensor", "actuator": "an actuator", "callable": "a callable port", "stream": "a stream"}

Found = Iterator[tuple[Source, Diagnostic]]


class InnerLevel(Node):
    """Fleet of a squad, with the sources and the programs of its applications.

    `robot`: the squad, a robot of the outer fleet. `source`: the inner fleet file.
    """

    robot: FleetRobot
    source: Source
    fleet: Fleet
    parts: tuple[ApplicationProgram, ...]

    @property
    def inner(self) -> SquadEntry:
        assert self.robot.inner is not None
        return self.robot.inner

    @property
    def providers(self) -> list[int]:
        """Numbers of the applications that provide modules."""
        return [index for index, part in enumerate(self.parts) if part.program.provides]


def with_squads(fleet: Fleet, levels: Several[InnerLevel]) -> Fleet:
    """Return the outer fleet with the inner fleets, and with the addresses of their robots for the outer fleet."""
    made = {level.robot.pid: _with_addresses(level) for level in levels}
    inner = {level.robot.name: level.fleet for level in levels}
    return replace(fleet, robots=tuple([made.get(robot.pid, robot) for robot in fleet.robots]), inner_fleets=inner)


def _with_addresses(level: InnerLevel) -> FleetRobot:
    robots = level.fleet.robots
    addresses = level.inner.addresses or tuple([(robot.host, outer_port(robot.port)) for robot in robots])
    host, port = addresses[0]
    inner = replace(level.inner, addresses=addresses)
    return replace(level.robot, host=host, port=port, control=control_port(port), inner=inner)


def check_fleets(fleet: Fleet, source: Source, levels: Several[InnerLevel]) -> Found:
    """Check that an outer fleet and the fleets of its squads can work together. `source`: the outer fleet file."""
    if fleet.network["transport"] != "unicast":
        message = f"a fleet with squads needs the transport unicast, not {fleet.network['transport']}"
        yield _at(source, levels[0], "inner", message, "remove `network`; each inner robot has an address of its own")
    seen: dict[str, str] = {}
    for level in levels:
        first = seen.setdefault(level.source.path, level.robot.name)
        if first != level.robot.name:
            message = f"{level.inner.file} is the fleet of {first} already"
            help = f"give {level.robot.name} a fleet file of its own: its robots have other addresses"
            yield _at(source, level, "inner", message, help, "F006")
            return
        yield from _level(source, level)
    yield from _delta(fleet, source, levels)
    yield from _application_ids(fleet, source, levels)
    yield from _origins(fleet, source, levels)
    yield from _addresses(fleet, source, levels)


def _delta(fleet: Fleet, source: Source, levels: Several[InnerLevel]) -> Found:
    level = max(levels, key=lambda each: each.fleet.delta)
    file, least = level.inner.file, LEAST_ROUNDS * level.fleet.delta
    if fleet.delta < least * (1 - 1e-9):
        message = (
            f"a round of {fleet.delta:g} s is too short for {level.robot.name}: it takes {LEAST_ROUNDS} rounds of "
            f"{file}, which are {level.fleet.delta:g} s long"
        )
        help = f"write `delta: {least:.6g}` or more here, or a shorter delta in {file}"
        yield _at(source, level, "inner", message, help)


def _level(source: Source, level: InnerLevel) -> Found:
    """Check the number of addresses, and the names of the applications of one inner fleet."""
    file = level.inner.file
    robots, listed = len(level.fleet.robots), len(level.inner.addresses)
    if listed not in (0, robots):
        message = f"the ports of {level.robot.name} are {listed} addresses, but {file} has {robots} robots"
        help = (
            "list one address for each inner robot, in their order; or remove `ports`: the default is the port + 2000"
        )
        yield _at(source, level, "ports", message, help)
    instances = sum(len(part.settings.members) for part in level.parts)
    if instances + robots > MOST_INSTANCES:
        message = f"with the application {OUTER!r} of a squad, the robots run {instances + robots} instances"
        help = "give robots fewer applications"
        yield level.source, _error("F005", f"{message}; at most {MOST_INSTANCES} are possible", Span(1, 1, 1, 2), help)
    for part in level.parts:
        if part.settings.name == OUTER:
            message = f"no application of a squad can be called {OUTER!r}: this is the outer program on inner robots"
            yield level.source, _error("F005", message, part.settings.spans["name"], "give it another name")


def _application_ids(fleet: Fleet, source: Source, levels: Several[InnerLevel]) -> Found:
    seen = {fleet.application_id: os.path.basename(source.path)}
    for level in levels:
        number = level.fleet.application_id
        first = seen.setdefault(number, level.inner.file)
        if first != level.inner.file:
            message = f"{level.inner.file} and {first} have the same application_id, {number}"
            help = f"write another `application_id` in {level.inner.file}: robots tell their fleets apart by it"
            yield _at(source, level, "inner", message, help)


def _origins(fleet: Fleet, source: Source, levels: Several[InnerLevel]) -> Found:
    """Report inner fleets with another frame: outer commands and inner positions are in the frame of both."""
    for level in levels:
        if level.fleet.origin != fleet.origin:
            message = f"the origin of {level.inner.file} is not that of this file, so positions would mean other places"
            yield _at(source, level, "inner", message, f"write the same `origin` in {level.inner.file}")


def _addresses(fleet: Fleet, source: Source, levels: Several[InnerLevel]) -> Found:
    """Report each address or control port that two robots of different fleets have."""
    seen: dict[Address, str] = {}
    for robot in fleet.robots:
        if robot.inner is None:
            seen[robot.host, robot.port] = f"the address of {robot.name}"
            seen[robot.host, robot.control] = f"the control port of {robot.name}"
    for level in levels:
        file, own = level.inner.file, dict[Address, str]()
        for robot in level.fleet.robots:
            both = [(robot.port, "the address"), (robot.control, "the control port")]
            for port, what in both:
                own[robot.host, port] = named = f"{what} of {robot.name} in {file}"
                if (robot.host, port) in seen:
                    message = f"{robot.host}:{port} is {named}, and {seen[robot.host, port]}"
                    help = "give one of the two another port in its fleet file"
                    yield _at(source, level, "inner", message, help, "F006")
                    break  # the default of the control port repeats with the address
        seen |= own
        squad = with_squads(fleet, [level]).robots[level.robot.pid].inner
        assert squad is not None
        for place, (robot, (host, port)) in enumerate(zip(level.fleet.robots, squad.addresses, strict=False)):
            named = f"the address of {level.robot.name}'s {robot.name} in this fleet"
            if (host, port) in seen:
                key = f"ports.{place}" if f"ports.{place}" in level.inner.spans else "inner"
                message = f"{host}:{port} is {named}, and {seen[host, port]}"
                yield _at(source, level, key, message, "write other ports: `ports: [HOST:PORT, ...]`", "F006")
            seen[host, port] = named


def check_provided(outer: Program, program: Source, source: Source, levels: Several[InnerLevel]) -> Found:
    """Check that each inner fleet provides the modules that the outer program uses.

    `program`: source of the outer program. `source`: the outer fleet file.
    """
    reported = set[tuple[str, Span]]()
    for level in levels:
        found = level.providers
        if len(found) != 1:
            file = level.inner.file
            message = f"no application of {file} provides a module, so its fleet cannot be a robot"
            help = "declare the robot's ports in one of its programs: 'provides Motion:' (`koordgen docs language`)"
            if found:
                names = " and ".join([level.parts[index].settings.name for index in found])
                message = f"several applications of {file} provide modules: {names}"
                help = "one program provides all modules of the fleet; remove `provides` from the others"
            yield _at(source, level, "inner", message, help)
            continue
        provider = level.parts[found[0]]
        for module in outer.modules:
            for error in _module(module, provider, level.robot.name):
                if (provider.source.path, error.span) not in reported:
                    reported.add((provider.source.path, error.span))
                    yield program, error


def _module(module: Module, provider: ApplicationProgram, squad: str) -> Iterator[Diagnostic]:
    """Compare a module of the outer program with what a program provides. `squad`: name of the robot."""
    path = provider.source.path
    provided = {each.name: each for each in provider.program.provides}.get(module.name)
    if provided is None:
        offered = ", ".join([each.name for each in provider.program.provides])
        message = f"the robot {squad} has no module {module.name}: {path} does not provide it"
        yield _error("B014", message, module.span, f"{path} provides {offered}; add `provides {module.name}:` to it")
        return
    ports = {each.port.name: each for each in provided.ports}
    for port in module.ports:
        difference = _difference(module.name, port, ports.get(port.name), path)
        if difference:
            yield _error(
                "B014", f"{difference[0]}, but the robot {squad} is a fleet of {path}", port.span, difference[1]
            )


def _difference(module: str, port: Port, there: Provided | None, path: str) -> tuple[str, str] | None:
    """Return what a program does not provide of a port, and what to do; None if it provides the port."""
    name = f"{module}.{port.name}"
    if port.direction in ("callable", "stream"):
        help = f"remove {port.name}, or give this robot a target in place of `inner`"
        return f"{name} is {_KINDS[port.direction]}, which a fleet cannot provide", help
    if there is None:
        help = f"add `{port.type} {port.name} = ...` to the {port.direction}s of `provides {module}:` in {path}"
        return f"{name}, {_KINDS[port.direction]} of type {port.type}, is not provided", help
    if there.port.direction != port.direction:
        return f"{name} is {_KINDS[port.direction]} here, and not there", "declare both alike"
    mine, theirs = _spelled(port.type), _spelled(there.port.type)
    if mine != theirs:
        return f"{name} is of type {mine} here and {theirs} there", "declare both with the same type and capacity"
    if _has_class(port.type):
        return f"{name} is of type {mine}, whose class is another one in each program", "use ports of other types"
    return None


def _spelled(type_: Type) -> str:
    sizes = ", ".join(map(str, capacities(type_)))
    return f"{type_} max {sizes}" if sizes else str(type_)


def _has_class(type_: Type) -> bool:
    """Return whether each generated program has a class of its own for values of this type."""
    match type_:
        case RecordType() | ExternType():
            return True
        case Sequence(_, element):
            return _has_class(element)
        case MapOf(key, value):
            return _has_class(key) or _has_class(value)
        case TupleOf(items):
            return any(map(_has_class, items))
        case _:
            return False


def _at(
    source: Source, level: InnerLevel, key: str, message: str, help: str, code: str = "F005"
) -> tuple[Source, Diagnostic]:
    return source, _error(code, message, level.inner.spans[key], help)


def _error(code: str, message: str, span: Span, help: str) -> Diagnostic:
    return Diagnostic(code, "error", message, span, help=help)
