"""Markers: to do, taken, done."""

from __future__ import annotations

from typing import Any

import msgspec

from koordgen.runtime.trace.schema import Header, Marker, MarkerList, SharedVariable, WorldRecord
from targets.sim.view.data.markers import DONE, TAKEN, TO_DO, Markers
from tests.sim.view.canned import header

FIRST, SECOND = [[1.0, 2.0, 0.0], 7], [[3.0, 2.0, 1.0], 8]


def markers(**world: Any) -> Markers:
    head: Header = msgspec.structs.replace(
        header(["alice", "bert"]),
        shared=(SharedVariable("tasks", "allwrite", "List<Task>"), SharedVariable("places", "allwrite", "List<Point>")),
        records={"Task": (("at", "Point"), ("id", "int"))},
        world=WorldRecord(**world),
    )
    return Markers(head)


def states(found: Markers) -> list[tuple[float, int, int]]:
    return [(row[0], row[1], row[2]) for row in found.rows]


def test_a_listed_marker_is_to_do_then_taken_then_done() -> None:
    found = markers(marker_list=MarkerList("tasks", "at", 0.3))
    found.value("others", [FIRST], 0.0)
    found.value("tasks", [FIRST, SECOND], 0.1)
    assert msgspec.json.decode(msgspec.json.encode(found.rows[0][3]))["position"] == [1.0, 2.0, 0.0]
    found.pose((1.0, 2.1, 0.0), 0.2)  # nobody has taken it yet
    found.value("tasks", [SECOND], 0.3)
    found.pose((1.0, 2.31, 0.0), 0.4)
    found.pose((1.0, 2.29, 0.0), 0.5)
    found.value("tasks", [], 0.6)
    assert states(found) == [(0.1, 0, TO_DO), (0.1, 1, TO_DO), (0.3, 0, TAKEN), (0.5, 0, DONE), (0.6, 1, TAKEN)]


def test_what_comes_back_into_the_list_is_to_do_again() -> None:
    found = markers(marker_list=MarkerList("places"))
    found.value("places", [[1.0, 2.0, 0.0]], 0.0)
    found.value("places", [], 1.0)
    found.value("places", [[1.0, 2.0, 0.0]], 2.0)
    assert states(found) == [(0.0, 0, TO_DO), (1.0, 0, TAKEN), (2.0, 0, TO_DO)]


def test_a_fixed_marker_is_done_when_a_robot_was_there_since_round_1() -> None:
    found = markers(markers=(Marker("gate", (0.0, 0.0, 1.0), 0.5),))
    found.pose((0.0, 0.0, 1.0), -1.0)
    found.pose((0.0, 0.0, 0.4), 1.0)
    found.pose((0.0, 0.0, 0.6), 2.0)
    assert states(found) == [(2.0, 0, DONE)]


def test_a_list_of_anything_else_is_no_marker() -> None:
    found = markers(marker_list=MarkerList("tasks", "nowhere"))
    for value in (None, 5, [], [5], [[1, 2]], ["x"], [["x", 1]]):
        found.value("tasks", value, 0.0)
    assert found.rows == []
