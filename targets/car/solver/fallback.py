"""The same problem for CasADi: what drives when there is no compiler on the robot.

CasADi's `sqpmethod` with `qrqp` (the conic plug-ins daqp and fatrop gave wrong answers) and the Gauss-Newton Hessian,
which is constant, since the cost is a sum of weighted squares of the variables.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from targets.car.solver.model import INPUTS, STATES, STEPS, step
from targets.car.solver.problem import INPUT_WEIGHTS, STATE_WEIGHTS, Limits

ITERATIONS = 8  # from a shifted plan it takes one to three
DEFECT = 1e-2  # metres, radians, m/s: a plan whose states do not follow from its inputs closer than this is refused
_STRIDE = INPUTS + STATES


class CasadiSolver:
    """`problem.Solver`; about 0.2 s to make, with the import of CasADi. All printing is off."""

    def __init__(self, limits: Limits) -> None:
        import casadi as ca

        self._wheelbase = limits.wheelbase
        self._nlp = nonlinear_program("sqpmethod")
        self._most = ca.DM(upper_bounds(limits))
        self._last: dict[str, Any] = {}  # the multipliers of the last solve warm-start the next one

    def __call__(
        self, present: Sequence[float], wished: Sequence[float], inputs: Sequence[float]
    ) -> list[float] | None:
        """See `problem.Solver`."""
        import casadi as ca

        start: list[float] = []
        for k in range(STEPS):
            start += inputs[INPUTS * k : INPUTS * (k + 1)]
            start += wished[STATES * k : STATES * (k + 1)]
        parameters = [self._wheelbase, *STATE_WEIGHTS, *INPUT_WEIGHTS, *present, *wished]
        try:
            found = self._nlp(x0=start, p=parameters, lbx=-self._most, ubx=self._most, lbg=0, ubg=0, **self._last)
        except RuntimeError:  # CasADi's, for whatever it finds wrong
            found = None
        if found is None or not float(ca.mmax(ca.fabs(found["g"]))) <= DEFECT:
            self._last = {}
            return None
        self._last = {"lam_x0": found["lam_x"], "lam_g0": found["lam_g"]}
        plan = found["x"].elements()
        return [v for k in range(STEPS) for v in plan[_STRIDE * k : _STRIDE * k + INPUTS]]


def upper_bounds(limits: Limits) -> list[float]:
    """The bounds of the program's variables; the lower ones are their negatives."""
    free = [math.inf] * 3
    return [limits.acceleration, limits.steering_rate, *free, limits.speed, limits.steering] * STEPS


def nonlinear_program(method: str, options: dict[str, Any] | None = None) -> Any:
    """The problem for CasADi's `nlpsol`. Variables: input, state after it, for each step; parameters: wheelbase,
    weights of states and of inputs, present state, wished states; constraints: the defects, which are 0."""
    import casadi as ca

    states, actions = ca.SX.sym("states", STATES, STEPS), ca.SX.sym("actions", INPUTS, STEPS)
    present, wished = ca.SX.sym("present", STATES), ca.SX.sym("wished", STATES, STEPS)
    wheelbase, weights, prices = ca.SX.sym("wheelbase"), ca.SX.sym("weights", STATES), ca.SX.sym("prices", INPUTS)
    variables, defects = [], []
    cost, before = ca.SX(0), present
    for k in range(STEPS):
        error = states[:, k] - wished[:, k]
        cost += ca.dot(weights, error * error) + ca.dot(prices, actions[:, k] * actions[:, k])
        defects.append(states[:, k] - step(before, actions[:, k], wheelbase))
        variables += [actions[:, k], states[:, k]]
        before = states[:, k]
    x, g = ca.vertcat(*variables), ca.vertcat(*defects)
    p = ca.vertcat(wheelbase, weights, prices, present, ca.vec(wished))
    problem = {"x": x, "p": p, "f": cost, "g": g}
    if method != "sqpmethod":
        return ca.nlpsol("mpc", method, problem, options or {})
    factor, multipliers = ca.SX.sym("factor"), ca.SX.sym("multipliers", g.numel())
    hessian = ca.Function(
        "hessian", [x, p, factor, multipliers], [ca.diag(2 * factor * ca.vertcat(*[prices, weights] * STEPS))],
        ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"],
    )  # fmt: skip
    return ca.nlpsol("mpc", method, problem, {
        "qpsol": "qrqp", "hess_lag": hessian, "max_iter": ITERATIONS, "tol_pr": 1e-4, "tol_du": 1e-2,
        "print_header": False, "print_iteration": False, "print_status": False, "print_time": False,
        "error_on_fail": False, "show_eval_warnings": False,
        "qpsol_options": {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False},
    })  # fmt: skip
