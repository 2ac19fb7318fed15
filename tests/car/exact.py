"""An exact checker of planned curves, written again from the words of docs/planners.md, with none of the planner's
code: every pose of the path, a centimetre apart or less, the outline against everything that stands there."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

from koordgen.runtime.obstacles import Block, Cylinder, Obstacle, Sphere
from targets.car.planner import Segment
from targets.planning.world import World

SPACING = 0.01  # metres
ROUNDING = 1e-6

Place = tuple[float, float]


def poses(path: Sequence[Segment], most: float = SPACING) -> Iterator[tuple[float, float, float]]:
    """The poses of a path, and so many on the arc between each two that they are no farther apart."""
    for part in path:
        for a, b in pairwise(part.poses):
            n = max(1, math.ceil(math.dist((a.x, a.y), (b.x, b.y)) / most))
            for i in range(n + 1):
                s, half = i / n, (b.yaw - a.yaw) / 2
                chord, whole = math.dist((a.x, a.y), (b.x, b.y)), math.atan2(b.y - a.y, b.x - a.x)
                part_of = math.sin(half * s) / math.sin(half) if abs(half) > 1e-9 else s
                course = whole - half + half * s  # of the chord from a to this place
                x, y = a.x + chord * part_of * math.cos(course), a.y + chord * part_of * math.sin(course)
                yield x, y, a.yaw + (b.yaw - a.yaw) * s


def outline(world: World, x: float, y: float, yaw: float) -> list[Place]:
    length, width = world.footprint
    corners = [(-world.overhang, -width / 2), (length - world.overhang, -width / 2)]
    corners += [(length - world.overhang, width / 2), (-world.overhang, width / 2)]
    c, s = math.cos(yaw), math.sin(yaw)
    return [(x + c * px - s * py, y + s * px + c * py) for px, py in corners]


def gap(corners: Sequence[Place], body: Obstacle) -> float:
    """Of an outline from an obstacle that stands on the ground; 0 when they overlap."""
    match body:
        case Block(lo, hi):
            box = [(lo.x, lo.y), (hi.x, lo.y), (hi.x, hi.y), (lo.x, hi.y)]
            if any(_within(p, box) for p in corners) or any(_within(p, corners) for p in box):
                return 0.0
            return min(_apart(*a, *b) for a in _sides(corners) for b in _sides(box))
        case Cylinder(centre, radius, _) | Sphere(centre, radius):
            place = (centre.x, centre.y)
            if _within(place, corners):
                return 0.0
            return max(0.0, min(_from(place, *side) for side in _sides(corners)) - radius)
    raise AssertionError(body)


def near(p: Place, body: Obstacle) -> float:
    """Of a place from an obstacle; 0 within it."""
    match body:
        case Block(lo, hi):
            return math.hypot(max(lo.x - p[0], 0.0, p[0] - hi.x), max(lo.y - p[1], 0.0, p[1] - hi.y))
        case Cylinder(centre, radius, _) | Sphere(centre, radius):
            return max(0.0, math.dist(p, (centre.x, centre.y)) - radius)
    raise AssertionError(body)


def collides(world: World, x: float, y: float, yaw: float) -> bool:
    """Whether the car, standing there, is nearer to something than it may be, or outside."""
    lo, hi = world.arena.lo, world.arena.hi
    if not (lo.x - ROUNDING <= x <= hi.x + ROUNDING and lo.y - ROUNDING <= y <= hi.y + ROUNDING):
        return True
    corners = outline(world, x, y, yaw)
    return any(gap(corners, body) < world.clearance - ROUNDING for body in world.obstacles)


def collisions(world: World, path: Sequence[Segment]) -> list[str]:
    """What is wrong with a path, in words. Most obstacles are farther from the pose than any corner can reach; only the
    others' gaps, which take their time, are reckoned."""
    reach = max(math.hypot(px, py) for px, py in outline(world, 0.0, 0.0, 0.0)) + world.clearance
    found = []
    for x, y, yaw in poses(path):
        lo, hi = world.arena.lo, world.arena.hi
        if not (lo.x - ROUNDING <= x <= hi.x + ROUNDING and lo.y - ROUNDING <= y <= hi.y + ROUNDING):
            found.append(f"({x:.3f}, {y:.3f}) is outside")
        corners = outline(world, x, y, yaw)
        for number, body in enumerate(world.obstacles):
            if near((x, y), body) > reach:
                continue
            away = gap(corners, body)
            if away < world.clearance - ROUNDING:
                found.append(f"{away:.4f} m from obstacle {number} at ({x:.3f}, {y:.3f})")
    return found


def infeasible(world: World, path: Sequence[Segment]) -> list[str]:
    """Where a path is too sharp, jumps, slips sideways, or changes gear without saying so."""
    sharpest, found = 1 / world.turning_radius + 1e-6, []
    for before, after in pairwise(path):
        a, b = before.poses[-1], after.poses[0]
        apart = math.dist((a.x, a.y), (b.x, b.y)) + abs(a.yaw - b.yaw)
        if apart > 1e-3 or after.direction != -before.direction:
            found.append("two segments do not fit")
    for part in path:
        for p, q in pairwise(part.poses):
            way, turn = math.dist((p.x, p.y), (q.x, q.y)), q.yaw - p.yaw
            arc = way * (turn / 2) / math.sin(turn / 2) if abs(turn) > 1e-9 else way
            if way == 0.0 or abs(q.curvature) > sharpest or abs(turn) > sharpest * arc + 1e-9:
                found.append(f"curvature {turn / max(arc, 1e-12):.3f} at ({p.x:.2f}, {p.y:.2f})")
            if abs(part.direction * turn - q.curvature * arc) > 1e-6:
                found.append("the curvature is not that of the poses")
            course = (p.yaw + q.yaw) / 2 + (0.0 if part.direction == 1 else math.pi)
            if abs(math.remainder(math.atan2(q.y - p.y, q.x - p.x) - course, 2 * math.pi)) * way > 1e-6:
                found.append("it slips sideways")
    return found


def _sides(corners: Sequence[Place]) -> Iterator[tuple[Place, Place]]:
    return zip(corners, (*corners[1:], corners[0]), strict=True)


def _within(p: Place, corners: Sequence[Place]) -> bool:
    """Corners counter-clockwise."""
    return all((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) >= 0 for a, b in _sides(corners))


def _from(p: Place, a: Place, b: Place) -> float:
    dx, dy = b[0] - a[0], b[1] - a[1]
    share = max(0.0, min(1.0, ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / (dx * dx + dy * dy)))
    return math.dist(p, (a[0] + share * dx, a[1] + share * dy))


def _apart(a: Place, b: Place, c: Place, d: Place) -> float:
    def side(p: Place, q: Place, r: Place) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    if side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0:
        return 0.0
    return min(_from(a, c, d), _from(b, c, d), _from(c, a, b), _from(d, a, b))
