"""Checks of modules: the ports that a program uses, and its assumptions about the ports."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from koordgen.lang.check.base import condition, with_article
from koordgen.lang.check.context import Context
from koordgen.lang.check.names import enter, is_owner
from koordgen.lang.check.types import resolve, with_capacities
from koordgen.lang.diagnostics import Label
from koordgen.lang.ir import decl
from koordgen.lang.ir.ports import NO_MEANING, usual
from koordgen.lang.ir.types import BOOL, PLANNER, POINT, POISON, STREAM, Type
from koordgen.lang.node import replace
from koordgen.lang.source import Span
from koordgen.lang.syntax import decl as ast
from koordgen.lang.syntax.types import BrokenType

Direction = Literal["sensor", "actuator", "callable", "stream"]


def modules(sections: list[ast.Using], c: Context) -> list[decl.Module]:
    """Return the modules with their ports, without assumptions. Sections of the same name form one module."""
    found: dict[str, tuple[ast.Using, dict[str, decl.Port], dict[str, ast.Port]]] = {}
    for section in sections:
        _, ports, written = found.setdefault(section.name, (section, {}, {}))
        for group in section.items:
            if isinstance(group, ast.Ports):
                for port in group.ports:
                    _add_port(port, group.direction, section.name, ports, c)
                    written.setdefault(port.name, port)
    result = []
    for name, (section, ports, written) in found.items():
        if is_owner(name, section, c):
            meant = [replace(port, meaning=meaning(written[port.name], port, ports, c)) for port in ports.values()]
            module = decl.Module(name, tuple(meant), (), section.span)
            enter(name, section, module, c)
            result.append(module)
    return result


def _add_port(
    node: ast.Port, under: Literal["sensor", "actuator", ""], module: str, ports: dict[str, decl.Port], c: Context
) -> None:
    if isinstance(node.type, BrokenType):
        return  # the port's name is only the parser's guess
    type_ = resolve(node.type, c, True)
    first = ports.get(node.name)
    if first is not None:
        label = Label(first.span, "declared here first")
        c.error("K011", f"the port {module}.{node.name} is declared twice", node.span, labels=(label,))
        return
    direction = _direction(node, type_, under, f"{module}.{node.name}", c)
    ports[node.name] = decl.Port(node.name, with_capacities(type_, (), True, c), direction, NO_MEANING, node.span)


def meaning(node: ast.Port | ast.Provided, port: decl.Port, ports: dict[str, decl.Port], c: Context) -> decl.Meaning:
    """Return the meaning of a port, as its marks (`as`, `at`, `clears`) declare it.

    A port without marks has the usual meaning of a port of that name."""
    if not node.marks:
        return usual(port, ports.values())
    position, held, clears = False, "", list[str]()
    for mark in node.marks:
        wrong = _mark_error(mark, port)
        if wrong is not None:
            c.error("K059", *wrong)
        elif mark.word == "as":
            position = True
        elif mark.word == "at":
            if held:
                c.error("K059", f"{port.name} already has '{held}' as its initial value", mark.span)
            held = mark.name if _has_sensor(mark, port.type, ports, c) else held
        elif _has_sensor(mark, BOOL, ports, c):
            clears.append(mark.name)
    return decl.Meaning(position, held, tuple(dict.fromkeys(clears)))


def _mark_error(mark: ast.Mark, port: decl.Port) -> tuple[str, Span, str] | None:
    """Return message, span and help of the error if a port cannot have the mark; otherwise None."""
    if mark.word != "as":
        help = f"{port.name} is not an actuator and gets no commands"
        return (
            None
            if port.direction == "actuator"
            else (f"'{mark.word}' is only allowed for an actuator", mark.span, help)
        )
    if mark.name != "position":
        return f"a sensor can be the robot's position, not '{mark.name}'", mark.span, "write 'as position'"
    if port.direction != "sensor" or port.type not in (POINT, POISON):
        return f"{port.name} cannot be the robot's position: only a sensor of type Point can", mark.span, ""
    return None


def _has_sensor(mark: ast.Mark, type_: Type, ports: dict[str, decl.Port], c: Context) -> bool:
    """Return whether the module has the sensor that a mark names, with the right type; report an error otherwise."""
    name = mark.name
    sensor = ports.get(name)
    if sensor is None or sensor.direction != "sensor":
        c.error("K059", f"this module has no sensor '{name}'", mark.span, "declare the sensor under 'sensors:'")
        return False
    if sensor.type != type_ and POISON not in (sensor.type, type_):
        found = f"the sensor '{name}' is {with_article(sensor.type)}"
        if mark.word == "clears":
            c.error("K059", f"{found}; 'clears' takes sensors of type {type_}", mark.span)
        else:
            c.error("K059", f"{found}; the actuator is {with_article(type_)}", mark.span)
        return False
    return True


def _direction(
    node: ast.Port, type_: Type, under: Literal["sensor", "actuator", ""], name: str, c: Context
) -> Direction:
    help = "declare the port directly under 'using'"
    if type_ is PLANNER:
        if under == "actuator":
            c.error("K017", f"{name} is called, not written: a PathPlanner is not an actuator", node.span, help)
        return "callable"
    if type_ is STREAM:
        if under == "sensor":
            c.error("K017", f"{name} is written, not read: a stream is not a sensor", node.span, help)
        return "stream"
    if not under:
        help = f"declare the port under 'sensors:' or 'actuators:' of {name.partition('.')[0]}"
        if type_ is not POISON:
            c.error(
                "K017",
                f"{name} is {with_article(type_)}; only a PathPlanner or a stream is allowed here",
                node.span,
                help,
            )
        return "sensor"
    return under


def assumptions(sections: Iterable[ast.Using], modules: list[decl.Module], c: Context) -> tuple[decl.Module, ...]:
    """Return the modules with the assumptions about their ports."""
    assumed: dict[str, list[decl.Assumption]] = {}
    for section in sections:
        known = isinstance(c.entities.get(section.name), decl.Module)
        for item in section.items if known else ():
            if isinstance(item, ast.Assume):
                c.enter("assume")
                c.module = section.name
                formula = condition(item.formula, c, "an assumption")
                assumed.setdefault(section.name, []).append(decl.Assumption(formula, item.span))
    return tuple([replace(m, assumptions=tuple(assumed[m.name])) if m.name in assumed else m for m in modules])
