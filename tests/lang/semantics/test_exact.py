"""Programs over exact numbers: nothing is rounded, and what has no exact value is refused, never approximated."""

from __future__ import annotations

import math
import random
from fractions import Fraction
from typing import Any

import pytest

from koordgen.lang.semantics.exact import NotExact, Root, distance, exact, made_exact, path_distance, root
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.step import execute, initial
from koordgen.runtime.values import geometry
from koordgen.runtime.values.points import Point
from koordgen.verify.prove.report.model import exact_state
from tests.lang.semantics.programs import compiled


def value_of(expression: str, type_: str = "float") -> Any:
    """What an expression is over exact numbers. `third` is 1/3, `n` is 7, `p` is (1/3, 0, 4)."""
    text = f"""
local:
  {type_} out
  float third
  int n = 7
  Point p
Go:
  pre: True
  eff:
    third = 1 / 3
    p = Point(third, 0, 4)
    out = {expression}
"""
    program = exact(compiled(text))
    outcome = execute(program, program.events[0].effect, exact_state(initial(program, 1)), 0)
    assert isinstance(outcome, Writes), outcome
    return outcome.locals["out"]


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("third + third + third", 1),
        ("1 / 3", Fraction(1, 3)),
        ("n / 2", Fraction(7, 2)),
        ("n", 7),
        ("0.1 + 0.2", Fraction(0.1) + Fraction(0.2)),
        ("0.1 * 3 - 0.3", Fraction(0.1) * 3 - Fraction(0.3)),
        ("third ** 2", Fraction(1, 9)),
        ("sqrt(third * third)", Fraction(1, 3)),
        ("abs(-third)", Fraction(1, 3)),
        ("max(third, 0.25)", Fraction(1, 3)),
        ("sum([third, third, third])", 1),
        ("distance(p, Point(third, 3, 0))", 5),
        ("path_distance([p], [Point(third, 3, 0)])", 5),
        ("(p * 3).x", 1),
        ("(p / 2).z", 2),
        ("(p - p).x", 0),
        ("-third", Fraction(-1, 3)),
    ],
)
def test_numbers(expression: str, value: object) -> None:
    found = value_of(expression)
    assert found == value
    assert type(found) in (int, Fraction)


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("distance(p, Point(third, 3, 0)) > 5", False),
        ("distance(p, Point(third, 3, 0)) >= 5", True),
        ("distance(Point(1, 1, 0), Point(0, 0, 0)) > 1.4142135623730951", False),  # the float is above the root
        ("distance(Point(1, 1, 0), Point(0, 0, 0)) > 1.414213562373095", True),
        ("p in Ball(Point(third, 0, 0), 4)", True),
        ("p in Rect(Point(third, 0, 0), Point(0, 0, 4))", True),
        ("floor(3 * third) == 1", True),
        ("round(third) == 0", True),
        ("path_distance([], [p]) > 1000000", True),
        ("clear([p], [[Point(third, 3, 0)]], 5)", False),
    ],
)
def test_comparisons(expression: str, value: bool) -> None:
    assert value_of(expression, "bool") is value


def test_the_distance_of_paths_is_that_of_the_robots_own_geometry() -> None:
    generator = random.Random(3)
    for _ in range(300):
        size = generator.choice([1, 2, 3]), generator.choice([1, 2])
        paths = [tuple(Point(*[generator.randint(-3, 3) / 2 for _ in range(3)]) for _ in range(n)) for n in size]
        found = path_distance(*[made_exact(path) for path in paths])
        square = found.square if isinstance(found, Root) else found * found
        assert math.isclose(math.sqrt(square), geometry.path_distance(*paths), abs_tol=1e-12)


@pytest.mark.parametrize("expression", ["sin(third)", "sqrt(2.0) + 1", "third ** 0.5"])
def test_what_has_no_exact_value_is_refused(expression: str) -> None:
    with pytest.raises(NotExact):
        value_of(expression)


def test_roots_compare_as_real_numbers_do() -> None:
    two, three = root(2), root(3)
    assert isinstance(two, Root) and two < three and three > two and two == root(2) and two != three
    assert 1 < two < Fraction(3, 2) and two > -5 and not two < 0
    assert root(Fraction(4, 9)) == Fraction(2, 3)
    with pytest.raises(ValueError, match="domain"):
        root(-1)
    near = Fraction(math.sqrt(2))
    assert (two > near) == (near * near < 2)


def test_values_of_all_kinds_are_made_exact() -> None:
    made = made_exact(((0.5, True, 3, "a"), Point(0.1, 0.0, 0.0)))
    assert made == ((Fraction(1, 2), True, 3, "a"), Point(Fraction(0.1), Fraction(0), Fraction(0)))  # type: ignore[arg-type]
    assert type(made[1].y) is Fraction
    assert distance(Point(1, 2, 2), Point(0, 0, 0)) == 3
