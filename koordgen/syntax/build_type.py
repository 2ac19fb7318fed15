"""The nodes of types. See build.py."""

from __future__ import annotations

from koordgen.source import Span
from koordgen.syntax import expr, types
from koordgen.syntax.build_base import Children, nodes, reach, refused, token_span

_FOREIGN = frozenset(("let", "var", "const", "auto", "import", "from"))  # `let x = 3` reads as a declaration


def named_type(c: Children) -> types.NamedType:
    return _named(c[0][1], token_span(c[0]))


def _named(name: str, span: Span) -> types.NamedType:
    if name in _FOREIGN:
        from koordgen.syntax.habits import FOREIGN

        raise refused("K001", f"Koord has no '{name}'", span, FOREIGN[name])
    return types.NamedType(name, span)


def generic(c: Children) -> types.GenericType:
    return types.GenericType(c[0][1], nodes(c), reach(c[0], c[-1]))


def tuple_type(c: Children) -> types.TupleType:
    items = tuple(map(as_type, nodes(c)))
    if len(items) < 2:
        raise refused("K001", "a tuple's type has two items at least", reach(c[0], c[-1]))
    return types.TupleType(items, reach(c[0], c[-1]))


def list_type(c: Children) -> types.GenericType:
    return types.GenericType("[]", (as_type(c[0]),), reach(c[0], c[-1]))


def as_type(node: types.TypeExpr | expr.Expr) -> types.TypeExpr:
    """What was read as an expression, because a type may begin like one."""
    match node:
        case types.NamedType() | types.GenericType() | types.TupleType() | types.BrokenType():
            return node
        case expr.Name():
            return _named(node.name, node.span)
        case expr.Tuple():
            return types.TupleType(tuple(map(as_type, node.items)), node.span)
        case expr.Broken():
            return types.BrokenType(node.span)
        case _:
            help = "a declaration is a type and a name: int count = 0"
            raise refused("K001", "this is no type", node.span, help)
