"""World and robots as entities of a foxglove.SceneUpdate: metres, local ENU, frame `map`."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from koordgen.runtime.trace.schema import Header
from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Point
from targets.sim.view.data.colours import GREY, STATES, STONE, of_robot, rgba

FRAME = "map"
Entity = dict[str, Any]
LISTS = ("metadata", "arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
STILL: dict[str, float] = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
LINE_STRIP, LINE_LIST = 0, 2
BODY = {"car": (0.5, 0.26, 0.2)}  # metres; other targets have the size of a small quadrotor
QUAD = (0.36, 0.36, 0.1)


def stamp(nanoseconds: int) -> dict[str, int]:
    return {"sec": nanoseconds // 1_000_000_000, "nsec": nanoseconds % 1_000_000_000}


def vector(place: Iterable[float]) -> dict[str, float]:
    x, y, z = place
    return {"x": x, "y": y, "z": z}


def pose(place: Iterable[float], yaw: float = 0.0) -> dict[str, Any]:
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {"position": vector(place), "orientation": turn}


def entity(at: int, name: str, frame: str = FRAME, **primitives: Any) -> Entity:
    """Return an entity that stays until the next one of its name.

    Locked to its frame if that is a robot's."""
    rest: Entity = {key: [] for key in LISTS}
    head = {"timestamp": stamp(at), "frame_id": frame, "id": name, "lifetime": stamp(0), "frame_locked": frame != FRAME}
    return {**head, **rest, **primitives}


def standing(header: Header, at: int) -> list[Entity]:
    """Return the static entities.

    Obstacles, geofence, arena, and the robots' bodies, each in its own frame."""
    found = [obstacle(o, at, k) for k, o in enumerate(header.obstacles)]
    if header.geofence:
        found.append(_frame(at, "geofence", *header.geofence))
    if header.world.arena:
        found.append(_frame(at, "arena", header.world.arena.lo, header.world.arena.hi))
    for robot in header.robots:
        size = BODY.get(robot.target, QUAD)
        cube = {"pose": pose((0.0, 0.0, size[2] / 2)), "size": vector(size), "color": rgba(of_robot(robot.pid))}
        text = {
            "pose": pose((0.0, 0.0, size[2] + 0.25)), "billboard": True, "font_size": 14.0, "scale_invariant": True,
            "color": rgba(of_robot(robot.pid)), "text": robot.name,
        }  # fmt: skip
        found.append(entity(at, f"robot {robot.name}", robot.name, cubes=[cube], texts=[text]))
    return found


def path(at: int, robot: str, pid: int, points: list[list[float]]) -> Entity:
    """Return a robot's commanded path."""
    return entity(at, f"path {robot}", lines=[_line(LINE_STRIP, points, of_robot(pid), 0.03)])


def marker(at: int, number: int, place: Iterable[float], radius: float, state: int) -> Entity:
    size = vector((2 * radius,) * 3)
    return entity(
        at, f"marker {number}", spheres=[{"pose": pose(place), "size": size, "color": rgba(STATES[state], 0.7)}]
    )


def _line(kind: int, points: Iterable[Iterable[float]], colour: str, thickness: float) -> dict[str, Any]:
    return {
        "type": kind, "pose": pose((0.0, 0.0, 0.0)), "thickness": thickness, "scale_invariant": False,
        "points": [vector(p) for p in points], "color": rgba(colour), "colors": [], "indices": [],
    }  # fmt: skip


def _frame(at: int, name: str, lo: Iterable[float], hi: Iterable[float]) -> Entity:
    """Return the twelve edges of a box."""
    (x0, y0, z0), (x1, y1, z1) = lo, hi
    points: list[tuple[float, float, float]] = []
    for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
        points += [(x0, (y0, y1)[a], (z0, z1)[b]), (x1, (y0, y1)[a], (z0, z1)[b])]
        points += [((x0, x1)[a], y0, (z0, z1)[b]), ((x0, x1)[a], y1, (z0, z1)[b])]
        points += [((x0, x1)[a], (y0, y1)[b], z0), ((x0, x1)[a], (y0, y1)[b], z1)]
    return entity(at, name, lines=[_line(LINE_LIST, points, GREY, 0.02)])


def obstacle(obstacle: Obstacle, at: int, number: int) -> Entity:
    """Return the entity of an obstacle."""
    name = f"obstacle {number}"
    colour = rgba(STONE, 0.8)
    match obstacle:
        case Block(lo, hi):
            middle = ((lo.x + hi.x) / 2, (lo.y + hi.y) / 2, (lo.z + hi.z) / 2)
            size = vector((hi.x - lo.x, hi.y - lo.y, hi.z - lo.z))
            return entity(at, name, cubes=[{"pose": pose(middle), "size": size, "color": colour}])
        case Sphere(centre, radius):
            ball = {"pose": pose(_place(centre)), "size": vector((2 * radius,) * 3), "color": colour}
            return entity(at, name, spheres=[ball])
        case Cylinder(base, radius, height):
            column = {
                "pose": pose((base.x, base.y, base.z + height / 2)), "size": vector((2 * radius, 2 * radius, height)),
                "bottom_scale": 1.0, "top_scale": 1.0, "color": colour,
            }  # fmt: skip
            return entity(at, name, cylinders=[column])
        case Mesh(vertices, faces):
            surface = {
                "pose": pose((0.0, 0.0, 0.0)), "points": [vector(_place(v)) for v in vertices], "color": colour,
                "colors": [], "indices": [i for face in faces for i in face],
            }  # fmt: skip
            return entity(at, name, triangles=[surface])


def _place(p: Point) -> tuple[float, float, float]:
    return (p.x, p.y, p.z)
