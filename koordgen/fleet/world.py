"""The world of a fleet file: the arena, walls, what the floor and the air are like, markers. Metres, local ENU.

Robots know of the walls alone; the rest is a harness's.
"""

from __future__ import annotations

import math
from typing import Any

import yaml

from koordgen.fleet.located import Reader, YamlNode
from koordgen.fleet.obstacles import LEAST, MOST, Obstacle, read_box
from koordgen.fleet.offered import Known
from koordgen.lang.node import Node

MOST_WALLS = 200
MOST_MARKERS = 1000
Place = tuple[float, float]


class Wall(Node):
    """An upright wall over the line between two places, which it reaches beyond by half its thickness, so that walls
    with a common end close a corner; `low` is the height of its foot."""

    start: Place
    end: Place
    thickness: float
    height: float
    low: float

    @property
    def corners(self) -> tuple[Place, Place, Place, Place]:
        """Seen from above, counter-clockwise."""
        dx, dy = self.end[0] - self.start[0], self.end[1] - self.start[1]
        half = self.thickness / 2 / math.hypot(dx, dy)
        ax, ay = half * dx, half * dy  # along the wall; across it is (-ay, ax)
        (x0, y0), (x1, y1) = self.start, self.end
        return (
            (x0 - ax + ay, y0 - ay - ax), (x1 + ax + ay, y1 + ay - ax),
            (x1 + ax - ay, y1 + ay + ax), (x0 - ax - ay, y0 - ay + ax),
        )  # fmt: skip

    def obstacle(self) -> Obstacle:
        """A box, if it lies along an axis, or else the mesh of its faces."""
        corners, high = self.corners, self.low + self.height
        if self.start[0] == self.end[0] or self.start[1] == self.end[1]:
            xs, ys = [x for x, _ in corners], [y for _, y in corners]
            return {"shape": "box", "lo": [min(xs), min(ys), self.low], "hi": [max(xs), max(ys), high]}
        return {
            "shape": "mesh",
            "vertices": [[x, y, z] for z in (self.low, high) for x, y in corners],
            "faces": [list(face) for face in _FACES],
        }


# Of a prism over four corners, outward: the lower and the upper ones are numbered counter-clockwise seen from above.
_SIDES = tuple(f for i in range(4) for j in [(i + 1) % 4] for f in ((i, j, j + 4), (i, j + 4, i + 4)))
_FACES = ((0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), *_SIDES)


class World(Node):
    """`facts` are plain values, as they go into a harness's scenario."""

    walls: tuple[Wall, ...]
    arena: dict[str, list[float]] | None
    facts: dict[str, Any]


def read_world(reader: Reader, node: YamlNode | None, known: Known) -> World:
    """The fleet file's `world`."""
    given = reader.table(node, "world", [], ["arena", "walls", "floor_friction", "wind", "markers", "marker_list"])
    arena = read_box(reader, given["arena"], "world.arena") if "arena" in given else None
    friction = reader.number(given.get("floor_friction"), "world.floor_friction", 0.01, 10.0)
    return World(
        _walls(reader, given.get("walls")),
        arena,
        {
            "arena": arena,
            "floor_friction": 1.0 if friction is None else friction,
            "wind": _wind(reader, given.get("wind")),
            "markers": _markers(reader, given.get("markers")),
            "marker_list": _marker_list(reader, given.get("marker_list"), known),
        },
    )


def _walls(reader: Reader, node: YamlNode | None) -> tuple[Wall, ...]:
    entries = reader.items(node, "world.walls")
    if node is not None and len(entries) > MOST_WALLS:
        reader.report("F005", f"world.walls lists {len(entries)}; there may be at most {MOST_WALLS}", node)
    found = (_wall(reader, entry, f"wall {i}") for i, entry in enumerate(entries))
    return tuple(wall for wall in found if wall is not None)


def _wall(reader: Reader, node: YamlNode, what: str) -> Wall | None:
    keys = reader.table(node, what, ["from", "to"], ["thickness", "height", "low"])
    start, end = _place(reader, keys.get("from"), f"{what}.from"), _place(reader, keys.get("to"), f"{what}.to")
    thickness = reader.number(keys.get("thickness"), f"{what}.thickness (metres)", LEAST, MOST)
    height = reader.number(keys.get("height"), f"{what}.height (metres)", LEAST, MOST)
    low = reader.number(keys.get("low"), f"{what}.low (metres)", -MOST, MOST)
    if start is None or end is None:
        return None
    if math.dist(start, end) < LEAST:
        reader.report("F005", f"{what} begins where it ends", keys["to"], "give it another end")
        return None
    return Wall(start, end, thickness or 0.1, height or 1.0, low or 0.0)


def _place(reader: Reader, node: YamlNode | None, what: str) -> Place | None:
    if node is None:
        return None
    elements = reader.items(node, what)
    if len(elements) != 2:
        if isinstance(node, yaml.SequenceNode):
            reader.report("F004", f"{what} must be [x, y], two numbers in metres", node)
        return None
    x, y = (reader.number(e, f"{what}'s {axis}", -MOST, MOST) for e, axis in zip(elements, "xy", strict=True))
    return None if x is None or y is None else (x, y)


def _wind(reader: Reader, node: YamlNode | None) -> dict[str, Any]:
    """`mean`, the air's velocity (m/s, ENU); `gust`, the standard deviation of what comes on top of it in each
    direction (m/s); `correlation`, the time in which that changes (s)."""
    what = "world.wind"
    given = reader.table(node, what, [], ["mean", "gust", "correlation"])
    gust = reader.number(given.get("gust"), f"{what}.gust (m/s)", 0.0, 50.0)
    correlation = reader.number(given.get("correlation"), f"{what}.correlation (seconds)", 0.01, 1000.0)
    return {
        "mean": reader.vector(given.get("mean"), f"{what}.mean") or [0.0, 0.0, 0.0],
        "gust": gust or 0.0,
        "correlation": correlation or 1.0,
    }


def _markers(reader: Reader, node: YamlNode | None) -> list[dict[str, Any]]:
    entries = reader.items(node, "world.markers")
    if node is not None and len(entries) > MOST_MARKERS:
        reader.report("F005", f"world.markers lists {len(entries)}; there may be at most {MOST_MARKERS}", node)
    found: list[dict[str, Any]] = []
    names: set[str] = set()
    for number, entry in enumerate(entries):
        what = f"marker {number}"
        keys = reader.table(entry, what, ["name", "position"], ["radius"])
        name: str | None = reader.scalar(keys.get("name"), f"{what}.name", str)
        if name is not None and name in names:
            reader.report("F006", f"marker {name!r} is there twice", keys["name"])
        names.add(name or "")
        position = reader.vector(keys.get("position"), f"{what}.position")
        found.append({"name": name, "position": position, "radius": _radius(reader, keys, what)})
    return found


def _marker_list(reader: Reader, node: YamlNode | None, known: Known) -> dict[str, Any] | None:
    if node is None:
        return None
    what = "world.marker_list"
    keys = reader.table(node, what, ["variable"], ["position", "radius"])
    variable: str | None = reader.scalar(keys.get("variable"), f"{what}.variable", str)
    position: str = reader.scalar(keys.get("position"), f"{what}.position", str) or ""
    if variable is not None and (misfit := known.markers(variable, position)):
        reader.report("F005", misfit, keys["variable"])
    return {"variable": variable, "position": position, "radius": _radius(reader, keys, what)}


def _radius(reader: Reader, keys: dict[str, YamlNode], what: str) -> float:
    return reader.number(keys.get("radius"), f"{what}.radius (metres)", LEAST, MOST) or 0.3
