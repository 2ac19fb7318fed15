"""Properties: initial conditions, invariants, and axioms about spec functions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from koordgen.lang.check.base import condition
from koordgen.lang.check.context import Context, Temp
from koordgen.lang.check.names import unique
from koordgen.lang.ir import decl
from koordgen.lang.ir.types import GRID, POINT, Type, list_of
from koordgen.lang.source import Span
from koordgen.lang.syntax import decl as ast
from koordgen.lang.syntax import expr as tree
from koordgen.lang.syntax.walk import parts

_PLANNER_ARGUMENTS = (POINT, list_of(GRID))  # types of the arguments of a PathPlanner: goal, obstacles


def properties(sections: Iterable[ast.Property], c: Context) -> tuple[decl.Property, ...]:
    """Check all properties and return them in the order of the text."""
    found = []
    seen: dict[str, Span] = {}
    for node in sections:
        if node.name:
            unique(node.name, "properties", node.span, seen, c)
        c.enter("property")
        what = f"the {node.kind} {node.name}" if node.name else "the formula of 'initially'"
        formula = condition(node.formula, c, what)
        found.append(decl.Property(node.kind, node.name, formula, node.span))
    return tuple(found)


def bind_goal(name: str, span: Span, c: Context) -> Temp | None:
    """Bind an undefined name that an assumption passes to a callable port of its module.

    Returns None if the assumption does not pass the name to such a port. The assumption holds for every value of the
    argument's type in place of the bound name.
    """
    module = c.entities.get(c.module)
    if not isinstance(module, decl.Module) or c.program is None:
        return None
    ports = {port.name for port in module.ports if port.direction == "callable"}
    items = [item for s in c.program.sections if isinstance(s, ast.Using) and s.name == c.module for item in s.items]
    at = span.line, span.column
    assumed = [item for item in items if isinstance(item, ast.Assume)]
    formulas = [item.formula for item in assumed if (item.span.line, item.span.column) < at]
    place = next(_argument_indices(formulas[-1], name, c.module, ports), None) if formulas else None
    if place is None:
        return None
    temp = c.scopes[0][name] = Temp(c.mint(name), _PLANNER_ARGUMENTS[place], span)
    return temp


def bind_any_value(name: str, span: Span, c: Context) -> Temp | None:
    """Bind an undefined name that an axiom passes to a function of the program.

    Returns None if the axiom does not pass the name to a function. The axiom states its formula for every value of the
    parameter's type in place of the bound name.
    """
    if c.program is None:
        return None
    at = span.line, span.column
    sections = [s for s in c.program.sections if isinstance(s, ast.Property)]
    before = [s for s in sections if (s.span.line, s.span.column) < at]
    if not before or before[-1].kind != "axiom":
        return None
    type_ = next(_parameter_types(before[-1].formula, name, c), None)
    if type_ is None:
        return None
    temp = c.scopes[0][name] = Temp(c.mint(name), type_, span)
    return temp


def _parameter_types(node: object, name: str, c: Context) -> Iterator[Type]:
    """Yield the type of each function parameter to which the expression passes `name`, unless a quantifier binds it."""
    if isinstance(node, tree.Quantified) and any(bound.name == name for bound in node.names):
        node = node.domain
    if isinstance(node, tree.Call) and isinstance(node.function, tree.Name):
        entity = c.entities.get(node.function.name)
        if isinstance(entity, (decl.Function, decl.ExternFunction, decl.SpecFunction)):
            for arg, parameter in zip(node.args, entity.parameters, strict=False):
                if isinstance(arg, tree.Name) and arg.name == name:
                    yield parameter.type
    for part in parts(node):
        yield from _parameter_types(part, name, c)


def _argument_indices(node: object, name: str, module: str, ports: set[str]) -> Iterator[int]:
    """Yield the index of each argument that is just `name`, in calls of the module's callable ports.

    Leaves out occurrences of the name that a quantifier binds.
    """
    if isinstance(node, tree.Quantified) and any(bound.name == name for bound in node.names):
        node = node.domain
    if isinstance(node, tree.Call):
        match node.function:
            case tree.Name(port) | tree.Attribute(tree.Name(), port) if port in ports and _is_port_of(
                module, node.function
            ):
                for place, arg in enumerate(node.args[: len(_PLANNER_ARGUMENTS)]):
                    if isinstance(arg, tree.Name) and arg.name == name:
                        yield place
            case _:
                pass
    for part in parts(node):
        yield from _argument_indices(part, name, module, ports)


def _is_port_of(module: str, function: tree.Expr) -> bool:
    """Return whether a call names a port of the module: as `port` or as `module.port`."""
    return not isinstance(function, tree.Attribute) or function.value == tree.Name(module, function.span)
