"""A stand-in for an ArduPilot copter in its SITL build: speaks the JSON interface byte for byte, by an encoder and a
parser of its own, written from ArduPilot's readme.md and SIM_JSON.cpp, and flies by what it is told.

As a program it is a whole one, `ardupilot.py INSTANCE MAVLINK_PORT`: the modes and the MAVLink of the simulated
autopilot, which gets its state and moves its motors by that interface alone.
"""

from __future__ import annotations

import math
import re
import select
import socket
import struct
import sys
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

Vector = tuple[float, float, float]
GRAVITY = 9.80665
RATE = 1200  # SIM_RATE_HZ
LOOP_RATE = 400  # SCHED_LOOP_RATE
# What SIM_JSON.cpp looks for: the text of a key, and how many numbers stand behind it.
KEYS = {"timestamp": 1, "gyro": 3, "accel_body": 3, "position": 3, "attitude": 3, "quaternion": 4, "velocity": 3}
REQUIRED = {"timestamp", "gyro", "accel_body", "position", "velocity"}
_NUMBER = r"\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)"


def frame(count: int, pwm: list[int], rate: int = RATE, magic: int = 18458) -> bytes:
    """struct servo_packet, on a machine with its low bytes first."""
    found = magic.to_bytes(2, "little") + rate.to_bytes(2, "little") + count.to_bytes(4, "little")
    for value in pwm:
        found += struct.pack("<H", value)
    return found


def sensors(datagram: bytes) -> dict[str, tuple[float, ...]] | None:
    """As SIM_JSON.cpp reads it: the last line between two line ends, keys by their text, no syntax looked at. None
    where it would stop: a field that must be there is not."""
    lines = datagram.split(b"\n")
    if len(lines) < 3:
        return None
    text = lines[-2].decode("ascii")
    found = {}
    for key, count in KEYS.items():
        at = text.find(key)
        if at < 0:
            continue
        rest = text[at + len(key) + 2 :]  # the quote and the colon
        pattern = _NUMBER if count == 1 else r"\[" + ",".join([_NUMBER] * count) + r"\]"
        match = re.match(pattern, rest)
        if match is None:
            return None
        found[key] = tuple(float(v) for v in match.groups())
    attitude = "attitude" in found or "quaternion" in found
    return found if attitude and found.keys() >= REQUIRED else None


@dataclass
class State:
    """What it knows of itself: NED and FRD, as it was told."""

    time: float
    gyro: Vector
    force: Vector
    position: Vector
    velocity: Vector
    attitude: tuple[float, float, float, float]


def state(told: dict[str, Any]) -> State:
    return State(
        told["timestamp"][0], told["gyro"], told["accel_body"], told["position"], told["velocity"], told["quaternion"]
    )


def body_frame(v: Vector, q: tuple[float, float, float, float]) -> Vector:
    """A vector of the world in the body's frame, by the rotation matrix of the attitude (w, x, y, z)."""
    w, x, y, z = q
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    a, b, c = (sum(rows[i][k] * v[i] for i in range(3)) for k in range(3))
    return a, b, c


def outputs(seen: State, acceleration: Vector, yaw_rate: float) -> list[int]:
    """The PWM of 16 channels for an acceleration (m/s^2, NED) and a yaw rate (rad/s, clockwise): quad X, ArduCopter's
    order of motors."""
    lift = (acceleration[0], acceleration[1], acceleration[2] - GRAVITY)
    x, y, z = body_frame(lift, seen.attitude)
    size = math.sqrt(x * x + y * y + z * z)
    # Thrust is along -z; what turns it to `lift` is the axis across both.
    wanted = (10.0 * y / size, -10.0 * x / size, yaw_rate)
    roll, pitch, yaw = (w - g for w, g in zip(wanted, seen.gyro, strict=True))
    thrust = max(0.0, -z) * 1.4 / (2.2 * 1.4 * 9.81)
    motors = (
        thrust - 0.1 * roll + 0.1 * pitch + 0.2 * yaw,  # front right, which turns counter-clockwise
        thrust + 0.1 * roll - 0.1 * pitch + 0.2 * yaw,  # rear left, too
        thrust + 0.1 * roll + 0.1 * pitch - 0.2 * yaw,  # front left
        thrust - 0.1 * roll - 0.1 * pitch - 0.2 * yaw,  # rear right
    )
    shares = [min(1.0, max(0.02, motor)) for motor in motors]
    commands = [(-0.35 + math.sqrt(0.35**2 + 4 * 0.65 * share)) / (2 * 0.65) for share in shares]
    return [round(1000 + 1000 * command) for command in commands] + [0] * 12


def single(value: float) -> float:
    """The nearest number of single precision, in which ArduPilot keeps its rate."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


class StandIn:
    """The process without its sockets. `armed` flies to `target` (m, NED), else its motors stand still.

    As SIM_JSON.cpp, it adopts the rate at which states come, by the time from one to the next, and asks for 1 Hz more
    until that is `wanted`. Its gyro gives one sample for each state, and it does not arm by a slow one."""

    def __init__(self, channels: int = 16, wanted: int = RATE) -> None:
        self.count = 0
        self.wanted = wanted
        self.rate = float(wanted)
        self.armed = False
        self.target: Vector = (0.0, 0.0, -2.0)
        self.seen: State | None = None
        self.times: list[float] = []  # of all states
        self._second: deque[float] = deque()  # those of the last second
        self._channels = channels
        self._pwm = [1000] * 4 + [0] * 12

    def output(self) -> bytes:
        """The frame that it sends, and sends again when nothing comes."""
        pwm = self._pwm + [0] * (self._channels - 16)
        return frame(self.count, pwm, int(self.rate), magic=18458 if self._channels == 16 else 29569)

    @property
    def gyro_rate(self) -> float:
        """Return the gyro's sample rate (Hz) over the last second of the autopilot's own clock."""
        return len(self._second) / min(1.0, max(self.times[-1] - self.times[0], 1e-3))

    @property
    def fault(self) -> str:
        """The pre-arm check that fails, in ArduPilot's words (AP_Arming::ins_checks); "" when none does."""
        least = 1.8 * LOOP_RATE
        return "" if self.gyro_rate >= least else f"Gyro 0 rate {self.gyro_rate:.0f}Hz < loop ratex1.8 {least:.0f}Hz"

    def arm(self) -> None:
        """Arm, unless a check fails."""
        assert not self.fault, self.fault
        self.armed = True

    def take(self, datagram: bytes) -> bytes:
        """One state, and the frame that follows it."""
        told = sensors(datagram)
        assert told is not None, datagram
        before, self.seen = self.seen, state(told)
        seen = self.seen
        step = seen.time - before.time if before is not None else 0.0
        if 0.0 < step < 0.1:
            self.rate = single(1.0 / step)
        self.rate = single(max(self.rate - 1, min(self.rate + 1, float(self.wanted))))
        self.times.append(seen.time)
        self._second.append(seen.time)
        while self._second[0] <= seen.time - 1.0:
            self._second.popleft()
        self.count += 1
        self._pwm = self.fly(seen) if self.armed else [1000] * 4 + [0] * 12
        return self.output()

    def fly(self, seen: State) -> list[int]:
        wanted = [
            max(-2.0, min(2.0, 1.5 * (t - p) - 2.2 * v))
            for t, p, v in zip(self.target, seen.position, seen.velocity, strict=True)
        ]
        return outputs(seen, (wanted[0], wanted[1], wanted[2]), 0.0)


class Remote:
    """A `bodies.Quadrotor` behind the interface, for the simulated autopilot."""

    def __init__(self, stand_in: StandIn) -> None:
        self._stand_in = stand_in
        self._asked: tuple[Vector, float] = ((0.0, 0.0, 0.0), 0.0)
        stand_in.fly = lambda seen: outputs(seen, *self._asked)  # type: ignore[method-assign]

    def state(self) -> Any:
        from targets.sim.base.bodies import BodyState

        seen = self._stand_in.seen
        assert seen is not None
        w, x, y, z = seen.attitude
        yaw = math.pi / 2 - math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        (n, e, d), (vn, ve, vd) = seen.position, seen.velocity
        return BodyState((e, n, -d), (ve, vn, -vd), yaw, -seen.gyro[2])

    def accelerate(self, acceleration: Vector, yaw_rate: float) -> None:
        east, north, up = acceleration
        self._asked = (north, east, -up), -yaw_rate

    def motors(self, on: bool) -> None:
        self._stand_in.armed = on


class MavlinkPort:
    """Sends to the agent's port, as SITL's --serial0 udpclient does."""

    def __init__(self, number: int) -> None:
        self._to = ("127.0.0.1", number)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)

    def receive(self) -> list[bytes]:
        found: list[bytes] = []
        while len(found) < 32:
            try:
                found.append(self._socket.recv(2048))
            except ConnectionRefusedError:
                continue
            except OSError:
                break
        return found

    def send(self, data: bytes) -> None:
        self._socket.sendto(data, self._to)

    def close(self) -> None:
        self._socket.close()


def main(instance: int, mavlink: int, origin: tuple[float, float, float]) -> None:
    """The process: it lives by the time of the states that it gets."""
    from targets.sim.autopilots.autopilot import SimulatedAutopilot
    from targets.sim.base.bodies import DeviceContext

    stand_in = StandIn()
    context = DeviceContext("external", {}, {"boot": 1.0}, origin, 1, b"")
    autopilot = SimulatedAutopilot(Remote(stand_in), context, MavlinkPort(mavlink))
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    place = ("127.0.0.1", 9002 + 10 * instance)
    link.sendto(stand_in.output(), place)
    last = time.monotonic()
    while True:
        if not select.select([link], [], [], 1.0)[0]:
            link.sendto(stand_in.output(), place)  # without an answer the same again
            if time.monotonic() - last > 60.0:
                return
            continue
        try:
            datagram = link.recv(65000)
        except ConnectionRefusedError:
            time.sleep(0.2)
            link.sendto(stand_in.output(), place)
            continue
        last = time.monotonic()
        answer = stand_in.take(datagram)
        assert stand_in.seen is not None
        autopilot.copter.failing_check = stand_in.fault
        autopilot.step(stand_in.seen.time)
        link.sendto(answer, place)


if __name__ == "__main__":
    latitude, longitude, altitude = map(float, sys.argv[3].split(","))
    main(int(sys.argv[1]), int(sys.argv[2]), (latitude, longitude, altitude))
