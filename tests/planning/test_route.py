"""What is left of a commanded path."""

from __future__ import annotations

import pytest

from koordgen.runtime.values.points import Point
from targets.planning.route import Route, passed


def test_a_route_gives_its_points_one_after_the_other() -> None:
    route = Route()
    a, b = Point(1.0, 0.0, 0.0), Point(2.0, 0.0, 0.0)

    def now() -> tuple[Point | None, bool]:
        return route.goal, route.last

    assert now() == (None, True)
    assert route.follow((a, b))
    assert now() == (a, False)
    assert route.passed() == b
    assert route.passed() == b, "the last one stays"
    assert now() == (b, True)
    assert not route.follow((a, b)), "it is being followed already"
    assert route.follow(())
    assert now() == (None, True)


SQUARE = (Point(0.0), Point(4.0), Point(4.0, 4.0), Point(0.0, 4.0), Point(0.0))


@pytest.mark.parametrize(
    ("points", "place", "behind"),
    [
        (SQUARE, Point(1.0, 0.2), 1),
        (SQUARE, Point(4.3, 2.0), 2),
        (SQUARE, Point(2.0, 3.9), 3),
        (SQUARE, Point(0.01, 0.01), 1),  # the first leg and the last are as near: nothing may be left out
        (SQUARE[:1], Point(3.0), 0),
    ],
)
def test_a_robot_amid_a_path_has_passed_the_points_before_the_nearest_leg(
    points: tuple[Point, ...], place: Point, behind: int
) -> None:
    assert passed(points, place) == behind


def test_a_route_can_leave_out_points() -> None:
    route = Route()
    route.follow(SQUARE)
    route.skip(2)
    assert route.goal == SQUARE[2]
    route.skip(9)
    assert route.goal == SQUARE[-1] and route.last
