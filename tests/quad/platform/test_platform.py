"""The quad platform's whole life against the simulated autopilot."""

from __future__ import annotations

import itertools
import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import FENCE, SETPOINT, Rig, at, commands, sent, told
from koordgen.runtime.values.geometry import path_distance
from koordgen.runtime.values.points import Point, distance
from koordgen.runtime.vehicle.platform import Platform, Unready
from targets.quad.motion.motion import MARGIN


def test_a_whole_life() -> None:
    rig = Rig(noise=0.005)
    platform: Platform = rig.quad
    rig.fly()
    sensed = platform.sense(rig.now)
    assert sensed.values["Motion.reached"] is True and sensed.time is not None and rig.now - sensed.time < 0.1
    assert distance(sensed.values["Motion.position"], at(rig)) < 0.03
    assert 1.2 < at(rig).z < 1.6

    rig.go(4.0, 3.0)  # z = 0 is raised to the flight height
    speeds: list[float] = []
    rig.watch = lambda: speeds.append(math.hypot(*rig.body.velocity[:2]))
    assert not rig.reached()
    assert rig.run(12.0, rig.reached)
    assert distance(at(rig), Point(4.0, 3.0, 1.5)) < 0.2 and max(speeds) < 1.15

    rig.go(-4.0, -3.0, 2.5)
    rig.run(3.0)
    rig.quad.hold(True, rig.now)
    here = at(rig)
    rig.run(6.0)
    assert distance(at(rig), here) < 0.7 and math.hypot(*rig.body.velocity) < 0.05 and not rig.reached()
    rig.quad.hold(True, rig.now)
    rig.quad.hold(False, rig.now)
    assert rig.run(15.0, rig.reached)
    assert distance(at(rig), Point(-4.0, -3.0, 2.5)) < 0.2

    rig.quad.stop(rig.now)
    rig.quad.stop(rig.now)
    assert rig.run(15.0, lambda: rig.quad.stopped)
    assert rig.autopilot is not None and not rig.autopilot.copter.armed and at(rig).z == 0.0
    rig.quad.close()
    rig.quad.close()
    assert rig.wire.closed


@pytest.mark.parametrize(("speed", "way"), [(0.5, 0.5), (1.0, 0.95), (2.0, 1.7)])
def test_a_hold_brakes_at_once(speed: float, way: float) -> None:
    """At a position alone from the first moment on; and it does not walk back to where it was told to."""
    rig = Rig(max_speed=speed)
    rig.fly()
    rig.go(-5.5, -2.0)
    assert rig.run(3.0, lambda: rig.body.velocity[0] < -0.95 * speed)
    here, far = at(rig), [0.0]
    rig.wire.up.clear()
    rig.quad.hold(True, rig.now)
    rig.watch = lambda: far.append(distance(at(rig), here))
    rig.run(6.0)
    assert max(far) < way and far[-1] > 0.4 * max(far) and math.hypot(*rig.body.velocity) < 0.05
    assert {m.type_mask for m in sent(rig, SETPOINT)} == {0x9F8}


def test_what_is_sent_on_the_way() -> None:
    """Setpoints at 20 Hz, GLOBAL_INT, with a velocity while it moves and a position alone before and after, the heading
    kept; none before the take-off's height; our heartbeat every 0.4 s."""
    rig = Rig()
    rig.fly()
    assert len(sent(rig, SETPOINT)) < 20
    rig.wire.up.clear()
    rig.go(3.0, 3.0)
    rig.run(10.0)
    setpoints = sent(rig, SETPOINT)
    assert 180 <= len(setpoints) <= 201
    assert {(m.type_mask, m.coordinate_frame) for m in setpoints} == {(0x9F8, 5), (0x9C0, 5)}
    masks = [m.type_mask for m in setpoints]
    changes = sum(a != b for a, b in itertools.pairwise(masks))
    assert changes <= 2 and masks[-1] == 0x9F8 and masks.count(0x9C0) > 60
    assert {round(m.yaw, 3) for m in setpoints} == {round(math.pi / 2, 3)}
    assert 24 <= len(sent(rig, mavlink.MAVLINK_MSG_ID_HEARTBEAT)) <= 26
    assert not commands(rig, mavlink.MAV_CMD_COMPONENT_ARM_DISARM)


def test_reached_is_kept_by_the_same_target_and_cleared_by_a_new_one() -> None:
    rig = Rig()
    rig.fly()
    rig.go(1.0, -2.0, 1.5)
    assert not rig.reached()
    rig.watch = lambda: rig.go(1.0, -2.0, 1.5)  # written anew in every round
    assert rig.run(5.0, rig.reached)
    rig.run(1.0)
    assert rig.reached()
    rig.watch = lambda: None
    rig.go(1.1, -2.0, 1.5)
    assert not rig.reached()


def test_reached_means_standing_still() -> None:
    rig = Rig(reached_dwell=0.0, reached_radius=0.5)
    rig.fly()
    rig.go(-4.0, -2.0)
    rig.run(2.5)
    assert rig.body.velocity[0] < -0.7
    rig.go(rig.body.position[0] - 0.3, -2.0)
    assert rig.run(5.0, rig.reached)
    assert math.hypot(*rig.body.velocity) < 0.26


def test_velocity_is_sensed_in_the_fleets_frame() -> None:
    rig = Rig()
    rig.fly()
    rig.go(4.0, 1.0, 3.0)
    rig.run(3.0)
    sensed, true = rig.quad.sense(rig.now).values["Motion.velocity"], Point(*rig.body.velocity)
    assert true.x > 0.4 and true.y > 0.4 and true.z > 0.1
    assert distance(sensed, true) < 0.03


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_target_that_is_not_finite_is_never_sent(bad: float) -> None:
    rig = Rig()
    rig.fly()
    rig.go(2.0, 2.0)
    rig.run(10.0)
    for target in (Point(bad, 0, 2), Point(0, bad, 2), Point(0, 0, bad)):
        rig.quad.command({"Motion.target": target}, rig.now)
        rig.run(1.0)
    assert all(math.isfinite(m.alt) for m in sent(rig, SETPOINT))
    assert distance(at(rig), Point(2.0, 2.0, 1.5)) < 0.15 and "3 targets were not finite" in rig.quad.progress


def test_a_target_outside_the_fence_is_clamped_to_its_inside() -> None:
    rig = Rig()
    rig.fly()
    rig.go(50.0, -50.0, 50.0)
    assert rig.run(20.0, rig.reached)
    inner = Point(6.0 - MARGIN, -5.0 + MARGIN, 4.0 - MARGIN)
    assert distance(at(rig), inner) < 0.15


def test_a_landing_that_never_disarms_is_ended_on_the_ground() -> None:
    rig = Rig()
    rig.fly()
    assert rig.autopilot is not None
    rig.autopilot.copter.params["LAND_REPOSITION"] = 1.0
    disarmed_at: list[float] = []
    copter = rig.autopilot.copter
    rig.watch = lambda: None if copter.armed else disarmed_at.append(rig.body.position[2])
    rig.quad.stop(rig.now)
    assert rig.run(25.0, lambda: rig.quad.stopped)
    assert disarmed_at[0] == 0.0 and any("still armed" in said for said in rig.progress)


def test_the_same_seed_gives_the_same_flight() -> None:
    def flight() -> list[bytes]:
        rig = Rig(noise=0.02)
        rig.fly()
        rig.go(2.0, 1.0)
        rig.run(3.0)
        return rig.wire.up

    assert flight() == flight()


@pytest.mark.parametrize(("yaw", "wanted"), [("keep", 0.0), ("forward", math.atan2(5.0, 3.0)), ("-0.5", -0.5)])
def test_headings(yaw: str, wanted: float) -> None:
    rig = Rig(yaw=yaw)
    rig.fly()
    rig.go(4.0, 3.0)
    rig.run(4.0)  # it turns by 0.6 rad/s
    told = {round(math.pi / 2 - m.yaw, 3) for m in sent(rig, SETPOINT)[-20:]}
    assert all(abs(math.remainder(y - wanted, math.tau)) < 0.02 for y in told)


def test_a_meeting_place_at_the_fence_is_reached_and_stayed_at() -> None:
    """A target on the fence's face: overshoot and wavering must not count as having left the fence."""
    rig = Rig(noise=0.02)
    rig.fly()
    furthest: list[float] = []
    rig.watch = lambda: furthest.append(rig.body.position[0])
    rig.go(6.0, -2.0)
    assert rig.run(15.0, rig.reached)
    rig.run(10.0)
    assert 5.8 < max(furthest) < 5.95


def test_when_the_agent_dies_in_motion_the_vehicle_stays_within_the_fence() -> None:
    """It runs on for 3 s with the last velocity that was sent."""
    for dead_at in (1.0, 2.5, 3.5, 4.5, 5.5):
        rig = Rig(position=(-4.0, 0.0, 0.0))
        rig.fly()
        rig.go(9.0, 9.0)
        rig.run(dead_at)
        beyond: list[float] = []
        for _ in range(50):  # and nobody polls any more; the GCS failsafe lands it after 5 s
            rig.pass_time(0.1)
            beyond.append(max(rig.body.position[0] - FENCE.hi.x, rig.body.position[1] - FENCE.hi.y))
        assert max(beyond) < 0.0, dead_at


@pytest.mark.parametrize(("speed", "dead_at"), [(1.0, 8.2), (1.0, 8.9), (1.0, 9.6), (2.0, 3.9), (2.0, 4.6), (3.0, 3.5)])
def test_a_vehicle_that_flies_at_the_fence_when_its_agent_dies_stops_before_it(speed: float, dead_at: float) -> None:
    """After 3 s with the last velocity it still needs room to stop."""
    rig = Rig(position=(-4.0, -2.0, 0.0), max_speed=speed, max_climb=1.0)
    rig.fly()
    rig.go(5.9, -2.0)
    rig.run(dead_at)
    assert rig.body.velocity[0] > 0.5
    farthest = nearest_to_the_fence(rig, 5.0)
    assert farthest < 0.0


@pytest.mark.parametrize("dead_at", [1.2, 1.8, 2.3])
def test_a_vehicle_that_climbs_when_its_agent_dies_stops_below_the_fence(dead_at: float) -> None:
    rig = Rig(position=(0.0, 0.0, 0.0), max_climb=1.5, max_speed=1.5)
    rig.fly()
    rig.go(0.0, 0.0, 3.9)
    rig.run(dead_at)
    assert rig.body.velocity[2] > 0.3
    assert nearest_to_the_fence(rig, 5.0) < 0.0


def nearest_to_the_fence(rig: Rig, seconds: float) -> float:
    """Let the autopilot fly alone. How far outside the fence the vehicle was, m; negative: it stayed inside."""
    beyond: list[float] = []
    for _ in range(round(seconds / 0.05)):
        rig.pass_time(0.05)
        x, y, z = rig.body.position
        beyond.append(max(x - FENCE.hi.x, y - FENCE.hi.y, z - FENCE.hi.z))
    return max(beyond)


def test_it_waits_for_its_first_target_at_the_flight_height() -> None:
    rig = Rig()
    rig.fly()
    rig.run(5.0)
    assert at(rig).z == pytest.approx(1.5, abs=0.05)


def test_targets_that_waver_are_stayed_at_and_the_kind_of_setpoint_does_not_flicker() -> None:
    """A program may compute its target from measured places in every round; ArduPilot's controller starts anew with
    each change of kind."""
    rig = Rig(noise=0.005)
    rig.fly()
    rig.go(1.0, -2.0)
    assert rig.run(5.0, rig.reached)
    rig.wire.up.clear()
    far: list[float] = []
    for i in range(100):
        rig.go(1.0 + 0.006 * math.sin(2.3 * i), -2.0 + 0.006 * math.cos(1.7 * i))
        rig.run(0.1)
        far.append(distance(at(rig), Point(1.0, -2.0, 1.5)))
    masks = [m.type_mask for m in sent(rig, SETPOINT)]
    assert max(far) < 0.06 and sum(a != b for a, b in itertools.pairwise(masks)) <= 1


def test_a_vehicle_that_does_not_follow_is_noticed_also_in_motion() -> None:
    """The reference waits for it, at a position alone."""
    rig = Rig()
    rig.fly()
    rig.wire.meddle = lambda data, down: None if not down and told(data) == SETPOINT else data
    rig.go(5.0, 3.0)
    with pytest.raises(Unready, match="does not follow"):
        rig.run(15.0)


def landed(rig: Rig) -> Point:
    """End the run. Where the quad stands then."""
    for _ in range(60):
        rig.quad.stop(rig.now)
        if rig.run(0.5, lambda: rig.quad.stopped):
            break
    assert rig.quad.stopped
    return at(rig)


@pytest.mark.parametrize(
    "below", [(Point(1.2, -2.0, 0.0),), (Point(1.0, -2.0, 1.0),), (Point(-3.0, -2.0), Point(4.0, -2.0))]
)
def test_a_quad_lands_beside_a_robot_that_is_below_it(below: tuple[Point, ...]) -> None:
    """A car, another quad, a path."""
    rig = Rig()
    rig.fly()
    rig.quad.others({1: below})
    rig.quad.hold(True, rig.now)
    place = landed(rig)
    assert path_distance((Point(place.x, place.y),), tuple(Point(p.x, p.y) for p in below)) > 0.6
    assert distance(place, Point(1.0, -2.0, 0.0)) < 1.2
    (line,) = rig.quad.log_lines()
    assert line.startswith("robot 1 may be below: moving to (")


def test_a_quad_lands_where_it_is_beside_others_as_high_and_without_a_free_place() -> None:
    rig = Rig()
    rig.fly()
    rig.quad.others({1: (Point(1.4, -2.0, 1.45),)})
    assert distance(landed(rig), Point(1.0, -2.0, 0.0)) < 0.2 and rig.quad.log_lines() == []
    rig = Rig()
    rig.fly()
    rig.quad.others({pid: (Point(-3.0, 0.5 * pid - 5.0), Point(4.0, 0.5 * pid - 5.0)) for pid in range(1, 12)})
    assert distance(landed(rig), Point(1.0, -2.0, 0.0)) < 0.2
    assert "there is no free place within 1.6 m" in rig.quad.log_lines()[0]
