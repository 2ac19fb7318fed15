"""Obstacles of the fleet's world in the form of the fleet file: boxes, spheres, upright cylinders, meshes."""

from __future__ import annotations

import msgspec

from koordgen.runtime.values.points import Point


class Block(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="box"):
    """Axis-aligned box with the corners `lo` and `hi`; `lo` is below `hi` on every axis."""

    lo: Point
    hi: Point


class Sphere(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="sphere"):
    """Solid sphere: all points at a distance of at most `radius` metres from `centre`."""

    centre: Point
    radius: float


class Cylinder(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="cylinder"):
    """Solid upright cylinder. `base` is the centre of the lower face. Lengths are in metres."""

    base: Point
    radius: float
    height: float


class Mesh(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="mesh"):
    """Surface of triangles. Each face consists of three indices into `vertices`."""

    vertices: tuple[Point, ...]
    faces: tuple[tuple[int, int, int], ...]


Obstacle = Block | Sphere | Cylinder | Mesh
