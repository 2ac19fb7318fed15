"""Model-predictive control of the kinematic bicycle: one small optimisation, solved again at every control step.

Horizon 20 steps of 50 ms, multiple shooting, midpoint rule; states (x, y, yaw, speed, steering), inputs acceleration
and steering rate. Speed and steering are what was commanded, not measured: the drive and the servo follow setpoints.
The cost is quadratic in the variables, so its constant Hessian is the Gauss-Newton one; CasADi's `sqpmethod` with
`qrqp` (the conic plug-ins daqp and fatrop gave wrong answers) starts from the plan of the step before.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from targets.car.bicycle import State

STEPS = 20
STEP = 0.05  # seconds
STATE_WEIGHTS = (100.0, 100.0, 1.0, 1.0, 0.1)  # x, y, yaw, speed, steering
INPUT_WEIGHTS = (0.02, 0.02)  # acceleration, steering rate
ITERATIONS = 8  # from a shifted plan it takes one to three
DEFECT = 1e-2  # metres, radians, m/s: a plan whose states do not follow from its inputs closer than this is refused
BLIND_STEPS = 5  # so long the plan before stands in when the solver fails
_STRIDE = len(STATE_WEIGHTS) + len(INPUT_WEIGHTS)

Solver = Callable[[list[float], list[float]], "tuple[list[float], float]"]


@dataclass(frozen=True, slots=True)
class Limits:
    """What a car can do: metres, m/s (both directions), m/s^2, radians, rad/s."""

    wheelbase: float
    speed: float
    acceleration: float
    steering: float
    steering_rate: float


@dataclass(frozen=True, slots=True)
class Command:
    """What to drive in the next step: speed in m/s (negative is reverse), steering in radians (positive to the left).
    Always finite and within the limits."""

    speed: float
    steering: float


class Mpc:
    """Steers along references. `failures` counts solves that gave nothing usable since the last that did; `solver`
    (parameters and start to plan and largest defect) is replaced in tests only."""

    def __init__(self, limits: Limits, solver: Solver | None = None) -> None:
        self._limits = limits
        self._solve = solver if solver is not None else build(limits)
        self._plan: list[float] = []
        self.failures = 0

    def warm_up(self) -> None:
        """Solve once for nothing: a first solve allocates, which a control step has no time for."""
        self.follow(State(0.0, 0.0, 0.0), [State(0.0, 0.0, 0.0)] * STEPS)
        self.reset()

    def reset(self) -> None:
        """Forget the plan: the car has been stopped by other means."""
        self._plan = []
        self.failures = 0

    def follow(self, state: State, reference: Sequence[State]) -> Command:
        """The command of the next step towards `reference`, the states wished for after 1 to 20 steps, whose yaw runs
        on from the car's without jumps. `state.speed` and `state.steering` are what was commanded last.

        When the solver fails, the plan before, shifted, stands in for a few steps; then the car brakes.
        """
        limits = self._limits
        if state.finite():  # a clamped NaN would look like full speed
            speed, steering = _clamp(state.speed, limits.speed), _clamp(state.steering, limits.steering)
            state = State(state.x, state.y, state.yaw, speed, steering)
        plan = self._attempt(state, reference)
        if plan is None:
            self.failures += 1
            plan = self._plan[_STRIDE:] if self.failures <= BLIND_STEPS else []
        else:
            self.failures = 0
        self._plan = plan
        if not plan:
            return self._braking(state)
        return Command(_clamp(plan[_STRIDE + 3], limits.speed), _clamp(plan[_STRIDE + 4], limits.steering))

    def _attempt(self, state: State, reference: Sequence[State]) -> list[float] | None:
        """A plan that may be driven, or None."""
        if not state.finite() or len(reference) != STEPS or not all(r.finite() for r in reference):
            return None
        present = _values(state)
        shifted = self._plan[_STRIDE:]
        if len(shifted) == STEPS * _STRIDE - 2:
            start = [*present, *shifted[5:], 0.0, 0.0, *shifted[-5:]]
        else:
            start = [*present, *(v for r in reference for v in (0.0, 0.0, *_values(r)))]
        try:
            plan, defect = self._solve([*present, *(v for r in reference for v in _values(r))], start)
        except RuntimeError:  # CasADi's, for whatever it finds wrong
            return None
        if not defect <= DEFECT or not all(map(math.isfinite, plan)):
            return None
        reach = self._limits
        change = STEP * 1.05  # rounding, and the solver's own tolerance
        if (
            abs(plan[_STRIDE + 3] - state.speed) > reach.acceleration * change + 1e-3
            or abs(plan[_STRIDE + 4] - state.steering) > reach.steering_rate * change + 1e-3
        ):
            return None
        return plan

    def _braking(self, state: State) -> Command:
        if not (math.isfinite(state.speed) and math.isfinite(state.steering)):
            return Command(0.0, 0.0)
        limits = self._limits
        speed = _clamp(state.speed, limits.speed)
        slower = max(0.0, abs(speed) - limits.acceleration * STEP)
        return Command(math.copysign(slower, speed), _clamp(state.steering, limits.steering))


def build(limits: Limits) -> Solver:
    """Build the solver: about 0.2 s with the import of CasADi. All printing is off."""
    import casadi as ca

    state, inputs = ca.SX.sym("state", 5), ca.SX.sym("inputs", 2)

    def slope(s: Any) -> Any:
        turn = s[3] * ca.tan(s[4]) / limits.wheelbase
        return ca.vertcat(s[3] * ca.cos(s[2]), s[3] * ca.sin(s[2]), turn, inputs[0], inputs[1])

    step = ca.Function("step", [state, inputs], [state + STEP * slope(state + STEP / 2 * slope(state))])
    states, actions = ca.SX.sym("states", 5, STEPS + 1), ca.SX.sym("actions", 2, STEPS)
    present, wished = ca.SX.sym("present", 5), ca.SX.sym("wished", 5, STEPS)
    weights, prices = ca.DM(STATE_WEIGHTS), ca.DM(INPUT_WEIGHTS)
    variables, defects = [states[:, 0]], [states[:, 0] - present]
    cost = ca.SX(0)
    for k in range(STEPS):
        error = states[:, k + 1] - wished[:, k]
        cost += ca.dot(weights, error * error) + ca.dot(prices, actions[:, k] * actions[:, k])
        defects.append(states[:, k + 1] - step(states[:, k], actions[:, k]))
        variables += [actions[:, k], states[:, k + 1]]
    x, p, g = ca.vertcat(*variables), ca.vertcat(present, ca.vec(wished)), ca.vertcat(*defects)
    factor, multipliers = ca.SX.sym("factor"), ca.SX.sym("multipliers", g.numel())
    curvature = ca.vertcat(ca.DM.zeros(5), *[prices, weights] * STEPS)
    hessian = ca.Function(
        "hessian", [x, p, factor, multipliers], [ca.diag(2 * factor * curvature)],
        ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"],
    )  # fmt: skip
    nlp = ca.nlpsol("mpc", "sqpmethod", {"x": x, "p": p, "f": cost, "g": g}, {
        "qpsol": "qrqp", "hess_lag": hessian, "max_iter": ITERATIONS, "tol_pr": 1e-4, "tol_du": 1e-2,
        "print_header": False, "print_iteration": False, "print_status": False, "print_time": False,
        "error_on_fail": False, "show_eval_warnings": False,
        "qpsol_options": {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False},
    })  # fmt: skip
    free = [math.inf] * 3
    most = ca.DM([*free, math.inf, math.inf] + [
        limits.acceleration, limits.steering_rate, *free, limits.speed, limits.steering] * STEPS)  # fmt: skip
    # The multipliers of the last solve warm-start the next one.
    last: dict[str, Any] = {"lam_x0": 0, "lam_g0": 0}

    def solve(parameters: list[float], start: list[float]) -> tuple[list[float], float]:
        found = nlp(x0=start, p=parameters, lbx=-most, ubx=most, lbg=0, ubg=0, **last)
        defect = float(ca.mmax(ca.fabs(found["g"])))
        sound = defect <= DEFECT
        last.update(lam_x0=found["lam_x"] if sound else 0, lam_g0=found["lam_g"] if sound else 0)
        return found["x"].elements(), defect

    return solve


def _values(state: State) -> tuple[float, float, float, float, float]:
    return (state.x, state.y, state.yaw, state.speed, state.steering)


def _clamp(value: float, most: float) -> float:
    return max(-most, min(most, value))
