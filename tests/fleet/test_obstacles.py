"""Obstacles in the fleet file: boxes as the geofence is one, each mistake told where it stands."""

from __future__ import annotations

import pytest

from koordgen.fleet import MOST_OBSTACLES
from tests.fleet.test_fleet import GOOD, read

WALL = "{lo: [1, -2, 0], hi: [1.2, 2, 1]}"
LINE = GOOD.count("\n") + 2  # of the first obstacle


def with_obstacles(*boxes: str) -> str:
    return GOOD + "obstacles:\n" + "".join(f"  - {box}\n" for box in boxes)


def test_obstacles_are_read_in_their_order() -> None:
    fleet, found = read(with_obstacles(WALL, "{lo: [0, 0, 0], hi: [1, 1, 1]}"))
    assert found == [] and fleet is not None
    assert fleet.obstacles == (
        {"lo": [1.0, -2.0, 0.0], "hi": [1.2, 2.0, 1.0]},
        {"lo": [0.0, 0.0, 0.0], "hi": [1.0, 1.0, 1.0]},
    )


def test_a_fleet_needs_none() -> None:
    fleet, found = read(GOOD)
    assert found == [] and fleet is not None and fleet.obstacles == ()


@pytest.mark.parametrize(
    ("box", "code", "said"),
    [
        ("{lo: [1, 0, 0], hi: [1, 1, 1]}", "F005", "obstacle 1.lo must be below obstacle 1.hi"),
        ("{lo: [1, 0, 0]}", "F003", "obstacle 1 lacks 'hi'"),
        ("{lo: [1, 0], hi: [2, 2, 2]}", "F004", "obstacle 1.lo must be [x, y, z]"),
        ("{lo: [1, .nan, 0], hi: [2, 2, 2]}", "F004", "obstacle 1.lo's y"),
        ("{low: [1, 0, 0], hi: [2, 2, 2]}", "F002", "unknown key 'low'"),
        ("[1, 2]", "F004", "obstacle 1 must be a mapping"),
    ],
)
def test_a_mistake_is_told_at_its_place(box: str, code: str, said: str) -> None:
    fleet, found = read(with_obstacles(WALL, box))
    assert fleet is None
    (mistake,) = found
    assert mistake[:2] == (code, LINE + 1) and said in mistake[3]


def test_there_is_a_limit_to_them() -> None:
    assert read(with_obstacles(*[WALL] * MOST_OBSTACLES))[1] == []
    (mistake,) = read(with_obstacles(*[WALL] * (MOST_OBSTACLES + 1)))[1]
    assert mistake[:2] == ("F005", LINE) and "at most 1000" in mistake[3]


def test_obstacles_are_a_list() -> None:
    (mistake,) = read(GOOD + f"obstacles: {WALL}\n")[1]
    assert mistake[0] == "F004" and "obstacles must be a list" in mistake[3]
