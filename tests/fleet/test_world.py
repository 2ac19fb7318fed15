"""World section of a fleet file, simulation settings of robots, and their starts."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest

from koordgen.fleet.file import Fleet
from koordgen.fleet.obstacles import Obstacle
from koordgen.fleet.world import Wall
from koordgen.runtime.trace.schema import MarkerList, Wind, WorldRecord
from targets.sim.base.scenario import Lidar, Sim
from tests.fleet.test_fleet import GOOD, read

HEAD = GOOD[: GOOD.index("robots:")]


def good(text: str) -> Fleet:
    fleet, found = read(text)
    assert found == [] and fleet is not None
    return fleet


def robots(*starts: str, target: str = "quad", head: str = HEAD) -> str:
    lines = [
        f"  - {{name: r{i}, target: {target}, address: 'h:{i + 1}'{', start: ' + start if start else ''}}}\n"
        for i, start in enumerate(starts)
    ]
    return f"{head}robots:\n" + "".join(lines)


def test_a_fleet_needs_no_world() -> None:
    fleet = good(GOOD)
    assert msgspec.convert(fleet.world.facts, WorldRecord) == WorldRecord()
    assert fleet.obstacles == () and fleet.robots[0].harness == {}


def test_all_that_a_world_says_is_what_the_harness_reads() -> None:
    text = """world:
  arena: {lo: [0, 0, 0], hi: [7, 8, 3]}
  floor_friction: 0.5
  wind: {mean: [1, 2, 0], gust: 0.3, correlation: 2}
  markers: [{name: dock, position: [1, 1, 0]}, {name: far, position: [5, 5, 1], radius: 0.5}]
  marker_list: {variable: tasks, position: target, radius: 0.2}
"""
    world = msgspec.convert(good(text + GOOD).world.facts, WorldRecord)
    assert world.arena is not None and world.arena.hi == (7.0, 8.0, 3.0)
    assert world.floor_friction == 0.5 and world.wind == Wind((1.0, 2.0, 0.0), 0.3, 2.0)
    assert [(m.name, m.radius) for m in world.markers] == [("dock", 0.3), ("far", 0.5)]
    assert world.marker_list == MarkerList("tasks", "target", 0.2)


def test_a_wall_along_an_axis_is_a_box_behind_the_obstacles() -> None:
    text = "world: {walls: [{from: [1, 0], to: [1, 4], thickness: 0.2, height: 0.5, low: 0.1}]}\n"
    obstacles = good(text + GOOD + "obstacles: [{centre: [4, 4, 0], radius: 0.5}]\n").obstacles
    assert [o["shape"] for o in obstacles] == ["sphere", "box"]
    assert obstacles[1]["lo"] == pytest.approx([0.9, -0.1, 0.1])
    assert obstacles[1]["hi"] == pytest.approx([1.1, 4.1, 0.6])


def test_a_wall_across_is_a_closed_mesh_that_looks_outward() -> None:
    wall = Wall((0.0, 0.0), (3.0, 4.0), 0.2, 1.5, 0.5)
    mesh: Obstacle = wall.obstacle()
    assert mesh["shape"] == "mesh" and len(mesh["faces"]) == 12
    edges = [(f[i], f[(i + 1) % 3]) for f in mesh["faces"] for i in range(3)]
    assert len(set(edges)) == 36 and {(b, a) for a, b in edges} == set(edges)  # each edge once in either direction
    volume = sum(_signed(*(mesh["vertices"][i] for i in face)) for face in mesh["faces"])
    assert volume == pytest.approx((5.0 + 0.2) * 0.2 * 1.5)
    inner = [(-0.06, -0.08), (3.06, 4.08)]  # beyond its ends, but within half its thickness
    assert all(any(math.dist(p, c) < 0.15 for c in wall.corners) for p in inner)


def _signed(a: list[float], b: list[float], c: list[float]) -> float:
    """Return the volume of the tetrahedron over a face; positive if the face's normal points outward."""
    cross = (b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0])
    return sum(x * y for x, y in zip(a, cross, strict=True)) / 6


def test_a_robot_is_simulated_as_it_says() -> None:
    sim = "{fidelity: simple, autopilot: external, lidar: {rays: 360, range: 4, rate: 10, noise: 0.01}}"
    fleet = good(GOOD.replace("47100\n", f"47100\n    sim: {sim}\n"))
    told = msgspec.convert(fleet.robots[0].harness["sim"], Sim)
    assert told == Sim("simple", Lidar(360, 4.0, 10.0, 0.01), "external")
    assert fleet.robots[1].harness == {}


@pytest.mark.parametrize(
    ("world", "code", "column", "said"),
    [
        ("{aerna: 1}", "F002", 9, "did you mean 'arena'"),
        ("[]", "F004", 8, "world must be a mapping"),
        ("{arena: {lo: [0, 0, 0]}}", "F003", 16, "world.arena lacks 'hi'"),
        ("{arena: {lo: [0, 0, 0], hi: [1, 0, 1]}}", "F005", 36, "below world.arena.hi"),
        ("{floor_friction: 0}", "F005", 25, "world.floor_friction is 0"),
        ("{wind: {mean: [1, 2]}}", "F004", 22, "world.wind.mean must be [x, y, z]"),
        ("{wind: {gust: -1}}", "F005", 22, "world.wind.gust (m/s) is -1"),
        ("{walls: [{from: [0, 0]}]}", "F003", 17, "wall 0 lacks 'to'"),
        ("{walls: [{from: [0, 0], to: [0, 0]}]}", "F005", 36, "wall 0 starts and ends at the same point"),
        ("{walls: [{from: [0, 0, 0], to: [0, 1]}]}", "F004", 24, "wall 0.from must be [x, y]"),
        ("{walls: [{from: [0, x], to: [0, 1]}]}", "F004", 28, "wall 0.from's y must be a finite number"),
        ("{walls: [{from: [0, 0], to: [0, 1], height: 0}]}", "F005", 52, "wall 0.height (metres) is 0"),
        ("{walls: {}}", "F004", 16, "world.walls must be a list"),
        ("{markers: [{name: a}]}", "F003", 19, "marker 0 lacks 'position'"),
        (
            "{markers: [{name: a, position: [0, 0, 0]}, {name: a, position: [0, 0, 0]}]}",
            "F006",
            58,
            "two markers have",
        ),
        ("{marker_list: {position: target}}", "F003", 22, "world.marker_list lacks 'variable'"),
    ],
)
def test_a_mistake_is_told_at_its_place(world: str, code: str, column: int, said: str) -> None:
    fleet, found = read(f"world: {world}\n{GOOD}")
    assert fleet is None
    (mistake,) = found
    assert mistake[:3] == (code, 1, column) and said in mistake[3]


@pytest.mark.parametrize(
    ("sim", "code", "said"),
    [
        ("{fidelty: simple}", "F002", "did you mean 'fidelity'"),
        ("{fidelity: best}", "F005", "possible values: full, simple"),
        ("{autopilot: px4}", "F005", "possible values: simulated, external"),
        ("{lidar: {rays: 0}}", "F005", "rays is 0"),
        ("{lidar: {rays: 1.5}}", "F004", "rays must be a whole number"),
        ("{lidar: {ray: 7}}", "F002", "did you mean 'rays'"),
        ("{lidar: 7}", "F004", "robot 0's sim.lidar must be a mapping"),
    ],
)
def test_a_mistake_in_how_a_robot_is_simulated(sim: str, code: str, said: str) -> None:
    fleet, found = read(GOOD.replace("47100\n", f"47100\n    sim: {sim}\n"))
    assert fleet is None
    (mistake,) = found
    assert mistake[:2] == (code, 8) and said in mistake[3]


POST = "obstacles: [{base: [1, 1, 0], radius: 0.5, height: 1}]\n"
WALL = "world: {walls: [{from: [0, -1], to: [2, 1]}]}\n"
STARTS: list[tuple[str, str, str]] = [
    (robots("{position: [0, 0, 0]}", "{position: [0.39, 0, 0]}"), "r1", "in contact with r0"),
    (robots("{position: [0, 0, 0]}", "{position: [0.41, 0, 0]}"), "", ""),
    (robots("{position: [0, 0, 0]}", "{position: [0, 0, 0.5]}"), "", ""),
    (robots("{position: [0.1, 0, 0]}", ""), "r1", "in contact with r0"),
    (robots("", ""), "", ""),
    # Cars: their reference point is the rear axle, 0.415 m behind their front and 0.085 m before their back.
    (robots("{position: [0, 0, 0]}", "{position: [0.49, 0, 0]}", target="car"), "r1", "in contact with r0"),
    (robots("{position: [0, 0, 0]}", "{position: [0.51, 0, 0]}", target="car"), "", ""),
    (robots("{position: [0, 0, 0]}", "{position: [0, 0.27, 0]}", target="car"), "r1", "in contact with r0"),
    (robots("{position: [0, 0, 0]}", "{position: [0, 0.29, 0]}", target="car"), "", ""),
    (robots("{position: [0, 0, 0]}", "{position: [0.2, 0.3, 0], yaw: -0.8}", target="car"), "r1", "in contact with r0"),
    (robots("{position: [0, 0, 0]}", "{position: [0.6, 0, 0], yaw: 1.57}", target="car"), "", ""),
    (robots("{position: [6, 0, 0]}"), "r0", "outside the geofence"),
    ("world: {arena: {lo: [0, 0, 0], hi: [2, 2, 2]}}\n" + robots("{position: [1, 1, 0]}", "{position: [3, 1, 0]}"),
     "r1", "outside the arena"),
    ("obstacles: [{lo: [1, 1, 0], hi: [2, 2, 1]}]\n" + robots("{position: [0.9, 1.5, 0]}"), "r0", "obstacle 0"),
    ("obstacles: [{lo: [1, 1, -1], hi: [2, 2, 0]}]\n" + robots("{position: [1.5, 1.5, 0]}"), "", ""),
    (POST + robots("{position: [1.6, 1, 0]}"), "r0", "obstacle 0"),
    (POST + robots("{position: [1.8, 1, 0]}"), "", ""),
    ("obstacles: [{centre: [1, 1, 1], radius: 1}]\n" + robots("{position: [1.5, 1, 0]}"), "r0", "obstacle 0"),
    ("obstacles: [{centre: [1, 1, 1], radius: 1}]\n" + robots("{position: [2, 1, 0]}"), "", ""),
    (WALL + robots("{position: [1, 0.2, 0]}"), "r0", "wall 0"),
    (WALL + robots("{position: [1, 0.5, 0]}"), "", ""),
]  # fmt: skip


@pytest.mark.parametrize(("text", "robot", "said"), STARTS)
def test_a_start_that_cannot_be_is_told_at_its_place(text: str, robot: str, said: str) -> None:
    fleet, found = read(text)
    if not said:
        assert found == [] and fleet is not None
        return
    assert fleet is None
    (mistake,) = found
    assert mistake[0] == "F005" and f"{robot} starts at (" in mistake[3] and said in mistake[3]
    line = text.splitlines()[mistake[1] - 1]
    assert line[mistake[2] - 1 :].startswith("{position")


def test_a_marker_list_is_one_of_the_program(tmp_path: Any) -> None:
    from koordgen.build.pipeline import Rejected, plan_file

    app = tmp_path / "app.koord"
    app.write_text(
        "using Motion:\n    actuators:\n        Point target\n"
        "def Task:\n    Point place\n    bool done\n"
        "allwrite:\n    List<Task> tasks max 4\n    List<Point> spots max 4\n    int n = 0\n"
        "go:\n    pre: n < 3\n    eff: n = 1\n"
    )
    for variable, position, said in [
        ("tasks", "place", ""),
        ("spots", "", ""),
        ("tasks", "", "of Points; possible positions: place"),
        ("tasks", "done", "a Point 'done'; possible positions: place"),
        ("n", "", "no shared list n of Points"),
        ("none", "place", "no shared list none whose elements have a Point"),
    ]:
        (tmp_path / "fleet.yaml").write_text(
            f"world: {{marker_list: {{variable: {variable}, position: '{position}'}}}}\n" + GOOD
        )
        try:
            plan_file(str(app), ["sim"], str(tmp_path / "fleet.yaml"), {})
            assert not said
        except Rejected as rejected:
            messages = [d.message for _, d in rejected.found]
            assert len(messages) == 1 and said and said in messages[0], messages
