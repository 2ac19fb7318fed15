"""Obstacles of the fleet's world, as in the fleet file: boxes, spheres, upright cylinders, meshes."""

from __future__ import annotations

import msgspec

from koordgen.runtime.values.points import Point


class Block(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="box"):
    """Axis-aligned box between two corners, `lo` below `hi` on every axis."""

    lo: Point
    hi: Point


class Sphere(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="sphere"):
    """All points no farther than `radius` from `centre`."""

    centre: Point
    radius: float


class Cylinder(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="cylinder"):
    """Upright cylinder; `base` is the centre of its lower face."""

    base: Point
    radius: float
    height: float


class Mesh(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="mesh"):
    """Surface of triangles: each face is three indices of vertices."""

    vertices: tuple[Point, ...]
    faces: tuple[tuple[int, int, int], ...]


Obstacle = Block | Sphere | Cylinder | Mesh
