"""MPC solver with CasADi, for robots without a C compiler.

It uses CasADi's `sqpmethod` with the QP solver `qrqp`; the plug-ins daqp and fatrop gave wrong answers. The solver uses
the Gauss-Newton Hessian, which is constant because the cost is a sum of weighted squares of the variables.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from typing import Any

from targets.car.control.solver.model import INPUTS, STATES, STEPS, step
from targets.car.control.solver.problem import INPUT_WEIGHTS, STATE_WEIGHTS, ControlLimits

ITERATIONS = 8  # maximum SQP iterations; from a shifted plan, one to three suffice
DEFECT = 1e-2  # metres, radians, m/s; maximum difference of a plan's states from the states that its inputs lead to

# Metres, radians, m/s. If the last plan predicted the present state within this tolerance, it is the initial guess.
NEAR = 0.1
_STRIDE = INPUTS + STATES


class CasadiSolver:
    """Solver with CasADi: implements `problem.Solver`. Creation takes about 0.2 s, with the import of CasADi.

    CasADi reads and writes preallocated arrays. Creating its matrices from lists would take a third of the solve time.
    """

    def __init__(self, limits: ControlLimits) -> None:
        nlp = nonlinear_program("sqpmethod")
        most = upper_bounds(limits)
        self._head = [limits.wheelbase, *STATE_WEIGHTS, *INPUT_WEIGHTS]
        self._given = {name: array("d", bytes(8 * nlp.nnz_in(name))) for name in nlp.name_in()}
        self._found = {name: array("d", bytes(8 * nlp.nnz_out(name))) for name in nlp.name_out()}
        self._given["lbx"][:] = array("d", [-m for m in most])
        self._given["ubx"][:] = array("d", most)
        self._buffer, self._run = nlp.buffer()
        for i, name in enumerate(nlp.name_in()):
            self._buffer.set_arg(i, memoryview(self._given[name]))
        for i, name in enumerate(nlp.name_out()):
            self._buffer.set_res(i, memoryview(self._found[name]))

    def __call__(
        self, present: Sequence[float], wished: Sequence[float], inputs: Sequence[float]
    ) -> list[float] | None:
        """Implement `problem.Solver`."""
        given, found = self._given, self._found
        given["x0"][:] = self._start(present, wished, inputs)
        given["p"][:] = array("d", [*self._head, *present, *wished])
        try:
            self._run()
            failed = bool(self._buffer.ret())
        except RuntimeError:  # CasADi raises RuntimeError for every error
            failed = True
        plan, defects = found["x"], found["g"]
        sound = math.isfinite(sum(plan)) and math.isfinite(sum(defects))
        if failed or not sound or max(defects) > DEFECT or min(defects) < -DEFECT:
            for values in (given["lam_x0"], given["lam_g0"]):
                values[:] = array("d", bytes(8 * len(values)))
            plan[:] = array("d", [math.nan] * len(plan))  # NaN, so that `_start` does not use this plan
            return None
        # The shifted multipliers of this solution are the initial guess of the next one.
        given["lam_x0"][:] = _shifted(found["lam_x"], _STRIDE)
        given["lam_g0"][:] = _shifted(found["lam_g"], STATES)
        return [v for k in range(STEPS) for v in plan[_STRIDE * k : _STRIDE * k + INPUTS]]

    def _start(self, present: Sequence[float], wished: Sequence[float], inputs: Sequence[float]) -> array[float]:
        """Return the initial guess: the shifted last plan if it predicted the present state (NEAR), else the path."""
        plan = self._found["x"]
        if all(abs(a - b) <= NEAR for a, b in zip(plan[INPUTS:_STRIDE], present, strict=True)):
            return _shifted(plan, _STRIDE)
        start: list[float] = []
        for k in range(STEPS):
            start += inputs[INPUTS * k : INPUTS * (k + 1)]
            start += wished[STATES * k : STATES * (k + 1)]
        return array("d", start)


def _shifted(values: array[float], stride: int) -> array[float]:
    """Return the sequence shifted by one step; the last element is repeated."""
    return values[stride:] + values[-stride:]


def upper_bounds(limits: ControlLimits) -> list[float]:
    """Return the upper bounds of the program's variables; the lower bounds are their negatives."""
    free = [math.inf] * 3
    return [limits.acceleration, limits.steering_rate, *free, limits.speed, limits.steering] * STEPS


def nonlinear_program(method: str, options: dict[str, Any] | None = None) -> Any:
    """Return the problem for CasADi's `nlpsol`.

    Variables: for each step, the input and the state after it.
    Parameters: wheelbase, weights of states and of inputs, present state, wished states.
    Constraints: the defects (state minus the model's prediction) are 0."""
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
        "qpsol": "qrqp", "hess_lag": hessian, "max_iter": ITERATIONS, "tol_pr": 1e-3, "tol_du": 2e-2,
        "print_header": False, "print_iteration": False, "print_status": False, "print_time": False,
        "error_on_fail": False, "show_eval_warnings": False,
        "qpsol_options": {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False},
    })  # fmt: skip
