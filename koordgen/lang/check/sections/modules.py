"""Modules: the ports that a program uses, and what it assumes of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from koordgen.lang.check.base import a, condition
from koordgen.lang.check.context import Context
from koordgen.lang.check.names import enter, owns
from koordgen.lang.check.types import bounded, resolve
from koordgen.lang.diagnostics import Label
from koordgen.lang.ir import decl
from koordgen.lang.ir.types import PLANNER, POISON, STREAM, Type
from koordgen.lang.node import replace
from koordgen.lang.syntax import decl as ast
from koordgen.lang.syntax.types import BrokenType

Direction = Literal["sensor", "actuator", "callable", "stream"]


def modules(sections: list[ast.Using], c: Context) -> list[decl.Module]:
    """The modules with their ports; sections of one name are one module. What they assume comes later."""
    found: dict[str, tuple[ast.Using, dict[str, decl.Port]]] = {}
    for section in sections:
        ports = found.setdefault(section.name, (section, {}))[1]
        for group in section.items:
            if isinstance(group, ast.Ports):
                for port in group.ports:
                    _add(port, group.direction, section.name, ports, c)
    result = []
    for name, (section, ports) in found.items():
        if owns(name, section, c):
            module = decl.Module(name, tuple(ports.values()), (), section.span)
            enter(name, section, module, c)
            result.append(module)
    return result


def _add(
    node: ast.Port, under: Literal["sensor", "actuator", ""], module: str, ports: dict[str, decl.Port], c: Context
) -> None:
    if isinstance(node.type, BrokenType):
        return  # its name is a guess
    type_ = resolve(node.type, c, True)
    first = ports.get(node.name)
    if first is not None:
        label = Label(first.span, "declared here first")
        c.error("K011", f"the port {module}.{node.name} is declared twice", node.span, labels=(label,))
        return
    direction = _direction(node, type_, under, f"{module}.{node.name}", c)
    ports[node.name] = decl.Port(node.name, bounded(type_, (), True, c), direction, node.span)


def _direction(
    node: ast.Port, type_: Type, under: Literal["sensor", "actuator", ""], name: str, c: Context
) -> Direction:
    help = "it stands directly under 'using'"
    if type_ is PLANNER:
        if under == "actuator":
            c.error("K017", f"{name} is called, not written: a PathPlanner is no actuator", node.span, help)
        return "callable"
    if type_ is STREAM:
        if under == "sensor":
            c.error("K017", f"{name} is written, not read: a stream is no sensor", node.span, help)
        return "stream"
    if not under:
        help = f"it stands under 'sensors:' or 'actuators:' of {name.partition('.')[0]}"
        if type_ is not POISON:
            c.error("K017", f"{name} is {a(type_)}; only a PathPlanner or a stream stands here", node.span, help)
        return "sensor"
    return under


def assumptions(sections: Iterable[ast.Using], modules: list[decl.Module], c: Context) -> tuple[decl.Module, ...]:
    """The modules with what is assumed of their ports."""
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
