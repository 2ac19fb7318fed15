"""Check of constants against the capacities of their variables."""

from __future__ import annotations

from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import MapOf, RecordType, Sequence, Sized, TupleOf, Type


def excess(value: ir.Expr, type_: Type) -> str:
    """Return why a constant does not fit its variable's capacity; empty if it fits or is not a constant."""
    match value, type_:
        case ir.Const(str(text)), Sized(_, capacity) if len(text.encode()) > capacity:
            return f"{len(text.encode())} bytes, and at most {capacity} fit"
        case ir.Make(items), Sequence(_, _, capacity) | MapOf(_, _, capacity) if len(items) > capacity:
            return f"{len(items)} elements, and at most {capacity} fit"
        case ir.Make(items), _:
            pairs = zip(items, _parts(type_, len(items)), strict=False)
            return next((found for item, part in pairs if (found := excess(item, part))), "")
        case _:
            return ""


def _parts(type_: Type, count: int) -> tuple[Type, ...]:
    match type_:
        case Sequence(_, element):
            return (element,) * count
        case MapOf(key, value):
            return (TupleOf((key, value)),) * count
        case TupleOf(items):
            return items
        case RecordType(_, fields):
            return tuple([field for _, field in fields])
        case _:
            return ()
