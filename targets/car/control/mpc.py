"""Model-predictive control of the kinematic bicycle: a small optimisation problem, solved at every control step.

The horizon is 20 steps of 50 ms. Module `solver.problem` defines the problem; this module chooses the solver. Speed and
steering of the initial state are the last commanded values, not measured ones, because drive and servo follow
setpoints.

This module integrates the solver's inputs within the limits to get the commands. So whatever inputs a solver returns,
each command is reachable from the previous command.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from koordgen.runtime.native.loader import NotCompiled
from targets.car.base.bicycle import BicycleState
from targets.car.control.solver import compiled
from targets.car.control.solver.fallback import CasadiSolver
from targets.car.control.solver.model import INPUTS, STEP, STEPS
from targets.car.control.solver.problem import ControlLimits, Solver

__all__ = ["BLIND_STEPS", "STEP", "STEPS", "Command", "ControlLimits", "Mpc"]

BLIND_STEPS = 5  # control steps without a new plan for which the last plan is used; after that, the car brakes
LATE = STEP  # seconds; a plan that took longer to compute is discarded, because its initial state is outdated


@dataclass(frozen=True, slots=True)
class Command:
    """Command for one control step: speed in m/s (negative in reverse), steering in radians (positive to the left).

    Both are finite and within the limits."""

    speed: float
    steering: float


def choose(limits: ControlLimits, cache: Path | None = None) -> tuple[Solver, str]:
    """Return the C solver and ""; if it cannot be compiled, the CasADi solver and a log line with the reason.

    At the first start on a robot, this compiles the solver, which takes some seconds."""
    try:
        return compiled.load(limits, cache), ""
    except NotCompiled as error:
        return CasadiSolver(limits), f"the controller runs in CasADi, which takes several times longer: {error}"


class Mpc:
    """Model-predictive controller of one car.

    `failures`: number of successive control steps without a usable plan.
    `trouble`: reason why the last step had no usable plan; "" if it had one.
    `note`: reason why the slower CasADi solver is used; "" if the C solver is used.
    `solver`, `clock`: replaced in tests; the clock (s) measures the solver's run time.
    """

    def __init__(
        self, limits: ControlLimits, solver: Solver | None = None, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self._limits = limits
        self._solve, self.note = (solver, "") if solver is not None else choose(limits)
        self._clock = clock
        self._inputs = [0.0] * INPUTS * STEPS
        self._plan: list[Command] = []
        self._last = Command(0.0, 0.0)
        self.failures = 0
        self.trouble = ""

    def warm_up(self) -> None:
        """Solve once in advance, because the first solve allocates, and would be too slow for a control step."""
        self.follow(BicycleState(0.0, 0.0, 0.0), [BicycleState(0.0, 0.0, 0.0)] * STEPS)
        self.reset()

    def reset(self) -> None:
        """Drop the plan, because the car has been stopped by other means."""
        self._inputs = [0.0] * INPUTS * STEPS
        self._plan = []
        self._last = Command(0.0, self._last.steering)
        self.failures = 0

    def follow(self, state: BicycleState, reference: Sequence[BicycleState]) -> Command:
        """Return the command of the next control step.

        `state`: pose of the car, with the speed and steering commanded last.
        `reference`: desired states after 1 to 20 steps; their yaw is continuous with the car's yaw.

        If there is no new plan in time, the last plan is shifted and used for up to BLIND_STEPS steps; after that, the
        car brakes.
        """
        before = self._last
        if math.isfinite(state.speed) and math.isfinite(state.steering):
            before = Command(_clamp(state.speed, self._limits.speed), _clamp(state.steering, self._limits.steering))
        began = self._clock()
        inputs, trouble = self._attempt(state, before, reference)
        spent = self._clock() - began
        if inputs is not None and spent > LATE:
            inputs, trouble = None, f"the solver took {1e3 * spent:.0f} ms, {1e3 * LATE:.0f} ms are allowed"
        self.trouble = trouble
        if inputs is None:
            self.failures += 1
            self._plan = self._plan[1:] if self.failures <= BLIND_STEPS else []
            self._inputs = _shifted(self._inputs)
        else:
            self.failures = 0
            self._plan, self._inputs = self._commands(before, inputs), inputs
        self._last = self._within_reach(before, self._plan[0] if self._plan else Command(0.0, before.steering))
        return self._last

    def _attempt(
        self, state: BicycleState, before: Command, reference: Sequence[BicycleState]
    ) -> tuple[list[float] | None, str]:
        """Return the inputs of a new plan and "", or None and the reason why there is no plan, in words."""
        if not state.finite():
            return None, "the car's state is not finite"
        if len(reference) != STEPS or not all(r.finite() for r in reference):
            return None, "the path's reference states are not finite"
        present = (state.x, state.y, state.yaw, before.speed, before.steering)
        wished = [v for r in reference for v in (r.x, r.y, r.yaw, r.speed, r.steering)]
        inputs = self._solve(present, wished, _shifted(self._inputs))
        if inputs is None or not all(map(math.isfinite, inputs)):
            return None, "the solver finds no plan to follow the path"
        return inputs, ""

    def _commands(self, before: Command, inputs: list[float]) -> list[Command]:
        """Return the commands that result from the inputs; each command is reachable from the previous command."""
        plan = []
        for k in range(STEPS):
            wished = Command(before.speed + STEP * inputs[2 * k], before.steering + STEP * inputs[2 * k + 1])
            before = self._within_reach(before, wished)
            plan.append(before)
        return plan

    def _within_reach(self, before: Command, wished: Command) -> Command:
        """Return the command nearest to `wished` that the limits allow after the command `before`."""
        limits = self._limits
        faster, further = limits.acceleration * STEP, limits.steering_rate * STEP
        return Command(
            _clamp(before.speed + _clamp(wished.speed - before.speed, faster), limits.speed),
            _clamp(before.steering + _clamp(wished.steering - before.steering, further), limits.steering),
        )


def _shifted(inputs: list[float]) -> list[float]:
    return [*inputs[INPUTS:], *[0.0] * INPUTS]


def _clamp(value: float, most: float) -> float:
    return max(-most, min(most, value))
