"""The kinematic bicycle as CasADi expressions: what both solvers have in common.

The discrete model is the midpoint rule over one step; the states are (x, y, yaw, speed, steering), the inputs
acceleration and steering rate, in the units and frame of `targets.car.base.bicycle`.
"""

from __future__ import annotations

from typing import Any

STEPS = 20
STEP = 0.05  # seconds
STATES, INPUTS = 5, 2


def step(state: Any, inputs: Any, wheelbase: Any) -> Any:
    """Return the state one step on, symbolically."""
    import casadi as ca

    def slope(s: Any) -> Any:
        turn = s[3] * ca.tan(s[4]) / wheelbase
        return ca.vertcat(s[3] * ca.cos(s[2]), s[3] * ca.sin(s[2]), turn, inputs[0], inputs[1])

    return state + STEP * slope(state + STEP / 2 * slope(state))
