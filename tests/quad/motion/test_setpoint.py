"""Setpoints: the type masks as ArduPilot reads them, never a number that is not finite, never outside the fence,
neither now nor when the autopilot runs on with the last of them."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import FENCE, ORIGIN, SETPOINT, Wire
from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Point, distance
from koordgen.runtime.vehicle.safety import clamp, inside
from targets.mavlink.framing import Message
from targets.mavlink.link import Link, Vehicle
from targets.quad.autopilot.telemetry import Telemetry
from targets.quad.motion import setpoint as setpoints
from targets.quad.motion.motion import MARGIN, Motion, room
from targets.quad.motion.reference import Reference
from targets.quad.motion.setpoint import Aim, NotSendable, Shaping, aimed, setpoint
from targets.quad.motion.trajectory import MotionLimits, norm
from targets.quad.motion.yaw import heading

VEHICLE = Vehicle(3, 1, 3, 2)
FRAME = LocalFrame(*ORIGIN)
HEIGHT = 1.5
ROOM = room(FENCE, HEIGHT)
SLACK = 0.02  # m: 1e-7 degrees, and single precision
coordinates = st.floats(-1e6, 1e6)
points = st.builds(Point, coordinates, coordinates, coordinates)
anything = st.builds(Point, *[st.floats() | st.floats(-8, 8) | st.just(1e308)] * 3)


def place(message: Message) -> Point:
    return Point(*FRAME.enu(message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt))


def velocity(message: Message) -> Point:
    return Point(*FRAME.turned(message.lat_int * 1e-7, message.lon_int * 1e-7, message.vx, message.vy, message.vz))


def wider(box: Box, by: float) -> Box:
    return Box(box.lo - Point(by, by, by), box.hi + Point(by, by, by))


def assert_harmless(message: Message) -> None:
    """All of it finite; within the fence now, and after any part of the time for which an autopilot runs on."""
    fields = (message.alt, message.vx, message.vy, message.vz, message.afx, message.afy, message.afz)
    assert all(map(math.isfinite, (*fields, message.yaw, message.yaw_rate)))
    assert (message.afx, message.afy, message.afz, message.yaw_rate) == (0, 0, 0, 0)
    assert message.type_mask in (0xDF8, 0xDC0, 0x9F8, 0x9C0) and message.coordinate_frame == 5
    assert inside(wider(FENCE, SLACK), place(message))
    if not message.type_mask & 0x38:
        assert inside(wider(FENCE, SLACK), place(message) + velocity(message) * 3.0)


def test_masks() -> None:
    """The observed values, and what their bits say."""
    position, velocities, acceleration, yaw, yaw_rate = 0x007, 0x038, 0x1C0, 0x400, 0x800
    assert setpoints.POSITION == 0xDF8 == velocities | acceleration | yaw | yaw_rate
    assert setpoints.POSITION_VELOCITY == 0xDC0 == acceleration | yaw | yaw_rate
    assert setpoints.POSITION & ~setpoints.YAW == 0x9F8 and position == 0x7
    names = mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE, mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
    assert names == (0x008, 0x800) and yaw == mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE


def test_a_setpoint_byte_for_byte() -> None:
    """GLOBAL_INT, AMSL, position only, everything else zero."""
    frame = setpoint(VEHICLE, FRAME, FENCE, Aim(Point(1.0, 2.0, 1.5))).pack(mavlink.MAVLink(None, 255, 190))
    golden = (
        "fd35000000ffbe560000"  # MAVLink 2, 53 bytes, from 255/190, message 86
        "00000000" "0053401c" "c8f41705" "00c0f443"  # time, latitude, longitude, altitude 489.5
        "0000000000000000000000000000000000000000000000000000000000000000"  # velocity, acceleration, yaw, its rate
        "f80d" "03" "01" "05" "bf99"  # mask, system, component, frame, checksum
    )  # fmt: skip
    assert frame.hex() == golden


def test_a_moving_setpoint_byte_for_byte() -> None:
    """Velocities north, east, down; yaw from north, clockwise."""
    aim = Aim(Point(), Point(0.25, 0.5, -0.125), math.pi / 2 - 0.5)
    frame = setpoint(VEHICLE, FRAME, FENCE, aim).pack(mavlink.MAVLink(None, 255, 190))
    north, east, down = struct.unpack("<fff", frame[26:38])
    assert (north, east) == (pytest.approx(0.5), pytest.approx(0.25)) and down == pytest.approx(0.125, abs=1e-6)
    assert frame[38:50] == bytes(12) and struct.unpack("<ff", frame[50:58]) == (pytest.approx(0.5), 0.0)
    assert frame[58:60].hex() == "c009" and frame[10:14] == bytes(4)


def test_a_setpoint_says_what_is_meant() -> None:
    message = setpoint(VEHICLE, FRAME, FENCE, Aim(Point(1.0, 2.0, 1.5)))
    assert (message.target_system, message.target_component) == (3, 1)
    assert message.coordinate_frame == 5 and message.type_mask == 0xDF8
    assert message.alt == pytest.approx(489.5, abs=1e-4)
    assert distance(place(message), Point(1.0, 2.0, 1.5)) < 0.01  # 1e-7 degrees
    unused = (message.vx, message.vy, message.vz, message.afx, message.afy, message.afz, message.yaw, message.yaw_rate)
    assert unused == (0,) * 8


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_never_sent(bad: float) -> None:
    for p in (Point(bad, 0, 1), Point(0, bad, 1), Point(0, 0, bad)):
        with pytest.raises(NotSendable):
            setpoint(VEHICLE, FRAME, FENCE, Aim(p))
        with pytest.raises(NotSendable):
            setpoint(VEHICLE, FRAME, FENCE, Aim(Point(), p))
    with pytest.raises(NotSendable):
        setpoint(VEHICLE, FRAME, FENCE, Aim(Point(), None, bad))


@given(points, st.none() | points, st.none() | st.floats(-100, 100))
def test_nothing_outside_the_fence_is_sent_nor_leads_there(p: Point, v: Point | None, yaw: float | None) -> None:
    assert_harmless(setpoint(VEHICLE, FRAME, FENCE, Aim(p, v, yaw)))


@given(st.lists(st.tuples(points, points), min_size=1, max_size=4), st.integers(1, 40))
@settings(deadline=None)
def test_an_aim_keeps_to_the_room_and_is_worth_the_same(ways: list[tuple[Point, Point]], ticks: int) -> None:
    """What velocity loses to the fence, position gets, as far as there is room."""
    shaping = Shaping()
    limits = MotionLimits(2.0, 0.7, 1.0, ROOM)
    reference = Reference(limits)
    reference.start(ways[0][0], Point(), 0.0)
    now = 0.0
    for target, vehicle in ways:
        reference.follow((clamp(ROOM, target),), now)
        for i in range(ticks):
            now += 0.05
            reference.advance(vehicle if i % 7 == 6 else reference.at(0.0).position, now)
            here = reference.at(shaping.delay)
            aim = aimed(reference, here, shaping, limits)
            assert inside(wider(ROOM, 1e-9), aim.position)
            if aim.velocity is None:
                continue
            assert inside(wider(ROOM, 1e-6), aim.position + aim.velocity * setpoints.RUN_ON)
            state = reference.at(shaping.delay)
            push = (reference.at(shaping.delay + shaping.ahead).velocity - state.velocity) / shaping.ahead
            wanted = state.position.x + state.velocity.x + shaping.lead[0] * push.x
            faster = norm(state.velocity) + norm(push) > 0.7  # may have been cut
            if not faster and ROOM.lo.x + 0.01 < aim.position.x < ROOM.hi.x - 0.01 and ROOM.lo.x < wanted < ROOM.hi.x:
                assert aim.position.x + aim.velocity.x == pytest.approx(wanted, abs=1e-6)
            assert norm(aim.velocity) <= limits.speed + 1e-9


Action = tuple[str, tuple[Point, ...], Point, float]
actions: st.SearchStrategy[Action] = st.tuples(
    st.sampled_from(("go", "go", "path", "hold", "resume", "lose", "other hands")),
    st.lists(anything | st.builds(Point, st.floats(-8, 8), st.floats(-8, 8), st.floats(-1, 6)), max_size=5).map(tuple),
    st.builds(Point, *[st.floats(-9, 9) | st.floats(-1e6, 1e6)] * 3),
    st.floats(0.0, 3.0),
)


@given(st.lists(actions, min_size=1, max_size=8), st.sampled_from(("keep", "forward", "1.5")), st.floats(0.1, 15))
@settings(deadline=None, max_examples=150)
def test_whatever_the_program_writes_and_wherever_the_vehicle_is(doings: list[Action], yaw: str, speed: float) -> None:
    """The bytes that were sent, decoded."""
    wire, now = Wire(), 50.0
    link, state = Link(wire), Telemetry(FRAME)
    link.vehicle = VEHICLE
    motion = Motion(FRAME, FENCE, HEIGHT, speed, 1.0, 0.7, 0.15, 0.3, heading(yaw))
    state.yaw = 0.3
    for what, points_, vehicle, seconds in doings:
        match what:
            case "go" if points_:
                motion.command(points_[:1], now)
            case "path":
                motion.command(points_, now)
            case "hold" | "resume":
                motion.hold(what == "hold", now)
        for _ in range(round(seconds / 0.05)):
            now += 0.05
            state.position, state.velocity = vehicle, Point(vehicle.y, -vehicle.x, vehicle.z)
            state.followed, state.followed_time = vehicle, -math.inf
            motion._unconfirmed = None  # whether it is followed is another test's business
            if what == "lose":
                motion.halt(link, now)
            elif what == "other hands":
                motion.coast(now)
            else:
                motion.steer(link, state, now)
    decoder = mavlink.MAVLink(None)
    for frame in wire.up:
        (message,) = decoder.parse_buffer(frame)
        assert message.get_msgId() == SETPOINT
        assert_harmless(message)


def test_the_room_is_the_fence_with_a_margin_above_the_flight_height() -> None:
    m = MARGIN
    assert Box(Point(-6 + m, -5 + m, HEIGHT), Point(6 - m, 5 - m, 4 - m)) == ROOM
    assert room(Box(Point(6, 5, 4), Point(-6, -5, 0)), HEIGHT) == ROOM  # corners in any order
    narrow = room(Box(Point(0, 0, 0), Point(0.2, 5, 1.6)), HEIGHT)
    assert narrow == Box(Point(0.05, m, HEIGHT), Point(0.2 - 0.05, 5 - m, HEIGHT))


def test_yaw_settings() -> None:
    assert [heading(t) for t in ("keep", "forward", "1.57", "-3")] == ["keep", "forward", 1.57, -3.0]
    for bad in ("north", "nan", "inf", ""):
        with pytest.raises(ValueError):
            heading(bad)
