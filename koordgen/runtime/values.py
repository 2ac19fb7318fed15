"""Koord's values on a robot: a Point is three metres in the local ENU frame, a Pose adds yaw in radians."""

from __future__ import annotations

import math

import msgspec


class Point(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """A position or displacement: x east, y north, z up, in metres about the fleet's origin."""

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


class Pose(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """A position and a heading: yaw in radians, counter-clockwise from east."""

    position: Point
    yaw: float = 0.0


def distance(p: Point, q: Point) -> float:
    """The Euclidean distance of two points, in metres."""
    return math.hypot(p.x - q.x, p.y - q.y, p.z - q.z)


INT_MIN, INT_MAX = -(2**63), 2**63 - 1


def transmissible(value: object) -> bool:
    """Whether a value may go to a port or to another robot: no NaN, no infinity, ints of 64 bits."""
    match value:
        case bool():
            return True
        case int():
            return INT_MIN <= value <= INT_MAX
        case float():
            return math.isfinite(value)
        case Point():
            return math.isfinite(value.x) and math.isfinite(value.y) and math.isfinite(value.z)
        case _:
            return False
