"""Obstacles in the fleet file: boxes, spheres, upright cylinders, meshes; as plain values, for settings and
scenarios."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from koordgen.fleet.located import Reader, YamlNode
from koordgen.fleet.mesh import BadMesh, Vector, read_mesh

MOST_OBSTACLES = 1000
MOST_BYTES = 1 << 24  # of a mesh's file
MOST_FACES = 10_000  # of a mesh: robots keep and measure each
LEAST, MOST = 1e-3, 1e5  # metres, of a radius or a height
_SHAPES = (
    "a box has lo and hi, a sphere centre and radius, an upright cylinder base, radius and height, a mesh the name of "
    "its file: mesh"
)
_FORMS = {".stl": "stl", ".obj": "obj"}

Obstacle = dict[str, Any]  # as koordgen/runtime/values/obstacles.py has it


def read_obstacles(reader: Reader, node: YamlNode | None, folder: Path) -> tuple[Obstacle, ...]:
    """The list of obstacles; meshes are files in `folder` or below."""
    entries = reader.items(node, "obstacles")
    if node is not None and len(entries) > MOST_OBSTACLES:
        reader.report("F005", f"obstacles lists {len(entries)}; there may be at most {MOST_OBSTACLES}", node)
    return tuple(_obstacle(reader, entry, f"obstacle {i}", folder) for i, entry in enumerate(entries))


def read_box(reader: Reader, node: YamlNode | None, what: str) -> dict[str, list[float]]:
    """`lo` and `hi`, two corners of a box."""
    corner = reader.table(node, what, ["lo", "hi"], [])
    lo, hi = reader.vector(corner.get("lo"), f"{what}.lo"), reader.vector(corner.get("hi"), f"{what}.hi")
    if lo and hi and any(a >= b for a, b in zip(lo, hi, strict=True)):
        reader.report("F005", f"{what}.lo must be below {what}.hi on every axis", corner["hi"])
    return {"lo": lo or [], "hi": hi or []}


def _obstacle(reader: Reader, node: YamlNode, what: str, folder: Path) -> Obstacle:
    if not isinstance(node, yaml.MappingNode):
        return _box(reader, node, what, folder)
    read = _kind(node)
    if read is None:
        reader.report("F003", f"{what} has no shape that is known", node, _SHAPES)
        return {}
    return read(reader, node, what, folder)


def _kind(node: yaml.MappingNode) -> Callable[[Reader, YamlNode, str, Path], Obstacle] | None:
    """By the key that only this kind has, misspelt or not; None when there is none."""
    from difflib import get_close_matches

    kinds = {"centre": _sphere, "base": _cylinder, "mesh": _mesh, "lo": _box, "hi": _box}
    found = (match for key, _ in node.value for match in get_close_matches(str(key.value), kinds, 1))
    return next((kinds[match] for match in found), None)


def _box(reader: Reader, node: YamlNode, what: str, folder: Path) -> Obstacle:
    return {"shape": "box", **read_box(reader, node, what)}


def _sphere(reader: Reader, node: YamlNode, what: str, folder: Path) -> Obstacle:
    keys = reader.table(node, what, ["centre", "radius"], [])
    centre = reader.vector(keys.get("centre"), f"{what}.centre")
    radius = reader.number(keys.get("radius"), f"{what}.radius (metres)", LEAST, MOST)
    return {"shape": "sphere", "centre": centre, "radius": radius}


def _cylinder(reader: Reader, node: YamlNode, what: str, folder: Path) -> Obstacle:
    keys = reader.table(node, what, ["base", "radius", "height"], [])
    base = reader.vector(keys.get("base"), f"{what}.base")
    radius = reader.number(keys.get("radius"), f"{what}.radius (metres)", LEAST, MOST)
    height = reader.number(keys.get("height"), f"{what}.height (metres)", LEAST, MOST)
    return {"shape": "cylinder", "base": base, "radius": radius, "height": height}


def _mesh(reader: Reader, node: YamlNode, what: str, folder: Path) -> Obstacle:
    keys = reader.table(node, what, ["mesh"], ["position", "yaw", "scale"])
    position = reader.vector(keys.get("position"), f"{what}.position") or [0.0, 0.0, 0.0]
    yaw = reader.number(keys.get("yaw"), f"{what}.yaw (radians)", -6.3, 6.3) or 0.0
    scale = reader.number(keys.get("scale"), f"{what}.scale", 1e-6, 1e6) or 1.0
    empty: Obstacle = {"shape": "mesh", "vertices": [], "faces": []}
    named = keys.get("mesh")
    name: str | None = reader.scalar(named, f"{what}.mesh", str)
    if name is None or named is None:
        return empty
    file = folder / name
    form = _FORMS.get(file.suffix.lower())
    if form is None:
        reader.report("F005", f"{what}.mesh is {name!r}", named, "a file that ends in .stl or .obj is expected")
        return empty
    try:
        if file.exists() and not file.is_file():
            reader.report("F005", f"the mesh {file} is no regular file", named)
            return empty
        if file.stat().st_size > MOST_BYTES:
            reader.report("F005", f"the mesh {file} has {file.stat().st_size:,} bytes; there may be at most "
                          f"{MOST_BYTES:,}", named, "simplify it: planners measure each triangle")  # fmt: skip
            return empty
        mesh = read_mesh(file.read_bytes(), form)
    except OSError as error:
        reader.report("F005", f"the mesh {file} cannot be read: {error.strerror or error}", named,
                      "its path is relative to the fleet file's folder")  # fmt: skip
        return empty
    except BadMesh as error:
        reader.report("F005", f"the mesh {file} cannot be used: {error}", named)
        return empty
    if len(mesh.faces) > MOST_FACES:
        reader.report("F005", f"the mesh {file} has {len(mesh.faces)} triangles; there may be at most {MOST_FACES}",
                      named, "simplify it: planners measure each")  # fmt: skip
        return empty
    vertices = [_placed(vertex, position, yaw, scale) for vertex in mesh.vertices]
    if any(abs(v) > MOST for vertex in vertices for v in vertex):
        reader.report(
            "F005", f"the mesh {file} reaches beyond {MOST:g} m", named, "is it in millimetres? `scale: 0.001`"
        )
        return empty
    return {"shape": "mesh", "vertices": vertices, "faces": [list(face) for face in mesh.faces]}


def _placed(p: Vector, position: list[float], yaw: float, scale: float) -> list[float]:
    c, s = math.cos(yaw), math.sin(yaw)
    x, y, z = (scale * v for v in p)
    return [position[0] + c * x - s * y, position[1] + s * x + c * y, position[2] + z]
