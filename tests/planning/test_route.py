"""What is left of a commanded path."""

from __future__ import annotations

from koordgen.runtime.values import Point
from targets.planning.route import Route


def test_a_route_gives_its_points_one_after_the_other() -> None:
    route = Route()
    a, b = Point(1.0, 0.0, 0.0), Point(2.0, 0.0, 0.0)

    def now() -> tuple[Point | None, bool]:
        return route.goal, route.last

    assert now() == (None, True)
    assert route.take((a, b))
    assert now() == (a, False)
    assert route.passed() == b
    assert route.passed() == b, "the last one stays"
    assert now() == (b, True)
    assert not route.take((a, b)), "it is being followed already"
    assert route.take(())
    assert now() == (None, True)
