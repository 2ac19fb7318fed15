"""MPC solver in C: compiled once on the robot, called by ctypes."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path

from koordgen.runtime.native import loader as native
from koordgen.runtime.native.loader import NotCompiled
from targets.car.control.solver.model import INPUTS, STATES, STEPS
from targets.car.control.solver.problem import INPUT_WEIGHTS, STATE_WEIGHTS, ControlLimits

SOURCE = Path(__file__).with_name("mpc.c")
FLAGS = ("-std=c99", "-O1", "-shared", "-fPIC", "-lm")  # -O3 compiles three times as long and saves 8 %

# Test problem with a known answer: a full stop 0.2 m ahead, from 0.8 m/s with a yaw error of 0.1 rad. PROBE_ANSWER is
# the first acceleration (m/s^2) and steering rate (rad/s) that CasADi with IPOPT finds.
PROBE_LIMITS = ControlLimits(wheelbase=0.33, speed=1.0, acceleration=1.5, steering=0.4, steering_rate=3.0)
PROBE_STATE = (0.0, 0.0, 0.1, 0.8, 0.0)
PROBE_WISHED = (0.2, 0.0, 0.0, 0.0, 0.0)
PROBE_ANSWER = (-1.5, -2.2148)
PROBE_TOLERANCE = 0.01


class CompiledSolver:
    """Solver in a library compiled from mpc.c: implements `problem.Solver`."""

    def __init__(self, library: ctypes.CDLL, limits: ControlLimits) -> None:
        self._solve = library.mpc_solve
        self._solve.restype = ctypes.c_double
        self._head = [
            limits.wheelbase, limits.acceleration, limits.steering_rate, limits.speed, limits.steering,
            *STATE_WEIGHTS, *INPUT_WEIGHTS,
        ]  # fmt: skip
        self._problem = (ctypes.c_double * (len(self._head) + STATES * (1 + STEPS)))()
        self._inputs = (ctypes.c_double * (INPUTS * STEPS))()
        self._states = (ctypes.c_double * (STATES * STEPS))()
        self.effort = (ctypes.c_int * 2)()

    def __call__(
        self, present: Sequence[float], wished: Sequence[float], inputs: Sequence[float]
    ) -> list[float] | None:
        """Implement `problem.Solver`."""
        self._problem[:] = [*self._head, *present, *wished]
        self._inputs[:] = [*inputs]
        cost = self._solve(self._problem, self._inputs, self._states, self.effort)
        return self._inputs[:] if cost >= 0 else None


def load(limits: ControlLimits, cache: Path | None = None) -> CompiledSolver:
    """Return the solver, from the cache of compiled libraries or newly compiled. Raises NotCompiled."""
    return CompiledSolver(native.load(SOURCE, FLAGS, _prove, cache), limits)


def _prove(library: ctypes.CDLL) -> None:
    answer = CompiledSolver(library, PROBE_LIMITS)(PROBE_STATE, PROBE_WISHED * STEPS, [0.0] * INPUTS * STEPS)
    if answer is None or not all(abs(answer[i] - PROBE_ANSWER[i]) <= PROBE_TOLERANCE for i in range(INPUTS)):
        raise NotCompiled("the compiled solver gives a wrong answer to a known problem")
