"""Rigid bodies in arrays: states of many bodies, their integration, and rotations.

Arrays are component first: (3, n) for vectors, (4, n) for quaternions (x, y, z, w), so a component of all bodies is one
row. A call of numpy costs about as much as the arithmetic of a hundred bodies. So an expression with many terms (a
rotation matrix, a quaternion's rate) is one product of a constant matrix with all products of two components."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Motions:
    """Motions of n bodies in the world frame.

    Centre of mass (m), orientation, velocity (m/s), spin (rad/s).

    The arrays are changed in place."""

    position: Array
    orientation: Array
    velocity: Array
    spin: Array

    @staticmethod
    def still(count: int) -> Motions:
        """Return motions at the origin, without rotation and at rest."""
        orientation = np.zeros((4, count))
        orientation[3] = 1.0
        return Motions(np.zeros((3, count)), orientation, np.zeros((3, count)), np.zeros((3, count)))

    def part(self, first: int, end: int) -> Motions:
        """Return a view of some of the bodies."""
        rows = slice(first, end)
        return Motions(
            self.position[:, rows], self.orientation[:, rows], self.velocity[:, rows], self.spin[:, rows]
        )  # fmt: skip


total = np.add.reduce  # over the first axis; takes half the time of `sum` for arrays of this size


def advance(motions: Motions, seconds: float) -> None:
    """Integrate positions and orientations by velocities and spins.

    With the velocities at the step's end this is the semi-implicit Euler method, as in the contact engines."""
    position = motions.position
    position += motions.velocity * seconds
    turn(motions.orientation, motions.spin, seconds)


def turn(orientation: Array, spin: Array, seconds: float) -> None:
    """Integrate orientations: q += seconds / 2 (spin, 0) q, then normalise."""
    products = (spin[:, None] * orientation[None]).reshape(12, -1)
    orientation += (_RATE * (seconds / 2)) @ products
    orientation /= np.sqrt(total(orientation * orientation))


def rotations(orientation: Array) -> Array:
    """Return the rotation matrices from body to world, (3, 3, n), of unit quaternions."""
    products = (orientation[:, None] * orientation[None]).reshape(16, -1)
    return (_MATRIX @ products).reshape(3, 3, -1)


def yaws(orientation: Array) -> Array:
    """Return the direction of each body's x axis seen from above (rad)."""
    x, y, z, w = orientation
    found: Array = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    return found


def _matrix() -> Array:
    """Return each entry of the rotation matrix as a form in the products of two components of x, y, z, w."""
    table = np.zeros((3, 3, 4, 4))
    x, y, z, w = range(4)
    for i, (a, b, c) in enumerate(((x, y, z), (y, z, x), (z, x, y))):
        j, k = (i + 1) % 3, (i + 2) % 3
        table[i, i, w, w] = table[i, i, a, a] = 1.0
        table[i, i, b, b] = table[i, i, c, c] = -1.0
        table[i, j, a, b], table[i, j, c, w] = 2.0, -2.0
        table[i, k, a, c], table[i, k, b, w] = 2.0, 2.0
    return table.reshape(9, 16)


def _rate() -> Array:
    """Return the product (spin, 0) q as a form in the products of a component of the spin and one of q."""
    table = np.zeros((4, 3, 4))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        table[i, i, 3] = table[i, j, k] = 1.0
        table[i, k, j] = -1.0
        table[3, i, i] = -1.0
    return table.reshape(4, 12)


_MATRIX, _RATE = _matrix(), _rate()
