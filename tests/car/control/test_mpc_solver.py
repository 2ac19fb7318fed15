"""The two solvers beside each other: the same plans, drivable ones, by C and by CasADi."""

from __future__ import annotations

import math
import random

import pytest

from targets.car.base.bicycle import BicycleState, advance
from targets.car.control.solver import compiled
from targets.car.control.solver.fallback import CasadiSolver
from targets.car.control.solver.model import STEP, STEPS
from targets.car.control.solver.problem import INPUT_WEIGHTS, STATE_WEIGHTS, ControlLimits

ROLLING = [0.0] * 2 * STEPS  # inputs: no change of speed and steering
Five = tuple[float, float, float, float, float]


def some_car(dice: random.Random) -> ControlLimits:
    return ControlLimits(
        dice.uniform(0.2, 0.6), dice.uniform(0.5, 3), dice.uniform(1, 5), dice.uniform(0.2, 0.6), dice.uniform(1, 6)
    )


def problem(dice: random.Random, limits: ControlLimits, spread: float) -> tuple[Five, list[float]]:
    """A car somewhere, `spread` metres and twice as many radians beside a path of changing curvature: state, wishes."""
    x, y, yaw = dice.uniform(-50, 50), dice.uniform(-50, 50), dice.uniform(-6, 6)
    speed, steering = dice.uniform(-0.9, 0.9) * limits.speed, dice.uniform(-0.9, 0.9) * limits.steering
    pace = max(-limits.speed, min(limits.speed, speed + dice.uniform(-0.2, 0.2)))
    at = BicycleState(x + dice.gauss(0, spread), y + dice.gauss(0, spread), yaw + dice.gauss(0, 2 * spread), pace)
    bend, wished = dice.uniform(-0.9, 0.9) * limits.steering, []
    for k in range(STEPS):
        at = BicycleState(at.x, at.y, at.yaw, at.speed, bend * math.sin(k / 6))
        at = advance(at, STEP, limits.wheelbase)
        wished += [at.x, at.y, at.yaw, at.speed, at.steering]
    return (x, y, yaw, speed, steering), wished


def step(state: Five, inputs: tuple[float, float], wheelbase: float) -> Five:
    """The midpoint rule, written down once more."""

    def slope(s: Five) -> Five:
        return (s[3] * math.cos(s[2]), s[3] * math.sin(s[2]), s[3] * math.tan(s[4]) / wheelbase, *inputs)

    def moved(by: Five, seconds: float) -> Five:
        a, b, c, d, e = (v + seconds * w for v, w in zip(state, by, strict=True))
        return (a, b, c, d, e)

    return moved(slope(moved(slope(state), STEP / 2)), STEP)


def cost(limits: ControlLimits, state: Five, wished: list[float], plan: list[float], slack: float = 1e-4) -> float:
    """Of a plan that keeps the limits, but for `slack`."""
    total = 0.0
    for k in range(STEPS):
        inputs = (plan[2 * k], plan[2 * k + 1])
        state = step(state, inputs, limits.wheelbase)
        assert abs(inputs[0]) <= limits.acceleration + slack and abs(inputs[1]) <= limits.steering_rate + slack
        assert abs(state[3]) <= limits.speed + slack and abs(state[4]) <= limits.steering + slack
        total += sum(w * u * u for w, u in zip(INPUT_WEIGHTS, inputs, strict=True))
        target = wished[5 * k : 5 * k + 5]
        total += sum(w * (a - b) ** 2 for w, a, b in zip(STATE_WEIGHTS, state, target, strict=True))
    return total


@pytest.mark.parametrize(("spread", "seed"), [(0.0, 1), (0.02, 2), (0.05, 3)])
def test_near_the_path_both_solvers_give_the_same_command(spread: float, seed: int) -> None:
    dice = random.Random(seed)
    for _ in range(12):
        limits = some_car(dice)
        in_c, in_casadi = compiled.load(limits), CasadiSolver(limits)
        for _ in range(10):
            state, wished = problem(dice, limits, spread)
            ours, first = in_c(state, wished, ROLLING), in_casadi(state, wished, ROLLING)
            assert ours is not None and first is not None
            theirs = in_casadi(state, wished, first)  # once more: its tolerance is coarse
            assert theirs is not None
            speed, steering = (abs(a - b) * STEP for a, b in zip(ours[:2], theirs[:2], strict=True))
            assert speed < 2e-3 and steering < 2e-3  # m/s, rad
            assert cost(limits, state, wished, ours) <= cost(limits, state, wished, theirs) * 1.001 + 1e-3


@pytest.mark.parametrize("spread", [0.3, 3.0, 300.0])
def test_far_from_the_path_the_plan_in_c_is_drivable_and_better_than_rolling_on(spread: float) -> None:
    dice = random.Random(4)
    for _ in range(60):
        limits = some_car(dice)
        state, wished = problem(dice, limits, spread)
        solver = compiled.load(limits)
        plan = solver(state, wished, ROLLING)
        assert plan is not None
        assert cost(limits, state, wished, plan) < cost(limits, state, wished, ROLLING)
        assert solver.effort[1] <= 100, "its time is bounded"


def test_a_guess_that_cannot_be_driven_still_leads_to_a_plan_that_can() -> None:
    dice = random.Random(7)
    for _ in range(60):
        limits = some_car(dice)
        state, wished = problem(dice, limits, dice.choice([0.02, 30.0]))
        plan = compiled.load(limits)(state, wished, [dice.gauss(0.0, 100.0) for _ in ROLLING])
        assert plan is not None
        cost(limits, state, wished, plan, 1e-9)


def test_far_from_the_path_c_finds_what_casadi_finds() -> None:
    dice, worse = random.Random(5), 0
    for _ in range(10):
        limits = some_car(dice)
        in_c, in_casadi = compiled.load(limits), CasadiSolver(limits)
        for _ in range(4):
            state, wished = problem(dice, limits, 0.3)
            ours, theirs = in_c(state, wished, ROLLING), in_casadi(state, wished, ROLLING)
            assert ours is not None
            if theirs is not None:
                worth = cost(limits, state, wished, theirs, math.inf)
                worse += cost(limits, state, wished, ours) > 1.05 * worth
    assert worse <= 2, "from nothing, six iterations are not always enough; the next step goes on from there"


def test_casadi_finds_its_way_again_after_a_problem_without_a_solution() -> None:
    dice = random.Random(8)
    limits = some_car(dice)
    state, wished = problem(dice, limits, 0.02)
    solver = CasadiSolver(limits)
    before = solver(state, wished, ROLLING)
    assert before is not None
    assert solver((1e300, 0.0, 0.0, 0.0, 0.0), [1e300] * 5 * STEPS, ROLLING) is None
    assert solver(state, wished, ROLLING) == pytest.approx(before, abs=0.1)


def test_a_plan_is_begun_with_the_one_before() -> None:
    dice = random.Random(6)
    limits = some_car(dice)
    state, wished = problem(dice, limits, 0.05)
    solver = compiled.load(limits)
    plan = solver(state, wished, ROLLING)
    assert plan is not None and solver.effort[0] > 1
    again = solver(state, wished, plan)
    assert solver.effort[0] == 1
    assert again == pytest.approx(plan, abs=0.02)
