"""Points, poses, grid cells, scans and other values of Koord programs, and checks of values.

A Point is a position in metres in the local ENU frame. A Pose is a position with a yaw in radians.

Every value is immutable. A value is a number, a string, a tuple, or a frozen Struct of this module, of gridmap.py or of
the program."""

from __future__ import annotations

import math
from typing import Any, TypeVar

import msgspec

T = TypeVar("T")


class Point(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """Position relative to the fleet's origin, or displacement: x east, y north, z up, in metres."""

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
    """Cell of a square lattice in the plane.

    The cell is the square with lower left corner (x * size, y * size), `size` metres wide, without its upper edges."""

    x: int = 0
    y: int = 0
    size: float = 1.0


class Scan(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """Ranges that one turn of a planar lidar measured.

    `angles`: radians, counter-clockwise from east, in the world frame; the robot's heading is already added. `ranges`:
    one range in metres for each angle. The range of a ray without a hit is `max_range`, never infinity."""

    angles: tuple[float, ...] = ()
    ranges: tuple[float, ...] = ()
    max_range: float = 0.0


class Opaque(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """Value of an extern type: MessagePack of an object of the user's class; b"" before the first object is made."""

    data: bytes = b""


class NotANumber(ArithmeticError):
    """Raised if an operand of a comparison is NaN or contains NaN. The exception discards the event."""

    def __init__(self) -> None:
        super().__init__("a comparison met NaN")


def no_nan(x: float) -> float:
    """Return x after a check that x is not NaN, for use in a comparison. Raises NotANumber."""
    if x == x:
        return x
    raise NotANumber


def no_nan_in(value: T) -> T:
    """Return a value after a check that it contains no NaN at any depth, for use in a comparison.

    Raises NotANumber if the value contains NaN."""
    if has_nan(value):
        raise NotANumber
    return value


def has_nan(value: object) -> bool:
    """Return whether a value is NaN, or contains NaN at any depth."""
    if isinstance(value, msgspec.Struct):
        value = msgspec.structs.astuple(value)
    return any(map(has_nan, value)) if isinstance(value, tuple) else value != value


def distance(p: Point, q: Point) -> float:
    """Return the Euclidean distance between two points in metres."""
    return math.hypot(p.x - q.x, p.y - q.y, p.z - q.z)


INT_MIN, INT_MAX = -(2**63), 2**63 - 1


def transmissible(value: object) -> bool:
    """Return whether a value may be stored in a variable, passed to a port or sent to another robot.

    False if the value contains, at any depth, NaN, infinity, an int beyond 64 bits, text that is not Unicode, or an
    object that is no Koord value. The check uses a list instead of recursion, so deep nesting cannot exhaust the stack.
    """
    if type(value) in _PARTLESS:
        return _plain(value)
    pending: list[Any] = [value]
    for item in pending:  # the loop appends the parts of each item to the list
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
    """Return whether a value without parts is transmissible.

    The patterns also match subclasses: floats and ints of other libraries."""
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
    except UnicodeEncodeError:  # a lone surrogate, for example from badly decoded bytes of a device
        return False
    return True
