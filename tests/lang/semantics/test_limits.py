"""Limits of one event in the semantics: turns, sizes, deadlines."""

from __future__ import annotations

from fractions import Fraction

import pytest

from koordgen.lang.semantics.deadline import Deadline, OutOfTime, ends
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exact import NotExact, exact
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.numbers import arithmetic
from koordgen.lang.semantics.property import holds_property
from koordgen.lang.semantics.step import enabled, execute, initial
from koordgen.runtime.values.points import Point
from tests.lang.semantics.programs import compiled


class Ticking:
    """A clock that goes on by a second whenever it is read."""

    def __init__(self) -> None:
        self.read = 0

    def __call__(self) -> float:
        self.read += 1
        return float(self.read)


def program(effect: str, functions: str = "", guard: str = "True") -> str:
    return f"{functions}local:\n  int k = 3\n  float f = 1.5\nGo:\n  pre: {guard}\n  eff:\n{effect}\n"


def outcome(text: str) -> Writes | Discarded:
    found = compiled(text)
    return execute(found, found.events[0].effect, initial(found, 1), 0)


def test_every_turn_looks_at_the_clock() -> None:
    clock = Ticking()
    with pytest.raises(OutOfTime), ends(Deadline(clock, 100.0)):
        outcome(program("    while True: pass"))
    assert clock.read == 101


def test_a_deadline_that_has_not_passed_changes_nothing() -> None:
    text = program("    for i in range(50): k += 1")
    with ends(Deadline(Ticking(), 50.0)):
        done = outcome(text)
    assert done == outcome(text)


def test_the_deadline_ends_with_its_block() -> None:
    with pytest.raises(OutOfTime), ends(Deadline(Ticking(), 0.0)):
        outcome(program("    while True: pass"))
    assert isinstance(outcome(program("    for i in range(5): k += 1")), Writes)


def test_a_guard_and_a_formula_have_the_deadline_too() -> None:
    slow = "fun slow(int a) -> int:\n  int n = a\n  while n >= 0: n += 1\n  return n\n"
    found = compiled(
        program("    k = 1", slow, "slow(k) > 0") + "invariant Far: forall n in range(1000000000): n >= 0\n"
    )
    state = initial(found, 1)
    with pytest.raises(OutOfTime), ends(Deadline(Ticking(), 9.0)):
        enabled(found, found.events[0], state, 0)
    with pytest.raises(OutOfTime), ends(Deadline(Ticking(), 9.0)):
        holds_property(found.properties[0], found, state)


@pytest.mark.slow
def test_a_formula_over_more_than_a_million_numbers_has_no_value() -> None:
    found = compiled(program("    k = 1") + "invariant Far: forall n in range(1000001): n >= 0\n")
    with pytest.raises(Discarded, match="not finished"):
        holds_property(found.properties[0], found, initial(found, 1))


def test_robots_of_a_quantifier_take_no_turns() -> None:
    found = compiled(program("    k = 1") + "invariant All: forall a, b, c in ID: k[a] + k[b] + k[c] == 9\n")
    with ends(Deadline(Ticking(), 0.0)):
        assert holds_property(found.properties[0], found, initial(found, 5))


@pytest.mark.parametrize("statement", ["f = f * f", "f = f ** 2"])
def test_exact_numbers_that_grow_without_bound_are_given_up(statement: str) -> None:
    found = exact(compiled(program("\n".join([f"    {statement}"] * 40))))
    state = initial(found, 1)
    with pytest.raises(NotExact, match="bits"):
        execute(found, found.events[0].effect, state, 0)


@pytest.mark.parametrize("op", ["+", "-", "*"])
def test_exact_points_are_limited_too(op: str) -> None:
    huge = Point(Fraction(1, 3 ** (1 << 15)), Fraction(0), Fraction(0))  # type: ignore[arg-type]
    other = Point(Fraction(1, 5 ** (1 << 15)), Fraction(0), Fraction(0))  # type: ignore[arg-type]
    with pytest.raises(NotExact, match="bits"):
        arithmetic(op, huge, huge.x if op == "*" else other)
