"""Kinematic bicycle model as CasADi expressions, from which both solvers are made.

The discrete model applies the midpoint rule over one step. The states are (x, y, yaw, speed, steering), the inputs are
acceleration and steering rate, in the units and frame of `targets.car.base.bicycle`.
"""

from __future__ import annotations

from typing import Any

STEPS = 20  # steps of the horizon
STEP = 0.05  # seconds of one step, also the period of the control loop
STATES, INPUTS = 5, 2  # numbers of states and inputs


def step(state: Any, inputs: Any, wheelbase: Any) -> Any:
    """Return the state after one step, as a CasADi expression."""
    import casadi as ca

    def slope(s: Any) -> Any:
        turn = s[3] * ca.tan(s[4]) / wheelbase
        return ca.vertcat(s[3] * ca.cos(s[2]), s[3] * ca.sin(s[2]), turn, inputs[0], inputs[1])

    return state + STEP * slope(state + STEP / 2 * slope(state))
