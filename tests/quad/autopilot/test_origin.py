"""The EKF's origin: set when it can be set, again until it is, and taken as it is where it is another."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import ORIGIN, Wire
from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Point, Pose
from targets.mavlink.framing import Framer, Message
from targets.mavlink.link import Link, Vehicle
from targets.quad.autopilot.origin import Origin

SET, ASK = mavlink.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN, mavlink.MAVLINK_MSG_ID_COMMAND_LONG
EKF_WORDS = mavlink.MAVLink_statustext_message(6, b"EKF3 IMU0 initialised")
ELSEWHERE = mavlink.MAVLink_gps_global_origin_message(473_980_000, 85_450_000, 490_000)


class Bench:
    def __init__(self, autopilot: int = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA) -> None:
        self.wire, self.now = Wire(), 100.0
        self.link = Link(self.wire)
        self.link.vehicle = Vehicle(7, 1, autopilot, 2)
        self.origin = Origin(LocalFrame(*ORIGIN), ORIGIN)

    def hear(self, *messages: Message) -> None:
        packer = mavlink.MAVLink(None, 7, 1)
        for message in messages:
            (received,) = Framer().datagram(message.pack(packer))
            self.origin.update(received)

    def run(self, seconds: float, height: float = 0.0) -> list[Message]:
        """Return what is sent meanwhile, for a robot at that height (m)."""
        self.wire.up.clear()
        for _ in range(round(seconds / 0.05)):
            self.now += 0.05
            self.origin.poll(self.link, Pose(Point(1.0, 2.0, height), 0.0), self.now)
        return Framer().stream(b"".join(self.wire.up))


def of(messages: list[Message], number: int) -> list[Message]:
    return [m for m in messages if m.get_msgId() == number]


def position(boot: int, latitude: int = 0) -> Message:
    return mavlink.MAVLink_global_position_int_message(boot, latitude, latitude, 0, 0, 0, 0, 0, 0)


def test_it_is_set_once_the_ekf_is_initialised_and_until_positions_are_told() -> None:
    bench = Bench()
    bench.hear(position(1000))
    assert not of(bench.run(5.0), SET), "what is sent earlier is lost"
    bench.hear(EKF_WORDS)
    sent = of(bench.run(5.0), SET)
    assert 4 <= len(sent) <= 6
    assert (sent[0].latitude, sent[0].longitude, sent[0].altitude) == (473_977_420, 85_455_940, 488_000)
    assert sent[0].target_system == 7
    bench.hear(position(2000, 473_977_420))
    assert not of(bench.run(5.0), SET)


def test_it_is_set_at_the_robots_own_altitude() -> None:
    """Also when the robot is lifted before the autopilot has taken it."""
    bench = Bench()
    bench.hear(EKF_WORDS, position(1000))
    assert {m.altitude for m in of(bench.run(3.0, height=0.3), SET)} == {488_300}
    assert {m.altitude for m in of(bench.run(3.0, height=1.0), SET)} == {489_000}
    assert bench.origin.ned.position(Point(0.0, 0.0, 1.0))[2] == pytest.approx(0.0, abs=1e-3)


def test_poses_wait_for_the_origin_of_an_autopilot_that_has_one() -> None:
    """An agent that begins in flight must not send poses about another origin than the autopilot's."""
    bench = Bench()
    bench.hear(position(60_000, 1))
    assert not of(bench.run(5.0, height=1.5), SET)
    known = [bench.origin.known]
    bench.hear(ELSEWHERE)
    assert [*known, bench.origin.known] == [False, True] and bench.origin.ned.origin[2] == 490.0


def test_an_agent_that_missed_the_words_sees_it_by_the_status() -> None:
    bench = Bench()
    bench.hear(mavlink.MAVLink_ekf_status_report_message(mavlink.EKF_UNINITIALIZED, 0, 0, 0, 0, 0))
    assert not of(bench.run(3.0), SET)
    bench.hear(mavlink.MAVLink_ekf_status_report_message(mavlink.EKF_ATTITUDE, 0, 0, 0, 0, 0))
    assert of(bench.run(3.0), SET)


def test_px4_has_no_such_words() -> None:
    assert of(Bench(mavlink.MAV_AUTOPILOT_PX4).run(3.0), SET)


def test_it_is_asked_for_until_it_is_known_and_then_flown_by() -> None:
    bench = Bench()
    asked = of(bench.run(3.0), ASK)
    assert 2 <= len(asked) <= 4 and all(m.param1 == mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN for m in asked)
    assert max(map(abs, bench.origin.ned.position(Point()))) < 0.01, "the one that is about to be set"
    bench.hear(position(1000, 1), ELSEWHERE, ELSEWHERE)
    assert not bench.run(3.0) and bench.origin.resets == 1
    north, east, down = bench.origin.ned.position(Point())
    assert -30 < north < -28 and 44 < east < 46 and 1.9 < down < 2.1


def test_the_one_that_was_set_is_no_reset() -> None:
    bench = Bench()
    bench.hear(mavlink.MAVLink_gps_global_origin_message(473_977_420, 85_455_940, 488_000))
    assert bench.origin.resets == 0


def test_an_autopilot_that_restarts_has_forgotten_it() -> None:
    bench = Bench()
    bench.hear(EKF_WORDS, position(60_000, 1), ELSEWHERE)
    assert not bench.run(3.0)
    bench.hear(position(500))
    assert of(bench.run(3.0), ASK)
    bench.hear(EKF_WORDS)
    assert of(bench.run(3.0), SET)


_int32 = st.integers(-(2**31), 2**31 - 1)


@given(_int32, _int32, _int32)
def test_no_origin_raises(latitude: int, longitude: int, altitude: int) -> None:
    bench = Bench()
    bench.hear(mavlink.MAVLink_gps_global_origin_message(latitude, longitude, altitude))
    bench.origin.ned.position(Point(1.0, 2.0, 3.0))


def test_without_a_vehicle_nothing_is_sent() -> None:
    bench: Any = Bench()
    bench.link.vehicle = None
    assert bench.run(3.0) == []
