"""Obstacles in the fleet file: boxes, spheres, upright cylinders and meshes, as plain values of JSON files."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from koordgen.fleet.mesh import BadMesh, Vector, read_mesh
from koordgen.fleet.yaml_reader import YamlNode, YamlReader

MOST_OBSTACLES = 1000
MOST_BYTES = 1 << 24  # of a mesh file
MOST_FACES = 10_000  # of a mesh: planners on robots compute the distance to each
LEAST, MOST = 1e-3, 1e5  # metres: bounds of a radius or a height
_SHAPES = (
    "a box has lo and hi; a sphere has centre and radius; an upright cylinder has base, radius and height; a mesh has "
    "mesh, the name of its file"
)
_FORMS = {".stl": "stl", ".obj": "obj"}

Obstacle = dict[str, Any]  # in the form that koordgen/runtime/values/obstacles.py reads


def read_obstacles(reader: YamlReader, node: YamlNode | None, folder: Path) -> tuple[Obstacle, ...]:
    """Read the list of obstacles. Paths of mesh files are relative to `folder`."""
    entries = reader.items(node, "obstacles")
    if node is not None and len(entries) > MOST_OBSTACLES:
        reader.report("F005", f"obstacles has {len(entries)} entries; at most {MOST_OBSTACLES} are allowed", node)
    return tuple(_obstacle(reader, entry, f"obstacle {i}", folder) for i, entry in enumerate(entries))


def read_box(reader: YamlReader, node: YamlNode | None, what: str) -> dict[str, list[float]]:
    """Read `lo` and `hi`, two opposite corners of a box."""
    corner = reader.table(node, what, ["lo", "hi"], [])
    lo, hi = reader.vector(corner.get("lo"), f"{what}.lo"), reader.vector(corner.get("hi"), f"{what}.hi")
    if lo and hi and any(a >= b for a, b in zip(lo, hi, strict=True)):
        reader.report("F005", f"{what}.lo must be below {what}.hi on every axis", corner["hi"])
    return {"lo": lo or [], "hi": hi or []}


def _obstacle(reader: YamlReader, node: YamlNode, what: str, folder: Path) -> Obstacle:
    if not isinstance(node, yaml.MappingNode):
        return _box(reader, node, what, folder)
    read = _kind(node)
    if read is None:
        reader.report("F003", f"{what} has the keys of no known shape", node, _SHAPES)
        return {}
    return read(reader, node, what, folder)


def _kind(node: yaml.MappingNode) -> Callable[[YamlReader, YamlNode, str, Path], Obstacle] | None:
    """Return the reader of a shape, found by a key that no other shape has, even if misspelt; None without one."""
    from difflib import get_close_matches

    kinds = {"centre": _sphere, "base": _cylinder, "mesh": _mesh, "lo": _box, "hi": _box}
    found = (match for key, _ in node.value for match in get_close_matches(str(key.value), kinds, 1))
    return next((kinds[match] for match in found), None)


def _box(reader: YamlReader, node: YamlNode, what: str, folder: Path) -> Obstacle:
    return {"shape": "box", **read_box(reader, node, what)}


def _sphere(reader: YamlReader, node: YamlNode, what: str, folder: Path) -> Obstacle:
    keys = reader.table(node, what, ["centre", "radius"], [])
    centre = reader.vector(keys.get("centre"), f"{what}.centre")
    radius = reader.number(keys.get("radius"), f"{what}.radius (metres)", LEAST, MOST)
    return {"shape": "sphere", "centre": centre, "radius": radius}


def _cylinder(reader: YamlReader, node: YamlNode, what: str, folder: Path) -> Obstacle:
    keys = reader.table(node, what, ["base", "radius", "height"], [])
    base = reader.vector(keys.get("base"), f"{what}.base")
    radius = reader.number(keys.get("radius"), f"{what}.radius (metres)", LEAST, MOST)
    height = reader.number(keys.get("height"), f"{what}.height (metres)", LEAST, MOST)
    return {"shape": "cylinder", "base": base, "radius": radius, "height": height}


def _mesh(reader: YamlReader, node: YamlNode, what: str, folder: Path) -> Obstacle:
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
        reader.report("F005", f"{what}.mesh cannot be {name!r}", named, "name a file that ends in .stl or .obj")
        return empty
    try:
        if file.exists() and not file.is_file():
            reader.report("F005", f"the mesh {file} is not a regular file", named)
            return empty
        if file.stat().st_size > MOST_BYTES:
            reader.report("F005", f"the mesh {file} has {file.stat().st_size:,} bytes; at most {MOST_BYTES:,} are "
                          "allowed", named, "simplify it: planners compute the distance to each triangle")  # fmt: skip
            return empty
        mesh = read_mesh(file.read_bytes(), form)
    except OSError as error:
        reader.report("F005", f"the mesh {file} cannot be read: {error.strerror or error}", named,
                      "its path is relative to the folder of the fleet file")  # fmt: skip
        return empty
    except BadMesh as error:
        reader.report("F005", f"the mesh {file} cannot be used: {error}", named)
        return empty
    if len(mesh.faces) > MOST_FACES:
        reader.report("F005", f"the mesh {file} has {len(mesh.faces)} triangles; at most {MOST_FACES} are allowed",
                      named, "simplify it: planners compute the distance to each triangle")  # fmt: skip
        return empty
    vertices = [_placed(vertex, position, yaw, scale) for vertex in mesh.vertices]
    if any(abs(v) > MOST for vertex in vertices for v in vertex):
        reader.report(
            "F005",
            f"a vertex of the mesh {file} is further than {MOST:g} m from the origin",
            named,
            "if the file is in millimetres, write `scale: 0.001`",
        )
        return empty
    return {"shape": "mesh", "vertices": vertices, "faces": [list(face) for face in mesh.faces]}


def _placed(p: Vector, position: list[float], yaw: float, scale: float) -> list[float]:
    c, s = math.cos(yaw), math.sin(yaw)
    x, y, z = (scale * v for v in p)
    return [position[0] + c * x - s * y, position[1] + s * x + c * y, position[2] + z]
