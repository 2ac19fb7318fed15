"""Decision procedure for linear integer conditions: refutes formulas, or finds satisfying examples.

`unsat` is sound: if `unsat` returns True, no integers satisfy the formulas. The procedure is Fourier-Motzkin
elimination, with bounds tightened to integers, on each branch of the disjunctions. `find` searches an example among
small values. Neither function is complete: if both fail, it is unknown whether integers satisfy the formulas.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from itertools import product
from math import gcd
from typing import assert_never

from koordgen.lang.analyze.facts.linear import (
    N_SYS,
    PID,
    And,
    AtLeastZero,
    BoolFact,
    ConditionalTerm,
    Formula,
    Length,
    Linear,
    Or,
    Quotient,
    Remainder,
    UnknownCondition,
    Var,
    at_least,
    combine,
    constant,
    equal,
    less,
    negate,
    truth,
    variable,
    variables,
)
from koordgen.lang.node import Node

MOST_BRANCHES = 100
MOST_ROWS = 300
MOST_EXAMPLES = 6000

# Facts about every fleet: N_SYS >= 1 and 0 <= pid < N_SYS.
FLEET: tuple[Formula, ...] = (
    at_least(variable(N_SYS), constant(1)),
    at_least(variable(PID), constant(0)),
    less(variable(PID), variable(N_SYS)),
)
_FLEET_NAMES = {PID, N_SYS}


def unsat(formulas: Iterable[Formula]) -> bool:
    """Return whether no robot of any fleet can satisfy all formulas.

    The result False may also mean that the search reached a limit.
    """
    return _unsat(tuple(formulas))


@lru_cache(1000)  # programs use the same index in many events, so the same formulas occur repeatedly
def _unsat(formulas: tuple[Formula, ...]) -> bool:
    return _is_refuted([*formulas, *FLEET], [], {}, frozenset(), [MOST_BRANCHES])


def relevant(facts: Iterable[Formula], about: Formula) -> tuple[Formula, ...]:
    """Return the facts that are connected to a condition by common variables.

    The other facts cannot help to refute the condition, unless they contradict each other. pid and N_SYS are always
    connected, by the facts about every fleet.
    """
    names = set(variables(about))
    left = [(fact, set(variables(fact))) for fact in facts]
    kept: list[Formula] = []
    grown = True
    while grown:
        grown = False
        if names & _FLEET_NAMES:
            names |= _FLEET_NAMES
        for item in list(left):
            if names & item[1]:
                left.remove(item)
                kept.append(item[0])
                names |= item[1]
                grown = True
    return tuple(kept)


def _is_refuted(
    pending: list[Formula], rows: list[Linear], facts: dict[object, bool], defined: frozenset[Var], budget: list[int]
) -> bool:
    """Return whether every branch of the formulas ends in a contradiction. Tries at most `budget[0]` branches."""
    open_: list[Or] = []
    ways: list[tuple[Formula, ...]] = []
    limits: _Limits = {}
    while pending:  # repeat until each disjunction has at least two parts that are still possible
        while pending:
            match formula := pending.pop():
                case AtLeastZero(linear):
                    rows.append(linear)
                    for var, _ in linear.terms:
                        if not isinstance(var, str) and var not in defined:
                            defined |= {var}
                            pending.extend(_definition(var))
                case BoolFact(key, holds):
                    if facts.setdefault(key, holds) != holds:
                        return True
                case And(parts):
                    pending.extend(parts)
                case Or(parts):
                    if not parts:
                        return True
                    open_.append(formula)
                case UnknownCondition():
                    pass
                case _:
                    assert_never(formula)
        limits_ = _limits(rows)
        if limits_ is None:
            return True
        limits = limits_
        left: list[Or] = []
        ways = []
        for either in open_:
            truths = [_truth_within(part, limits, facts) for part in either.parts]
            if True in truths:
                continue
            possible = tuple([part for part, truth in zip(either.parts, truths, strict=True) if truth is None])
            if not possible:
                return True
            if len(possible) == 1:
                pending.append(possible[0])
            else:
                left.append(either)
                ways.append(possible)
        open_ = left
    if not _holds_at_limits(rows, limits) and _is_contradictory(rows):
        return True
    if not open_:
        return False
    least = min(range(len(ways)), key=lambda i: len(ways[i]))
    others = [Or(way) for i, way in enumerate(ways) if i != least]
    for part in ways[least]:
        budget[0] -= 1
        if budget[0] < 0 or not _is_refuted([part, *others], list(rows), dict(facts), defined, budget):
            return False
    return True


_Limits = dict[Var, tuple[int | None, int | None]]
_ANY = (None, None)


def _limits(rows: list[Linear]) -> _Limits | None:
    """Return the bounds of each variable, derived from the rows that contain only this variable.

    Returns None if the bounds leave a variable no value.
    """
    limits: _Limits = {}
    for row in rows:
        if len(row.terms) == 1:
            ((var, factor),) = row.terms
            low, high = limits.get(var, _ANY)
            if factor > 0:
                bound = -(row.constant // factor)
                low = bound if low is None or bound > low else low
            else:
                bound = row.constant // -factor
                high = bound if high is None or bound < high else high
            if low is not None and high is not None and low > high:
                return None
            limits[var] = (low, high)
        elif not row.terms and row.constant < 0:
            return None
    return limits


def _holds_at_limits(rows: list[Linear], limits: _Limits) -> bool:
    """Return whether all rows hold for values at the variables' limits.

    This is a quick proof that the rows can be satisfied.
    """
    values: dict[Var, int] = {}
    for row in rows:
        for var, _ in row.terms:
            if var not in values:
                low, high = limits.get(var, _ANY)
                values[var] = low if low is not None else high if high is not None else 0
    if PID in values:
        values[N_SYS] = max(values[N_SYS], values[PID] + 1)
    for row in rows:
        total = row.constant
        for var, factor in row.terms:
            total += factor * values[var]
        if total < 0:
            return False
    return True


def _truth_within(formula: Formula, limits: _Limits, facts: dict[object, bool]) -> bool | None:
    """Return whether a formula holds, if the variables' limits and the facts decide this; else None."""
    match formula:
        case AtLeastZero(linear):
            least, most = _least(linear, limits, 1), _least(linear, limits, -1)
            if least is not None and least >= 0:
                return True
            return False if most is not None and most > 0 else None
        case BoolFact(key, holds):
            known = facts.get(key)
            return None if known is None else known == holds
        case And(parts):
            truths = [_truth_within(part, limits, facts) for part in parts]
            return False if False in truths else None if None in truths else True
        case Or(parts):
            truths = [_truth_within(part, limits, facts) for part in parts]
            return True if True in truths else None if None in truths else False
        case _:
            return None


def _least(linear: Linear, limits: _Limits, sign: int) -> int | None:
    """Return the least value of sign * linear within the limits; None if it is unbounded."""
    total = sign * linear.constant
    for var, factor in linear.terms:
        low, high = limits.get(var, _ANY)
        bound = low if sign * factor > 0 else high
        if bound is None:
            return None
        total += sign * factor * bound
    return total


def _definition(var: Var) -> list[Formula]:
    """Return the conditions that define a variable that stands for another term, such as a length or quotient."""
    match var:
        case Length():
            return [at_least(variable(var), constant(0))]
        case Quotient(operand, divisor):
            rest = combine(operand, variable(var), -divisor)
            return [at_least(rest, constant(0)), less(rest, constant(divisor))]
        case Remainder(operand, Linear((), by)) if by > 0:
            quotient = variable(Quotient(operand, by))
            return [equal(variable(var), combine(operand, quotient, -by))]
        case Remainder(_, divisor):
            positive = at_least(divisor, constant(1))
            range_ = And((at_least(variable(var), constant(0)), less(variable(var), divisor)))
            return [Or((negate(positive), range_))]
        case ConditionalTerm(condition, then, orelse):
            return [
                Or(
                    (
                        And((condition, equal(variable(var), then))),
                        And((negate(condition), equal(variable(var), orelse))),
                    )
                )
            ]
        case _:
            return []


def _is_contradictory(rows: Iterable[Linear]) -> bool:
    """Return whether no integers make all rows >= 0, by elimination of one variable after the other."""
    system: dict[tuple[tuple[Var, int], ...], int] = {}
    for row in rows:
        if not _add(system, dict(row.terms), row.constant):
            return True
    while True:
        counts: dict[Var, list[int]] = {}
        for terms in system:
            for var, factor in terms:
                counts.setdefault(var, [0, 0])[factor > 0] += 1
        if not counts:
            return False
        # Over integers, elimination is exact only for variables with factors 1 and -1, so these are eliminated first.
        rough = {var for terms in system for var, factor in terms if abs(factor) != 1}
        least = min(counts, key=lambda v: (v in rough, counts[v][0] * counts[v][1]))
        lower, upper, rest = [], [], {}
        for terms, bound in system.items():
            factor = dict(terms).get(least, 0)
            if factor > 0:
                lower.append((terms, bound, factor))
            elif factor < 0:
                upper.append((terms, bound, -factor))
            else:
                rest[terms] = bound
        if len(rest) + len(lower) * len(upper) > MOST_ROWS:
            return False
        system = rest
        for (low, low_bound, up), (high, high_bound, down) in product(lower, upper):
            sums = {var: factor * down for var, factor in low}
            for var, factor in high:
                sums[var] = sums.get(var, 0) + factor * up
            if not _add(system, sums, low_bound * down + high_bound * up):
                return True


def _add(system: dict[tuple[tuple[Var, int], ...], int], sums: dict[Var, int], bound: int) -> bool:
    """Add the inequality `sums + bound >= 0` as a row, divided by the gcd of its coefficients.

    Returns False if the row can never hold.
    """
    kept = [(var, factor) for var, factor in sums.items() if factor]
    if not kept:
        return bound >= 0
    shared = gcd(*(factor for _, factor in kept))
    key = tuple(sorted(((var, factor // shared) for var, factor in kept), key=_order))
    bound //= shared
    system[key] = min(bound, system.get(key, bound))
    return True


def _order(term: tuple[Var, int]) -> str:
    return term[0] if isinstance(term[0], str) else repr(term[0])


class Example(Node):
    """Values that satisfy some formulas. `certain` is True if the formulas have no unknown condition or value."""

    values: dict[str, int]
    certain: bool


def find(formulas: Iterable[Formula], params: Mapping[str, int]) -> Example | None:
    """Search for values that satisfy the formulas; return None if the search finds none.

    Tries small values, and values near the constants in the formulas. `params` has fixed values of variables. Prefers
    examples that depend on no unknown value, then fleets of three robots, which are easy to read.
    """
    wanted = And(tuple(formulas))
    marks = {abs(c) for c in _constants(wanted) if abs(c) < 2**62} | {0}
    near = sorted({mark + d for mark in marks for d in (-1, 0, 1, 2)})
    possible: Example | None = None
    sizes = dict.fromkeys([3, 4, 5, 2, 1, *range(6, 25), *(n for n in near if n > 0)])
    tries = 0
    for position, size in enumerate(sizes):
        if possible is not None and position >= 5:
            return possible  # larger fleets seldom give a certain example if small fleets gave none
        for pid in dict.fromkeys(p for p in [*range(24), *range(size - 4, size), *near] if 0 <= p < size):
            tries += 1
            if tries > MOST_EXAMPLES:
                return possible
            values = {**params, PID: pid, N_SYS: size}
            held = truth(wanted, values)
            if held:
                return Example(values, True)
            if held is None and possible is None:
                possible = Example(values, False)
    return possible


def _constants(item: Formula | Linear | Var) -> Iterator[int]:
    match item:
        case Linear(terms, constant_):
            yield constant_
            for var, _ in terms:
                yield from _constants(var)
        case AtLeastZero(linear) | Quotient(linear):
            yield from _constants(linear)
        case And(parts) | Or(parts):
            for part in parts:
                yield from _constants(part)
        case Remainder(operand, divisor):
            yield from _constants(operand)
            yield from _constants(divisor)
        case ConditionalTerm(condition, then, orelse):
            yield from _constants(condition)
            yield from _constants(then)
            yield from _constants(orelse)
        case _:
            return
