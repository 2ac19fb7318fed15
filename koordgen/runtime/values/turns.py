"""Limits of one event: turns of loops, and sizes of the numbers, texts and collections that it makes.

An event, a guard and a formula each have MOST_TURNS turns. One turn of a loop and one call of a function cost one turn.
Every full ELEMENTS_A_TURN elements of a new list, set, map, queue or text cost one turn, too, and so does passing over
such a collection. More than the limit raises TooMuch, which discards the event. koordgen/lang/semantics counts the
same; tests/agree compares both at the limits. Generated code has no call where a static bound shows that the cost is 0
(koordgen/build/emit/size.py).

The count is an iterator of the process, for one event at a time: counting stays in C."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sized
from itertools import chain, compress, islice, repeat
from typing import Literal, TypeVar

import msgspec

from koordgen.runtime.values.gridmap import GridMap
from koordgen.runtime.values.points import Opaque, Point

T = TypeVar("T")
S = TypeVar("S", bound=Sized)

MOST_TURNS = 1_000_000
ELEMENTS_A_TURN = 100
MOST_ELEMENTS = 100_000  # largest number of elements of a list, set, map or queue, and of characters of a text
CELLS_AN_ELEMENT = 100  # number of cells of a GridMap that count as one element
MOST_BITS = 4096  # largest length of an int, in bits
_PLAIN = frozenset((int, bool, float, Point))  # types whose values have no elements to count
SMALL_BITS = 64  # an int of at most this length is added and subtracted without a check of the result
TOO_LONG = f"an int of more than {MOST_BITS} bits"


class TooMuch(Exception):
    """An event exceeds a limit, and is discarded."""


class NoTurns(TooMuch):
    """An event needs more turns than it has."""


class _UsedUp:
    """Iterator after the last turn: it raises NoTurns."""

    def __iter__(self) -> _UsedUp:
        return self

    def __next__(self) -> Literal[True]:
        raise NoTurns("it is not finished by the end of the round")


class _Count:
    """Remaining turns: an iterator that yields True for each, and raises TooMuch after the last."""

    def __init__(self) -> None:
        self.left: Iterator[Literal[True]] | None = None

    def full(self) -> Iterator[Literal[True]]:
        every: Iterator[Literal[True]] = repeat(True, MOST_TURNS)
        self.left = chain(every, _UsedUp())
        return self.left


_count = _Count()


def begin() -> None:
    """Start the count for the next event, guard or formula."""
    _count.left = None  # created on demand: most events have no loop


def turns(values: Iterable[T]) -> Iterator[T]:
    """Yield the values, each for one turn. Raises TooMuch."""
    return compress(values, _count.left or _count.full())


def turn() -> Literal[True]:
    """Take one turn. Raises TooMuch."""
    return next(_count.left or _count.full())


def made(value: S) -> S:
    """Return a new list, set, map, queue or text, after spending its turns. Raises TooMuch."""
    size = len(value)
    if size >= ELEMENTS_A_TURN:
        if size > MOST_ELEMENTS:
            raise TooMuch(f"{size} elements or characters, where an event makes at most {MOST_ELEMENTS}")
        spend(size // ELEMENTS_A_TURN)
    return value


def looked(values: S) -> S:
    """Return a collection after spending the turns of passing over it.

    It is a text, or a list, queue or set of numbers or Points. Raises TooMuch."""
    size = len(values)
    if size >= ELEMENTS_A_TURN:
        spend(size // ELEMENTS_A_TURN)
    return values


def looked_in(value: T) -> T:
    """Return a value of any type, after spending the turns of passing over all its contents.

    Raises TooMuch."""
    spend(elements(value) // ELEMENTS_A_TURN)
    return value


def elements(value: object) -> int:
    """Count the elements of a value and of all its contents.

    These are elements of a list, queue or set; items of a tuple; pairs, keys and values of a map; characters; rays; for
    a GridMap one per CELLS_AN_ELEMENT cells. Counting ends beyond the limit of any event."""
    if isinstance(value, tuple):
        found = len(value)
        for part in value:
            if type(part) in _PLAIN:
                continue
            if found > MOST_TURNS * ELEMENTS_A_TURN:
                break
            found += elements(part)
        return found
    if isinstance(value, str):
        return len(value)
    if isinstance(value, GridMap):
        return value.width * value.height // CELLS_AN_ELEMENT
    if isinstance(value, msgspec.Struct) and not isinstance(value, Opaque):
        return sum([elements(field) for field in msgspec.structs.astuple(value)])
    return 0


def spend(turns: int) -> None:
    """Spend this many turns. Raises TooMuch."""
    if turns:
        next(islice(_count.left or _count.full(), turns - 1, None))


def plus(a: int, b: int) -> int:
    """Return a + b. Raises TooMuch if both are beyond SMALL_BITS and the sum is beyond MOST_BITS."""
    found = a + b
    return found if found.bit_length() <= MOST_BITS else _large(found, a, b)


def minus(a: int, b: int) -> int:
    """Return a - b. Raises TooMuch as `plus` does."""
    found = a - b
    return found if found.bit_length() <= MOST_BITS else _large(found, a, b)


def product(a: int, b: int) -> int:
    """Return a * b. Raises TooMuch beyond MOST_BITS."""
    if a.bit_length() + b.bit_length() <= MOST_BITS + 1:  # a product has as many bits as both factors, or one less
        found = a * b
        if found.bit_length() <= MOST_BITS:
            return found
    raise TooMuch(TOO_LONG)


def checked(found: int) -> int:
    """Return an int after a check. Raises TooMuch beyond MOST_BITS."""
    if found.bit_length() > MOST_BITS:
        raise TooMuch(TOO_LONG)
    return found


def _large(found: int, a: int, b: int) -> int:
    if min(a.bit_length(), b.bit_length()) > SMALL_BITS:
        raise TooMuch(TOO_LONG)
    return found
