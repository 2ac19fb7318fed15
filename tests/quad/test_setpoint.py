"""Setpoints: the type masks as ArduPilot reads them, never a number that is not finite, never outside the fence."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.geodesy import LocalFrame
from koordgen.runtime.safety import inside
from koordgen.runtime.values import Point, distance
from targets.quad import setpoint as setpoints
from targets.quad.link import Vehicle
from targets.quad.setpoint import Carrot, NotSendable, setpoint
from tests.quad.rig import FENCE, ORIGIN

VEHICLE = Vehicle(3, 1, 3, 2)
FRAME = LocalFrame(*ORIGIN)
coordinates = st.floats(-1e6, 1e6)


def test_masks() -> None:
    """The observed values, and what their bits say."""
    position, velocity, acceleration, yaw, yaw_rate = 0x007, 0x038, 0x1C0, 0x400, 0x800
    assert setpoints.POSITION == 0xDF8 == velocity | acceleration | yaw | yaw_rate
    assert setpoints.POSITION_YAW == 0x9F8 == velocity | acceleration | yaw_rate
    assert setpoints.VELOCITY == 0xDC7 == position | acceleration | yaw | yaw_rate
    assert setpoints.POSITION_VELOCITY == 0xDC0 == acceleration | yaw | yaw_rate
    names = mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE, mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
    assert names == (0x008, 0x800)


def test_a_setpoint_byte_for_byte() -> None:
    """GLOBAL_INT, AMSL, position only, everything else zero."""
    frame = setpoint(VEHICLE, FRAME, FENCE, Point(1.0, 2.0, 1.5)).pack(mavlink.MAVLink(None, 255, 190))
    golden = (
        "fd35000000ffbe560000"  # MAVLink 2, 53 bytes, from 255/190, message 86
        "00000000" "0053401c" "c8f41705" "00c0f443"  # time, latitude, longitude, altitude 489.5
        "0000000000000000000000000000000000000000000000000000000000000000"  # velocity, acceleration, yaw, its rate
        "f80d" "03" "01" "05" "bf99"  # mask, system, component, frame, checksum
    )  # fmt: skip
    assert frame.hex() == golden


def test_a_setpoint_says_what_is_meant() -> None:
    message = setpoint(VEHICLE, FRAME, FENCE, Point(1.0, 2.0, 1.5))
    assert (message.target_system, message.target_component) == (3, 1)
    assert message.coordinate_frame == 5 and message.type_mask == 0xDF8
    assert message.alt == pytest.approx(489.5, abs=1e-4)
    place = FRAME.enu(message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt)
    assert math.dist(place, (1.0, 2.0, 1.5)) < 0.01  # 1e-7 degrees
    unused = (message.vx, message.vy, message.vz, message.afx, message.afy, message.afz, message.yaw, message.yaw_rate)
    assert unused == (0,) * 8


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_never_sent(bad: float) -> None:
    for p in (Point(bad, 0, 1), Point(0, bad, 1), Point(0, 0, bad)):
        with pytest.raises(NotSendable):
            setpoint(VEHICLE, FRAME, FENCE, p)


@given(coordinates, coordinates, coordinates)
def test_nothing_outside_the_fence_is_sent(x: float, y: float, z: float) -> None:
    message = setpoint(VEHICLE, FRAME, FENCE, Point(x, y, z))
    sent = Point(*FRAME.enu(message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt))
    slack = Point(0.01, 0.01, 0.01)
    assert inside(type(FENCE)(FENCE.lo - slack, FENCE.hi + slack), sent)


@given(st.floats(0.1, 15), st.lists(st.tuples(*[st.floats(-100, 100)] * 6), max_size=20))
def test_the_carrot_keeps_to_its_speed_and_its_leash(speed: float, jumps: list[tuple[float, ...]]) -> None:
    carrot = Carrot(speed)
    before = None
    for jump in jumps:
        goal, position = Point(*jump[:3]), Point(*jump[3:])
        at = carrot.step(goal, position, 0.05)
        leash = setpoints.LEASH_LENGTH + setpoints.LEASH_TIME * speed
        assert distance(at, position) <= leash + speed * 0.05 + 1e-9
        if before is not None and distance(before, position) <= leash:
            assert distance(at, before) <= speed * 0.05 + 1e-9
        before = at


def test_the_carrot_ends_exactly_at_the_goal() -> None:
    carrot, goal = Carrot(1.0), Point(1.0, 0.0, 1.5)
    for _ in range(100):
        at = carrot.step(goal, Point(0.5, 0.0, 1.5), 0.05)
    assert at == goal
