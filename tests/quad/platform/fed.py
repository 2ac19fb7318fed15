"""A quad that is told where it is: the rig with a base station, all in memory and on the rig's clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from msgspec.structs import replace

from benchmarks.fixtures.quad_rig import ORIGIN, STEP, Rig, settings
from koordgen.runtime.values.points import Point, Pose
from koordgen.runtime.vehicle.feed import Sample, encode
from targets.planning.process import Inside
from targets.quad.platform.platform import Quad
from targets.sim.base.bodies import BodyState, DeviceContext
from targets.sim.sensing.station import BaseStation

KEY = bytes(range(32))
WALL = 1_750_000_000.0  # the time of day when the agent's clock shows 0


class Cable:
    """A DatagramLink in memory."""

    def __init__(self) -> None:
        self.waiting: deque[bytes] = deque()
        self.closed = False

    def receive(self) -> bytes | None:
        return self.waiting.popleft() if self.waiting else None

    def close(self) -> None:
        self.closed = True


class Markers:
    """What the cameras see of a body: the truth, and `moved` away from it."""

    def __init__(self, body: Any) -> None:
        self._body = body
        self.moved = Point()

    def state(self) -> BodyState:
        seen: BodyState = self._body.state()
        x, y, z = seen.position
        return replace(seen, position=(x + self.moved.x, y + self.moved.y, z + self.moved.z))


class FedRig(Rig):
    """`station` None: nothing is sent. `meddle` may change, damage or drop (None) what is."""

    def __init__(self, mode: str, noise: float = 0.005, delay: float = 0.0, **how: Any) -> None:
        self.cable = Cable()
        self.alter: Callable[[bytes], bytes | None] = lambda datagram: datagram
        self.station: BaseStation | None = None
        super().__init__(positioning=mode, **how)
        self.markers = Markers(self.body)
        harness = {"position_noise": noise, "position_delay": delay}
        self.station = BaseStation(self.markers, DeviceContext("alice", {}, harness, ORIGIN, 7, KEY))

    def agent(self, **body: Any) -> Quad:
        return Quad(
            settings(**body), KEY, connect=lambda url: self.wire, clock=lambda: self.now, sleep=self.pass_time,
            bind=lambda setting: self.cable, wall=lambda: WALL + self.now, planning=Inside,
        )  # fmt: skip

    def pass_time(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP)):
            super().pass_time(STEP)
            if self.station is not None and (datagram := self.station.sample(self.now, self.now)) is not None:
                altered = self.alter(datagram)
                if altered is not None:
                    self.cable.waiting.append(altered)


def sample(sequence: int, sent: float, pose: Pose, **change: Any) -> bytes:
    """A datagram of a later session than the rig's station's."""
    given = {"robot": "alice", "key": KEY, "session": 2, **change}
    return encode(Sample(given["robot"], given["session"], sequence, sent, pose), given["key"])
