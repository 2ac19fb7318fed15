"""An external autopilot's vehicle: the bytes of ArduPilot's JSON interface, and a stand-in that flies by them."""

from __future__ import annotations

import json
import math
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random

import pytest

from targets.sim.autopilots import json_link
from targets.sim.autopilots.external import ExternalAutopilot, Socket
from targets.sim.autopilots.json_link import Servos, VehicleState
from targets.sim.base.bodies import DeviceContext
from targets.sim.base.fault_state import FaultState
from targets.sim.base.scenario import BadScenario, Robot, Sim, Start
from targets.sim.base.schedule import read
from targets.sim.physics.quadrotor import SimulatedQuadrotor
from targets.sim.physics.world import STEP, BodyMotion, SimulatedWorld
from targets.sim.run.faults import check_robots
from tests.sim.autopilots import ardupilot
from tests.sim.autopilots.ardupilot import StandIn

# Frames as a little-endian machine lays servo_packet out, written down by hand.
GOLDEN_16 = bytes.fromhex(
    "1a48" "b004" "04030201"
    "e803" "dc05" "d007" "0000" "0000" "0000" "0000" "0000" "0000" "0000" "0000" "0000" "0000" "0000" "0000" "0100"
)  # fmt: skip
GOLDEN_32 = bytes.fromhex("8173900100000000") + bytes.fromhex("e803" * 31 + "ffff")
REST = BodyMotion((1.0, 2.0, 0.06), (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_frames_of_both_kinds() -> None:
    assert json_link.servos(GOLDEN_16) == Servos(1200, 0x01020304, (1000, 1500, 2000, *[0] * 12, 1))
    assert json_link.servos(GOLDEN_32) == Servos(400, 0, (*[1000] * 31, 65535))
    assert ardupilot.frame(0x01020304, [1000, 1500, 2000, *[0] * 12, 1]) == GOLDEN_16
    assert ardupilot.frame(0, [1000] * 31 + [65535], 400, 29569) == GOLDEN_32


@pytest.mark.parametrize(
    "datagram",
    [b"", b"\x1a", GOLDEN_16[:-1], GOLDEN_16 + b"\0", GOLDEN_32[:40], b"\x1b" + GOLDEN_16[1:], bytes(40),
     GOLDEN_16[:8] + GOLDEN_32[8:]],
)  # fmt: skip
def test_what_is_no_frame(datagram: bytes) -> None:
    assert json_link.servos(datagram) is None


def test_a_state_byte_for_byte() -> None:
    """Heading east, at rest: NED and FRD."""
    vehicle = json_link.vehicle(REST, (1.0, 2.0, 0.0), REST.velocity, 9.81, STEP, 2.5)
    assert json_link.line(vehicle, 12.6, 0.5) == (
        b'\n{"timestamp":2.5,"imu":{"gyro":[0.0,0.0,0.0],"accel_body":[0.0,0.0,-9.81]},"position":[2.0,1.0,0.0],'
        b'"attitude":[0.0,0.0,1.5707963],"quaternion":[0.7071068,0.0,0.0,0.7071068],"velocity":[0.0,0.0,0.0],'
        b'"battery":{"voltage":12.6,"current":0.5}}\n'
    )


def test_the_state_is_what_ardupilots_parser_reads() -> None:
    vehicle = VehicleState(
        1e-5, (0.1, -0.2, 1e-7), (0.0, 9.0, -9.81), (1e5, -2e-7, 3.0), (-1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    )
    found = ardupilot.sensors(json_link.line(vehicle, 12.6, 0.0))
    assert found is not None and set(found) == set(ardupilot.KEYS)
    assert found["position"] == (1e5, -2e-7, 3.0) and found["gyro"] == (0.1, -0.2, 1e-7)
    assert found["timestamp"] == (1e-5,) and found["accel_body"] == vehicle.force


def spun(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """The orientation (x, y, z, w) in ENU of a body (forward, left, up) turned about its own axes: yaw, pitch, roll."""
    c, s = [math.cos(a / 2) for a in (roll, pitch, yaw)], [math.sin(a / 2) for a in (roll, pitch, yaw)]
    return (
        s[0] * c[1] * c[2] - c[0] * s[1] * s[2], c[0] * s[1] * c[2] + s[0] * c[1] * s[2],
        c[0] * c[1] * s[2] - s[0] * s[1] * c[2], c[0] * c[1] * c[2] + s[0] * s[1] * s[2],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("enu", "ned"),
    [
        ((0.0, 0.0, math.pi / 2), (0.0, 0.0, 0.0)),  # north
        ((0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2)),  # east
        ((0.3, 0.0, math.pi / 2), (0.3, 0.0, 0.0)),  # right side down, both times
        ((0.0, -0.2, math.pi / 2), (0.0, 0.2, 0.0)),  # nose up is about the axis to the left, or to the right
        ((0.1, 0.2, -2.0), (0.1, -0.2, math.pi / 2 + 2.0 - math.tau)),
    ],
)
def test_attitudes(enu: tuple[float, float, float], ned: tuple[float, float, float]) -> None:
    motion = BodyMotion((0.0, 0.0, 0.0), spun(*enu), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    vehicle = json_link.vehicle(motion, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 9.81, STEP, 0.0)
    assert json_link.angles(vehicle.attitude) == pytest.approx(ned)
    size = math.sqrt(sum(v * v for v in vehicle.force))
    assert size == pytest.approx(9.81)  # at rest, however it is turned


def test_turning_and_accelerating_in_the_bodys_frame() -> None:
    """Heading north: to the east is to the right; a turn to the left is negative."""
    motion = BodyMotion((0.0, 0.0, 0.0), spun(0, 0, math.pi / 2), (0.5, 0.0, 0.25), (0.0, 0.1, 0.7))
    vehicle = json_link.vehicle(motion, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 9.81, 0.1, 0.0)
    assert vehicle.force == pytest.approx((0.0, 5.0, -2.5 - 9.81))
    assert vehicle.gyro == pytest.approx((0.1, 0.0, -0.7))
    assert vehicle.velocity == pytest.approx((0.0, 0.5, -0.25))


def test_states_between_two() -> None:
    a = json_link.vehicle(REST, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 9.81, STEP, 1.0)
    motion = BodyMotion((0.0, 0.0, 0.0), spun(0, 0, 0.2), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    b = json_link.vehicle(motion, (2.0, 0.0, 0.0), (0.0, 0.0, 0.0), 9.81, 1.0, 2.0)
    c = json_link.interpolate(a, b, 0.5)
    assert (c.time, c.position, c.velocity) == (1.5, (0.0, 1.0, 0.0), (0.0, 0.5, 0.0))
    assert json_link.angles(c.attitude)[2] == pytest.approx(math.pi / 2 - 0.1)
    assert math.sqrt(sum(v * v for v in c.attitude)) == pytest.approx(1.0)


class Link:
    """Both ends in memory, for the device. `work` is what the stand-in does while the device waits for it."""

    def __init__(self) -> None:
        self.up: list[bytes] = []  # to the device
        self.down: list[bytes] = []
        self.work: Callable[[], None] = lambda: None

    def receive(self) -> list[bytes]:
        taken, self.up = self.up, []
        return taken

    def send(self, data: bytes) -> None:
        self.down.append(data)

    def wait(self, seconds: float) -> bool:
        self.work()
        return bool(self.up)

    def close(self) -> None: ...


class Bench:
    """A world with one quadrotor, and the stand-in that flies it. `slow` is how many states it takes in a step without
    being waited for; with `stopped` it takes none, as a process that does not run."""

    def __init__(self, channels: int = 16) -> None:
        self.world = SimulatedWorld()
        self.body = SimulatedQuadrotor(self.world, (0.0, 0.0, 0.0), 0.5)
        self.link, self.fault_state = Link(), FaultState()
        context = DeviceContext("ann", {}, {}, (47.0, 8.0, 400.0), 1, b"", fault_state=self.fault_state)
        self.device = ExternalAutopilot(self.body, context, 0, self.link)
        self.stand_in = StandIn(channels)
        self.link.up.append(self.stand_in.output())
        self.slow, self.stopped = 1000, False
        self.link.work = lambda: self.work(1)
        self.lossy: Callable[[bytes], bytes] = lambda data: data
        self.now = 50.0

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP)):
            self.device.step(self.now)
            self.work(self.slow)
            self.world.step()
            self.now += STEP

    def work(self, states: int) -> None:
        """Let the stand-in take so many states, and answer."""
        for _ in range(0 if self.stopped else min(states, len(self.link.down))):
            told = self.lossy(self.link.down.pop(0))
            answer = self.lossy(self.stand_in.take(told)) if told else b""
            if answer:
                self.link.up.append(answer)

    @property
    def height(self) -> float:
        return self.body.state().position[2]


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.world.close()


def test_it_is_told_as_many_states_as_it_wants(bench: Bench) -> None:
    bench.run(1.0)
    assert len(bench.stand_in.times) == pytest.approx(1200, abs=10)
    steps = [b - a for a, b in zip(bench.stand_in.times, bench.stand_in.times[1:], strict=False)]
    assert min(steps) == pytest.approx(1 / 1200, rel=0.01) and max(steps) == pytest.approx(1 / 1200, rel=0.01)
    assert bench.stand_in.times[0] == 0.0  # its time begins with it
    assert bench.stand_in.seen is not None and bench.stand_in.seen.force == pytest.approx((0, 0, -9.81), abs=0.01)


@pytest.mark.parametrize("channels", [16, pytest.param(32, marks=pytest.mark.slow)])
def test_it_hovers_and_climbs(channels: int) -> None:
    bench = Bench(channels)
    bench.run(0.5)
    assert bench.height == pytest.approx(0.0, abs=0.01)
    bench.stand_in.armed = True
    bench.run(6.0)
    place = bench.body.state()
    assert math.dist(place.position, (0.0, 0.0, 2.0)) < 0.1 and math.hypot(*place.velocity) < 0.05
    assert place.yaw == pytest.approx(0.5, abs=0.1)
    bench.stand_in.target = (3.0, 1.0, -5.0)  # north, east
    bench.run(8.0)
    assert math.dist(bench.body.state().position, (1.0, 3.0, 5.0)) < 0.1
    bench.world.close()


def flying(bench: Bench) -> None:
    bench.stand_in.armed = True
    bench.run(5.0)
    assert bench.height == pytest.approx(2.0, abs=0.15)


def test_lost_packets_do_not_stop_it(bench: Bench) -> None:
    flying(bench)
    dice = Random(1)
    bench.lossy = lambda data: b"" if dice.random() < 0.01 else data
    bench.run(5.0)
    assert bench.height == pytest.approx(2.0, abs=0.15) and bench.device.lost > 20
    assert bench.stand_in.times == sorted(bench.stand_in.times)


def test_when_all_is_lost_the_state_is_told_again(bench: Bench) -> None:
    flying(bench)
    bench.link.up.clear()
    bench.link.down.clear()
    bench.run(0.3)
    assert bench.height == pytest.approx(2.0, abs=0.2)
    bench.run(2.0)
    assert bench.height == pytest.approx(2.0, abs=0.15)


def test_one_that_repeats_itself_is_answered_with_the_present_state(bench: Bench) -> None:
    flying(bench)
    bench.link.up.clear()
    bench.link.up.append(bench.stand_in.output())
    bench.device.step(bench.now)
    bench.link.down.clear()
    motors, count = bench.device._last, bench.stand_in.count
    bench.link.up += [bench.stand_in.output()] * 2
    bench.device.step(bench.now)
    assert len(bench.link.down) == 1 and bench.device._last == motors and bench.device.resets == 0
    bench.stand_in.take(bench.link.down.pop())
    assert bench.stand_in.count == count + 1


def test_a_new_process_begins_a_new_time_with_still_motors(bench: Bench) -> None:
    flying(bench)
    bench.stand_in = StandIn()
    bench.link.up, bench.link.down = [bench.stand_in.output()], []
    bench.run(0.2)
    assert bench.device.resets == 1 and bench.stand_in.times[0] == 0.0
    assert bench.body.state().velocity[2] < -1.0  # it falls
    bench.stand_in.armed = True
    bench.run(6.0)
    assert bench.height == pytest.approx(2.0, abs=0.15)


def test_what_is_no_frame_is_dropped(bench: Bench) -> None:
    flying(bench)
    bench.link.up += [b"", b"\0" * 40, GOLDEN_16[:-1], b"{}\n"]
    bench.run(1.0)
    assert bench.device.dropped == 4 and bench.height == pytest.approx(2.0, abs=0.15)


def test_without_an_autopilot_motors_stop(bench: Bench) -> None:
    flying(bench)
    bench.stopped = True
    bench.run(3.0)
    assert bench.height == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("slow", [0, 2])
def test_one_that_is_too_slow_is_waited_for(bench: Bench, slow: int) -> None:
    """It takes fewer than the five states of a step in time, as on a computer that does other work."""
    bench.slow = slow
    bench.run(1.0)
    assert bench.stand_in.gyro_rate == pytest.approx(1200, abs=10)
    bench.stand_in.arm()
    bench.run(4.0)
    assert bench.height == pytest.approx(2.0, abs=0.15)
    seen = bench.stand_in.seen
    assert seen is not None and seen.time == pytest.approx(5.0, abs=0.02)


@pytest.mark.parametrize("seconds", [0.02, 0.09, 1.0])
def test_a_pause_does_not_leave_it_with_a_low_rate(bench: Bench, seconds: float) -> None:
    """It adopts a low rate at the pause, and asks for 1 Hz more than that: its arming check wants 720 Hz."""
    bench.run(0.2)
    bench.stopped = True
    bench.run(seconds)
    bench.stopped = False
    bench.run(1.2)
    assert bench.stand_in.gyro_rate == pytest.approx(1200, abs=10)
    bench.stand_in.arm()


@pytest.mark.parametrize(("wanted", "given"), [(240, 1200), (400, 1200), (1200, 1200), (2400, 2400), (8000, 3840)])
def test_the_rate_rises_to_the_wanted_one_and_never_falls_below_1200(wanted: int, given: int) -> None:
    bench = Bench()
    bench.stand_in = StandIn(wanted=wanted)
    bench.stand_in.rate = 240.0
    bench.link.up = [bench.stand_in.output()]
    bench.run(1.2)
    assert bench.stand_in.gyro_rate == pytest.approx(given, rel=0.01)
    bench.world.close()


def test_a_pause_in_flight_is_no_fall(bench: Bench) -> None:
    flying(bench)
    bench.stopped = True
    bench.run(0.2)
    bench.stopped = False
    bench.run(2.0)
    assert bench.height == pytest.approx(2.0, abs=0.15)


def test_its_battery_and_its_motors_are_upset(bench: Bench) -> None:
    bench.fault_state.battery = 0.5
    bench.run(0.1)
    bench.stopped = True
    bench.run(0.01)
    assert b'"voltage":11.55' in bench.link.down[-1]


def test_a_port_that_is_taken_is_told() -> None:
    first = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    first.bind(("127.0.0.1", 0))
    with pytest.raises(OSError, match=r"port \d+ for an external autopilot: Address already in use"):
        Socket(first.getsockname()[1])
    first.close()


def robot(**settings: str) -> Robot:
    sim = Sim(autopilot="external")
    return Robot("ann", 0, "quad", "", "quadrotor", "autopilot", Start((0, 0, 0)), settings=settings, sim=sim)


def test_positions_of_a_gps_that_is_not_ours_are_left_alone() -> None:
    schedule, _ = read({"events": [{"at": 1, "positioning": {"robot": "ann", "noise": 1}}]}, ["ann"])
    check_robots(schedule, [robot(positioning="gps_input")])
    with pytest.raises(BadScenario, match="the GPS of ann is that of its external autopilot"):
        check_robots(schedule, [robot(positioning="own")])


APP = """
using Motion:
  actuators:
    Point target
  sensors:
    Point position

Go:
  pre: True
  eff:
    Motion.target = Point(2 * pid, 3, 2)
"""
FLEET = """
delta: 0.1
origin: {latitude: 47.397742, longitude: 8.545594, altitude: 488.0}
geofence: {lo: [-6, -6, -0.5], hi: [6, 6, 4]}
sim: {min_separation: 0.5, boot: 1.0, fidelity: full}
robots:
  - {name: ann, target: quad, address: "127.0.0.1:47100", start: {position: [0, 0, 0]}}
  - name: ext
    target: quad
    address: "127.0.0.1:47101"
    start: {position: [2, 0, 0], yaw: 1.0}
    sim: {autopilot: external}
    settings: {autopilot: "udpin:127.0.0.1:PORT"}
"""


@pytest.mark.slow
@pytest.mark.parametrize("busy", [0, 2])
def test_an_agent_flies_with_an_external_autopilot(tmp_path: Path, busy: int) -> None:
    """End to end: the agent's own bundle, the simulator, and the stand-in as a process of its own; beside so many
    processes that never rest."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    (tmp_path / "go.koord").write_text(APP)
    (tmp_path / "fleet.yaml").write_text(FLEET.replace("PORT", port))
    origin = "47.397742,8.545594,488.0"
    stand_in = subprocess.Popen([sys.executable, "-m", "tests.sim.autopilots.ardupilot", "1", port, origin])
    load = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(busy)]
    out = tmp_path / "out"
    words = [str(tmp_path / "go.koord"), "--fleet", str(tmp_path / "fleet.yaml"), "--out", str(out)]
    words += ["--duration", str(14 + 8 * busy)]
    try:
        done = subprocess.run([sys.executable, "-m", "koordgen", "sim", *words], capture_output=True, text=True)
        assert stand_in.poll() is None
    finally:
        for process in (stand_in, *load):
            process.kill()
            process.wait()
    # On a busy computer an event of an agent may be late, which fails the run; the flight is as it was.
    assert done.returncode in ((0, 3) if busy else (0,)), done.stdout + done.stderr
    robots = {robot["name"]: robot for robot in json.loads((out / "summary.json").read_text())["robots"]}
    assert math.dist(robots["ext"]["final"], (2.0, 3.0, 2.0)) < 0.3
    assert robots["ext"]["stop"][2] == pytest.approx(0.0, abs=0.05)  # it has landed
    lockstep = [sys.executable, "-m", "koordgen", "sim", *words, "--lockstep"]
    done = subprocess.run(lockstep, capture_output=True, text=True)
    assert (
        done.returncode == 1
        and "ext: its external autopilot has its own clock and cannot run in lockstep" in done.stderr
    )


def test_a_robot_without_a_battery_cannot_run_out_of_it() -> None:
    schedule, _ = read({"events": [{"at": 4, "battery": {"robot": "ann", "level": 0.1}}]}, ["ann"])
    simple = Robot("ann", 0, "quad", "", "simple_quad", "simple", Start((0, 0, 0)), sim=Sim(fidelity="simple"))
    check_robots(schedule, [robot()])
    with pytest.raises(BadScenario, match="battery at 4 s: ann is simulated without a battery"):
        check_robots(schedule, [simple])
