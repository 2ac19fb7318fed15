"""The car's platform on a simulated clock, with links in memory: missions, holding, failing links, coming to rest."""

from __future__ import annotations

import math
import random
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest

from koordgen.runtime.platform import Platform, Unready
from koordgen.runtime.values import Point
from targets.car import vesc
from targets.car.platform import WAIT_FOR_DRIVE, WAIT_FOR_FEED, Car
from targets.car.settings import CarSettings, decode
from tests.car.world import FENCE, KEY, NoLinks, TestBody, Wire, World, datagram, robot_settings

MANIFEST = Path(__file__).parents[2] / "targets/car/manifest.toml"


def standing(world: World) -> bool:
    return abs(world.body.truth.speed) < 0.02


def rested(world: World) -> bool:
    return world.car.rested


def open_and_start(car: Car) -> None:
    car.start(0.0)


def test_the_settings_are_those_of_the_manifest() -> None:
    manifest = tomllib.loads(MANIFEST.read_text())["settings"]
    assert msgspec.structs.asdict(CarSettings()) == {key: said["default"] for key, said in manifest.items()}
    for key, said in manifest.items():
        for end in ("min", "max"):
            if end in said:
                decode({key: said[end]})
                with pytest.raises(Unready, match=key):
                    decode({key: said[end] + (1.0 if end == "max" else -1.0)})


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ({"wheelbas": 0.3}, "wheelbas"),
        ({"wheelbase": "long"}, "wheelbase"),
        ({"steering_to_servo_gain": 0.0}, "steering_to_servo_gain is 0"),
        ({"steering_to_servo_offset": 0.9, "steering_to_servo_gain": 8.0}, "servo leaves 0.012 rad"),
        ({"speed_to_erpm_gain": 0.0}, "speed_to_erpm_gain is 0"),
    ],
)
def test_settings_that_cannot_be_are_refused_by_name(body: dict[str, Any], message: str) -> None:
    with pytest.raises(Unready, match=message) as refused:
        Car(robot_settings(body), KEY, Wire())
    assert refused.value.hint


def test_the_servo_range_bounds_the_steering() -> None:
    assert CarSettings().steering_limit == pytest.approx((1 - 0.5304) / 1.2135)
    assert CarSettings(max_steering=0.2).steering_limit == 0.2


def test_it_becomes_ready_and_stands_before_any_command() -> None:
    world = World()
    platform: Platform = world.car
    assert platform.sense(0.0).time is None
    assert not platform.ready
    world.begin().run(1.0)
    assert world.value("reached") is True
    assert "no target" in platform.progress
    assert standing(world) and world.distance(0, 0) < 0.01
    sensed = platform.sense(world.now)
    assert sensed.time == pytest.approx(world.now, abs=0.06)
    ports = ("position", "pose", "velocity", "reached")
    both = {f"{module}.{port}" for module in ("Motion", "MotionWithScan") for port in ports}
    assert set(sensed.values) == both | {"MotionWithScan.pscan"}


@pytest.mark.parametrize("goal", [(3.0, 1.0), (-2.0, 0.0), (0.0, 0.25), (-3.0, -3.0), (5.95, -4.95)])
def test_it_drives_to_a_point_and_says_when_it_is_there(goal: tuple[float, float]) -> None:
    world = World().begin()
    world.go(*goal)
    assert world.value("reached") is False
    reached_at: list[float] = []

    def look() -> None:
        t = world.body.truth
        assert FENCE.lo.x <= t.x <= FENCE.hi.x and FENCE.lo.y <= t.y <= FENCE.hi.y
        if world.value("reached"):
            assert standing(world), "reached while moving"
            reached_at.append(world.now)

    world.run(15.0, look)
    assert reached_at, world.car.progress
    assert world.distance(*goal) < 0.08  # 0.05 of it, in a corner, is the margin to the fence
    assert standing(world) and world.value("reached") is True
    position = world.value("position")
    assert position.z == 0.0 and math.hypot(position.x - goal[0], position.y - goal[1]) < 0.08


def test_reached_takes_the_dwell_time_and_a_new_target_clears_it() -> None:
    world = World(reached_dwell=2.0).begin()
    world.go(1.0, 0.0)
    world.run(5.0)
    assert standing(world) and world.distance(1, 0) < 0.1
    since: list[float] = []
    world.run(3.0, lambda: since.append(world.now) if not world.value("reached") else None)
    assert world.value("reached") is True
    world.go(1.02, 0.0)
    assert world.value("reached") is False
    world.run(1.0)
    assert world.value("reached") is False
    world.run(1.5)
    assert world.value("reached") is True, "it stands within the radius of the new target"
    world.go(1.02, 0.0)
    assert world.value("reached") is True, "the same target is no new one"


def test_velocity_and_position_are_true_while_it_drives() -> None:
    world = World().begin()
    world.go(5.0, 2.0)
    world.run(3.0)
    truth, velocity, position = world.body.truth, world.value("velocity"), world.value("position")
    assert truth.speed > 0.8
    assert velocity.x == pytest.approx(truth.speed * math.cos(truth.yaw), abs=0.1)
    assert velocity.y == pytest.approx(truth.speed * math.sin(truth.yaw), abs=0.1)
    assert math.hypot(position.x - truth.x, position.y - truth.y) < 0.04


@pytest.mark.parametrize("start", [(-3.0, 2.5, -0.6), (0.5, 3.2, 0.4), (-2.0, -0.9, 3.0)])
def test_a_target_that_creeps_as_in_lineform_is_followed_without_stop_and_go(
    start: tuple[float, float, float],
) -> None:
    world = World(TestBody(*start)).begin()
    x, y = start[:2]
    turns: list[int] = []
    stops = 0
    moving = False

    def look() -> None:
        nonlocal moving, stops
        speed = world.body.truth.speed
        gear = (speed > 0.15) - (speed < -0.15)
        if gear and (not turns or turns[-1] != gear):
            turns.append(gear)
        stops += moving and abs(speed) < 0.02
        moving = abs(speed) > 0.05 or (moving and abs(speed) >= 0.02)

    for _ in range(250):
        x, y = x + 0.03 * (-2.0 - x), y + 0.03 * (-0.75 - y)
        world.go(x, y)
        world.run(0.1, look)
    assert len(turns) <= 3 and stops <= 5, (turns, stops)
    assert world.distance(-2.0, -0.75) < 0.10
    before = world.body.truth
    world.run(3.0)
    assert world.distance(before.x, before.y) < 0.005, "it still creeps"


@pytest.mark.parametrize(("step", "gap"), [(0.02, 0.12), (0.03, 0.14), (0.06, 0.28)])
def test_while_a_target_moves_steadily_the_car_stays_close_behind(step: float, gap: float) -> None:
    dice = random.Random(5)
    world = World(TestBody(-4.0, 0.0, 0.0)).begin()
    gaps = []
    for k in range(round(8.0 / step)):
        x = -4.0 + step * k
        y = 0.3 * math.sin(x)
        world.go(x + dice.gauss(0, 0.003), y + dice.gauss(0, 0.003))
        world.run(0.1)
        if k > 60:
            gaps.append(world.distance(x, y))
            course = math.atan(0.3 * math.cos(x))
            assert abs(math.remainder(world.body.truth.yaw - course, 2 * math.pi)) < 0.5, "it sways"
            assert world.body.truth.speed > 0.1, "stop-and-go"
    assert max(gaps) < gap


@pytest.mark.parametrize(
    ("x", "y", "dx", "dy"),
    [(0.18, -0.67, -0.0082, 0.0008), (-0.36, -0.5, 0.0068, -0.0021), (-0.36, 0.69, 0.018, -0.005)],
)
def test_a_target_that_drifts_by_beside_is_not_chased_by_endless_changes_of_gear(
    x: float, y: float, dx: float, dy: float
) -> None:
    world = World().begin()
    nearest = math.inf
    for _ in range(120):
        x, y = x + dx, y + dy
        world.go(x, y)
        world.run(0.1)
        nearest = min(nearest, world.distance(x, y))
    assert nearest < 0.15


def test_noise_does_not_wake_a_car_that_has_arrived_but_a_move_does() -> None:
    world = World().begin()
    world.go(1.0, 0.0)
    world.run(6.0)
    at = world.body.truth
    for k in range(100):
        world.go(1.0 + 0.03 * math.sin(k), 0.03 * math.cos(k))
        world.run(0.1)
    assert world.distance(at.x, at.y) < 0.002
    world.go(at.x + 0.13, at.y)  # within 1.5 radii: after a while
    world.run(0.5)
    assert world.distance(at.x, at.y) < 0.002
    world.run(3.0)
    assert world.distance(at.x + 0.13, at.y) < 0.10
    world.go(at.x + 0.5, at.y)
    world.run(0.5)
    assert world.distance(at.x, at.y) > 0.1


def test_hold_stops_it_and_resume_takes_it_to_its_target() -> None:
    world = World().begin()
    world.go(4.0, 1.0)
    world.run(2.0)
    assert world.body.truth.speed > 0.7
    for _ in range(2):  # idempotent
        world.car.hold(True, world.now)
    world.run(1.0)
    held = world.body.truth
    assert standing(world) and world.car.progress == "holding"
    world.run(2.0)
    assert world.distance(held.x, held.y) < 0.005
    world.car.command({"Motion.target": Point(4.0, -1.0)}, world.now)
    world.run(1.0)
    assert world.distance(held.x, held.y) < 0.005, "a command does not end a hold"
    world.car.hold(False, world.now)
    world.run(8.0)
    assert world.distance(4.0, -1.0) < 0.06 and world.value("reached") is True


def test_a_stale_position_brakes_it_and_it_goes_on_afterwards() -> None:
    world = World().begin()
    world.go(5.0, 0.0)
    world.run(2.0)
    assert world.body.truth.speed > 0.7
    station, world.station = world.station, None
    sensed = world.car.sense(world.now).time
    world.run(1.0)
    assert standing(world) and "old" in world.car.progress
    assert not world.car.ready
    assert world.car.sense(world.now).time == pytest.approx(sensed, abs=0.06)
    assert world.value("reached") is False
    world.station = station
    world.run(8.0)
    assert world.value("reached") is True


def test_a_car_that_stands_at_its_target_without_a_fresh_position_has_not_reached_it() -> None:
    world = World().begin()
    world.go(1.0, 0.0)
    world.run(4.0)
    assert world.value("reached") is True
    world.station = None
    world.run(0.5)
    assert world.value("reached") is False


def test_a_device_that_takes_few_bytes_at_a_time_gets_whole_frames() -> None:
    world = World().begin()
    got: list[vesc.Message] = []
    decoder = vesc.Decoder()

    def few(data: bytes) -> int:
        got.extend(decoder.feed(data[:11]))
        return len(data[:11])

    world.wire.write = few  # type: ignore[method-assign]
    world.go(3.0, 0.0)
    for k in range(20):
        world.car.poll(world.now + k * 0.05)
    assert len(got) > 15 and decoder.dropped == 0


def test_a_device_that_takes_nothing_is_unready() -> None:
    world = World().begin()
    world.wire.write = lambda data: 0  # type: ignore[method-assign]
    with pytest.raises(Unready, match="takes no commands"):
        for k in range(30):
            world.car.poll(world.now + k * 0.05)


def test_it_stops_short_of_no_target_by_much_whatever_its_lag() -> None:
    for lag, error in ((0.05, 0.03), (0.1, 0.03), (0.15, 0.03)):
        world = World(TestBody(lag=lag), noise=0.0).begin()
        world.go(2.5, 0.0)
        world.run(6.0)
        assert world.distance(2.5, 0.0) < error, lag


def test_a_fault_of_the_motor_controller_brakes_it_and_is_told() -> None:
    world = World().begin()
    world.go(5.0, 0.0)
    world.run(1.5)
    world.wire.to_drive = b""
    world.wire.to_agent += vesc.encode(vesc.Values(2000.0, 11.0, 5))
    world.car.poll(world.now + 0.06)
    assert "fault 5" in world.car.progress and not world.car.ready
    assert vesc.encode(vesc.Brake(10.0)) in world.wire.to_drive
    assert not [m for m in vesc.Decoder().feed(world.wire.to_drive) if isinstance(m, vesc.SetErpm)]


def test_rest_brakes_and_keeps_braking_whatever_comes() -> None:
    world = World().begin()
    world.go(5.0, 0.0)
    world.run(2.0)
    world.car.rest(world.now)
    assert not rested(world)
    world.run(0.1)
    assert not rested(world) and world.car.progress == "braking to rest"
    world.car.hold(False, world.now)
    world.go(5.0, 0.0)
    world.run(2.0)
    world.car.rest(world.now)
    assert rested(world) and standing(world)
    at = world.body.truth
    sent: list[vesc.Message] = []
    for _ in range(20):
        world.physics(0.05)
        world.car.poll(world.now)
        sent += vesc.Decoder().feed(world.wire.to_drive)
    assert sum(isinstance(m, vesc.Brake) for m in sent) == 20
    assert not any(isinstance(m, vesc.SetErpm) for m in sent)
    assert world.distance(at.x, at.y) < 0.002


def test_rest_without_any_measured_speed_takes_some_seconds_of_braking() -> None:
    world = World().begin()
    world.go(5.0, 0.0)
    world.run(2.0)
    world.station = None
    world.car.rest(world.now)
    begin, rested_at = world.now, math.inf
    while world.now - begin < 1.8:  # the controller brakes, but its answers are lost
        world.physics(0.05)
        world.wire.to_agent = b""
        world.car.poll(world.now)
        if world.car.rested:
            rested_at = min(rested_at, world.now - begin)
    assert rested_at == pytest.approx(1.5, abs=0.1)


def test_an_unreachable_target_is_said_and_the_car_stands() -> None:
    # Nose to the wall in a lane too narrow to turn in.
    settings = msgspec.structs.replace(
        robot_settings({}), geofence=type(FENCE)(Point(-3.0, -0.3, -1.0), Point(3.0, 0.3, 1.0))
    )
    world = World(TestBody(0.0, 0.0, math.pi / 2))
    world.car = Car(settings, KEY, world.wire)
    world.begin()
    world.go(2.0, 0.0)
    world.run(2.0)
    assert "no path inside the geofence leads to (2.00, 0.00)" in world.car.progress
    assert standing(world) and world.distance(0, 0) < 0.01 and world.value("reached") is False


def test_a_car_that_is_stuck_says_so() -> None:
    world = World().begin()
    world.body.drive = lambda speed, steering: None  # type: ignore[method-assign]
    world.go(2.0, 0.0)
    world.run(4.0)
    assert "has not moved for" in world.car.progress
    sent = [m for m in vesc.Decoder().feed(world.wire.to_drive) if isinstance(m, vesc.SetErpm)]
    assert all(abs(m.erpm) <= 0.6 * 4614 for m in sent), "it winds up"


def test_a_device_that_cannot_be_opened_is_unready() -> None:
    for act in (open_and_start, Car.check):
        with pytest.raises(Unready, match="cannot open it"):
            act(Car(robot_settings({}), KEY, NoLinks()))


def test_a_silent_feed_is_waited_for_and_then_unready() -> None:
    world = World()
    world.station = None
    world.car.start(world.now)
    world.run(2.0)
    assert not world.car.ready and "waiting for the position feed on udp:0.0.0.0:47300" in world.car.progress
    world.wire.datagrams.append(b"forged" * 10)
    world.run(0.1)
    assert "1 not authentic" in world.car.progress
    with pytest.raises(Unready, match="no position has arrived") as lost:
        world.run(WAIT_FOR_FEED + 1)
    assert lost.value.hint


def test_a_silent_motor_controller_is_unready() -> None:
    world = World()
    world.controller = None
    world.car.start(world.now)
    world.run(1.0)
    assert "waiting for the motor controller" in world.car.progress
    with pytest.raises(Unready, match="has not answered"):
        world.run(WAIT_FOR_DRIVE + 1)


def test_a_motor_controller_that_falls_silent_is_unready() -> None:
    world = World().begin()
    world.go(3.0, 0.0)
    world.run(1.0)
    world.controller = None
    with pytest.raises(Unready, match="has not answered for"):
        world.run(4.0)


def test_a_car_that_no_longer_hears_its_motor_controller_brakes_it_all_the_same() -> None:
    world = World(max_speed=2.0).begin()
    world.go(5.5, 0.0)
    world.run(1.5)
    lost = 0
    for _ in range(100):
        world.physics(0.05)
        world.wire.to_agent = b""  # the cable's one direction is broken
        try:
            world.car.poll(world.now)
        except Unready:
            lost += 1
            world.car.rest(world.now)
            assert vesc.encode(vesc.Brake(10.0)) in world.wire.to_drive
    assert lost > 30 and standing(world)


def test_check_looks_and_moves_nothing() -> None:
    world = World()
    lines = world.car.check()
    assert len(lines) == 3 and any("supply 11.1 V" in line for line in lines)
    assert world.body.asked == (0.0, 0.0)
    world.car.close()
    world.car.close()
    assert world.wire.closed == 2  # one for each link


@pytest.mark.parametrize(("dead", "message"), [("controller", "motor controller"), ("station", "no position")])
def test_check_says_what_is_missing(dead: str, message: str) -> None:
    world = World()
    setattr(world, dead, None)
    with pytest.raises(Unready, match=message):
        world.car.check()


def test_check_of_a_missing_package_is_unready(monkeypatch: pytest.MonkeyPatch) -> None:
    import builtins

    real = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name == "casadi":
            raise ImportError("No module named 'casadi'")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(Unready, match="casadi"):
        World().car.check()


def test_a_flood_of_forged_datagrams_neither_stops_nor_moves_it() -> None:
    world = World().begin()
    world.go(3.0, 0.0)
    world.run(1.0)
    for _ in range(5000):
        world.wire.datagrams.append(datagram(1e3, 0.0, 0.0, 1)[:-1] + b"\0")
    world.physics(0.05)
    world.car.poll(world.now)
    assert 4000 < len(world.wire.datagrams) < 5000
    world.wire.datagrams.clear()
    world.run(6.0)
    assert world.value("reached") is True


def test_no_position_waits_behind_forged_ones_and_is_then_taken_for_new() -> None:
    """A socket's buffer holds 256 datagrams: all must be looked at in one poll."""
    world = World().begin()
    world.station = None
    world.run(0.2)
    for _ in range(255):
        world.wire.datagrams.append(datagram(1e3, 0.0, 0.0, 1)[:-1] + b"\0")
    world.wire.datagrams.append(datagram(0.0, 0.0, 0.0, 1))
    world.physics(0.05)
    world.car.poll(world.now)
    assert world.car.sense(world.now).time == world.now


def test_polling_more_often_does_not_command_more_often() -> None:
    world = World().begin()
    commands = 0
    for i in range(1000):
        world.wire.to_drive = b""
        world.car.poll(world.now + i / 1000)
        commands += sum(isinstance(m, vesc.Brake) for m in vesc.Decoder().feed(world.wire.to_drive))
    assert commands in (20, 21)
