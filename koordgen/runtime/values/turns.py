"""Limits of one event: its turns, and the sizes of the numbers, texts and collections that it makes.

An event, a guard or a formula may use MOST_TURNS turns. One pass of a loop and one call of a function each cost one
turn. The creation of a list, set, map, queue or text costs one turn for each full ELEMENTS_A_TURN elements, and so does
iteration over such a value. An event beyond a limit raises TooMuch and is discarded. koordgen/lang/semantics counts
turns by the same rules, and tests/agree compares both counts at the limits. Generated code contains no call of this
module where a static bound shows that the cost is 0 (koordgen/build/emit/size.py).

The count is one iterator for the whole process, because one event runs at a time. An iterator counts in C, so it is
fast."""

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
MOST_ELEMENTS = 100_000  # largest number of elements of a list, set, map or queue, and of characters in a text
CELLS_AN_ELEMENT = 100  # number of cells of a GridMap that count as one element
MOST_BITS = 4096  # largest number of bits in an int
_PLAIN = frozenset((int, bool, float, Point))  # types whose values have no elements to count
SMALL_BITS = 64  # a sum or difference is not checked if one operand has at most this number of bits
TOO_LONG = f"an int of more than {MOST_BITS} bits"


class TooMuch(Exception):
    """Raised if an event exceeds a limit. The event is discarded."""


class NoTurns(TooMuch):
    """Raised if an event needs more than MOST_TURNS turns."""


class _UsedUp:
    """Iterator that follows after the last turn. It raises NoTurns."""

    def __iter__(self) -> _UsedUp:
        return self

    def __next__(self) -> Literal[True]:
        raise NoTurns("it is not finished by the end of the round")


class _Count:
    """Remaining turns of the present event: `left` yields True for each turn and raises NoTurns after the last turn."""

    def __init__(self) -> None:
        self.left: Iterator[Literal[True]] | None = None

    def full(self) -> Iterator[Literal[True]]:
        every: Iterator[Literal[True]] = repeat(True, MOST_TURNS)
        self.left = chain(every, _UsedUp())
        return self.left


_count = _Count()


def begin() -> None:
    """Start the count for the next event, guard or formula."""
    _count.left = None  # the first turn creates the iterator, because most events have no loop


def turns(values: Iterable[T]) -> Iterator[T]:
    """Yield the values. Each value costs one turn. Raises TooMuch after the last turn."""
    return compress(values, _count.left or _count.full())


def turn() -> Literal[True]:
    """Spend one turn. Raises TooMuch if no turn is left."""
    return next(_count.left or _count.full())


def made(value: S) -> S:
    """Return a new list, set, map, queue or text after spending the turns that making it costs. Raises TooMuch."""
    size = len(value)
    if size >= ELEMENTS_A_TURN:
        if size > MOST_ELEMENTS:
            raise TooMuch(f"{size} elements or characters, where an event makes at most {MOST_ELEMENTS}")
        spend(size // ELEMENTS_A_TURN)
    return value


def looked(values: S) -> S:
    """Return a collection after spending the turns that iterating over it costs. Raises TooMuch.

    The collection is a text, or a list, queue or set of numbers or Points."""
    size = len(values)
    if size >= ELEMENTS_A_TURN:
        spend(size // ELEMENTS_A_TURN)
    return values


def looked_in(value: T) -> T:
    """Return a value of any type after spending the turns that iterating over all its contents costs.

    Raises TooMuch."""
    spend(elements(value) // ELEMENTS_A_TURN)
    return value


def elements(value: object) -> int:
    """Count the elements of a value and of all values that it contains.

    An element is an element of a list, queue or set, an item of a tuple, a pair, a key or a value of a map, a
    character, or a ray. In a GridMap, CELLS_AN_ELEMENT cells count as one element. Counting ends when the count
    exceeds the elements that MOST_TURNS turns pay for."""
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
    """Spend a number of turns. Raises TooMuch if too few turns are left."""
    if turns:
        next(islice(_count.left or _count.full(), turns - 1, None))


def plus(a: int, b: int) -> int:
    """Return a + b. Raises TooMuch if a and b have more than SMALL_BITS bits and the sum has more than MOST_BITS."""
    found = a + b
    return found if found.bit_length() <= MOST_BITS else _large(found, a, b)


def minus(a: int, b: int) -> int:
    """Return a - b. Raises TooMuch if a and b have more than SMALL_BITS bits and the result more than MOST_BITS."""
    found = a - b
    return found if found.bit_length() <= MOST_BITS else _large(found, a, b)


def product(a: int, b: int) -> int:
    """Return a * b. Raises TooMuch if the product has more than MOST_BITS bits."""
    if a.bit_length() + b.bit_length() <= MOST_BITS + 1:  # a product has as many bits as both factors, or 1 less
        found = a * b
        if found.bit_length() <= MOST_BITS:
            return found
    raise TooMuch(TOO_LONG)


def checked(found: int) -> int:
    """Return an int after a check of its length. Raises TooMuch if the int has more than MOST_BITS bits."""
    if found.bit_length() > MOST_BITS:
        raise TooMuch(TOO_LONG)
    return found


def _large(found: int, a: int, b: int) -> int:
    if min(a.bit_length(), b.bit_length()) > SMALL_BITS:
        raise TooMuch(TOO_LONG)
    return found
