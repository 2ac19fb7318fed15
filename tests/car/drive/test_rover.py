"""The rover driver against the simulated rover, on one simulated clock with the link in memory; sockets at the end."""

from __future__ import annotations

import math
import os
import select
import socket
import time
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.vehicle.platform import Unready
from targets.car.base.settings import CarSettings, decode
from targets.car.control.fence import beyond
from targets.car.control.mpc import Command
from targets.car.drive.rover import LOST, MANUAL, STARTING, RoverDrive
from targets.car.drive.throttle import SpeedLoop, channel
from targets.car.drive.watched import WatchdogProcess
from targets.car.platform.platform import Car
from targets.mavlink.framing import Framer
from targets.mavlink.transport import Address, Chunk, Way, opened
from targets.planning.process import Inside
from targets.sim.autopilots.rover import HOLD, SimulatedRover
from tests.car.platform import world as bench
from tests.car.platform.world import FENCE, KEY, TestBody, context, robot_settings, standing

OVERRIDE = mavlink.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE
URL = "rover:udpin:127.0.0.1:14550"


class Radio:
    """Both ends of the link: a Transport for the agent, a Port for the rover. `cut` loses all; `up` records."""

    datagrams = True

    def __init__(self) -> None:
        self.down: list[Chunk] = []
        self.waiting: list[bytes] = []
        self.up: list[bytes] = []
        self.cut = False
        self.meddle: Callable[[bytes], bytes] = lambda data: data

    def way(self) -> Way | None:
        return Way(0, -1)

    def answer(self, source: Address | None) -> None:
        pass

    def receive(self, now: float) -> list[Chunk]:
        taken, self.down = self.down, []
        return taken

    def send(self, data: bytes) -> bool:
        self.up.append(data)
        if not self.cut:
            self.waiting.append(data)
        return True

    def close(self) -> None:
        pass


class RoverEnd:
    """The rover's side of a Radio."""

    def __init__(self, radio: Radio) -> None:
        self._radio = radio

    def receive(self) -> list[bytes]:
        taken, self._radio.waiting = self._radio.waiting, []
        return taken

    def send(self, data: bytes) -> None:
        if not self._radio.cut:
            self._radio.down.append((self._radio.meddle(data), ("rover", 1)))

    def close(self) -> None:
        pass


class Links(bench.Wire):
    """The car's links, with the radio for its drive."""

    def __init__(self, radio: Radio) -> None:
        super().__init__()
        self._radio = radio

    def mavlink(self, url: str) -> Radio:
        return self._radio


class World(bench.World):
    """One car whose drive is a rover, with positions from a base station or (position="rover") from its EKF."""

    def __init__(self, body: TestBody | None = None, boot: float = 0.0, **settings: Any) -> None:
        settings = {"drive": URL, **settings}
        super().__init__(body, **{**settings, "drive": "vesc:none", "position": "udp:none"})
        self.radio = Radio()
        self.wire = Links(self.radio)
        self.wire.idle = self.physics
        self.car = Car(robot_settings(settings), KEY, self.wire, Inside)
        where = context(settings, 0.0)
        self.rover: SimulatedRover | None = SimulatedRover(
            self.body, where.__class__("bert", settings, {"boot": boot}, where.origin, 7, KEY), RoverEnd(self.radio)
        )
        self.controller = None
        if settings.get("position") == "rover":
            self.station = None

    def physics(self, seconds: float) -> None:
        for _ in range(round(seconds / bench.PHYSICS)):
            super().physics(bench.PHYSICS)
            if self.rover is not None:
                self.rover.step(self.now)

    def begin(self) -> World:
        self.car.start(self.now)
        self.run(4.0)
        assert self.car.ready, self.car.progress
        return self

    def overrides(self) -> list[tuple[int, int]]:
        """Steering and throttle of what was sent since this was asked last."""
        sent, self.radio.up = self.radio.up, []
        messages = [m for data in sent for m in Framer().datagram(data)]
        return [(m.chan1_raw, m.chan3_raw) for m in messages if m.get_msgId() == OVERRIDE]


@pytest.mark.parametrize("position", ["udp:0.0.0.0:47300", "rover"])
def test_a_rover_drives_to_a_point_and_is_disarmed_at_the_end(position: str) -> None:
    world = World(position=position, max_speed=1.5).begin()
    assert world.rover is not None and world.rover.armed and world.rover.mode == MANUAL
    world.go(3.0, 1.0)
    world.run(10.0)
    assert world.value("reached") is True and standing(world), world.car.progress
    assert world.distance(3.0, 1.0) < 0.12
    world.car.stop(world.now)
    world.run(1.0)
    assert world.car.stopped
    world.car.close()
    world.physics(0.1)
    assert not world.rover.armed


def test_it_is_not_armed_before_it_can_be_and_the_rovers_own_words_are_told() -> None:
    world = World(boot=10.0)
    world.car.start(world.now)
    world.run(6.0)
    assert not world.car.ready and world.car.progress == "arming: Arm: Need Position Estimate"
    world.run(8.0)
    assert world.car.ready


def test_neutral_goes_out_at_20_hz_whenever_it_is_braked() -> None:
    world = World().begin()
    world.overrides()
    world.run(1.0)
    assert world.overrides() == [(1500, 1500)] * 20
    world.go(4.0, 0.0)
    world.run(2.0)
    assert max(throttle for _, throttle in world.overrides()) > 1600
    world.car.stop(world.now)
    world.run(1.0)
    assert world.overrides() == [(1500, 1500)] * 20 and standing(world)


def test_all_overrides_come_from_system_255_and_leave_other_channels_alone() -> None:
    world = World().begin()
    messages = [m for data in world.radio.up for m in Framer().datagram(data)]
    sent = [m for m in messages if m.get_msgId() == OVERRIDE]
    assert sent and {m.get_srcSystem() for m in messages} == {255}
    assert {(m.chan2_raw, m.chan4_raw, m.chan8_raw, m.target_system) for m in sent} == {(65535, 65535, 65535, 1)}


def test_a_pilot_who_takes_the_mode_keeps_it_and_gets_the_sticks() -> None:
    world = World().begin()
    world.go(5.0, 0.0)
    world.run(1.5)
    assert world.rover is not None
    world.rover.mode = HOLD
    world.run(1.5)
    assert world.car.progress == "braking: somebody has changed the rover to mode 4, and controls it"
    assert world.rover.mode == HOLD and not world.car.ready
    world.overrides()
    world.run(0.5)
    assert set(world.overrides()) == {(0, 0)}
    world.rover.mode = MANUAL
    world.run(2.0)
    assert standing(world), "not even when it is given back"
    assert any("mode 4" in line for line in world.car.log_lines())
    world.car.close()
    world.physics(0.1)
    assert world.rover.armed, "whose it is now decides"


def test_one_that_is_disarmed_is_not_armed_again() -> None:
    world = World().begin()
    assert world.rover is not None
    world.rover.armed = False
    world.run(3.0)
    assert not world.rover.armed and "disarmed" in world.car.progress


def test_a_rover_that_falls_silent_brakes_it_and_is_unready_after_a_while() -> None:
    world = World().begin()
    world.go(5.0, 0.0)
    world.run(1.5)
    world.radio.cut = True
    world.run(2.0)
    assert "nothing has come from the rover for" in world.car.progress
    world.radio.cut = False
    world.run(1.0)
    assert world.car.progress.startswith("driving"), "it goes on"
    world.radio.cut = True
    with pytest.raises(Unready, match="nothing has come from"):
        world.run(LOST + 1.0)
    assert standing(world), "three seconds after the last override"


def test_a_rover_that_is_never_heard_is_unready() -> None:
    world = World()
    world.rover = None
    world.car.start(world.now)
    world.run(1.0)
    assert world.car.progress == f"waiting for a heartbeat on {URL}"
    with pytest.raises(Unready, match="nothing has come from"):
        world.run(STARTING + 1)


def test_garbage_on_the_link_does_not_keep_it_from_driving() -> None:
    world = World()
    world.radio.meddle = lambda data: os.urandom(30) + data + os.urandom(5)
    world.begin()
    world.go(2.0, 0.0)
    world.run(6.0)
    assert world.value("reached") is True


def test_a_copter_is_not_driven(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World()
    monkeypatch.setattr(mavlink, "MAV_TYPE_GROUND_ROVER", mavlink.MAV_TYPE_QUADROTOR)
    world.car.start(world.now)
    with pytest.raises(Unready, match="is not an ArduPilot rover"):
        world.run(2.0)
    assert not world.overrides()


def test_the_geofence_brakes_a_rover_too(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(max_speed=2.0).begin()
    navigator = world.car._navigator
    assert navigator is not None
    monkeypatch.setattr(navigator, "step", lambda state, standing, now: Command(2.0, 0.0))
    world.go(5.0, 0.0)
    outside = []
    world.run(8.0, lambda: outside.append(beyond(FENCE, world.body.truth.x, world.body.truth.y)))
    assert -2.0 < max(outside) < 0.0


@pytest.mark.parametrize("position", ["udp:0.0.0.0:47300", "rover"])
def test_diagnosis_arms_nothing(position: str) -> None:
    world = World(position=position)
    found = {f.name: f for f in world.car.diagnose()}
    assert list(found) == ["drive", "parameters", "watchdog", "position", "place", "limits", "controller", "planner"], (
        found
    )
    assert {f.state for f in found.values()} == {"ok"}, found
    assert "ArduPilot rover 4.7.0 answers" in found["drive"].found and "11.1 V" in found["drive"].found
    assert world.rover is not None and not world.rover.armed and world.rover.mode == HOLD
    assert not world.overrides()


def test_diagnosis_of_a_silent_rover() -> None:
    world = World()
    world.rover = None
    assert "waiting for a heartbeat" in world.car.diagnose()[0].found


def test_diagnosis_of_an_estimate_that_is_not_there() -> None:
    found = {f.name: f for f in World(boot=60.0, position="rover").car.diagnose()}
    assert found["position"].state == "fail" and "has not reported its position" in found["position"].found


def test_a_rover_without_an_estimate_is_waited_for_and_then_unready() -> None:
    world = World(boot=100.0, position="rover")
    world.car.start(world.now)
    with pytest.raises(Unready, match="has not reported its position"):
        world.run(61.0)


@pytest.mark.parametrize("share", [-1.0, -0.5, -0.01, 0.0, 0.003, 0.2, 1.0])
def test_a_channel_is_what_the_rover_makes_of_it(share: float) -> None:
    rover = SimulatedRover(TestBody(), context({"drive": URL}, 0.0), RoverEnd(Radio()))
    rover._override[1] = (channel(share), 0.0)
    assert rover.stick(1, 0.0) == pytest.approx(share, abs=0.0011)
    assert rover.stick(1, 3.1) == 0.0, "three seconds later it is neutral"


def test_channels_have_their_ends() -> None:
    assert [channel(s) for s in (-9.0, -1.0, 0.0, 1.0, 9.0)] == [1000, 1000, 1500, 2000, 2000]
    with pytest.raises(ValueError, match="not a share"):
        channel(math.nan)


def test_a_left_turn_is_less_than_1500() -> None:
    world = World().begin()
    world.overrides()
    drive = world.car._drive
    assert drive is not None
    drive.go(Command(0.5, 0.4), 0.5, world.now)
    drive.go(Command(0.5, -0.4), 0.5, world.now)
    assert [steering for steering, _ in world.overrides()] == [1000, 2000]


@pytest.mark.parametrize("full", [2.0, 3.0, 4.0])
@pytest.mark.parametrize("lag", [0.1, 0.3, 0.5])
def test_the_speed_loop_reaches_a_speed_though_full_speed_was_measured_wrong(full: float, lag: float) -> None:
    loop, speed, fastest = SpeedLoop(3.0), 0.0, 0.0
    for _ in range(100):
        throttle = loop.throttle(1.2, speed, 0.05)
        for _ in range(10):
            speed += (full * throttle - speed) * 0.005 / lag
        fastest = max(fastest, speed)
    assert speed == pytest.approx(1.2, abs=0.03) and fastest < 1.2 * 1.35


def test_a_speed_that_nobody_knows_is_fed_forward() -> None:
    assert SpeedLoop(3.0).throttle(1.5, None, 0.05) == pytest.approx(0.5)
    with pytest.raises(ValueError, match="not a speed"):
        SpeedLoop(3.0).throttle(math.inf, 0.0, 0.05)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ({"position": "rover"}, "position is rover, but the drive is not a rover"),
        ({"drive": URL, "max_speed": 4.0}, "max_speed 4 is more than full_speed 3"),
    ],
)
def test_settings_that_do_not_go_together(body: dict[str, Any], message: str) -> None:
    with pytest.raises(Unready, match=message) as refused:
        decode(body)
    assert refused.value.hint


def test_a_rovers_steering_is_not_bounded_by_a_servo() -> None:
    assert CarSettings(drive=URL, max_steering=0.6).steering_limit == 0.6


def test_over_udp_its_watchdog_goes_neutral_when_the_agent_is_stuck() -> None:
    """The process that it is, to the address that the rover speaks from."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as rover:
        rover.bind(("127.0.0.1", 0))
        rover.setblocking(False)
        probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
        probe.close()
        settings = CarSettings(drive=f"rover:udpin:127.0.0.1:{port}")
        drive = RoverDrive(settings, opened(f"udpin:127.0.0.1:{port}"), WatchdogProcess(), LocalFrame(47.0, 8.0, 0.0))
        packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        beat = mavlink.MAVLink_heartbeat_message(10, 3, armed, MANUAL, 4, 3)
        status = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 11100, 0, 0, 0, 0, 0, 0, 0, 0)
        nothing = bytes(8)
        version = mavlink.MAVLink_autopilot_version_message(0, 4 << 24, 0, 0, 0, nothing, nothing, nothing, 0, 0, 0)
        end = time.monotonic() + 10.0
        try:
            while drive.blocked or not drive.heard:
                assert time.monotonic() < end, drive.blocked
                for message in (beat, status, version):
                    rover.sendto(message.pack(packer), ("127.0.0.1", port))
                time.sleep(0.02)
                drive.read(time.monotonic())
                drive.go(Command(1.0, 0.0), 0.0, time.monotonic())
            stuck, neutral = time.monotonic(), []
            while time.monotonic() < stuck + 0.5:
                if not select.select([rover], [], [], 0.02)[0]:
                    continue
                for got in Framer().datagram(rover.recv(2048)):
                    if got.get_msgId() == OVERRIDE and got.chan3_raw == 1500:
                        neutral.append(time.monotonic() - stuck)
            assert 0.1 < neutral[0] < 0.2 and len(neutral) >= 5
        finally:
            drive.close(standing=True)
