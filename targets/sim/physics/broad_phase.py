"""Broad phase: finds the bodies that may touch something soon. All others need no contact engine."""

from __future__ import annotations

import numpy as np

from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Point
from targets.sim.base.bodies import Vector
from targets.sim.physics.rigid import Array, Mask, Motions, total

BROAD_PHASE_PERIOD = 12  # steps
MOST_ACCELERATION = 40.0  # m/s^2, more than motors and gravity give together
MARGIN = 0.05  # m; PyBullet finds contacts at 0.02 or less


class BroadPhase:
    """Obstacles as axis-aligned boxes, each with its obstacle's number; a mesh has one box per triangle."""

    def __init__(self) -> None:
        self._lo = np.zeros((3, 0))
        self._hi = np.zeros((3, 0))
        self._numbers = np.zeros(0, dtype=int)  # obstacle of each box
        self._obstacle_count = 0  # number of obstacles

    def stand(self, obstacle: Obstacle) -> None:
        """Add an obstacle."""
        for lo, hi in _boxes(obstacle):
            self._lo = np.column_stack((self._lo, lo))
            self._hi = np.column_stack((self._hi, hi))
            self._numbers = np.append(self._numbers, self._obstacle_count)
        self._obstacle_count += 1

    def move(self, number: int, by: Vector) -> None:
        """Move an obstacle by a vector (m)."""
        self._lo[:, self._numbers == number] += np.array(by)[:, None]
        self._hi[:, self._numbers == number] += np.array(by)[:, None]

    def to_floor(self, motions: Motions, reach: Array, seconds: float) -> Mask:
        """Return which bodies may reach the floor within `seconds`. `reach`: radius of each body (m)."""
        found: Mask = motions.position[2] < reach + _travel(motions.velocity, seconds)
        return found

    def to_others(self, motions: Motions, reach: Array, seconds: float) -> Mask:
        """Return which bodies may reach an obstacle or another body within `seconds`."""
        position = motions.position
        swept = reach + _travel(motions.velocity, seconds)
        apart = position[:, :, None] - position[:, None, :]
        near = total(apart * apart) < (swept[:, None] + swept[None, :]) ** 2
        np.fill_diagonal(near, False)
        found: Mask = near.any(1)
        if self._lo.size:
            beyond = np.maximum(self._lo[:, None] - position[:, :, None], position[:, :, None] - self._hi[:, None])
            np.maximum(beyond, 0.0, out=beyond)
            found |= (total(beyond * beyond) < (swept * swept)[:, None]).any(1)
        return found


def _travel(velocity: Array, seconds: float) -> Array:
    """Return an upper bound of the distance that each body travels."""
    speed = np.sqrt(total(velocity * velocity))
    found: Array = speed * seconds + (MOST_ACCELERATION * seconds * seconds / 2 + MARGIN)
    return found


def _boxes(obstacle: Obstacle) -> list[tuple[Vector, Vector]]:
    match obstacle:
        case Block(lo, hi):
            return [((lo.x, lo.y, lo.z), (hi.x, hi.y, hi.z))]
        case Sphere(c, r):
            return [((c.x - r, c.y - r, c.z - r), (c.x + r, c.y + r, c.z + r))]
        case Cylinder(b, r, height):
            return [((b.x - r, b.y - r, b.z), (b.x + r, b.y + r, b.z + height))]
        case Mesh(vertices, faces):
            return [_bounding_box([vertices[i] for i in face]) for face in faces]
    raise AssertionError(f"no obstacle: {obstacle}")


def _bounding_box(corners: list[Point]) -> tuple[Vector, Vector]:
    x, y, z = [p.x for p in corners], [p.y for p in corners], [p.z for p in corners]
    return (min(x), min(y), min(z)), (max(x), max(y), max(z))
