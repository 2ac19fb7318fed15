"""Functions of strings: substrings, and the text of a Point."""

from __future__ import annotations

from koordgen.runtime.values.containers import OutOfRange
from koordgen.runtime.values.points import Point
from koordgen.runtime.values.turns import made


def part(text: str, a: int | None, b: int | None) -> str:
    """Return the characters with indices from a to b - 1. None for a denotes the start, None for b the end.

    A bound beyond the length counts as the length. Raises OutOfRange for a negative bound."""
    if (a is not None and a < 0) or (b is not None and b < 0):
        raise OutOfRange("a negative index bounds no part of a text: indices never count from the end")
    return made(text[a:b])


def shown(p: Point) -> str:
    """Return the text `(x, y, z)` of a Point, in metres."""
    return f"({p.x}, {p.y}, {p.z})"
