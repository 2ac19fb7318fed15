"""Strings: substrings, and the notation of values in strings."""

from __future__ import annotations

from koordgen.runtime.values.containers import OutOfRange
from koordgen.runtime.values.points import Point
from koordgen.runtime.values.turns import made


def part(text: str, a: int | None, b: int | None) -> str:
    """Return the characters from a up to, not including, b; None is the start or the end.

    Bounds beyond the length are clipped. Raises OutOfRange for a negative one."""
    if (a is not None and a < 0) or (b is not None and b < 0):
        raise OutOfRange("a negative index bounds no part of a text: indices never count from the end")
    return made(text[a:b])


def shown(p: Point) -> str:
    """Return a Point as `(x, y, z)`, in metres."""
    return f"({p.x}, {p.y}, {p.z})"
