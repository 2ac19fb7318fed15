"""World section of the fleet file: arena, walls, floor friction, wind and markers. Metres, local ENU.

Robots receive the walls, as obstacles; only harnesses use the rest.
"""

from __future__ import annotations

import math
from typing import Any

import yaml

from koordgen.fleet.obstacles import LEAST, MOST, Obstacle, read_box
from koordgen.fleet.settings import NameChecks
from koordgen.fleet.yaml_reader import YamlNode, YamlReader
from koordgen.lang.node import Node

MOST_WALLS = 200
MOST_MARKERS = 1000
Place = tuple[float, float]


class Wall(Node):
    """Upright wall over the line from `start` to `end`; lengths in metres. `low`: height of its lower edge.

    The wall extends by half its thickness beyond both ends, so walls with a common end leave no gap.
    """

    start: Place
    end: Place
    thickness: float
    height: float
    low: float

    @property
    def corners(self) -> tuple[Place, Place, Place, Place]:
        """Corners of its outline (m, ENU), counter-clockwise from above."""
        dx, dy = self.end[0] - self.start[0], self.end[1] - self.start[1]
        half = self.thickness / 2 / math.hypot(dx, dy)
        ax, ay = half * dx, half * dy  # along the wall; across it is (-ay, ax)
        (x0, y0), (x1, y1) = self.start, self.end
        return (
            (x0 - ax + ay, y0 - ay - ax), (x1 + ax + ay, y1 + ay - ax),
            (x1 + ax - ay, y1 + ay + ax), (x0 - ax - ay, y0 - ay + ax),
        )  # fmt: skip

    def obstacle(self) -> Obstacle:
        """Return the wall as an obstacle: a box if it is parallel to an axis, else a mesh."""
        corners, high = self.corners, self.low + self.height
        if self.start[0] == self.end[0] or self.start[1] == self.end[1]:
            xs, ys = [x for x, _ in corners], [y for _, y in corners]
            return {"shape": "box", "lo": [min(xs), min(ys), self.low], "hi": [max(xs), max(ys), high]}
        return {
            "shape": "mesh",
            "vertices": [[x, y, z] for z in (self.low, high) for x, y in corners],
            "faces": [list(face) for face in _FACES],
        }


# Triangles of a prism over four corners, with outward normals. Corners 0 to 3 are the lower, 4 to 7 the upper ones,
# counter-clockwise from above.
_SIDES = tuple(f for i in range(4) for j in [(i + 1) % 4] for f in ((i, j, j + 4), (i, j + 4, i + 4)))
_FACES = ((0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), *_SIDES)


class FleetWorld(Node):
    """World of the fleet. `facts`: arena, friction, wind and markers as JSON values of a harness's scenario."""

    walls: tuple[Wall, ...]
    arena: dict[str, list[float]] | None
    facts: dict[str, Any]


def read_world(reader: YamlReader, node: YamlNode | None, known: NameChecks) -> FleetWorld:
    """Read the fleet file's `world`."""
    given = reader.table(node, "world", [], ["arena", "walls", "floor_friction", "wind", "markers", "marker_list"])
    arena = read_box(reader, given["arena"], "world.arena") if "arena" in given else None
    friction = reader.number(given.get("floor_friction"), "world.floor_friction", 0.01, 10.0)
    return FleetWorld(
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


def _walls(reader: YamlReader, node: YamlNode | None) -> tuple[Wall, ...]:
    entries = reader.items(node, "world.walls")
    if node is not None and len(entries) > MOST_WALLS:
        reader.report("F005", f"world.walls has {len(entries)} entries; at most {MOST_WALLS} are allowed", node)
    found = (_wall(reader, entry, f"wall {i}") for i, entry in enumerate(entries))
    return tuple(wall for wall in found if wall is not None)


def _wall(reader: YamlReader, node: YamlNode, what: str) -> Wall | None:
    keys = reader.table(node, what, ["from", "to"], ["thickness", "height", "low"])
    start, end = _place(reader, keys.get("from"), f"{what}.from"), _place(reader, keys.get("to"), f"{what}.to")
    thickness = reader.number(keys.get("thickness"), f"{what}.thickness (metres)", LEAST, MOST)
    height = reader.number(keys.get("height"), f"{what}.height (metres)", LEAST, MOST)
    low = reader.number(keys.get("low"), f"{what}.low (metres)", -MOST, MOST)
    if start is None or end is None:
        return None
    if math.dist(start, end) < LEAST:
        reader.report("F005", f"{what} starts and ends at the same point", keys["to"], "change one of the two")
        return None
    return Wall(start, end, thickness or 0.1, height or 1.0, low or 0.0)


def _place(reader: YamlReader, node: YamlNode | None, what: str) -> Place | None:
    if node is None:
        return None
    elements = reader.items(node, what)
    if len(elements) != 2:
        if isinstance(node, yaml.SequenceNode):
            reader.report("F004", f"{what} must be [x, y], two numbers in metres", node)
        return None
    x, y = (reader.number(e, f"{what}'s {axis}", -MOST, MOST) for e, axis in zip(elements, "xy", strict=True))
    return None if x is None or y is None else (x, y)


def _wind(reader: YamlReader, node: YamlNode | None) -> dict[str, Any]:
    """Read `wind`.

    mean: velocity of the air (m/s, ENU). gust: standard deviation of the additional velocity in each direction (m/s).
    correlation: correlation time of the gusts (s).
    """
    what = "world.wind"
    given = reader.table(node, what, [], ["mean", "gust", "correlation"])
    gust = reader.number(given.get("gust"), f"{what}.gust (m/s)", 0.0, 50.0)
    correlation = reader.number(given.get("correlation"), f"{what}.correlation (seconds)", 0.01, 1000.0)
    return {
        "mean": reader.vector(given.get("mean"), f"{what}.mean") or [0.0, 0.0, 0.0],
        "gust": gust or 0.0,
        "correlation": correlation or 1.0,
    }


def _markers(reader: YamlReader, node: YamlNode | None) -> list[dict[str, Any]]:
    entries = reader.items(node, "world.markers")
    if node is not None and len(entries) > MOST_MARKERS:
        reader.report("F005", f"world.markers has {len(entries)} entries; at most {MOST_MARKERS} are allowed", node)
    found: list[dict[str, Any]] = []
    names: set[str] = set()
    for number, entry in enumerate(entries):
        what = f"marker {number}"
        keys = reader.table(entry, what, ["name", "position"], ["radius"])
        name: str | None = reader.scalar(keys.get("name"), f"{what}.name", str)
        if name is not None and name in names:
            reader.report("F006", f"two markers have the name {name!r}", keys["name"], "rename one of them")
        names.add(name or "")
        position = reader.vector(keys.get("position"), f"{what}.position")
        found.append({"name": name, "position": position, "radius": _radius(reader, keys, what)})
    return found


def _marker_list(reader: YamlReader, node: YamlNode | None, known: NameChecks) -> dict[str, Any] | None:
    if node is None:
        return None
    what = "world.marker_list"
    keys = reader.table(node, what, ["variable"], ["position", "radius"])
    variable: str | None = reader.scalar(keys.get("variable"), f"{what}.variable", str)
    position: str = reader.scalar(keys.get("position"), f"{what}.position", str) or ""
    if variable is not None and (misfit := known.markers(variable, position)):
        reader.report("F005", misfit, keys["variable"])
    return {"variable": variable, "position": position, "radius": _radius(reader, keys, what)}


def _radius(reader: YamlReader, keys: dict[str, YamlNode], what: str) -> float:
    return reader.number(keys.get("radius"), f"{what}.radius (metres)", LEAST, MOST) or 0.3
