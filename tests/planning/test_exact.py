"""The distance of a straight line from an obstacle, against independent ways to find it: a search along the line over
the distance of points, and python-fcl."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from functools import partial

import fcl
import numpy as np
import pytest

from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Sphere
from koordgen.runtime.values.points import Point
from targets.planning.exact import Solid, solid_distance
from targets.planning.mesh import Surface

Vector = tuple[float, float, float]


def searched(at: Callable[[Point], float], a: Point, b: Point) -> float:
    """The least of a convex function along a segment, by thirds."""
    low, high = 0.0, 1.0
    for _ in range(120):
        p, q = low + (high - low) / 3, high - (high - low) / 3
        low, high = (low, q) if at(a + (b - a) * p) <= at(a + (b - a) * q) else (p, high)
    return min(at(a), at(b), at(a + (b - a) * low))


def from_point(body: Solid, p: Point) -> float:
    match body:
        case Block(lo, hi):
            gaps = [max(getattr(lo, k) - getattr(p, k), 0.0, getattr(p, k) - getattr(hi, k)) for k in "xyz"]
            return math.hypot(*gaps)
        case Sphere(c, r):
            return max(0.0, math.dist((c.x, c.y, c.z), (p.x, p.y, p.z)) - r)
        case Cylinder(base, r, h):
            beside = max(0.0, math.hypot(p.x - base.x, p.y - base.y) - r)
            return math.hypot(beside, max(base.z - p.z, 0.0, p.z - base.z - h))


def from_triangle(p: Point, corners: tuple[Point, Point, Point]) -> float:
    """By the regions of its corners and sides (Ericson, Real-Time Collision Detection, 5.1.5)."""
    a, b, c = (np.array((q.x, q.y, q.z)) for q in corners)
    x = np.array((p.x, p.y, p.z))
    ab, ac = b - a, c - a
    d1, d2 = ab @ (x - a), ac @ (x - a)
    d3, d4 = ab @ (x - b), ac @ (x - b)
    d5, d6 = ab @ (x - c), ac @ (x - c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0 and d2 <= 0:
        near = a
    elif d3 >= 0 and d4 <= d3:
        near = b
    elif d6 >= 0 and d5 <= d6:
        near = c
    elif vc <= 0 <= d1 and d3 <= 0:
        near = a + ab * d1 / (d1 - d3)
    elif vb <= 0 <= d2 and d6 <= 0:
        near = a + ac * d2 / (d2 - d6)
    elif va <= 0 and d4 >= d3 and d5 >= d6:
        near = b + (c - b) * (d4 - d3) / ((d4 - d3) + (d5 - d6))
    else:
        near = a + (ab * vb + ac * vc) / (va + vb + vc)
    return float(np.linalg.norm(x - near))


def point(source: random.Random, reach: float = 3.0) -> Point:
    # Some coordinates are round: lines along faces and axes are what breaks closed forms.
    return Point(*(source.choice((source.uniform(-reach, reach), float(source.randint(-2, 2)))) for _ in range(3)))


def solids(source: random.Random) -> Solid:
    kind, at = source.randrange(3), point(source, 1.5)
    size = Point(*(source.uniform(0.05, 2.0) for _ in range(3)))
    if kind == 0:
        return Block(at, at + size)
    return Sphere(at, size.x) if kind == 1 else Cylinder(at, size.x, size.z)


def test_solids_against_a_search_along_the_line() -> None:
    source = random.Random(1)
    touched = 0
    for _ in range(3000):
        body, a, b = solids(source), point(source), point(source)
        found = solid_distance(body, a, b)
        assert found == pytest.approx(searched(partial(from_point, body), a, b), abs=2e-7), (body, a, b)
        least = min(from_point(body, a + (b - a) * (i / 50)) for i in range(51))
        assert found <= least + 1e-12
        touched += found == 0.0
    assert 300 < touched < 2700


def test_a_line_that_is_a_point_and_one_along_the_axis() -> None:
    column = Cylinder(Point(0, 0, 0), 0.5, 1.0)
    assert solid_distance(column, Point(2, 0, 0.5), Point(2, 0, 0.5)) == 1.5
    assert solid_distance(column, Point(0, 0, 3), Point(0, 0, 2)) == 1.0
    assert solid_distance(column, Point(0, 0, 3), Point(0, 0, -1)) == 0.0
    assert solid_distance(Block(Point(0, 0, 0), Point(1, 1, 1)), Point(-1, 2, 0), Point(2, 2, 0)) == 1.0


def as_fcl(body: Solid) -> fcl.CollisionObject:
    match body:
        case Block(lo, hi):
            middle = (lo + hi) / 2
            return fcl.CollisionObject(fcl.Box(*np.array(_vector(hi - lo))), fcl.Transform(np.array(_vector(middle))))
        case Sphere(c, r):
            return fcl.CollisionObject(fcl.Sphere(r), fcl.Transform(np.array(_vector(c))))
        case Cylinder(base, r, h):
            middle = Point(base.x, base.y, base.z + h / 2)
            return fcl.CollisionObject(fcl.Cylinder(r, h), fcl.Transform(np.array(_vector(middle))))


def _vector(p: Point) -> Vector:
    return p.x, p.y, p.z


def test_points_against_fcl() -> None:
    """fcl's own distances are exact to some micrometres: a ball of no size at a place, from the body."""
    source = random.Random(2)
    for _ in range(500):
        body, p = solids(source), point(source)
        mine = solid_distance(body, p, p)
        ball = fcl.CollisionObject(fcl.Sphere(1e-9), fcl.Transform(np.array(_vector(p))))
        theirs = fcl.distance(as_fcl(body), ball, fcl.DistanceRequest(), fcl.DistanceResult())
        if mine > 1e-3:
            assert theirs == pytest.approx(mine, abs=1e-4), (body, p)
        elif mine == 0.0:
            assert theirs <= 1e-4


def soup(source: random.Random, faces: int) -> Mesh:
    vertices = tuple(point(source, 2.0) for _ in range(3 * faces))
    return Mesh(vertices, tuple((3 * i, 3 * i + 1, 3 * i + 2) for i in range(faces)))


def test_meshes_against_a_search_along_the_line(monkeypatch: pytest.MonkeyPatch) -> None:
    source = random.Random(3)
    touched = 0
    for _ in range(150):
        mesh, a, b = soup(source, 4), point(source), point(source)
        monkeypatch.setattr("targets.planning.mesh.FEW", source.choice((0, 12)))  # all at once, or one by one
        found = Surface(mesh).distance(a, b)
        each = []
        for i, j, k in mesh.faces:
            corners = (mesh.vertices[i], mesh.vertices[j], mesh.vertices[k])
            if np.linalg.norm(np.cross(_vector(corners[1] - corners[0]), _vector(corners[2] - corners[0]))) < 1e-9:
                each.append(math.inf)
                continue
            each.append(searched(lambda p, c=corners: from_triangle(p, c), a, b))  # type: ignore[misc]
        if math.inf not in each:
            assert found == pytest.approx(min(each), abs=2e-7), (mesh, a, b)
        touched += found == 0.0
    assert 15 < touched < 135


def test_triangles_without_area_are_their_sides() -> None:
    line = Mesh((Point(0, 0, 0), Point(1, 0, 0), Point(2, 0, 0)), ((0, 1, 2),))
    assert Surface(line).distance(Point(0.5, 1, 0), Point(0.5, 3, 0)) == 1.0


def test_what_is_farther_than_asked_for_is_left_out() -> None:
    surface = Surface(Mesh((Point(0, 0, 0), Point(1, 0, 0), Point(0, 1, 0)), ((0, 1, 2),)))
    assert surface.distance(Point(0, 0, 2), Point(1, 0, 2), 1.0) > 1.0
    assert surface.distance(Point(0, 0, 2), Point(1, 0, 2), 2.5) == 2.0
