"""What four tyres do to a car in one step: two axles, each held to where its wheels roll, by no more than friction.

The wheels of each axle hold the body's velocity there to their own direction, and along it to their own speed. The
forces of both axles that do so within the step are found by projected Gauss-Seidel, each axle's kept within its
friction circle (Coulomb: friction times load; the load is half the weight, nothing is shifted by acceleration). So a
car within its limits follows the kinematic bicycle exactly, one that is too fast for its curve is pushed wide, and one
that brakes too hard slides. Sequential impulses: E. Catto, Iterative Dynamics with Temporal Coherence (2005).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_ROUNDS = 6  # far more than needed: for a body like this the two axles hardly disturb each other


@dataclass(frozen=True, slots=True)
class Chassis:
    """Mass (kg), inertia about the vertical (kg m^2), distance of each axle from the centre of mass (m), and the most
    impulse (N s) that one axle's tyres give in one step."""

    mass: float
    inertia: float
    reach: float
    most: float


def impulses(
    chassis: Chassis, velocity: tuple[float, float], spin: float, speed: float, steering: float
) -> tuple[float, float, float]:
    """Impulses of one step in the body's frame: forward, to the left (N s), and about the vertical (N m s).
    `velocity` is that of the centre of mass, forward and to the left (m/s), `spin` in rad/s; `speed` is that of the
    rear wheels (m/s), `steering` the front wheels' angle (rad, positive to the left). All wheels are driven."""
    u, w = velocity
    m, inertia, reach = chassis.mass, chassis.inertia, chassis.reach
    cos, sin = math.cos(steering), math.sin(steering)
    # Axle by axle: its lever arm, the direction its wheels roll in, their speed.
    axles = ((-reach, 1.0, 0.0, speed), (reach, cos, sin, speed / cos))
    along, across = [0.0, 0.0], [0.0, 0.0]
    for _ in range(_ROUNDS):
        for k, (arm, dx, dy, rolling) in enumerate(axles):
            old = along[k], across[k]
            # Half the error along is this axle's part, or both would mend it.
            slip = rolling - (u * dx + (w + spin * arm) * dy)
            along[k] += 0.5 * slip / (1.0 / m + (arm * dy) ** 2 / inertia)
            slide = u * -dy + (w + spin * arm) * dx
            across[k] -= slide / (1.0 / m + (arm * dx) ** 2 / inertia)
            share = min(1.0, chassis.most / max(math.hypot(along[k], across[k]), 1e-12))
            along[k], across[k] = along[k] * share, across[k] * share
            fore, side = along[k] - old[0], across[k] - old[1]
            x, y = fore * dx - side * dy, fore * dy + side * dx
            u, w, spin = u + x / m, w + y / m, spin + arm * y / inertia
    forward = sum(p * dx - q * dy for p, q, (_, dx, dy, _) in zip(along, across, axles, strict=True))
    left = [p * dy + q * dx for p, q, (_, dx, dy, _) in zip(along, across, axles, strict=True)]
    return forward, left[0] + left[1], reach * (left[1] - left[0])
