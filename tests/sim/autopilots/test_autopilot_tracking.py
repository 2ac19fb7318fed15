"""How closely the simulated autopilot follows setpoints: the rows that were measured on ArduPilot 4.7, and its shaping.

As there, a row compares the reference of the moment with the vehicle's own newest telemetry.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from tests.sim.autopilots.bench import FRAME, INTERVAL, Bench

Reference = Callable[[float], tuple[float, float, float, float]]  # time to east, north and their rates


def followed(mask: int, reference: Reference, rate: float, seconds: float) -> list[float]:
    """The distances between reference and telemetry, twenty times a second, while setpoints come at `rate` (Hz)."""
    bench = Bench()
    bench.fly()
    assert bench.command(INTERVAL, 33, 50_000) == 0
    errors: list[float] = []
    for tick in range(round(seconds * 20)):
        x, y, vx, vy = reference(tick * 0.05)
        for told in bench.of(33)[-1:]:
            at = FRAME.enu(told.lat * 1e-7, told.lon * 1e-7, told.alt * 1e-3)
            errors.append(math.hypot(at[0] - x, at[1] - y))
        if tick % round(20 / rate) == 0:
            bench.global_setpoint(mask, 5, x, y, 490.0, vy, vx, 0.0)
        bench.wait(0.05)
    return errors


def carrot(t: float) -> tuple[float, float, float, float]:
    return 1.0 - 0.5 * t, -2.0, 0.0, 0.0


def circle(t: float) -> tuple[float, float, float, float]:
    """2 m about (-1, -2), from where the vehicle is, at 0.8 m/s."""
    turn = 0.4 * t
    return -1 + 2 * math.cos(turn), -2 + 2 * math.sin(turn), -0.8 * math.sin(turn), 0.8 * math.cos(turn)


def mean(values: list[float]) -> float:
    return sum(values) / len(values)


def test_a_position_that_moves_is_followed_half_a_metre_behind() -> None:
    assert mean(followed(0xDF8, carrot, 20, 14)[-100:]) == pytest.approx(0.54, rel=0.15)


def test_at_one_setpoint_a_second_it_falls_further_behind() -> None:
    assert mean(followed(0xDF8, carrot, 1, 14)[-100:]) == pytest.approx(0.82, rel=0.15)


def test_a_circle_of_positions_and_velocities_is_left_by_a_quarter_of_a_metre() -> None:
    assert mean(followed(0xDC0, circle, 20, 32)) == pytest.approx(0.26, rel=0.15)


def test_an_acceleration_that_is_told_is_not_learnt_from_the_error() -> None:
    """The circle's, with position and velocity: what is left is the body's own lag and the telemetry's age."""
    bench = Bench()
    bench.fly()
    errors: list[float] = []
    for tick in range(400):
        x, y, vx, vy = circle(tick * 0.05)
        errors.append(math.hypot(bench.at[0] - x, bench.at[1] - y))
        ax, ay = -0.16 * (x + 1), -0.16 * (y + 2)
        north, east = y + 2.0, x - 1.0
        bench.local_setpoint(0xC00, 1, north, east, -2.0, vy, vx, 0.0, push=(ay, ax, 0.0))
        bench.wait(0.05)
    assert mean(errors[-200:]) < 0.12


def test_a_step_is_shaped_within_acceleration_and_jerk() -> None:
    """1 m: slowly to begin with, two seconds in all, and a few centimetres too far: the integral does that."""
    bench = Bench()
    bench.fly()
    bench.global_setpoint(0xDF8, 5, 2.0, -2.0, 490.0)
    way: list[float] = []
    speeds: list[float] = []
    for _ in range(160):
        bench.wait(0.05)
        way.append(bench.at[0] - 1.0)
        speeds.append(bench.rig.body.velocity[0])
    assert way[9] < 0.12  # jerk 5 m/s^3 and the lean
    first = next(i for i, d in enumerate(way) if d > 0.9) * 0.05
    assert 1.8 < first < 2.3
    assert 1.0 < max(way) < 1.05 and way[-1] == pytest.approx(1.0, abs=0.02)
    assert 0.6 < max(speeds) < 0.75
