"""Mesh files: readers of STL (text or binary) and Wavefront OBJ (vertices and faces). Units are those of the file."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from itertools import pairwise

from koordgen.lang.node import Node

Vector = tuple[float, float, float]
_HEAD, _FACE = 84, 50  # bytes of a binary STL: header with the number of faces; each face


class BadMesh(Exception):
    """Raised for a file that is not a mesh. The message gives the reason, without the file's name."""


class TriangleMesh(Node):
    """Surface of triangles: each face has three indices into `vertices`."""

    vertices: tuple[Vector, ...]
    faces: tuple[tuple[int, int, int], ...]


def read_mesh(data: bytes, form: str) -> TriangleMesh:
    """Return the mesh in a file's bytes. Raises BadMesh.

    `form`: "stl" or "obj". Corners at the same place become one vertex.
    """
    if form == "obj":
        corners = _obj(_text(data))
    elif len(data) >= _HEAD and len(data) == _HEAD + _FACE * int.from_bytes(data[80:84], "little"):
        corners = _binary(data)
    else:
        corners = _stl(_text(data))
    if not corners:
        raise BadMesh("it has no faces")
    if not all(math.isfinite(v) for corner in corners for v in corner):
        raise BadMesh("a coordinate is not finite")
    numbers: dict[Vector, int] = {}
    indices = [numbers.setdefault(corner, len(numbers)) for corner in corners]
    faces = (indices[i : i + 3] for i in range(0, len(indices), 3))
    return TriangleMesh(tuple(numbers), tuple((a, b, c) for a, b, c in faces))


def _text(data: bytes) -> Iterable[tuple[int, list[str]]]:
    """Yield the number and the words of each line."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        raise BadMesh("the file is truncated, or not a mesh of this format") from None
    return ((number, line.split()) for number, line in enumerate(text.splitlines(), 1))


def _binary(data: bytes) -> list[Vector]:
    found: list[Vector] = []
    for at in range(_HEAD, len(data), _FACE):
        values = struct.unpack_from("<9f", data, at + 12)  # after the normal
        found += [(values[i], values[i + 1], values[i + 2]) for i in (0, 3, 6)]
    return found


def _stl(lines: Iterable[tuple[int, list[str]]]) -> list[Vector]:
    found: list[Vector] = []
    solid = False
    for number, words in lines:
        match words:
            case ["solid", *_]:
                solid = True
            case ["vertex", *values]:
                found.append(_vector(values, number))
            case ["endloop"] if len(found) % 3:
                raise BadMesh(f"line {number}: a face is not a triangle")
            case _:
                pass
    if not solid or len(found) % 3:
        raise BadMesh("the file is truncated, or not an STL file")
    return found


def _obj(lines: Iterable[tuple[int, list[str]]]) -> list[Vector]:
    vertices: list[Vector] = []
    found: list[Vector] = []
    for number, words in lines:
        match words:
            case ["v", *values]:
                vertices.append(_vector(values[:3], number))
            case ["f", *corners]:
                places = [_vertex(corner, vertices, number) for corner in corners]
                if len(places) < 3:
                    raise BadMesh(f"line {number}: a face has {len(places)} corners; it needs 3 or more")
                for b, c in pairwise(places[1:]):  # split a polygon into a fan of triangles
                    found += [places[0], b, c]
            case _:
                pass
    return found


def _vertex(corner: str, vertices: list[Vector], number: int) -> Vector:
    """Return the vertex of a corner: `7`, `7/1/3`, or `-1` (counted from the last vertex)."""
    try:
        index = int(corner.partition("/")[0])
        return vertices[index - 1 if index > 0 else len(vertices) + index] if index else vertices[len(vertices)]
    except (ValueError, IndexError):
        raise BadMesh(f"line {number}: there is no vertex {corner}") from None


def _vector(values: list[str], number: int) -> Vector:
    try:
        x, y, z = map(float, values)
    except ValueError:
        raise BadMesh(f"line {number}: three numbers are expected") from None
    return x, y, z
