"""What an autopilot is told of its position: frames, signs and units, against values worked out by hand and pymap3d."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import ORIGIN
from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Point, Pose
from targets.mavlink.framing import Framer
from targets.quad.autopilot.external import Ned, gps_input, odometry, vision

FRAME = LocalFrame(*ORIGIN)
HERE = Ned(FRAME, *ORIGIN)
ARDUPILOT, PX4 = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_AUTOPILOT_PX4
NORTH_EAST = Pose(Point(3.0, 4.0, 1.5), math.pi / 4)


def received(message: Any) -> Any:
    """As it comes out at the other end."""
    (one,) = Framer().datagram(message.pack(mavlink.MAVLink(None, 255, 190)))
    return one


def test_a_fix_has_place_velocity_yaw_and_accuracies() -> None:
    unix = 1_750_000_000.25  # 2025-06-15 15:06:40.25 UTC: a Sunday
    fix = received(gps_input(FRAME, NORTH_EAST, Point(0.5, 1.5, 0.25), unix))
    latitude, longitude, altitude = pymap3d.enu2geodetic(3.0, 4.0, 1.5, *ORIGIN)
    assert (fix.lat, fix.lon) == (round(latitude * 1e7), round(longitude * 1e7))
    assert fix.alt == pytest.approx(altitude, abs=1e-4) and fix.fix_type == 3 and fix.ignore_flags == 0
    assert (fix.vn, fix.ve, fix.vd) == pytest.approx((1.5, 0.5, -0.25), abs=1e-4)
    assert fix.yaw == 4500
    assert fix.time_week == 2371 and fix.time_week_ms == (15 * 3600 + 6 * 60 + 40 + 18) * 1000 + 250
    assert 0 < fix.horiz_accuracy < 0.1 and 0 < fix.vert_accuracy < 0.1 and 0 < fix.speed_accuracy < 0.5
    assert fix.satellites_visible >= 6 and 0 < fix.hdop < 1.4


@pytest.mark.parametrize(
    ("yaw", "centidegrees"),
    [(math.pi / 2, 36000), (0.0, 9000), (math.pi, 27000), (-math.pi / 2, 18000), (math.pi / 2 - 1e-9, 36000),
     (math.pi / 2 + 1e-9, 36000), (math.pi / 2 + math.tau, 36000), (math.pi / 2 + 1e-3, 35994)],
)  # fmt: skip
def test_the_yaw_of_a_fix_is_never_zero(yaw: float, centidegrees: int) -> None:
    assert received(gps_input(FRAME, Pose(Point(), yaw), Point(), 1.75e9)).yaw == centidegrees


def test_time_goes_on_from_week_to_week() -> None:
    end = 315_964_800 + 2371 * 604_800 - 18
    times = []
    for i in range(-20, 20):
        fix = received(gps_input(FRAME, NORTH_EAST, Point(), end + i * 0.125))
        times.append((fix.time_week, fix.time_week_ms))
    assert times == sorted(set(times)) and times[0][0] == 2370 and times[-1][0] == 2371
    assert all(0 <= ms < 604_800_000 for _, ms in times)


def test_a_pose_is_told_in_ned() -> None:
    told = received(vision(HERE, NORTH_EAST, 12.5, 259))
    assert (told.x, told.y, told.z) == pytest.approx((4.0, 3.0, -1.5), abs=1e-5)
    assert told.yaw == pytest.approx(math.pi / 4) and told.roll == told.pitch == 0.0
    assert told.usec == 12_500_000 and told.reset_counter == 3
    assert all(told.covariance[i] > 0 for i in (0, 6, 11, 15, 18, 20)) and sum(map(bool, told.covariance)) == 6
    for enu, ned in ((0.0, math.pi / 2), (math.pi, -math.pi / 2), (-math.pi / 2, math.pi)):
        yaw = received(vision(HERE, Pose(Point(), enu), 0.0, 0)).yaw
        assert math.remainder(yaw - ned, math.tau) == pytest.approx(0.0, abs=1e-6)


def test_odometry_has_the_velocity_in_the_vehicles_own_axes() -> None:
    """It heads north-east and flies east, climbing."""
    told = received(odometry(HERE, NORTH_EAST, Point(1.0, 0.0, 0.5), 12.5, 1, ARDUPILOT))
    assert (told.x, told.y, told.z) == pytest.approx((4.0, 3.0, -1.5), abs=1e-5)
    half = math.sqrt(0.5)
    assert (told.vx, told.vy, told.vz) == pytest.approx((half, half, -0.5), abs=1e-5)
    w, x, y, z = told.q
    assert (x, y) == (0.0, 0.0) and 2 * math.atan2(z, w) == pytest.approx(math.pi / 4, abs=1e-6)
    assert told.frame_id == mavlink.MAV_FRAME_LOCAL_FRD and told.child_frame_id == mavlink.MAV_FRAME_BODY_FRD
    assert (told.rollspeed, told.pitchspeed, told.yawspeed, told.quality, told.reset_counter) == (0, 0, 0, 100, 1)
    assert received(odometry(HERE, NORTH_EAST, Point(), 0.0, 0, PX4)).frame_id == mavlink.MAV_FRAME_LOCAL_NED


_angle, _far = st.floats(-10, 10), st.floats(-3000, 3000)


@given(
    st.floats(-89.9, 89.9),
    st.floats(-180, 180),
    _far,
    _far,
    st.floats(-50, 50),
    _angle,
    st.tuples(*[st.floats(-9, 9)] * 3),
)
def test_an_origin_of_the_vehicles_own_is_allowed_for(
    latitude: float, longitude: float, x: float, y: float, z: float, yaw: float, velocity: tuple[float, float, float]
) -> None:
    """Wherever the EKF began: places are the same places, directions the same directions."""
    fleet = LocalFrame(latitude, longitude, 500.0)
    ekf = pymap3d.enu2geodetic(x, y, z, latitude, longitude, 500.0)
    pose, v = Pose(Point(1.0, -2.0, 1.5), yaw), Point(*velocity)
    ned = Ned(fleet, *map(float, ekf))
    place = pymap3d.enu2geodetic(1.0, -2.0, 1.5, latitude, longitude, 500.0)
    assert ned.position(pose.position) == pytest.approx(pymap3d.geodetic2ned(*place, *ekf), abs=1e-3)

    def turned(e: float, n: float, u: float) -> Any:
        east, north, up = pymap3d.uvw2enu(*pymap3d.enu2uvw(e, n, u, latitude, longitude), ekf[0], ekf[1])
        return np.array((north, east, -up))

    assert ned.direction(v, pose.position) == pytest.approx(turned(*velocity), abs=1e-6)
    north, east, _ = turned(math.cos(yaw), math.sin(yaw), 0.0)
    assert math.remainder(ned.yaw(pose) - math.atan2(east, north), math.tau) == pytest.approx(0.0, abs=1e-6)
