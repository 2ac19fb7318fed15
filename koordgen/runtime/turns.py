"""Limits of one event: the turns of its loops, and the sizes of the numbers, texts and collections that it makes.

An event, a guard and a formula each have MOST_TURNS turns. A turn of a loop and a call of a function cost one turn; so
does every full ELEMENTS_A_TURN elements of a new list, set, map, queue or text. What needs more raises TooMuch, which
discards the event. koordgen/semantics counts the same; tests/agree compares both at the limits.

The count is an iterator that one process has, for one event at a time: counting stays in C.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sized
from itertools import chain, compress, islice, repeat
from typing import Literal, TypeVar

T = TypeVar("T")
S = TypeVar("S", bound=Sized)

MOST_TURNS = 1_000_000
ELEMENTS_A_TURN = 100
MOST_ELEMENTS = 100_000  # of a list, set, map, queue; characters of a text
MOST_BITS = 4096  # of an int
SMALL_BITS = 64  # an int of at most so many is added and subtracted without a look at the result
TOO_LONG = f"an int of more than {MOST_BITS} bits"


class TooMuch(Exception):
    """An event exceeds a limit, and is discarded."""


class NoTurns(TooMuch):
    """An event needs more turns than it has."""


class _UsedUp:
    """Emit what comes after the last turn."""

    def __iter__(self) -> _UsedUp:
        return self

    def __next__(self) -> Literal[True]:
        raise NoTurns("it is not finished by the end of the round")


class _Count:
    """The turns that are left: an iterator that yields True for each, and raises TooMuch after the last."""

    def __init__(self) -> None:
        self.left: Iterator[Literal[True]] | None = None

    def full(self) -> Iterator[Literal[True]]:
        every: Iterator[Literal[True]] = repeat(True, MOST_TURNS)
        self.left = chain(every, _UsedUp())
        return self.left


_count = _Count()


def begin() -> None:
    """Start the count for the next event, guard or formula."""
    _count.left = None  # made when it is asked for: most events have no loop


def turns(values: Iterable[T]) -> Iterator[T]:
    """Yield the values, each for one turn. Raises TooMuch."""
    return compress(values, _count.left or _count.full())


def turn() -> Literal[True]:
    """Take one turn. Raises TooMuch."""
    return next(_count.left or _count.full())


def made(value: S) -> S:
    """Return a new list, set, map, queue or text, for the turns that it costs. Raises TooMuch."""
    size = len(value)
    if size >= ELEMENTS_A_TURN:
        if size > MOST_ELEMENTS:
            raise TooMuch(f"{size} elements or characters, where an event makes at most {MOST_ELEMENTS}")
        next(islice(_count.left or _count.full(), size // ELEMENTS_A_TURN - 1, None))
    return value


def plus(a: int, b: int) -> int:
    """a + b. Raises TooMuch when both are beyond SMALL_BITS and the sum is beyond MOST_BITS."""
    found = a + b
    return found if found.bit_length() <= MOST_BITS else _large(found, a, b)


def minus(a: int, b: int) -> int:
    """a - b. Raises TooMuch as `plus` does."""
    found = a - b
    return found if found.bit_length() <= MOST_BITS else _large(found, a, b)


def product(a: int, b: int) -> int:
    """a * b. Raises TooMuch beyond MOST_BITS."""
    if a.bit_length() + b.bit_length() <= MOST_BITS + 1:  # a product has as many bits as both factors, or one less
        found = a * b
        if found.bit_length() <= MOST_BITS:
            return found
    raise TooMuch(TOO_LONG)


def checked(found: int) -> int:
    """Return an int. Raises TooMuch beyond MOST_BITS."""
    if found.bit_length() > MOST_BITS:
        raise TooMuch(TOO_LONG)
    return found


def _large(found: int, a: int, b: int) -> int:
    if min(a.bit_length(), b.bit_length()) > SMALL_BITS:
        raise TooMuch(TOO_LONG)
    return found
