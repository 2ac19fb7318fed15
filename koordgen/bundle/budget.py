"""Whether a round's writes fit in one datagram: decided at build time, with the arithmetic in the message."""

from __future__ import annotations

from typing import assert_never

from koordgen.diagnostics import Diagnostic
from koordgen.emit.types import EXTERN_BYTES, FIXED, NUMBER
from koordgen.ir.decl import Program, Shared
from koordgen.ir.types import ExternType, MapOf, PerRobot, RecordType, Scalar, Sequence, Sized, TupleOf, Type
from koordgen.node import replace

# As koordgen/runtime/layout.py, bounds.py and wire.py have them (tests compare): MessagePack's longest forms.
DATAGRAM = 1200
_WRITE, _CLOSING = 5, 38


def check_budget(program: Program, robots: int) -> list[Diagnostic]:
    """An error at the shared variable that takes most, if all of them do not fit for a fleet of that size."""
    room = DATAGRAM - overhead(robots)
    total = _CLOSING + sum(_WRITE + most_bytes(v.type) for v in program.shared)
    if total <= room:
        return []
    largest = max(program.shared, key=lambda v: most_bytes(v.type))
    message = (
        f"one round's shared writes take up to {total} bytes; with {robots} robots a datagram of {DATAGRAM} "
        f"has room for {room}; {largest.name} alone takes up to {most_bytes(largest.type)}"
    )
    left = room - (total - most_bytes(largest.type))
    return [Diagnostic("B004", "error", message, largest.span, help=_help(largest, left))]


def most_bytes(type_: Type) -> int:
    """The most bytes of a value in MessagePack, within its capacities."""
    match type_:
        case Scalar():
            return FIXED[type_]
        case Sized("string", capacity):
            return _head(capacity, 32, 256) + capacity
        case Sized("GridMap", capacity):
            packed = (capacity + 3) // 4  # two bits a cell
            return 1 + 5 * NUMBER + _head(packed, 0, 256) + packed
        case Sized(_, capacity):
            return 1 + 2 * (_head(capacity, 16, 0) + NUMBER * capacity) + NUMBER
        case Sequence(_, element, capacity):
            return _head(capacity, 16, 0) + capacity * most_bytes(element)
        case MapOf(key, value, capacity):
            return _head(capacity, 16, 0) + capacity * most_bytes(TupleOf((key, value)))
        case TupleOf(items):
            return _head(len(items), 16, 0) + sum(map(most_bytes, items))
        case RecordType(_, fields):
            return most_bytes(TupleOf(tuple([field for _, field in fields])))
        case ExternType():
            return 1 + _head(EXTERN_BYTES, 0, 256) + EXTERN_BYTES
        case PerRobot(element):
            raise AssertionError(f"a variable of type {element}[N_SYS]")
        case _:
            assert_never(type_)


def overhead(robots: int) -> int:
    """The most bytes of a datagram beside its closings: head, clock echoes of up to 8 robots, what is held of each."""
    echoes = 20 * min(robots, 8)
    return 141 + echoes + 5 * robots + (2 if robots >= 16 else 0)


def _head(count: int, shortest: int, short: int) -> int:
    return 1 if count < shortest else 2 if count < short else 3 if count < 1 << 16 else 5


def _help(variable: Shared, left: int) -> str:
    """The greatest `max` with which a variable fits into so many bytes."""
    type_ = variable.type
    if isinstance(type_, (Sized, Sequence, MapOf)):
        fit = 0
        while most_bytes(replace(type_, capacity=fit + 1)) <= left:
            fit += 1
        if fit:
            inner = " as its first capacity" if isinstance(type_, (Sequence, MapOf)) and _sized_inside(type_) else ""
            return f"it fits with `max {fit}`{inner}: {type_} {variable.name} ... max {fit}"
    return "share fewer or smaller variables, or declare smaller capacities with `max`"


def _sized_inside(type_: Sequence | MapOf) -> bool:
    """Whether more capacities follow the outermost one."""
    parts = (type_.element,) if isinstance(type_, Sequence) else (type_.key, type_.value)
    return any(isinstance(part, (Sized, Sequence, MapOf)) for part in parts)
