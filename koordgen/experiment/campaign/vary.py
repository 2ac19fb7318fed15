"""Varied values of a campaign's runs, as `--vary` gives them: `seed=1:70`, `loss=0:0.3`, `delay=0,0.05`.

A range (`loss=0:0.3`) varies over an interval, a list (`delay=0,0.05`) over its values. A cell is one combination of
values of all lists. The runs of a campaign use the cells in turn; one cycle through all cells is a pass. All runs of a
pass have the same seed and the same values of ranges, so that cells can be compared with each other.

The value of a range is computed from multiples of the square root of a prime (R. D. Richtmyer, "The Evaluation of
Definite Integrals, and a Quasi-Monte-Carlo Method", 1951). So the first n runs of a campaign cover the ranges evenly
for each n.
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
    """Raised if the arguments of `--vary` are wrong. The message says which argument is wrong and why."""


@dataclass(frozen=True)
class ValueList:
    """Varied quantity with a list of values, such as `delay=0,0.05`. Values stay as the user wrote them."""

    name: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class NumberRange:
    """Varied quantity whose value is a number between `lo` and `hi`, such as `loss=0:0.3`."""

    name: str
    lo: float
    hi: float


@dataclass(frozen=True)
class Seeds:
    """Varied seed, such as `seed=1:70`. The first pass over all cells has the seed `first`, the next `first` + 1.

    `last`: last allowed seed, which limits the number of passes; None if there is no limit."""

    first: int
    last: int | None = None
    name: str = SEED


Varied = ValueList | NumberRange | Seeds


def parse(texts: Sequence[str]) -> tuple[Varied, ...]:
    """Parse the arguments of all `--vary` options of a command. Raises BadVary."""
    found: list[Varied] = []
    for text in texts:
        found += [_one(*item) for item in _items(text)]
    names = [varied.name for varied in found]
    for name in names:
        if names.count(name) > 1:
            raise BadVary(f"{name} is varied twice; each name is allowed once")
    if math.prod(len(v.values) for v in found if isinstance(v, ValueList)) > MOST_CELLS:
        raise BadVary(f"the lists have more than {MOST_CELLS} combinations of values; shorten a list")
    if sum(isinstance(v, NumberRange) for v in found) > len(PRIMES):
        raise BadVary(f"more than {len(PRIMES)} ranges; remove some")
    return tuple(found)


def _items(text: str) -> list[tuple[str, list[str]]]:
    """Split the argument of a `--vary` option into names with their values.

    `seed,loss=0,0.1,delay=0:1` becomes [("seed", []), ("loss", ["0", "0.1"]), ("delay", ["0:1"])]. A part without `=`
    is a further value of the name before it, unless the part is `seed`."""
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
            raise BadVary(f"{name}={values[0]}: the last seed is less than the first seed")
        return Seeds(first, last)
    lo, hi = _number(name, low), _number(name, high)
    if not lo < hi:
        raise BadVary(f"{name}={values[0]}: the first number of a range must be less than the second number")
    return NumberRange(name, lo, hi)


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadVary(f"{name}: {text!r} is not a finite number")
    return value


def _whole(name: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise BadVary(f"{name}: {text!r} is not a whole number") from None


def natural(varied: Sequence[Varied]) -> int | None:
    """Return the default number of runs: the number of seeds times the number of cells.

    Returns None if a range is varied, or if the seeds have no end. A cell is one combination of values of all lists."""
    seeds = next((v for v in varied if isinstance(v, Seeds)), None)
    if any(isinstance(v, NumberRange) for v in varied) or (seeds and seeds.last is None):
        return None
    turns = seeds.last - seeds.first + 1 if seeds and seeds.last is not None else 1
    return turns * len(cells(varied))


def cells(varied: Sequence[Varied]) -> list[dict[str, str]]:
    """Return all combinations of values of the varied lists, each as name -> value.

    If no list is varied, the result is one empty combination."""
    grids = [v for v in varied if isinstance(v, ValueList)]
    return [
        dict(zip([g.name for g in grids], values, strict=True)) for values in product(*[grid.values for grid in grids])
    ]


def values(varied: Sequence[Varied], runs: int) -> list[dict[str, str]]:
    """Return the varied values of each run of a campaign, as name -> text of the value.

    The names are in the order of `varied`. Raises BadVary if there are too few seeds for `runs` runs."""
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
                    raise BadVary(f"seed={seeds.first}:{seeds.last} has too few seeds for {runs} runs")
                own[SEED] = str(seeds.first + turn)
        result.append({v.name: own[v.name] for v in varied})
    return result
