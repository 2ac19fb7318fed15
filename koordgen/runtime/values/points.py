"""Values of Koord programs.

A Point is a position in metres in the local ENU frame, a Pose adds yaw in radians.

Every value is immutable: numbers, strings, tuples and the frozen Structs of this module, of gridmap.py and of the
program."""

from __future__ import annotations

import math
from typing import Any, TypeVar

import msgspec

T = TypeVar("T")


class Point(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """Position or displacement: x east, y north, z up, in metres about the fleet's origin."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    def __add__(self, other: Point) -> Point:
        return Point(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: Point) -> Point:
        return Point(self.x - other.x, self.y - other.y, self.z - other.z)

    def __mul__(self, factor: float) -> Point:
        return Point(self.x * factor, self.y * factor, self.z * factor)

    __rmul__ = __mul__

    def __truediv__(self, divisor: float) -> Point:
        return Point(self.x / divisor, self.y / divisor, self.z / divisor)

    def __neg__(self) -> Point:
        return Point(-self.x, -self.y, -self.z)


class Pose(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """Position and heading: yaw in radians, counter-clockwise from east."""

    position: Point = Point()
    yaw: float = 0.0


class Grid(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """Cell of the plane's lattice.

    The square from (x * size, y * size), `size` metres wide, upper edges excluded."""

    x: int = 0
    y: int = 0
    size: float = 1.0


class Scan(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """One turn of a planar lidar.

    `angles`: radians from east, counter-clockwise, in the world frame, independent of the heading. `ranges`: metres,
    one for each angle; a ray without a hit has `max_range`, never infinity."""

    angles: tuple[float, ...] = ()
    ranges: tuple[float, ...] = ()
    max_range: float = 0.0


class Opaque(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """Value of an extern type: MessagePack of the user's own class, b"" until one has been made."""

    data: bytes = b""


class NotANumber(ArithmeticError):
    """A comparison with NaN: one of its operands is NaN, or contains NaN. Discards the event."""

    def __init__(self) -> None:
        super().__init__("a comparison met NaN")


def no_nan(x: float) -> float:
    """Return a number that is about to be compared. Raises NotANumber."""
    if x == x:
        return x
    raise NotANumber


def no_nan_in(value: T) -> T:
    """Return a value that is about to be compared as a whole.

    Raises NotANumber for NaN in it, at any depth."""
    if has_nan(value):
        raise NotANumber
    return value


def has_nan(value: object) -> bool:
    """Return whether a value is NaN, or has NaN in it at any depth."""
    if isinstance(value, msgspec.Struct):
        value = msgspec.structs.astuple(value)
    return any(map(has_nan, value)) if isinstance(value, tuple) else value != value


def distance(p: Point, q: Point) -> float:
    """Return the Euclidean distance of two points, in metres."""
    return math.hypot(p.x - q.x, p.y - q.y, p.z - q.z)


INT_MIN, INT_MAX = -(2**63), 2**63 - 1


def transmissible(value: object) -> bool:
    """Return whether a value may be kept, or go to a port or to another robot.

    Not allowed at any depth: NaN, infinity, an int beyond 64 bits, text that is not Unicode, any object that is no
    Koord value. It uses a list instead of recursion, so no nesting can exhaust the stack (the result of a typed decoder
    is as deep as its static type, and no deeper)."""
    if type(value) in _PARTLESS:
        return _plain(value)
    pending: list[Any] = [value]
    for item in pending:  # grows during the loop
        kind = type(item)
        if kind is float:
            if not math.isfinite(item):
                return False
        elif kind is tuple:
            pending.extend(item)
        elif kind is Point:
            pending += (item.x, item.y, item.z)
        elif isinstance(item, msgspec.Struct):
            if not kind.__struct_config__.frozen:
                return False
            pending.extend(msgspec.structs.astuple(item))
        elif not _plain(item):
            return False
    return True


_PARTLESS = frozenset((bool, int, float, str))


def _plain(value: object) -> bool:
    """Do the check of `transmissible` for a value without parts.

    Subclasses are floats and ints of other libraries."""
    match value:
        case bool() | bytes():
            return True
        case int():
            return INT_MIN <= value <= INT_MAX
        case float():
            return math.isfinite(value)
        case str():
            return value.isascii() or _encodable(value)
        case _:
            return False


def _encodable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:  # a lone surrogate, as from badly decoded bytes of a device
        return False
    return True
