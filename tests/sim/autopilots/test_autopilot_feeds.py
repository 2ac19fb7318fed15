"""The simulated autopilot believes what it is told of its position, as ArduPilot 4.7 was seen to."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import ORIGIN
from tests.sim.autopilots.bench import ARM, FRAME, INTERVAL, MODE, TAKEOFF, Bench

GPS, VISION = "gps_input", "vision"


class Fed:
    """A bench whose test is its position feed as well: the pose of `lag` seconds ago at `rate` Hz, with an offset."""

    def __init__(self, positioning: str, rate: float, lag: float = 0.0, boot: float | str = 1.0) -> None:
        self.bench = Bench(boot=boot, prepared=positioning)
        self.rate, self.lag = rate, lag
        self.feeding = True
        self.offset = (0.0, 0.0, 0.0)
        self.yaw = 9000
        self.week_ms = 1000
        self.send: Callable[[float, float, float], None] = self.gps
        self._past: list[tuple[float, tuple[float, float, float]]] = []
        self._due = self.bench.rig.now
        self.errors: list[float] = []
        self.said: list[str] = []

    def gps(self, x: float, y: float, z: float) -> None:
        latitude, longitude, altitude = FRAME.geodetic(x, y, z)
        self.week_ms += round(1000 / self.rate)
        self.bench.send(
            mavlink.MAVLink_gps_input_message(
                0, 0, 0, self.week_ms, 2300, 3, round(latitude * 1e7), round(longitude * 1e7), altitude, 0.5, 0.5,
                0, 0, 0, 0.1, 0.02, 0.02, 16, self.yaw,
            )
        )  # fmt: skip

    def vision(self, x: float, y: float, z: float) -> None:
        self.bench.send(mavlink.MAVLink_vision_position_estimate_message(0, y, x, -z, 0, 0, math.pi / 2))

    def odometry(self, x: float, y: float, z: float) -> None:
        half = math.pi / 4
        self.bench.send(
            mavlink.MAVLink_odometry_message(
                0, mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD, y, x, -z,
                [math.cos(half), 0, 0, math.sin(half)], 0, 0, 0, 0, 0, 0, [0.0] * 21, [0.0] * 21,
            )
        )  # fmt: skip

    def origin(self) -> None:
        latitude, longitude, altitude = ORIGIN
        self.bench.send(
            mavlink.MAVLink_set_gps_global_origin_message(
                1, round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3)
            )
        )

    def wait(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        rig = self.bench.rig
        end = rig.now + seconds
        while rig.now < end:
            at = self.bench.at
            self._past.append((rig.now, at))
            if self.feeding and rig.now >= self._due:
                self._due = max(self._due, rig.now - 0.01) + 1 / self.rate
                then = [p for t, p in self._past[-100:] if t <= rig.now - self.lag + 1e-9][-1:] or [at]
                self.send(*(p + o for p, o in zip(then[0], self.offset, strict=True)))
            self.bench.wait(1 / 240)
            self.said += [m.text for m in self.bench.of(253)]
            self.errors.append(math.dist(self.bench.copter.position, self.bench.at))
            if until():
                return True
        return False

    def fly(self) -> None:
        assert self.wait(60.0, lambda: self.bench.copter.estimator.ready)
        self.wait(2.6)
        assert self.bench.command(MODE, 1, 4) == 0 and self.bench.copter.mode == 4
        assert self.bench.command(ARM, 1) == 0
        assert self.bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0) == 0
        self.wait(8.0)
        assert self.bench.at[2] == pytest.approx(2.0, abs=0.1)

    def circle(self, seconds: float) -> float:
        """Fly 1 m about where it is at 0.5 m/s; the mean error of the estimate meanwhile."""
        x, y, _ = self.bench.at
        self.errors.clear()
        for tick in range(round(seconds * 10)):
            turn = 0.05 * tick
            self.bench.global_setpoint(0xDF8, 5, x + math.sin(turn), y + 1 - math.cos(turn), 490.0)
            self.wait(0.1)
        return sum(self.errors) / len(self.errors)


def test_without_its_feed_it_has_no_position() -> None:
    bench = Bench(prepared=GPS)
    bench.command(INTERVAL, 33, 100_000)
    bench.wait(5.0)
    assert all(m.lat == m.lon == m.alt == 0 for m in bench.of(33)) and bench.of(33)
    assert bench.command(MODE, 1, 4) == mavlink.MAV_RESULT_FAILED
    assert bench.command(ARM, 1) == mavlink.MAV_RESULT_FAILED
    assert "PreArm: GPS 1: Bad fix" in [m.text for m in bench.of(253)]


@pytest.mark.parametrize("rate", [5.0, 8.0, 10.0])
def test_gps_input_is_enough_to_fly_by(rate: float) -> None:
    fed = Fed(GPS, rate, 0.05)
    fed.fly()
    assert fed.circle(15.0) < 0.03  # 0.024 m were observed


def test_with_the_default_delay_it_errs_by_more() -> None:
    fed = Fed(GPS, 8.0, 0.05)
    fed.bench.copter.params["GPS1_DELAY_MS"] = 0.0
    fed.fly()
    assert 0.05 < fed.circle(15.0) < 0.11  # 0.08 m were observed


def test_two_positions_a_second_are_too_few_to_arm() -> None:
    fed = Fed(GPS, 2.0)
    fed.wait(6.0)
    assert not fed.bench.copter.estimator.ready
    assert fed.bench.command(ARM, 1) == mavlink.MAV_RESULT_FAILED
    assert "PreArm: GPS 1: not healthy" in [m.text for m in fed.bench.of(253)]


def test_a_time_that_stands_still_is_no_new_fix() -> None:
    fed = Fed(GPS, 8.0)

    def frozen(x: float, y: float, z: float) -> None:
        fed.week_ms = 1000
        fed.gps(x, y, z)

    fed.send = frozen
    assert not fed.wait(6.0, lambda: fed.bench.copter.estimator.ready)


@pytest.mark.parametrize("yaw", [0, 36001, 65535])
def test_a_yaw_beyond_1_to_36000_is_none(yaw: int) -> None:
    fed = Fed(GPS, 8.0)
    fed.yaw = yaw
    assert not fed.wait(6.0, lambda: fed.bench.copter.estimator.ready)
    fed.yaw = 36000
    assert fed.wait(6.0, lambda: fed.bench.copter.estimator.ready)


@pytest.mark.parametrize("kind", ["vision", "odometry"])
def test_vision_needs_an_origin_first(kind: str) -> None:
    fed = Fed(kind, 20.0, 0.01, boot=4.0)
    fed.send = getattr(fed, kind)
    fed.origin()  # too early
    assert fed.wait(2.0, lambda: "EKF3 IMU0 initialised" in fed.said)
    assert not fed.wait(5.0, lambda: fed.bench.copter.estimator.ready)
    assert fed.bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 33) == 0
    assert fed.bench.of(33)[0].lat == 0
    fed.origin()
    assert fed.wait(5.0, lambda: fed.bench.copter.estimator.ready)
    assert fed.bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 33) == 0
    assert fed.bench.of(33)[0].lat == pytest.approx(FRAME.geodetic(1.0, -2.0, 0.0)[0] * 1e7, abs=2)
    assert fed.bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 1) == 0
    (status,) = fed.bench.of(1)
    vision, gps = mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION, mavlink.MAV_SYS_STATUS_SENSOR_GPS
    assert status.onboard_control_sensors_health & vision and not status.onboard_control_sensors_present & gps
    fed.fly()
    assert fed.circle(10.0) < 0.02  # 0.013 m were observed


def test_vision_is_ready_in_half_of_a_real_boot() -> None:
    fed = Fed("vision", 20.0, 0.01, boot="real")
    fed.send = fed.vision
    assert fed.wait(20.0, lambda: "EKF3 IMU0 initialised" in fed.said)
    fed.origin()
    assert fed.wait(40.0, lambda: fed.bench.copter.estimator.ready)
    assert fed.bench.rig.now - 1000.0 == pytest.approx(23.0, abs=1.0)


def test_vision_is_ignored_unless_it_is_configured() -> None:
    fed = Fed(VISION, 20.0)
    fed.send = fed.vision
    fed.bench.copter.params["VISO_TYPE"] = 0.0
    fed.wait(2.0)
    fed.origin()
    assert not fed.wait(5.0, lambda: fed.bench.copter.estimator.ready)


def test_the_estimate_is_the_feeds_not_the_truth() -> None:
    fed = Fed(GPS, 8.0)
    fed.fly()
    fed.offset = (0.5, 0.0, 0.0)
    fed.bench.global_setpoint(0xDF8, 5, 1.0, -2.0, 490.0)
    fed.wait(10.0)
    assert fed.bench.at[0] == pytest.approx(0.5, abs=0.06)


def test_a_feed_that_ends_is_missed_after_seven_to_eight_seconds() -> None:
    fed = Fed(GPS, 8.0)
    fed.fly()
    x, y, _ = fed.bench.at
    fed.feeding = False
    assert not fed.wait(7.0, lambda: fed.bench.copter.mode != 4)
    assert fed.wait(1.0, lambda: fed.bench.copter.mode == 9)
    assert fed.wait(20.0, lambda: not fed.bench.copter.armed)
    assert 0.5 < math.dist((x, y), fed.bench.at[:2]) < 3.5  # 2.9 m were observed
    assert "EKF Failsafe: changed to LAND Mode" in fed.said


def test_hostile_feeds_never_raise() -> None:
    fed = Fed(GPS, 8.0)
    seen = Fed(VISION, 20.0)
    seen.wait(2.0)
    seen.origin()
    for value in (math.nan, math.inf, -math.inf, 3e38):
        fed.bench.send(
            mavlink.MAVLink_gps_input_message(
                0, 0, 0, 2000, 2300, 3, 2**31 - 1, -(2**31), value, value, value, value, value, value, value, value,
                value, 255, 1,
            )
        )  # fmt: skip
        seen.vision(value, value, value)
        seen.odometry(value, 0.0, 0.0)
        fed.wait(0.2)
        seen.wait(0.2)
    fed.send, seen.send = fed.gps, seen.vision
    fed.wait(3.0)
    seen.wait(3.0)
