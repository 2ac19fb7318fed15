"""Checks of `provides Name:`: the ports of the one robot that a fleet is to the program of another fleet.

The value of a sensor is an expression over shared variables, which any robot of the fleet can compute. An actuator
names the allwrite variable into which a command is written.
"""

from __future__ import annotations

from collections.abc import Iterable

from koordgen.lang.check.base import check_expr, converted, with_article
from koordgen.lang.check.context import Context
from koordgen.lang.check.names import unique
from koordgen.lang.check.sections.modules import meaning
from koordgen.lang.check.types import resolve
from koordgen.lang.diagnostics import Label
from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.ports import NO_MEANING
from koordgen.lang.ir.types import PLANNER, POISON, STREAM
from koordgen.lang.node import replace
from koordgen.lang.source import Span
from koordgen.lang.syntax import decl as ast
from koordgen.lang.syntax import expr as tree
from koordgen.lang.syntax.types import BrokenType


def provides(sections: Iterable[ast.Provides], c: Context) -> tuple[decl.Provides, ...]:
    """Return the provided modules, in the order of the text. Each variable takes the commands of one actuator."""
    found, modules, commanded = [], dict[str, Span](), dict[str, Span]()
    for section in sections:
        is_first = unique(section.name, "provided modules", section.span, modules, c)
        written, seen = dict[str, ast.Provided](), dict[str, Span]()
        ports = dict[str, decl.Provided]()
        for block in section.items:
            for node in block.ports:
                if isinstance(node.type, BrokenType):
                    continue  # the parser only guessed the port's name
                if unique(node.name, f"ports of {section.name}", node.span, seen, c):
                    written[node.name] = node
                    ports[node.name] = _provided(node, block.direction, commanded, c)
        declared = {name: each.port for name, each in ports.items()}
        meant = [
            replace(each, port=replace(each.port, meaning=meaning(written[name], each.port, declared, c)))
            for name, each in ports.items()
        ]
        if is_first:
            found.append(decl.Provides(section.name, tuple(meant), section.span))
    return tuple(found)


def _provided(node: ast.Provided, direction: str, commanded: dict[str, Span], c: Context) -> decl.Provided:
    type_ = resolve(node.type, c, True)
    if type_ in (PLANNER, STREAM):
        help = "a fleet provides sensors and actuators only"
        c.error("K061", f"{node.name} is {with_article(type_)}, which a fleet cannot provide", node.span, help)
        type_ = POISON
    if direction == "actuator":
        value = _variable(node, commanded, c)
        if value.type not in (type_, POISON) and type_ is not POISON:
            message = (
                f"the actuator {node.name} is {with_article(type_)}, but its variable is {with_article(value.type)}"
            )
            value = c.error("K061", message, node.value.span, "both need the same type")
        return decl.Provided(decl.Port(node.name, value.type, "actuator", NO_MEANING, node.span), value)
    c.enter("provided")
    value = converted(check_expr(node.value, c, type_), type_, node.name, c)
    return decl.Provided(decl.Port(node.name, type_, "sensor", NO_MEANING, node.span), value)


def _variable(node: ast.Provided, commanded: dict[str, Span], c: Context) -> ir.Expr:
    """Return the read of the variable that an actuator names; report an error if it names none."""
    value = node.value
    help = f"name an allwrite variable: '{node.name} = name'"
    if not isinstance(value, tree.Name):
        if not isinstance(value, tree.Broken):
            c.error("K061", f"the actuator {node.name} must name a variable", value.span, help)
        return c.poison(value.span)
    shared = c.entities.get(value.name)
    if value.name in c.imported:
        message = f"{value.name} is imported from {c.imported[value.name].name} and takes no commands"
        return c.error("K061", message, value.span, "declare a variable of this program for them")
    if not isinstance(shared, decl.Shared):
        if value.name in c.entities and shared is None:
            return c.poison(value.span)
        label = () if shared is None else (Label(shared.span, "declared here"),)
        return c.error("K061", f"{value.name} is not an allwrite variable", value.span, help, label)
    if shared.kind != "allwrite":
        message = f"{value.name} is allread: each robot writes its own slot, so no command can write it"
        return c.error("K061", message, value.span, help, (Label(shared.span, "declared here"),))
    first = commanded.setdefault(value.name, value.span)
    if first != value.span:
        label = (Label(first, "first actuator with this variable"),)
        return c.error(
            "K061", f"{value.name} takes the commands of two actuators", value.span, "use two variables", label
        )
    return ir.SharedRead(value.name, shared.type, value.span)
