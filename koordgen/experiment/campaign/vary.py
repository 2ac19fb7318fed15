"""What varies from run to run: `seed`, `seed=1:70`, `loss=0:0.3`, `delay=0,0.02,0.05`, `param.eps=0.5:0.9`.

Grids make cells, one for each combination of their values; the runs go round the cells. The runs of all cells with one
turn have the same seed and the same drawn values, so cells are compared in pairs. Values of ranges are drawn evenly, by
multiples of the square roots of primes (R. D. Richtmyer, "The Evaluation of Definite Integrals, and a Quasi-Monte-Carlo
Method", 1951): each beginning of the campaign covers its ranges about as evenly as the whole.
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
    """What is not understood; the message quotes it."""


@dataclass(frozen=True)
class Grid:
    """One of these values, as they were written."""

    name: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class Range:
    """Any number from `lo` to `hi`."""

    name: str
    lo: float
    hi: float


@dataclass(frozen=True)
class Seeds:
    """Another seed with each turn, from `first` on; `last` bounds how many turns there can be."""

    first: int
    last: int | None = None
    name: str = SEED


Varied = Grid | Range | Seeds


def parse(texts: Sequence[str]) -> tuple[Varied, ...]:
    """What several `--vary` say together. Raises BadVary."""
    found: list[Varied] = []
    for text in texts:
        found += [_one(*item) for item in _items(text)]
    names = [varied.name for varied in found]
    for name in names:
        if names.count(name) > 1:
            raise BadVary(f"{name} is varied twice")
    if math.prod(len(v.values) for v in found if isinstance(v, Grid)) > MOST_CELLS:
        raise BadVary(f"the lists have more than {MOST_CELLS} combinations")
    if sum(isinstance(v, Range) for v in found) > len(PRIMES):
        raise BadVary(f"more than {len(PRIMES)} ranges")
    return tuple(found)


def _items(text: str) -> list[tuple[str, list[str]]]:
    """`seed,loss=0,0.1,delay=0:1` -> [("seed", []), ("loss", ["0", "0.1"]), ("delay", ["0:1"])]: what has no `=` goes
    on with the list before it, but for `seed`."""
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
        return Grid(name, tuple(values))
    low, _, high = values[0].partition(":")
    if name == SEED:
        first, last = _whole(name, low), _whole(name, high)
        if last < first:
            raise BadVary(f"{name}={values[0]}: it ends before it begins")
        return Seeds(first, last)
    lo, hi = _number(name, low), _number(name, high)
    if not lo < hi:
        raise BadVary(f"{name}={values[0]}: a range goes from a smaller to a greater number")
    return Range(name, lo, hi)


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
    """How many runs there are when nobody says it: every combination once, with every seed. None: as many as one
    likes."""
    seeds = next((v for v in varied if isinstance(v, Seeds)), None)
    if any(isinstance(v, Range) for v in varied) or (seeds and seeds.last is None):
        return None
    turns = seeds.last - seeds.first + 1 if seeds and seeds.last is not None else 1
    return turns * len(cells(varied))


def cells(varied: Sequence[Varied]) -> list[dict[str, str]]:
    """The combinations of the grids' values; one, without any, when there is no grid."""
    grids = [v for v in varied if isinstance(v, Grid)]
    return [
        dict(zip([g.name for g in grids], values, strict=True)) for values in product(*[grid.values for grid in grids])
    ]


def values(varied: Sequence[Varied], runs: int) -> list[dict[str, str]]:
    """For each run what its varied names are, as written on a command line, in the order of `varied`. Raises BadVary
    when the seeds do not suffice."""
    combinations = cells(varied)
    ranges = [v for v in varied if isinstance(v, Range)]
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
