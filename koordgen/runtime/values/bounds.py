"""Size limits of variables: largest number of bytes on the wire, and a check of whether a value fits.

The classes follow the structure of Koord's types. koordgen/build/emit/types.py writes their objects into generated
programs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

from koordgen.runtime.values.containers import is_map, is_set
from koordgen.runtime.values.gridmap import GridMap, sound
from koordgen.runtime.values.points import INT_MAX, INT_MIN, Grid, Opaque, Scan

NUMBER = 9  # largest number of bytes of an int or a float in MessagePack


class Bound(Protocol):
    """Size limit of a value.

    `flaw` checks a value of the right type. It returns "" if the value fits and Koord's operations can produce it,
    otherwise a description of the value, as the end of the sentence "x would become ..."."""

    @property
    def bytes(self) -> int: ...

    def flaw(self, value: Any) -> str: ...


def fits(bound: Bound, value: Any) -> bool:
    """Return whether a value is within its size limit."""
    return not bound.flaw(value)


@dataclass(frozen=True, slots=True)
class Fixed:
    """Size limit of a value whose length is constant: a number, a Point, a Pose or a Grid."""

    bytes: int

    def flaw(self, value: Any) -> str:
        if isinstance(value, int):
            fits = INT_MIN <= value <= INT_MAX
        else:
            fits = not isinstance(value, Grid) or (
                min(value.x, value.y) >= INT_MIN and max(value.x, value.y) <= INT_MAX
            )
        return "" if fits else "an int beyond 64 bits, which no robot may use"


@dataclass(frozen=True, slots=True)
class Text:
    """Size limit of a string: at most `capacity` bytes in UTF-8."""

    capacity: int

    @property
    def bytes(self) -> int:
        return _head(self.capacity, 32, 256) + self.capacity

    def flaw(self, value: str) -> str:
        try:
            length = len(value) if value.isascii() else len(value.encode())
        except UnicodeEncodeError:
            return "a text that is not Unicode"
        return _excess("text", length, "bytes", self.capacity)


@dataclass(frozen=True, slots=True)
class Cells:
    """Size limit of a GridMap: at most `capacity` cells."""

    capacity: int

    @property
    def bytes(self) -> int:
        packed = (self.capacity + 3) // 4
        return 1 + 5 * NUMBER + _head(packed, 0, 256) + packed

    def flaw(self, value: GridMap) -> str:
        count = value.width * value.height
        return _excess("map", count, "cells", self.capacity) or ("" if sound(value) else "a broken map")


@dataclass(frozen=True, slots=True)
class Rays:
    """Size limit of a Scan: at most `capacity` rays."""

    capacity: int

    @property
    def bytes(self) -> int:
        return 1 + 2 * (_head(self.capacity, 16, 0) + NUMBER * self.capacity) + NUMBER

    def flaw(self, value: Scan) -> str:
        count = max(len(value.angles), len(value.ranges))
        return _excess("scan", count, "rays", self.capacity)


@dataclass(frozen=True, slots=True)
class Blob:
    """Size limit of a value of the extern type `name`: at most `capacity` bytes."""

    capacity: int
    name: str

    @property
    def bytes(self) -> int:
        return 1 + _head(self.capacity, 0, 256) + self.capacity

    def flaw(self, value: Opaque) -> str:
        return _excess(self.name, len(value.data), "bytes", self.capacity)


@dataclass(frozen=True, slots=True)
class Many:
    """Size limit of a List or a Queue: at most `capacity` elements."""

    capacity: int
    element: Bound

    @property
    def bytes(self) -> int:
        return _head(self.capacity, 16, 0) + self.capacity * self.element.bytes

    def flaw(self, value: tuple[Any, ...]) -> str:
        return _elements("list", value, self.capacity, self.element)


@dataclass(frozen=True, slots=True)
class Distinct:
    """Size limit of a Set: at most `capacity` elements."""

    capacity: int
    element: Bound

    @property
    def bytes(self) -> int:
        return Many(self.capacity, self.element).bytes

    def flaw(self, value: tuple[Any, ...]) -> str:
        flaw = _elements("set", value, self.capacity, self.element)
        return flaw or ("" if is_set(value) else "a set out of order")


@dataclass(frozen=True, slots=True)
class Pairs:
    """Size limit of a Map: at most `capacity` keys."""

    capacity: int
    key: Bound
    value: Bound

    @property
    def bytes(self) -> int:
        return Many(self.capacity, Parts((self.key, self.value))).bytes

    def flaw(self, value: tuple[tuple[Any, Any], ...]) -> str:
        flaw = _elements("map", value, self.capacity, Parts((self.key, self.value)))
        return flaw or ("" if is_map(value) else "a map out of order")


@dataclass(frozen=True, slots=True)
class Parts:
    """Size limits of the items of a tuple, in their order. For a record, `fields` names the field of each item."""

    items: tuple[Bound, ...]
    fields: tuple[str, ...] = ()

    @property
    def bytes(self) -> int:
        return _head(len(self.items), 16, 0) + sum(item.bytes for item in self.items)

    def flaw(self, value: Any) -> str:
        return _first(bound.flaw(v) for bound, v in zip(self.items, parts_of(value), strict=True))


def parts_of(value: Any) -> tuple[Any, ...]:
    """Return the items of a tuple, or the fields of a record."""
    return value if isinstance(value, tuple) else tuple(getattr(value, f) for f in value.__struct_fields__)


def _head(count: int, shortest: int, short: int) -> int:
    """Return the largest number of bytes that MessagePack writes before `count` items or bytes.

    The number is 1 if `count < shortest`, otherwise 2 if `count < short`, otherwise 3 or 5."""
    return 1 if count < shortest else 2 if count < short else 3 if count < 1 << 16 else 5


def _excess(what: str, count: int, unit: str, capacity: int) -> str:
    return f"a {what} of {count} {unit}, beyond its `max {capacity}`" if count > capacity else ""


def _elements(what: str, value: tuple[Any, ...], capacity: int, element: Bound) -> str:
    excess = _excess(what, len(value), "elements", capacity)
    return excess or _first(element.flaw(v) for v in value)


def _first(flaws: Iterable[str]) -> str:
    flaw = next(filter(None, flaws), "")
    return flaw if not flaw or flaw.startswith("one with ") else f"one with {flaw}"
