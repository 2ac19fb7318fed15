"""The simulated lidar of a robot: what stands around it in the world, sent as a real one's driver sends it."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from typing import Any, Protocol

from koordgen.runtime.scans import Sweep, encode, packed
from koordgen.runtime.values import Point
from targets.sim.bodies import BodyState, DeviceContext, Vector
from targets.sim.world import Rigid, World

RAYS = 180  # evenly over the full turn, the first to the east
MAX_RANGE = 6.0  # metres
PERIOD = 0.2  # seconds between two turns
SETTING = "scans"  # of a robot, which is pointed at the lidar
# A noisy range of something is never taken for the range of nothing.
_FARTHEST_SEEN = MAX_RANGE * (1 - 1e-6)


class Carrier(Protocol):
    """The body that a lidar is mounted on."""

    rigid: Rigid

    def state(self) -> BodyState: ...


class SimulatedLidar:
    """targets.sim.bodies.Device: a turn each PERIOD, with `position_noise` (m, standard deviation) in every range and
    in the position that is told with it. Its turns begin at a moment of its own, or all robots' would in one step."""

    def __init__(self, world: World, body: Carrier, context: DeviceContext) -> None:
        self._world = world
        self._body = body
        self._robot, self._key = context.robot, context.key
        self._noise = float(context.harness.get("position_noise", 0.0))
        self._random = random.Random(f"{context.seed} {context.robot} lidar")
        turn = [math.tau * i / RAYS for i in range(RAYS)]
        self._ways = [(MAX_RANGE * math.cos(a), MAX_RANGE * math.sin(a)) for a in turn]
        self._next = self._random.uniform(0.0, PERIOD)
        self._sequence = 0
        self._port = context.wiring.port()
        self.overrides: Mapping[str, Any] = {SETTING: f"udp:127.0.0.1:{self._port.number}"}

    def look(self) -> tuple[Vector, list[float | None]]:
        """The robot's true position, and how far (m) each ray goes from there, level with the middle of its body, until
        another robot or an obstacle; None: beyond MAX_RANGE. Neither the floor nor the robot itself ends a ray."""
        position = self._body.state().position
        x, y, z = position[0], position[1], self._body.rigid.motion().position[2]
        shares = self._world.rays((x, y, z), [(x + dx, y + dy, z) for dx, dy in self._ways], self._body.rigid)
        return position, [None if share is None else share * MAX_RANGE for share in shares]

    def step(self, now: float) -> None:
        """See Device."""
        if now < self._next:
            return
        self._next = max(self._next + PERIOD, now)
        self._port.send(self._turn())

    def _turn(self) -> bytes:
        position, found = self.look()
        ranges = [MAX_RANGE if r is None else min(_FARTHEST_SEEN, r + self._error()) for r in found]
        place = Point(*(v + self._error() for v in position))
        self._sequence += 1
        sweep = Sweep(self._robot, 1, self._sequence, place, 0.0, math.tau / RAYS, MAX_RANGE, packed(ranges, MAX_RANGE))
        return encode(sweep, self._key)

    def _error(self) -> float:
        return self._random.gauss(0.0, self._noise)

    def close(self) -> None:
        """See Device."""
        self._port.close()
