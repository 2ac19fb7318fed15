"""What stands in the fleet's way, as the fleet file says it: boxes, spheres, upright cylinders, meshes.

Metres, local ENU. Boxes, spheres and cylinders are solid; a mesh is its surface.
"""

from __future__ import annotations

import msgspec

from koordgen.runtime.values.points import Point


class Block(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="box"):
    """An axis-parallel box between two corners, `lo` below `hi` on every axis."""

    lo: Point
    hi: Point


class Sphere(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="sphere"):
    """All that is no farther than `radius` from `centre`."""

    centre: Point
    radius: float


class Cylinder(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="cylinder"):
    """An upright cylinder; `base` is the middle of its lower face."""

    base: Point
    radius: float
    height: float


class Mesh(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="mesh"):
    """A surface of triangles: each face is three indices of vertices."""

    vertices: tuple[Point, ...]
    faces: tuple[tuple[int, int, int], ...]


Obstacle = Block | Sphere | Cylinder | Mesh
