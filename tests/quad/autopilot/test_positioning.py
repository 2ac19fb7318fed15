"""A quad that flies by a feed: what its autopilot is sent, and what happens when the feed fails, jumps or lies."""

from __future__ import annotations

import itertools
import math
import random
import re
from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import FENCE, ORIGIN, Rig, at, sent, settings
from koordgen.runtime.config.settings import BadSettings, Safety
from koordgen.runtime.values.points import Point, Pose, distance
from koordgen.runtime.vehicle.platform import Finding, Unready
from koordgen.runtime.vehicle.safety import SafetyGuard
from targets.quad.autopilot.positioning import FIRST_SAMPLE_TIMEOUT, JUMPED, STALE
from targets.quad.autopilot.track import PositionTrack
from targets.quad.platform.platform import Quad
from tests.quad.platform.fed import KEY, WALL, Cable, FedRig, sample

NUMBERS = {
    "gps_input": mavlink.MAVLINK_MSG_ID_GPS_INPUT,
    "vision": mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE,
    "odometry": mavlink.MAVLINK_MSG_ID_ODOMETRY,
}
MODES = pytest.mark.parametrize("mode", NUMBERS)


@MODES
def test_it_takes_off_and_reaches_a_target(mode: str) -> None:
    rig = FedRig(mode)
    rig.fly()
    assert rig.autopilot is not None
    estimator, errors = rig.autopilot.copter.estimator, []
    assert estimator.source == ("gps_input" if mode == "gps_input" else "vision"), "it flies by the feed"
    rig.watch = lambda: errors.append(distance(at(rig), Point(*estimator.estimate.position)))
    rig.go(-2.0, 1.0)
    assert rig.run(20.0, rig.reached)
    assert sum(errors) / len(errors) < 0.05
    assert distance(at(rig), Point(-2.0, 1.0, 1.5)) < 0.2
    rig.quad.stop(rig.now)
    assert rig.run(20.0, lambda: rig.quad.stopped) and rig.body.position[2] == 0.0


@pytest.mark.parametrize("ground", [0.3, -0.25])
@MODES
def test_it_flies_at_its_height_where_the_ground_is_not_at_the_origins(mode: str, ground: float) -> None:
    """The simulated autopilot resets its height datum as the real one does: the ground's height must count once."""
    rig = FedRig(mode, noise=0.0, position=(1.0, -2.0, ground))
    rig.fly()
    rig.run(5.0)
    assert at(rig).z == pytest.approx(1.5, abs=0.03)
    assert rig.quad.sense(rig.now).values["Motion.position"].z == pytest.approx(at(rig).z, abs=0.03)


def test_an_agent_that_begins_in_flight_asks_for_the_origin_before_it_sends_poses() -> None:
    """The autopilot's origin is at the ground, 0.3 m above the fleet's: other poses would lift or drop the vehicle."""
    rig = FedRig("vision", noise=0.0, position=(1.0, -2.0, 0.3))
    rig.fly()
    rig.run(3.0)
    rig.quad = rig.agent(positioning="vision")
    rig.quad.start(rig.now)
    heights: list[float] = []
    rig.watch = lambda: heights.append(at(rig).z)
    assert rig.run(5.0, lambda: rig.quad.ready)
    rig.run(3.0)
    assert min(heights) > 1.45 and max(heights) < 1.55


@pytest.mark.parametrize(("below", "flies"), [(0.12, False), (0.08, True)])
def test_heights_that_differ_by_more_than_a_tenth_of_a_metre_forbid_the_take_off(below: float, flies: bool) -> None:
    """Another program set the autopilot's origin below the robot, which then counts the difference twice."""
    rig = FedRig("vision", noise=0.0)
    assert rig.autopilot is not None
    rig.pass_time(0.5)
    there = mavlink.MAVLink_set_gps_global_origin_message(
        1, round(ORIGIN[0] * 1e7), round(ORIGIN[1] * 1e7), round((ORIGIN[2] - below) * 1e3)
    )
    rig.wire.send(bytes(there.pack(mavlink.MAVLink(None, 250, 190))))
    rig.quad.start(rig.now)
    assert rig.run(20.0, lambda: rig.quad.ready) is flies
    assert rig.autopilot.copter.armed is flies
    if not flies:
        assert "the autopilot's height is 0.12 m above the position source's, more than 0.1 m" in rig.quad.progress


@MODES
def test_as_often_as_it_must_be_and_in_order(mode: str) -> None:
    rig = FedRig(mode)
    rig.fly()
    rig.wire.up.clear()
    rig.run(10.0)
    messages = sent(rig, NUMBERS[mode])
    rate = 8 if mode == "gps_input" else 20
    assert 10 * rate - 2 <= len(messages) <= 10 * rate + 2
    if mode == "gps_input":
        times = [m.time_week * 604_800_000 + m.time_week_ms for m in messages]
        expected = round((WALL + rig.now - 315_964_800 + 18) * 1000)
        assert 0 <= expected - times[-1] < 150
    else:
        times = [m.usec if mode == "vision" else m.time_usec for m in messages]
        assert len({m.reset_counter for m in messages}) == 1
    assert all(a < b for a, b in pairwise(times))
    assert sum(len(sent(rig, number)) for number in NUMBERS.values()) == len(messages)


def test_an_autopilot_of_its_own_position_is_told_nothing() -> None:
    rig = Rig()
    rig.fly()
    assert not any(sent(rig, number) for number in (*NUMBERS.values(), mavlink.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN))


@MODES
def test_a_flight_along_the_way_is_told_as_it_is(mode: str) -> None:
    """Position, velocity and yaw of a vehicle that flies north-west, at the time that the message says."""
    rig = FedRig(mode, noise=0.0)
    rig.fly()
    rig.go(-4.0, 3.0)
    truth: list[tuple[float, Point, Point]] = []
    rig.watch = lambda: truth.append((rig.now, at(rig), Point(*rig.body.velocity)))
    rig.run(4.0)
    message, (_, p, v) = sent(rig, NUMBERS[mode])[-1], truth[-1]
    assert math.hypot(v.x, v.y) > 0.6
    if mode == "gps_input":
        assert (message.ve, message.vn, -message.vd) == pytest.approx((v.x, v.y, v.z), abs=0.15)
        assert message.yaw == 9000
        return
    assert rig.quad._positioning is not None
    ned = rig.quad._positioning._origin.ned  # about the origin that the autopilot says it has
    assert (message.x, message.y, message.z) == pytest.approx(ned.position(p), abs=0.15)
    if mode == "odometry":  # it heads east
        assert (message.vx, -message.vy, -message.vz) == pytest.approx((v.x, v.y, v.z), abs=0.15)
    else:
        assert message.yaw == pytest.approx(math.pi / 2)


@MODES
def test_silence_in_flight_holds_within_half_a_second_and_then_lands(mode: str) -> None:
    rig = FedRig(mode)
    rig.fly()
    rig.go(-5.0, -2.0)
    rig.run(2.0)
    assert rig.body.velocity[0] < -0.5 and not rig.quad.progress.count("no fresh position")
    rig.station, silent = None, rig.now
    guard = SafetyGuard(Safety(), FENCE)
    held: list[float] = []

    def watch() -> None:
        before = sent(rig, mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT)[-1]
        if not held and before.vx == before.vy == 0.0 and "no fresh position" in rig.quad.progress:
            held.append(rig.now - silent)
        guard.judge(rig.quad.sense(rig.now), rig.now)

    rig.watch = watch
    rig.run(0.7)
    assert held and held[0] <= 0.5
    assert guard.judge(rig.quad.sense(rig.now), rig.now).action == "hold"
    with pytest.raises(Unready, match="no fresh position") as told:
        rig.run(3.0)
    assert told.value.hint and rig.now - silent == pytest.approx(Safety().position_lost, abs=0.1)
    assert not sent(rig, NUMBERS[mode])[-1:] or rig.now - silent > STALE
    rig.quad.stop(rig.now)
    assert rig.run(20.0, lambda: rig.quad.stopped) and rig.body.position[2] == 0.0


def test_nothing_old_is_passed_on() -> None:
    rig = FedRig("vision")
    rig.fly()
    rig.station = None
    rig.wire.up.clear()
    rig.run(1.5)
    assert len(sent(rig, NUMBERS["vision"])) <= 1


def test_a_feed_that_comes_back_goes_on() -> None:
    rig = FedRig("vision")
    rig.fly()
    rig.go(-2.0, 1.0)
    rig.run(1.0)
    station, rig.station = rig.station, None
    rig.run(1.7)
    assert rig.body.velocity[0] > -0.3, "it holds"
    rig.station = station
    assert rig.run(20.0, rig.reached)
    assert SafetyGuard(Safety(), FENCE).judge(rig.quad.sense(rig.now), rig.now).action == "go"


@MODES
@pytest.mark.parametrize("jump", [Point(2.0, 0.0, 0.0), Point(0.0, 0.0, -1.5), Point(-40.0, 30.0, 0.0)])
def test_a_jump_in_flight_is_refused_and_lands(mode: str, jump: Point) -> None:
    rig = FedRig(mode, max_speed=0.5)
    rig.fly()
    rig.run(2.0)
    before = len(sent(rig, NUMBERS[mode]))
    place, jumped = at(rig), rig.now
    rig.markers.moved = jump
    with pytest.raises(Unready, match="position source jumped") as told:
        rig.run(5.0)
    assert told.value.hint and JUMPED <= rig.now - jumped < JUMPED + 0.2
    assert len(sent(rig, NUMBERS[mode])) - before <= 2, "none of them was passed on"
    assert distance(at(rig), place) < 0.2 and "the position source jumped" in rig.quad.progress
    rig.quad.stop(rig.now)
    assert rig.run(20.0, lambda: rig.quad.stopped)


def test_single_jumps_are_refused_and_do_no_harm() -> None:
    rig, draw = FedRig("vision"), random.Random(5)
    rig.fly()
    flip = [False]

    def seldom(datagram: bytes) -> bytes:
        rig.markers.moved = Point(3.0, 0.0, 0.0) if flip[0] and draw.random() < 0.1 else Point()
        return datagram

    rig.alter, flip[0] = seldom, True
    rig.go(-2.0, 1.0)
    assert rig.run(20.0, rig.reached)
    assert distance(at(rig), Point(-2.0, 1.0, 1.5)) < 0.2


def test_a_robot_that_is_carried_before_it_flies_is_believed_anew() -> None:
    rig = FedRig("vision", boot=6.0)
    rig.quad.start(rig.now)
    rig.run(2.0)
    rig.body.position[0] -= 3.0
    assert rig.run(30.0, lambda: rig.quad.ready), rig.progress
    assert rig.quad._positioning is not None and rig.quad._positioning._carried == 1


@MODES
def test_what_is_hostile_is_counted_and_moves_nothing(mode: str) -> None:
    rig, draw = FedRig(mode), random.Random(9)
    rig.fly()
    rig.run(2.0)
    place, recorded = at(rig), []
    far = Pose(Point(5.0, 4.0, 3.0))

    def record(datagram: bytes) -> bytes:
        recorded.append(datagram)
        return datagram

    def attack() -> None:
        rig.cable.waiting.extend(
            (
                sample(1, 0.0, far, key=bytes(32)),
                sample(1, 0.0, far, robot="bert"),
                sample(1, 0.0, Pose(Point(math.nan, 0, 0))),
                sample(1, 0.0, Pose(Point(0, 1e300, 0))),
                draw.choice(recorded),
                draw.randbytes(draw.randrange(300)),
            )
        )

    rig.alter = record
    rig.run(0.2)
    rig.watch = attack
    rig.run(4.0)
    assert distance(at(rig), place) < 0.15 and rig.quad.ready
    counted = rig.quad._positioning._feed.rejected  # type: ignore[union-attr]
    assert set(counted) == {"not authentic", "another robot's", "not finite", "out of range", "old"}
    assert min(counted.values()) >= 70


@MODES
def test_an_estimate_that_leaves_the_source_holds_and_lands(mode: str) -> None:
    """They drift apart slowly: what is right nobody knows."""
    rig = FedRig(mode, prepared="own")
    rig.fly()

    def watch() -> None:
        rig.markers.moved += Point(0.02, 0.0, 0.0)

    rig.watch = watch
    with pytest.raises(Unready, match=r"the autopilot's estimate is \d\.\d m from the position source for 2\.\d s"):
        rig.run(20.0)
    assert any("the autopilot's estimate is 0.6" in said for said in rig.progress)


def test_a_flood_does_not_flood_the_log() -> None:
    rig = FedRig("vision")
    rig.station = None
    rig.quad.start(rig.now)
    rig.watch = lambda: rig.cable.waiting.extend([b"x" * 40] * 50)
    rig.run(20.0)
    assert "dropped: 10000+ not authentic" in rig.quad.progress
    assert sum("dropped" in said for said in rig.progress) < 10


def test_no_take_off_without_a_feed_and_after_a_minute_it_is_given_up() -> None:
    rig = FedRig("vision")
    rig.station = None
    rig.quad.start(rig.now)
    rig.run(10.0)
    assert not rig.body._on and "waiting for the position feed on udp:0.0.0.0:47300" in rig.quad.progress
    rig.cable.waiting.append(sample(1, 0.0, Pose(), key=bytes(32)))
    with pytest.raises(Unready, match=r"no position has arrived on .* dropped: 1 not authentic"):
        rig.run(FIRST_SAMPLE_TIMEOUT)
    rig.quad.stop(rig.now)
    rig.run(1.0)
    assert rig.quad.stopped


def test_no_take_off_where_estimate_and_source_differ() -> None:
    rig = FedRig("gps_input", prepared="own")
    rig.markers.moved = Point(1.0, 0.0, 0.0)
    rig.quad.start(rig.now)
    rig.run(15.0)
    assert not rig.body._on and re.search(r"(0\.9|1\.0) m from the position source", rig.quad.progress)


def test_no_take_off_once_the_feed_is_gone_again() -> None:
    rig = FedRig("vision")
    rig.quad.hold(True, rig.now)
    rig.quad.start(rig.now)
    assert rig.run(30.0, lambda: "waiting for the fleet" in rig.quad.progress), rig.progress
    rig.station = None
    rig.run(1.0)
    rig.quad.hold(False, rig.now)
    rig.run(3.0)
    assert not rig.body._on and "not taking off: no fresh position" in rig.quad.progress


@MODES
def test_a_feed_that_ends_while_climbing_lands_at_once(mode: str) -> None:
    rig = FedRig(mode)
    rig.quad.start(rig.now)
    assert rig.run(40.0, lambda: rig.body.position[2] > 0.5)
    rig.station, silent = None, rig.now
    with pytest.raises(Unready, match="no fresh position"):
        rig.run(5.0)
    assert rig.now - silent <= 0.6


def test_landing_goes_on_with_the_feed_and_without() -> None:
    rig = FedRig("vision")
    rig.fly()
    rig.quad.stop(rig.now)
    rig.run(0.5)
    rig.wire.up.clear()
    rig.run(0.5)
    assert len(sent(rig, NUMBERS["vision"])) >= 8
    rig.station = None
    assert rig.run(20.0, lambda: rig.quad.stopped)


def test_the_doctor_tells_of_the_feed_and_passes_it_on() -> None:
    rig = FedRig("vision")
    found = {f.name: f for f in rig.quad.diagnose()}
    assert found["feed"].state == "ok" and re.match(
        r"50 Hz on udp:0.0.0.0:47300, \d+ ms old: \(1.0", found["feed"].found
    )
    assert found["followed"].state == found["estimate"].state == "ok", found
    assert sent(rig, NUMBERS["vision"]) and rig.cable.closed
    rig = FedRig("gps_input")
    rig.station = None
    found = {f.name: f for f in rig.quad.diagnose()}
    assert found["feed"].state == "fail" and found["feed"].why
    assert len(found) > 5, "and goes on"


def test_the_doctor_tells_of_a_feed_that_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    def findings(rig: FedRig) -> dict[str, Finding]:
        return {f.name: f for f in rig.quad.diagnose()}

    seldom, count = FedRig("vision"), itertools.count()
    seldom.alter = lambda datagram: datagram if next(count) % 5 == 0 else None
    assert (findings(seldom)["feed"].state, findings(seldom)["feed"].wanted) == ("warn", "a rate of 15 Hz or more")
    silenced = FedRig("vision")
    silenced.alter = lambda datagram: datagram if silenced.now < 1003.0 else None
    assert findings(silenced)["feed"].wanted == "not older than 300 ms"
    jumpy = FedRig("vision")
    pass_time = jumpy.pass_time

    def move(seconds: float) -> None:
        jumpy.markers.moved = Point(3.0, 0.0, 0.0) if jumpy.now > 1002.0 else Point()
        pass_time(seconds)

    monkeypatch.setattr(jumpy, "pass_time", move)
    jumpy.quad = jumpy.agent(positioning="vision")
    assert "samples jumped" in findings(jumpy)["feed"].found
    apart = FedRig("gps_input")
    monkeypatch.setattr(PositionTrack, "at", lambda track, time: Point(1.6, -2.0, 0.0))
    found = findings(apart)["followed"]
    assert found.state == "fail" and re.match(r"the estimate is 0\.\d+ m from the position source", found.found)


def test_the_doctor_compares_the_heights_of_feed_and_autopilot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PositionTrack, "at", lambda track, time: Point(1.0, -2.0, 0.15))
    found = {f.name: f for f in FedRig("gps_input", noise=0.0).quad.diagnose()}["followed"]
    assert found.state == "fail" and "the autopilot's height is 0.15 m below the position source's" in found.found


def test_the_doctor_of_a_feed_whose_port_is_taken() -> None:
    rig = FedRig("vision")

    def taken(setting: str) -> Cable:
        raise Unready("cannot receive positions", "free the port")

    quad = Quad(
        settings(positioning="vision"), KEY, connect=lambda url: rig.wire, clock=lambda: rig.now, sleep=rig.pass_time,
        bind=taken,
    )  # fmt: skip
    found = {f.name: f for f in quad.diagnose()}
    assert found["feed"] == Finding("feed", "fail", "cannot receive positions", why="free the port")
    assert found["link"].state == "ok", "the rest is looked at all the same"


def test_the_port_is_given_back() -> None:
    rig = FedRig("vision")
    rig.quad.start(rig.now)
    rig.quad.close()
    assert rig.cable.closed
    assert isinstance(rig.cable, Cable)


def test_a_way_of_positioning_that_is_none() -> None:
    with pytest.raises(BadSettings, match="positioning"):
        Rig(positioning="dead reckoning")


def test_the_same_seed_gives_the_same_flight() -> None:
    def flight() -> list[bytes]:
        rig = FedRig("gps_input", noise=0.02)
        rig.fly()
        rig.go(2.0, 1.0)
        rig.run(2.0)
        return rig.wire.up

    assert flight() == flight()
