"""Variation from run to run, as in `seed=1:70`, `loss=0:0.3`, `delay=0,0.05`, `param.eps=0.5:0.9`.

Lists of values span cells, one for each combination of their values. Runs go through the cells in turn; one pass
through all cells is a turn. The runs of one turn have the same seed and the same drawn values, so that cells can be
compared in pairs. Values of ranges are multiples of square roots of primes (R. D. Richtmyer, "The Evaluation of
Definite Integrals, and a Quasi-Monte-Carlo Method", 1951): every initial part of a campaign covers its ranges about as
evenly as the whole.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from random import Random

SEED = "seed"
PARAM = "param."
MOST_CELLS = 100_000
PRIMES = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37)


class BadVary(Exception):
    """An argument of `--vary` is wrong; the message quotes it."""


@dataclass(frozen=True)
class ValueList:
    """A list of values, as they were written."""

    name: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class NumberRange:
    """Any number from `lo` to `hi`."""

    name: str
    lo: float
    hi: float


@dataclass(frozen=True)
class Seeds:
    """A new seed in each turn, beginning with `first`; `last` limits the number of turns."""

    first: int
    last: int | None = None
    name: str = SEED


Varied = ValueList | NumberRange | Seeds


def parse(texts: Sequence[str]) -> tuple[Varied, ...]:
    """Parse the arguments of all `--vary`. Raises BadVary."""
    found: list[Varied] = []
    for text in texts:
        found += [_one(*item) for item in _items(text)]
    names = [varied.name for varied in found]
    for name in names:
        if names.count(name) > 1:
            raise BadVary(f"{name} is varied twice")
    if math.prod(len(v.values) for v in found if isinstance(v, ValueList)) > MOST_CELLS:
        raise BadVary(f"the lists have more than {MOST_CELLS} combinations")
    if sum(isinstance(v, NumberRange) for v in found) > len(PRIMES):
        raise BadVary(f"more than {len(PRIMES)} ranges")
    return tuple(found)


def _items(text: str) -> list[tuple[str, list[str]]]:
    """Split `seed,loss=0,0.1,delay=0:1` into [("seed", []), ("loss", ["0", "0.1"]), ("delay", ["0:1"])].

    An item without `=`, except `seed`, continues the list before it."""
    items: list[tuple[str, list[str]]] = []
    for part in text.split(","):
        name, equals, value = (word.strip() for word in part.partition("="))
        if equals and name and value:
            items.append((name, [value]))
        elif part.strip() == SEED:
            items.append((SEED, []))
        elif items and items[-1][1] and not equals and name:
            items[-1][1].append(name)
        else:
            raise BadVary(f"{text!r}: {part.strip()!r} is neither `seed`, NAME=LO:HI nor NAME=A,B,C")
    return items


def _one(name: str, values: list[str]) -> Varied:
    if not values:
        return Seeds(1)
    if len(values) > 1 or ":" not in values[0]:
        if name == SEED:
            for value in values:
                _whole(name, value)
        return ValueList(name, tuple(values))
    low, _, high = values[0].partition(":")
    if name == SEED:
        first, last = _whole(name, low), _whole(name, high)
        if last < first:
            raise BadVary(f"{name}={values[0]}: it ends before it begins")
        return Seeds(first, last)
    lo, hi = _number(name, low), _number(name, high)
    if not lo < hi:
        raise BadVary(f"{name}={values[0]}: a range goes from a smaller to a greater number")
    return NumberRange(name, lo, hi)


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadVary(f"{name}: {text!r} is no number")
    return value


def _whole(name: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise BadVary(f"{name}: {text!r} is no whole number") from None


def natural(varied: Sequence[Varied]) -> int | None:
    """Return the default number of runs: every combination once, with every seed.

    None if there is no natural number."""
    seeds = next((v for v in varied if isinstance(v, Seeds)), None)
    if any(isinstance(v, NumberRange) for v in varied) or (seeds and seeds.last is None):
        return None
    turns = seeds.last - seeds.first + 1 if seeds and seeds.last is not None else 1
    return turns * len(cells(varied))


def cells(varied: Sequence[Varied]) -> list[dict[str, str]]:
    """Return the combinations of the lists' values; a single empty one if there is no list."""
    grids = [v for v in varied if isinstance(v, ValueList)]
    return [
        dict(zip([g.name for g in grids], values, strict=True)) for values in product(*[grid.values for grid in grids])
    ]


def values(varied: Sequence[Varied], runs: int) -> list[dict[str, str]]:
    """Return for each run its varied values by name, as on a command line, in the order of `varied`.

    Raises BadVary if there are too few seeds."""
    combinations = cells(varied)
    ranges = [v for v in varied if isinstance(v, NumberRange)]
    steps = [math.sqrt(prime) for prime in PRIMES]
    starts = [Random(f"campaign/{v.name}").random() for v in ranges]
    result = []
    for number in range(runs):
        turn, cell = divmod(number, len(combinations))
        own = dict(combinations[cell])
        for range_, start, step in zip(ranges, starts, steps, strict=False):
            share = (start + (turn + 1) * step) % 1.0
            own[range_.name] = f"{range_.lo + share * (range_.hi - range_.lo):.6g}"
        for seeds in varied:
            if isinstance(seeds, Seeds):
                if seeds.last is not None and seeds.first + turn > seeds.last:
                    raise BadVary(f"seed={seeds.first}:{seeds.last} are too few seeds for {runs} runs")
                own[SEED] = str(seeds.first + turn)
        result.append({v.name: own[v.name] for v in varied})
    return result
