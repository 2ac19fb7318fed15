"""Obstacles in the fleet file: boxes, spheres, cylinders and meshes, with errors at their places."""

from __future__ import annotations

import math
import os
import struct
from pathlib import Path
from typing import Any

import msgspec
import pytest

from koordgen.fleet import file as fleet
from koordgen.fleet.mesh import BadMesh, read_mesh
from koordgen.fleet.obstacles import MOST_BYTES, MOST_FACES, MOST_OBSTACLES
from koordgen.lang.source import Source, Span
from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Point
from tests.fleet.test_fleet import GOOD, PARAMS, TARGETS, read

WALL = "{lo: [1, -2, 0], hi: [1.2, 2, 1]}"
LINE = GOOD.count("\n") + 2  # of the first obstacle


def with_obstacles(*boxes: str) -> str:
    return GOOD + "obstacles:\n" + "".join(f"  - {box}\n" for box in boxes)


def test_obstacles_are_read_in_their_order() -> None:
    fleet, found = read(with_obstacles(WALL, "{lo: [0, 0, 0], hi: [1, 1, 1]}"))
    assert found == [] and fleet is not None
    assert fleet.obstacles == (
        {"shape": "box", "lo": [1.0, -2.0, 0.0], "hi": [1.2, 2.0, 1.0]},
        {"shape": "box", "lo": [0.0, 0.0, 0.0], "hi": [1.0, 1.0, 1.0]},
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
        ("{centre: [0, 0, 0]}", "F003", "obstacle 1 lacks 'radius'"),
        ("{center: [0, 0, 0], radius: 1}", "F002", "unknown key 'center'"),
        ("{centre: [0, 0, 0], radius: 0}", "F005", "obstacle 1.radius (metres) is 0"),
        ("{centre: [0, 0, 0], radius: wide}", "F004", "obstacle 1.radius (metres) must be a finite number"),
        ("{base: [0, 0, 0], radius: 1}", "F003", "obstacle 1 lacks 'height'"),
        ("{base: [0, 0, 0], radius: 1, height: -2}", "F005", "obstacle 1.height (metres) is -2"),
        ("{centre: [0, 0, 0], radius: 1, height: 2}", "F002", "unknown key 'height'"),
        ("{mesh: nowhere.stl}", "F005", "cannot be read: No such file"),
        ("{mesh: house.fbx}", "F005", "obstacle 1.mesh cannot be 'house.fbx'"),
        ("{mesh: 7}", "F004", "obstacle 1.mesh must be a text"),
        ("{cone: [0, 0, 0], angle: 1}", "F003", "obstacle 1 has the keys of no known shape"),
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


def test_all_kinds_are_what_robots_read() -> None:
    found = obstacles("{lo: [0, 0, 0], hi: [1, 1, 1]}", "{centre: [1, 2, 3], radius: 0.5}",
                      "{base: [1, 2, 0], radius: 0.5, height: 2}")  # fmt: skip
    assert found == (
        Block(Point(0, 0, 0), Point(1, 1, 1)), Sphere(Point(1, 2, 3), 0.5), Cylinder(Point(1, 2, 0), 0.5, 2.0),
    )  # fmt: skip


def obstacles(*boxes: str, folder: Path = Path()) -> tuple[Obstacle, ...]:
    told: list[str] = []

    def report(code: str, message: str, span: Span, help: str) -> None:
        told.append(f"{code} {span.line}:{span.column} {message}")

    source = Source(str(folder / "fleet.yaml"), with_obstacles(*boxes))
    read_fleet = fleet.read(source, TARGETS, PARAMS, report)
    if read_fleet is None:
        raise ValueError("; ".join(told))
    return msgspec.convert(read_fleet.obstacles, tuple[Obstacle, ...])


ROOF = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1/1 2/2 3/3 -1\n"  # a square, in OBJ
TEXT = "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"


def binary(*faces: tuple[float, ...]) -> bytes:
    return bytes(80) + len(faces).to_bytes(4, "little") + b"".join(struct.pack("<12fH", 0, 0, 1, *f, 0) for f in faces)


def test_meshes_are_put_where_the_file_says(tmp_path: Path) -> None:
    (tmp_path / "roof.obj").write_text(ROOF)
    mesh: Any = obstacles("{mesh: roof.obj, position: [5, 0, 2], yaw: 1.5707963, scale: 2}", folder=tmp_path)[0]
    assert type(mesh) is Mesh and mesh.faces == ((0, 1, 2), (0, 2, 3))
    wanted = (Point(5, 0, 2), Point(5, 2, 2), Point(3, 2, 2), Point(3, 0, 2))
    for p, q in zip(mesh.vertices, wanted, strict=True):
        assert math.dist((p.x, p.y, p.z), (q.x, q.y, q.z)) < 1e-6


def test_stl_of_both_kinds_and_obj() -> None:
    square = read_mesh(ROOF.encode(), "obj")
    assert list(square.faces) == [(0, 1, 2), (0, 2, 3)] and len(square.vertices) == 4
    triangle = read_mesh(TEXT.encode(), "stl")
    assert [list(v) for v in triangle.vertices] == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert triangle.faces == ((0, 1, 2),)
    same = read_mesh(binary((0, 0, 0, 1, 0, 0, 0, 1, 0)), "stl")
    assert (same.vertices, same.faces) == (triangle.vertices, triangle.faces)


@pytest.mark.parametrize(
    ("data", "form", "said"),
    [
        (b"", "stl", "not an STL"),
        (b"", "obj", "no faces"),
        (binary((0, 0, 0, 1, 0, 0, 0, 1, 0))[:-7], "stl", "truncated"),
        (binary((0, 0, 0, math.nan, 0, 0, 0, 1, 0)), "stl", "not finite"),
        (TEXT.replace("vertex 0 1 0\n", "").encode(), "stl", "line 6: a face is not a triangle"),
        (TEXT.replace("1 0 0", "1 0").encode(), "stl", "line 5: three numbers"),
        (b"v 0 0 0\nf 1 2 3\n", "obj", "line 2: there is no vertex 2"),
        (b"v 0 0 0\nf 1 0 1\n", "obj", "line 2: there is no vertex 0"),
        (b"v 0 0 0\nf 1 1\n", "obj", "line 2: a face has 2 corners"),
        (b"v 0 zero 0\n", "obj", "line 1: three numbers"),
        (b"\xff\xfe", "obj", "not a mesh of this format"),
    ],
)
def test_what_is_no_mesh_says_why(data: bytes, form: str, said: str) -> None:
    with pytest.raises(BadMesh, match=said):
        read_mesh(data, form)


def test_a_mistake_in_a_mesh_stands_at_its_name(tmp_path: Path) -> None:
    (tmp_path / "bad.obj").write_text("f 1 2 3")
    column = len("  - {mesh: ") + 1
    with pytest.raises(ValueError, match=rf"F005 {LINE}:{column} the mesh .*bad.obj cannot be used: line 1"):
        obstacles("{mesh: bad.obj}", folder=tmp_path)
    (tmp_path / "huge.stl").write_bytes(binary(*[(0, 0, 0, 1, 0, 0, 0, 1, 0)] * (MOST_FACES + 1)))
    with pytest.raises(ValueError, match="10001 triangles; at most 10000 are allowed"):
        obstacles("{mesh: huge.stl}", folder=tmp_path)
    (tmp_path / "roof.obj").write_text(ROOF)
    with pytest.raises(ValueError, match="is further than 100000 m"):
        obstacles("{mesh: roof.obj, scale: 1e6}".replace("1e6", "1000000"), folder=tmp_path)


@pytest.mark.parametrize(
    ("setting", "said"),
    [("planner: rrt-star", ""), ("planner: dijkstra", "planner cannot be 'dijkstra'"), ("planner: own.plan:Mine", "")],
)
def test_a_planner_is_one_of_those_there_are_or_a_class(setting: str, said: str) -> None:
    robot = f"  - {{name: q, target: quad, address: 'h:1', settings: {{{setting}}}}}\n"
    head = GOOD[: GOOD.index("robots:")]
    _, found = read(f"{head}robots:\n{robot}")
    assert [message for *_, message in found] == ([] if not said else [found[0][3]]) and all(
        said in f[3] for f in found
    )
    assert bool(found) == bool(said)


def test_a_mesh_is_a_regular_file_of_a_size_that_can_be_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "folder.stl").mkdir()
    (tmp_path / "endless.stl").symlink_to("/dev/zero")
    with (tmp_path / "large.stl").open("wb") as large:
        large.truncate(MOST_BYTES + 1)
    for name, words in (
        ("pipe", "is not a regular file"), ("folder", "is not a regular file"), ("endless", "is not a regular file"),
        ("large", "has 16,777,217 bytes; at most 16,777,216 are allowed"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=words):
            obstacles(f"{{mesh: {name}.stl}}", folder=tmp_path)
