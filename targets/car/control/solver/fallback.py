"""The same problem for CasADi: what drives when there is no compiler on the robot.

CasADi's `sqpmethod` with `qrqp` (the conic plug-ins daqp and fatrop gave wrong answers) and the Gauss-Newton Hessian,
which is constant, since the cost is a sum of weighted squares of the variables.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from typing import Any

from targets.car.control.solver.model import INPUTS, STATES, STEPS, step
from targets.car.control.solver.problem import INPUT_WEIGHTS, STATE_WEIGHTS, Limits

ITERATIONS = 8  # from a shifted plan it takes one to three
DEFECT = 1e-2  # metres, radians, m/s: a plan whose states do not follow from its inputs closer than this is refused
NEAR = 0.1  # metres, radians, m/s: so far from where the plan before wanted the car it is still the better start
_STRIDE = INPUTS + STATES


class CasadiSolver:
    """`problem.Solver`; about 0.2 s to make, with the import of CasADi. All printing is off.

    CasADi reads and writes arrays of ours: making its matrices of lists would take as long as a third of the solve.
    """

    def __init__(self, limits: Limits) -> None:
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
        """See `problem.Solver`."""
        given, found = self._given, self._found
        given["x0"][:] = self._start(present, wished, inputs)
        given["p"][:] = array("d", [*self._head, *present, *wished])
        try:
            self._run()
            failed = bool(self._buffer.ret())
        except RuntimeError:  # CasADi's, for whatever it finds wrong
            failed = True
        plan, defects = found["x"], found["g"]
        sound = math.isfinite(sum(plan)) and math.isfinite(sum(defects))
        if failed or not sound or max(defects) > DEFECT or min(defects) < -DEFECT:
            for values in (given["lam_x0"], given["lam_g0"]):
                values[:] = array("d", bytes(8 * len(values)))
            plan[:] = array("d", [math.nan] * len(plan))  # near nothing: no start for the next search
            return None
        # The multipliers of this solve, shifted, warm-start the next one.
        given["lam_x0"][:] = _shifted(found["lam_x"], _STRIDE)
        given["lam_g0"][:] = _shifted(found["lam_g"], STATES)
        return [v for k in range(STEPS) for v in plan[_STRIDE * k : _STRIDE * k + INPUTS]]

    def _start(self, present: Sequence[float], wished: Sequence[float], inputs: Sequence[float]) -> array[float]:
        """Where the search begins: with the plan before, shifted, if that has led to about here, else on the path."""
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


def upper_bounds(limits: Limits) -> list[float]:
    """Return the bounds of the program's variables; the lower ones are their negatives."""
    free = [math.inf] * 3
    return [limits.acceleration, limits.steering_rate, *free, limits.speed, limits.steering] * STEPS


def nonlinear_program(method: str, options: dict[str, Any] | None = None) -> Any:
    """Return the problem for CasADi's `nlpsol`. Variables: input, state after it, for each step; parameters: wheelbase,
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
        "qpsol": "qrqp", "hess_lag": hessian, "max_iter": ITERATIONS, "tol_pr": 1e-3, "tol_du": 2e-2,
        "print_header": False, "print_iteration": False, "print_status": False, "print_time": False,
        "error_on_fail": False, "show_eval_warnings": False,
        "qpsol_options": {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False},
    })  # fmt: skip
