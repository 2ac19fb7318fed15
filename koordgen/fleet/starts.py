"""Starts of robots: checks that each robot starts within the arena, and touches no obstacle, wall or other robot.

A body is its outline seen from above, and its height. Obstacles that are meshes are not checked; walls are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from koordgen.fleet.manifest import Target
from koordgen.fleet.obstacles import Obstacle
from koordgen.fleet.robots import FleetRobot, Roster
from koordgen.fleet.world import FleetWorld
from koordgen.fleet.yaml_reader import YamlReader
from koordgen.lang.node import Node

Place = tuple[float, float]
TOUCH = 1e-6  # metres: bodies that overlap less than this are not in contact


class Shape(Node):
    """Convex polygon, enlarged by `radius` (m), from height `low` to `high` (m). One corner: a disc. Metres, ENU."""

    corners: tuple[Place, ...]
    radius: float
    low: float
    high: float


def check_starts(
    reader: YamlReader,
    roster: Roster,
    targets: Mapping[str, Target],
    geofence: dict[str, list[float]],
    world: FleetWorld,
    obstacles: tuple[Obstacle, ...],
) -> None:
    """Check the starts of all robots, if the file has a start for at least one of them.

    Robots without a start are at the origin. Squads are left out: their robots start as their own fleet files say.
    """
    if not any(roster.starts):
        return
    bodies: list[Shape] = []
    solids = list(_solids(world, obstacles))
    robots = [(robot, node) for robot, node in zip(roster.robots, roster.starts, strict=True) if robot.inner is None]
    for robot, node in robots:
        body = _body(robot, targets[robot.target])
        wrong = _wrong(robot, body, geofence, world, solids)
        for (other, _), taken in zip(robots, bodies, strict=False):
            if not wrong and _touch(body, taken):
                wrong = f"in contact with {other.name}"
        bodies.append(body)
        place = node or next(start for start in roster.starts if start is not None)
        if wrong:
            shown = ", ".join(f"{v:g}" for v in robot.start["position"])
            help = "change its start" if node is not None else "give it a start: the default is the origin"
            reader.report("F005", f"{robot.name} starts at ({shown}), {wrong}", place, help)


def _wrong(
    robot: FleetRobot,
    body: Shape,
    geofence: dict[str, list[float]],
    world: FleetWorld,
    solids: list[tuple[str, Obstacle | Shape]],
) -> str:
    position = robot.start["position"]
    for name, box in (("arena", world.arena), ("geofence", geofence)):
        if box is not None and not all(a <= v <= b for a, v, b in zip(box["lo"], position, box["hi"], strict=True)):
            return f"outside the {name}"
    for name, solid in solids:
        shape = solid if isinstance(solid, Shape) else _cut(solid, body.low, body.high)
        if shape is not None and _touch(body, shape):
            return f"in contact with {name}"
    return ""


def _solids(world: FleetWorld, obstacles: tuple[Obstacle, ...]) -> Iterator[tuple[str, Obstacle | Shape]]:
    yield from ((f"obstacle {number}", obstacle) for number, obstacle in enumerate(obstacles))
    for number, wall in enumerate(world.walls):
        yield f"wall {number}", Shape(wall.corners, 0.0, wall.low, wall.low + wall.height)


def _body(robot: FleetRobot, target: Target) -> Shape:
    """Return a robot's shape at its start, by the settings that `footprint` names; a point without a footprint."""
    size = {part: float(robot.settings[setting]) for part, setting in target.footprint.items()}
    (x, y, z), yaw = robot.start["position"], robot.start["yaw"]
    radius = size.get("radius", 0.0)
    height = size.get("height", radius)
    ahead, half = size.get("length", 0.0) - size.get("behind", 0.0), size.get("width", 0.0) / 2
    back = -size.get("behind", 0.0)
    own = ((back, -half), (ahead, -half), (ahead, half), (back, half)) if half else ((0.0, 0.0),)
    c, s = math.cos(yaw), math.sin(yaw)
    return Shape(tuple((x + c * a - s * b, y + s * a + c * b) for a, b in own), radius, z, z + height)


def _cut(obstacle: dict[str, Any], low: float, high: float) -> Shape | None:
    """Return the widest horizontal cut of an obstacle between two heights (m); None for a mesh or no overlap."""
    match obstacle:
        case {"shape": "box", "lo": [x0, y0, z0], "hi": [x1, y1, z1]}:
            return Shape(((x0, y0), (x1, y0), (x1, y1), (x0, y1)), 0.0, z0, z1)
        case {"shape": "cylinder", "base": [x, y, z], "radius": radius, "height": height}:
            return Shape(((x, y),), radius, z, z + height)
        case {"shape": "sphere", "centre": [x, y, z], "radius": radius}:
            away = max(low - z, z - high, 0.0)
            return Shape(((x, y),), math.sqrt(radius**2 - away**2), low, high) if away < radius else None
    return None


def _touch(a: Shape, b: Shape) -> bool:
    if a.low >= b.high - TOUCH or b.low >= a.high - TOUCH:
        return False
    return _distance(a.corners, b.corners) < a.radius + b.radius - TOUCH


def _distance(a: tuple[Place, ...], b: tuple[Place, ...]) -> float:
    """Return the distance (m) of two convex polygons; negative if they overlap."""
    if len(a) + len(b) > 2 and not any(_splits(edge, a, b) for edge in (*_edges(a), *_edges(b))):
        return -1.0
    pairs = [(p, edge) for p in a for edge in _edges(b)] + [(p, edge) for p in b for edge in _edges(a)]
    return min((_to_edge(p, *edge) for p, edge in pairs), default=math.dist(a[0], b[0]))


def _edges(corners: tuple[Place, ...]) -> list[tuple[Place, Place]]:
    return list(zip(corners, (*corners[1:], corners[0]), strict=True)) if len(corners) > 1 else []


def _splits(edge: tuple[Place, Place], a: tuple[Place, ...], b: tuple[Place, ...]) -> bool:
    """Return whether the normal of an edge separates two polygons (separating axis theorem)."""
    (x0, y0), (x1, y1) = edge
    along = [[(y1 - y0) * x - (x1 - x0) * y for x, y in corners] for corners in (a, b)]
    gap = TOUCH * math.hypot(x1 - x0, y1 - y0)
    return max(along[0]) <= min(along[1]) + gap or max(along[1]) <= min(along[0]) + gap


def _to_edge(p: Place, a: Place, b: Place) -> float:
    dx, dy = b[0] - a[0], b[1] - a[1]
    share = ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / (dx * dx + dy * dy)
    share = min(1.0, max(0.0, share))
    return math.dist(p, (a[0] + share * dx, a[1] + share * dy))
