"""A quad's agent against the simulated autopilot on one simulated clock: bytes in memory, a point mass for a body."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.settings import Box, Origin, Peer, Settings
from koordgen.runtime.values import Point
from targets.mavlink.framing import Framer, Message
from targets.mavlink.transport import Address, Chunk
from targets.planning.process import Inside
from targets.quad.platform import Quad
from targets.sim.autopilot import SimulatedAutopilot
from targets.sim.bodies import BodyState, DeviceContext, Vector
from targets.sim.quadrotor import DRAG
from targets.sim.upset import Upset

ORIGIN = (47.397742, 8.545594, 488.0)
FENCE = Box(Point(-6, -5, -0.5), Point(6, 5, 4))
STEP = 1 / 240
SETPOINT = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT


class PointMass:
    """A Quadrotor that takes 0.15 s to follow an acceleration, with the air's drag, and 0.1 s to follow a yaw rate. The
    ground is at the height at which it starts."""

    def __init__(self, position: Vector = (1.0, -2.0, 0.0)) -> None:
        self.position, self.velocity = list(position), [0.0, 0.0, 0.0]
        self.yaw = self.yaw_rate = 0.0
        self._ground, self._asked_rate = position[2], 0.0
        self._asked: Vector = (0.0, 0.0, 0.0)
        self._actual = [0.0, 0.0, 0.0]
        self._on = False

    def state(self) -> BodyState:
        x, y, z = self.position
        vx, vy, vz = self.velocity
        return BodyState((x, y, z), (vx, vy, vz), self.yaw, self.yaw_rate)

    def accelerate(self, acceleration: Vector, yaw_rate: float) -> None:
        assert all(map(math.isfinite, (*acceleration, yaw_rate)))
        self._asked, self._asked_rate = acceleration, yaw_rate

    def motors(self, on: bool) -> None:
        self._on = on

    def step(self, dt: float) -> None:
        for i in range(3):
            self._actual[i] += (self._asked[i] - self._actual[i]) * dt / 0.15
            a = (self._actual[i] if self._on else (0.0, 0.0, -9.8)[i]) - DRAG * self.velocity[i]
            self.velocity[i] += a * dt
            self.position[i] += self.velocity[i] * dt
        self.yaw_rate += (self._asked_rate * self._on - self.yaw_rate) * dt / 0.1
        self.yaw = math.remainder(self.yaw + self.yaw_rate * dt, math.tau)
        if self.position[2] <= self._ground:
            self.position[2], self.yaw_rate = self._ground, 0.0
            self.velocity = [0.0, 0.0, max(0.0, self.velocity[2])]


class Wire:
    """Both ends of a link in memory. `lossy(data, down)` may damage or drop (None) what passes; `up` is the recording
    of what the agent sent. Serves the agent as a Transport and, through `autopilot_end`, the autopilot as a Port."""

    datagrams = True

    def __init__(self) -> None:
        self.down: list[Chunk] = []
        self.waiting: list[bytes] = []
        self.up: list[bytes] = []
        self.cut = False
        self.meddle: Callable[[bytes, bool], bytes | None] = lambda data, down: data
        self.closed = False
        self.autopilot_end = _AutopilotEnd(self)

    def receive(self, now: float) -> list[Chunk]:
        taken, self.down = self.down, []
        return taken

    def answer(self, source: Address | None) -> None:
        pass

    def send(self, data: bytes) -> bool:
        self.up.append(data)
        passed = None if self.cut else self.meddle(data, False)
        if passed is not None:
            self.waiting.append(passed)
        return True

    def inject(self, data: bytes) -> None:
        """Let the agent receive this."""
        self.down.append((data, ("127.0.0.1", 1)))

    def close(self) -> None:
        self.closed = True


class _AutopilotEnd:
    def __init__(self, wire: Wire) -> None:
        self._wire = wire

    def receive(self) -> list[bytes]:
        taken, self._wire.waiting = self._wire.waiting, []
        return taken

    def send(self, data: bytes) -> None:
        passed = None if self._wire.cut else self._wire.meddle(data, True)
        if passed is not None:
            self._wire.inject(passed)

    def close(self) -> None:
        pass


def settings(**body: Any) -> Settings:
    peers = (Peer("alice", "127.0.0.1", 47100),)
    return Settings("app", "alice", 0, 0.1, peers, Origin(*ORIGIN), FENCE, body=body, planner_budget=0.1)


class Rig:
    """The pair, and the clock. `now` begins at 1000 s: no code may take 0 for the beginning of time. The autopilot
    takes off at once, unless `harness` says otherwise. `prepared` is the `positioning` that the autopilot's parameters
    were set for, where that is not the agent's own."""

    def __init__(
        self, boot: float | str = 1.0, noise: float = 0.0, autopilot: bool = True,
        position: Vector = (1.0, -2.0, 0.0), harness: dict[str, Any] | None = None,
        prepared: str = "", seed: int = 7, **body: Any,
    ) -> None:  # fmt: skip
        self.now = 1000.0
        self.body = self.vehicle(position)
        self.wire = Wire()
        self.upset = Upset()
        told = {"positioning": prepared or body.get("positioning", "own")}
        setup = {"boot": boot, "spool_up": 0.3, "position_noise": noise, **(harness or {})}
        context = DeviceContext("alice", told, setup, ORIGIN, seed, b"", upset=self.upset)
        self.autopilot = SimulatedAutopilot(self.body, context, self.wire.autopilot_end) if autopilot else None
        self.quad = self.agent(**body)
        self.progress: list[str] = []
        self.watch: Callable[[], None] = lambda: None

    def vehicle(self, position: Vector) -> PointMass:
        """The body that the autopilot flies."""
        return PointMass(position)

    def agent(self, **body: Any) -> Quad:
        """A new agent process on the same wire."""
        return Quad(
            settings(**body), None, connect=lambda url: self.wire, clock=lambda: self.now, sleep=self.pass_time,
            planning=Inside,
        )  # fmt: skip

    def pass_time(self, seconds: float) -> None:
        """The world without the agent."""
        for _ in range(round(seconds / STEP)):
            self.now += STEP
            self.body.step(STEP)
            if self.autopilot is not None:
                self.autopilot.step(self.now)

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Both, the agent polling at its period, until something holds. Whether it came to hold."""
        end = self.now + seconds
        while self.now < end:
            self.pass_time(self.quad.period)
            self.quad.poll(self.now)
            if not self.progress or self.progress[-1] != self.quad.progress:
                self.progress.append(self.quad.progress)
            self.watch()
            if until():
                return True
        return False

    def fly(self) -> None:
        """From nothing to ready."""
        self.quad.start(self.now)
        assert self.run(40.0, lambda: self.quad.ready), self.progress

    def go(self, x: float, y: float, z: float = 0.0) -> None:
        self.quad.command({"Motion.target": Point(x, y, z)}, self.now)

    def reached(self) -> bool:
        return bool(self.quad.sense(self.now).values["Motion.reached"])


def sent(rig: Rig, number: int) -> list[Message]:
    return [m for m in Framer().stream(b"".join(rig.wire.up)) if m.get_msgId() == number]


def commands(rig: Rig, command: int) -> list[Message]:
    return [m for m in sent(rig, mavlink.MAVLINK_MSG_ID_COMMAND_LONG) if m.command == command]


def at(rig: Rig) -> Point:
    return Point(*rig.body.position)


def told(data: bytes) -> int:
    """The number of a MAVLink 2 frame's message."""
    return int.from_bytes(data[7:10], "little")
