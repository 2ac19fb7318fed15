"""How far a car's outline is from another robot's way: the fast answer is that of any polygon."""

from __future__ import annotations

import math
from random import Random

import pytest

from targets.car.planning.shapes import OVERLAP, Footprint, Shape

BODY = Footprint(0.5, 0.28, 0.085)


def test_a_line_is_as_far_as_the_thinnest_of_triangles() -> None:
    dice, overlaps = Random(1), 0
    for _ in range(2000):
        a, b = ((dice.uniform(-1.0, 1.0), dice.uniform(-1.0, 1.0)) for _ in range(2))
        middle = ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)
        pose = dice.uniform(-0.5, 0.5), dice.uniform(-0.5, 0.5), dice.uniform(-math.pi, math.pi)
        line = BODY.distance(*pose, Shape((a, b), 0.1, "line"))
        assert line == pytest.approx(BODY.distance(*pose, Shape((a, middle, b), 0.1, "triangle")), abs=1e-9)
        overlaps += line == OVERLAP
    assert 200 < overlaps < 1800


def test_a_line_of_no_length_is_a_point() -> None:
    point, line = Shape(((1.0, 0.3),), 0.0, "point"), Shape(((1.0, 0.3), (1.0, 0.3)), 0.0, "line")
    assert BODY.distance(0.2, 0.1, 0.4, line) == pytest.approx(BODY.distance(0.2, 0.1, 0.4, point))
