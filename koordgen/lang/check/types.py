"""Translation of types in the syntax tree to types of the IR, with the capacities of variables."""

from __future__ import annotations

from collections.abc import Iterator
from typing import assert_never

from koordgen.lang.check.base import with_article
from koordgen.lang.check.context import Context
from koordgen.lang.ir.types import (
    GENERIC,
    LOCAL_BYTES,
    LOCAL_CELLS,
    LOCAL_ELEMENTS,
    LOCAL_RAYS,
    NAMED,
    PLANNER,
    POISON,
    SHARED_ELEMENTS,
    STREAM,
    MapOf,
    Sequence,
    Sized,
    TupleOf,
    Type,
    is_key,
)
from koordgen.lang.source import Span
from koordgen.lang.syntax import expr as ast
from koordgen.lang.syntax import types as tree

_DIALECT = {"pos": "Point", "boolean": "bool"}
_MEANT = {
    "str": "string", "String": "string", "text": "string", "double": "float", "real": "float", "number": "float",
    "integer": "int", "point": "Point", "Position": "Point", "position": "Point", "Vector": "Point", "array": "List",
    "list": "List", "dict": "Map", "tuple": "(A, B)", "Tuple": "(A, B)",
}  # fmt: skip
_LOCAL = {"string": LOCAL_BYTES, "GridMap": LOCAL_CELLS, "Scan": LOCAL_RAYS}
_DEEPEST = 20  # limit on the nesting of types


def resolve(node: tree.TypeExpr, c: Context, port: bool = False) -> Type:
    """Return the IR's type for a written type. Reports a type that does not exist and returns POISON.

    The type's capacities are the defaults of shared variables. Only a port may be a PathPlanner or a stream.
    """
    if isinstance(node, tree.NamedType):
        return _named(node.name, node.span, c, port)
    return _composed(node, c, 0)


def _resolve(node: tree.TypeExpr, c: Context, depth: int) -> Type:
    if isinstance(node, tree.NamedType):
        return _named(node.name, node.span, c, False)
    return _composed(node, c, depth + 1)


def _named(name: str, span: Span, c: Context, port: bool) -> Type:
    known = NAMED.get(name)
    if known is not None:
        if (known is PLANNER or known is STREAM) and not port:
            c.error("K017", f"a {name} is a port, not a value", span, "declare the port under 'using'")
            return POISON
        return known
    if name in c.types:
        return c.types[name] or POISON
    if name in _DIALECT:
        c.report_old_spelling(name, _DIALECT[name], span)
        return NAMED[_DIALECT[name]]
    if name in c.broken:
        return POISON
    if name in ("Rect", "Ball"):
        c.error("K017", f"a {name} is a region, not a value", span, "write the region on the right of 'in'")
    elif name in GENERIC:
        c.error("K014", f"{name} needs the types of its contents", span, f"write {name}<{_example_types(name)}>")
    else:
        help = c.suggestion(name, [*NAMED, *GENERIC, *c.types], _MEANT)
        define = f"define the record: 'def {name}:' with its fields" if name[0].isupper() else ""
        c.error("K016", f"{name} is not a type", span, help or define)
    return POISON


def _example_types(name: str) -> str:
    return "int, Point" if name == "Map" else "int" if name == "Set" else "Point"


def _composed(node: tree.GenericType | tree.TupleType | tree.BrokenType, c: Context, depth: int) -> Type:
    if depth > _DEEPEST:
        c.error(
            "K007", f"this type is nested more than {_DEEPEST} deep", node.span, "declare records for parts of the type"
        )
        return POISON
    match node:
        case tree.BrokenType():
            return POISON
        case tree.TupleType(items):
            parts = tuple([_resolve(item, c, depth) for item in items])
            return POISON if POISON in parts else TupleOf(parts)
        case tree.GenericType("[]", (element,)):
            return _dialect_list(node, element, c, depth)
        case tree.GenericType(name, args):
            return _generic(name, args, node.span, c, depth)
        case _:
            assert_never(node)


def _generic(name: str, args: tuple[tree.TypeExpr, ...], span: Span, c: Context, depth: int) -> Type:
    parts = [_resolve(arg, c, depth) for arg in args]
    wanted = GENERIC[name]
    if len(parts) != wanted and (name != "List" or not parts):
        plural = "" if wanted == 1 else "s"
        c.error(
            "K014",
            f"{name} takes {wanted} type{plural}, not {len(parts)}",
            span,
            f"write {name}<{_example_types(name)}>",
        )
        return POISON
    if POISON in parts:
        return POISON
    if name in ("Set", "Map") and not is_key(parts[0]):
        what = "an element of a Set" if name == "Set" else "the key of a Map"
        help = "use an int, a bool, a string, or a tuple of these types"
        c.error("K052", f"{parts[0]} cannot be {what}", args[0].span, help)
        return POISON
    if name == "Map":
        return MapOf(parts[0], parts[1], SHARED_ELEMENTS)
    return Sequence(name, parts[0] if len(parts) == 1 else TupleOf(tuple(parts)), SHARED_ELEMENTS)


def _dialect_list(node: tree.GenericType, element: tree.TypeExpr, c: Context, depth: int) -> Type:
    """Resolve the list type `T[]` of the 2020 dialect. One note reports its brackets and its old type names."""
    type_ = dialect_element(element, c, depth)
    if type_ == POISON:
        return POISON
    type_ = Sequence("List", type_, SHARED_ELEMENTS)
    c.report_old_spelling(c.text(node.span), str(type_), node.span)
    return type_


def dialect_element(element: tree.TypeExpr, c: Context, depth: int = 0) -> Type:
    """Resolve the type T in `T[]`. Old spellings in T are not reported: the note about the whole type covers them."""
    before = len(c.found)
    type_ = _resolve(element, c, depth)
    c.found[before:] = [d for d in c.found[before:] if d.code != "K050"]
    return type_


def is_fleet_size(size: ast.Expr, c: Context) -> bool:
    """Return whether the size of an array is N_SYS. Reports the names of N_SYS in the 2020 dialect."""
    name = size.name if isinstance(size, ast.Name) else ""
    if name in ("numAgents", "numBots"):
        c.report_old_spelling(name, "N_SYS", size.span)
    return name in ("N_SYS", "numAgents", "numBots")


def with_capacities(type_: Type, capacities: tuple[ast.Expr, ...], local: bool, c: Context) -> Type:
    """Return the type with the capacities of its declaration: the outermost type's first (pre-order).

    Without declared capacities, the type has the default capacities of local variables if `local`, else those of shared
    variables. The fields of a record keep the capacities that the record declares.
    """
    if not capacities:
        return _sized(type_, None) if local else type_
    wanted = _capacity_count(type_)
    if type_ != POISON and len(capacities) != wanted:
        span = capacities[min(wanted, len(capacities) - 1)].span
        if not wanted:
            c.error("K053", f"{with_article(type_)} has a fixed size: 'max' is not allowed here", span)
        else:
            many = "one capacity" if wanted == 1 else f"{wanted} capacities, outermost first"
            c.error("K053", f"{type_} takes {many}, not {len(capacities)}", span)
        return type_
    given = [_capacity(node, c) for node in capacities]
    if type_ == POISON or None in given:
        return type_
    return _sized(type_, iter([g for g in given if g is not None]))


def _capacity(node: ast.Expr, c: Context) -> int | None:
    match node:
        case ast.Literal(int(value)) if value > 0 and not isinstance(value, bool):
            return value
        case ast.Broken():
            return None
        case _:
            c.error("K053", f"{c.text(node.span)} is not a capacity", node.span, "write a number of at least 1")
            return None


def _capacity_count(type_: Type) -> int:
    """Return the number of capacities that a declaration of this type may give: one for each sized type in it."""
    match type_:
        case Sized():
            return 1
        case Sequence(_, element):
            return 1 + _capacity_count(element)
        case MapOf(key, value):
            return 1 + _capacity_count(key) + _capacity_count(value)
        case TupleOf(items):
            return sum(map(_capacity_count, items))
        case _:
            return 0


def _sized(type_: Type, given: Iterator[int] | None) -> Type:
    """Return the type with capacities taken from the iterator `given`.

    If `given` is None, the capacities are the defaults of local variables.
    """
    match type_:
        case Sized(name):
            return Sized(name, _LOCAL[name] if given is None else next(given))
        case Sequence(name, element):
            most = LOCAL_ELEMENTS if given is None else next(given)
            return Sequence(name, _sized(element, given), most)
        case MapOf(key, value):
            most = LOCAL_ELEMENTS if given is None else next(given)
            return MapOf(_sized(key, given), _sized(value, given), most)
        case TupleOf(items):
            return TupleOf(tuple([_sized(item, given) for item in items]))
        case _:
            return type_
