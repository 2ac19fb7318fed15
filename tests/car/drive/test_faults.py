"""Links that fail, lie or fall silent: the car brakes, says which, and goes on when they heal."""

from __future__ import annotations

import math
import random
import re
from contextlib import suppress

import pytest

from koordgen.runtime.values.points import Point, Pose
from koordgen.runtime.vehicle.feed import Sample, encode
from koordgen.runtime.vehicle.platform import Unready
from targets.car.drive import vesc
from targets.car.drive.vesc_drive import STARTING
from targets.car.platform.platform import WAIT_FOR_FEED, Car
from tests.car.platform.world import KEY, NoLinks, World, datagram, robot_settings, standing


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


def test_rest_without_any_measured_speed_takes_some_seconds_of_braking() -> None:
    world = World().begin()
    world.go(5.0, 0.0)
    world.run(2.0)
    world.station = None
    world.car.stop(world.now)
    begin, stopped_at = world.now, math.inf
    while world.now - begin < 1.8:  # the controller brakes, but its answers are lost
        world.physics(0.05)
        world.wire.to_agent = b""
        world.car.poll(world.now)
        if world.car.stopped:
            stopped_at = min(stopped_at, world.now - begin)
    assert stopped_at == pytest.approx(1.5, abs=0.1)


def test_a_device_that_cannot_be_opened_is_unready() -> None:
    with pytest.raises(Unready, match="cannot open it"):
        Car(robot_settings({}), KEY, NoLinks()).start(0.0)


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
        world.run(STARTING + 1)


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
            world.car.stop(world.now)
            assert vesc.encode(vesc.Brake(10.0)) in world.wire.to_drive
    assert lost > 30 and standing(world)


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


def test_a_position_that_jumps_for_a_moment_is_passed_over() -> None:
    world = World().begin()
    world.go(5.0, 0.0)
    world.run(2.0)
    world.wire.datagrams.append(again(world, -3.0))
    world.run(0.05)
    assert world.value("position").x > 0.5 and world.body.truth.speed > 0.7
    world.run(7.0)
    assert world.value("reached") is True


def again(world: World, x: float, yaw: float = 0.0) -> bytes:
    """The next sample of the base station, but from elsewhere."""
    assert world.station is not None
    world.station._sequence += 1
    sequence = world.station._sequence
    return encode(Sample("bert", 1, sequence, world.now, Pose(Point(x, 0.0, 0.0), yaw)), KEY)


def elsewhere(world: World, seconds: float, x: float) -> None:
    """All samples come from there from now on."""
    for _ in range(round(seconds / 0.05)):
        world.physics(0.05)
        world.wire.datagrams.clear()
        world.wire.datagrams.append(again(world, x))
        world.car.poll(world.now)


def test_a_position_source_that_has_jumped_brakes_it_for_good_and_says_so() -> None:
    world = World(max_speed=2.0).begin()
    world.go(5.0, 0.0)
    world.run(2.0)
    assert world.body.truth.speed > 1.0
    elsewhere(world, 0.9, -3.0)
    assert standing(world) and re.match(
        r"braking: the position source jumped: a sample was \d\.\d m off; dropped: \d+ jumped", world.car.progress
    )
    assert world.car.sense(world.now).values["Motion.position"].x > 0.5
    with pytest.raises(Unready, match="position source jumped") as lost:
        elsewhere(world, 0.3, -3.0)
    assert lost.value.hint
    world.car.stop(world.now)
    elsewhere(world, 1.0, -3.0)
    assert world.car.stopped


def test_a_car_that_stood_and_was_carried_is_believed_after_a_second() -> None:
    world = World().begin()
    world.run(2.0)
    elsewhere(world, 0.9, -3.0)
    assert "jumped" in world.car.progress
    elsewhere(world, 0.4, -3.0)
    assert world.car.ready and world.value("position").x == pytest.approx(-3.0, abs=0.01)
    assert any("jumped by 3.0 m: accepted" in line for line in world.car.log_lines())


def test_positions_that_are_no_numbers_are_dropped_and_brake_it() -> None:
    world = World().begin()
    world.go(5.0, 0.0)
    world.run(2.0)
    for _ in range(16):
        world.physics(0.05)
        world.wire.datagrams.clear()
        world.wire.datagrams.append(again(world, math.nan))
        world.car.poll(world.now)
    assert standing(world) and re.match(
        r"braking: the position is 0\.\d s old; dropped: 16 not finite", world.car.progress
    )


def test_unplugged_while_driving_and_plugged_in_again_within_two_seconds_it_goes_on() -> None:
    world = World().begin()
    world.go(4.0, 0.0)
    world.run(2.0)
    world.wire.unplugged = True
    world.run(1.5)
    assert standing(world), "the VESC's own time-out has braked it"
    assert world.car.progress == "braking: /dev/ttyACM0 is gone" and not world.car.ready
    world.wire.unplugged = False
    world.run(8.0)
    assert world.value("reached") is True
    assert world.car.log_lines() == [
        "/dev/ttyACM0 is gone: braking",
        "the motor controller at /dev/ttyACM0 is there again",
    ]


def test_unplugged_for_longer_it_is_unready_and_brakes_when_it_is_back() -> None:
    world = World().begin()
    world.go(4.0, 0.0)
    world.run(2.0)
    world.wire.unplugged = True
    with pytest.raises(Unready, match="/dev/ttyACM0 is gone") as lost:
        world.run(2.5)
    assert lost.value.hint
    world.car.stop(world.now)
    for _ in range(20):
        world.physics(0.05)
        with pytest.raises(Unready):
            world.car.poll(world.now)
    world.wire.unplugged = False
    for _ in range(40):
        world.physics(0.05)
        with suppress(Unready):
            world.car.poll(world.now)
    assert world.car.stopped


@pytest.mark.parametrize("major", [1, 2])
def test_a_firmware_for_which_the_servo_command_means_something_else_is_never_driven(major: int) -> None:
    world = World()
    assert world.controller is not None
    answer = vesc.encode(vesc.Version(major, 18)) + vesc.encode(vesc.Values(0.0, 11.0))
    sent: list[vesc.Message] = []

    def old(received: bytes, now: float) -> bytes:
        sent.extend(vesc.Decoder().feed(received))
        return answer if received else b""

    world.controller.step = old  # type: ignore[method-assign]
    world.car.start(world.now)
    with pytest.raises(Unready, match=rf"firmware {major}\.18 is too old"):
        world.run(1.0)
    assert sent and not any(isinstance(m, vesc.SetServo | vesc.SetErpm) for m in sent)
    (found,) = (f for f in world.car.diagnose() if f.name == "drive")
    assert found.state == "fail" and "too old" in found.found


def test_garbage_between_its_answers_does_not_keep_it_from_driving() -> None:
    dice = random.Random(7)
    world = World().begin()
    world.go(3.0, 0.5)

    def noise() -> None:
        world.wire.to_agent += dice.randbytes(40)

    world.run(8.0, noise)
    assert world.value("reached") is True


def test_nothing_but_garbage_is_a_silent_motor_controller() -> None:
    dice = random.Random(8)
    world = World()
    world.controller = None
    world.car.start(world.now)

    def noise() -> None:
        world.wire.to_agent += dice.randbytes(100)

    with pytest.raises(Unready, match=r"has not answered for 5\.\d s"):
        world.run(STARTING + 1, noise)
