"""The simulated lidar of a robot: what stands around it in the world, sent as a real one's driver sends it."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from typing import Any, Protocol

from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.scans import MOST_RAYS, Sweep, encode, packed
from targets.sim.base.bodies import BodyState, DeviceContext, Vector
from targets.sim.base.ports import Port
from targets.sim.base.scenario import BadScenario, Lidar
from targets.sim.physics.sight import Eye
from targets.sim.physics.world import Rigid, World

SETTING = "scans"  # of a robot, which is pointed at the lidar


class Carrier(Protocol):
    """The body that a lidar is mounted on."""

    rigid: Rigid

    def state(self) -> BodyState: ...


class SimulatedLidar:
    """targets.sim.base.bodies.Device: turns at `lidar.rate`, with `lidar.noise` (m, standard deviation; None: the
    harness's `position_noise`) in every range and `position_noise` in the position that is told with it. Its turns
    begin at a moment of its own, or all robots' would in one step. Raises BadScenario."""

    def __init__(
        self, world: World, body: Carrier, context: DeviceContext, lidar: Lidar | None = None, port: Port | None = None
    ) -> None:
        lidar = lidar or Lidar()
        if lidar.rays > MOST_RAYS:
            raise BadScenario(
                f"{context.robot}'s lidar has {lidar.rays} rays", f"at most {MOST_RAYS} fit in a datagram"
            )
        self._world = world
        self._body = body
        self._robot, self._key = context.robot, context.key
        self._noise = float(context.harness.get("position_noise", 0.0))
        self._range_noise = self._noise if lidar.noise is None else lidar.noise
        self._rays, self._range, self._period = lidar.rays, lidar.range, 1.0 / lidar.rate
        # A noisy range of something is never taken for the range of nothing.
        self._farthest = lidar.range * (1 - 1e-6)
        self._random = random.Random(f"{context.seed} {context.robot} lidar")
        self._next = self._random.uniform(0.0, self._period)
        self._sequence = 0
        self.overrides: Mapping[str, Any] = {}
        if port is None:
            port = context.wiring.port()
            self.overrides = {SETTING: f"udp:127.0.0.1:{port.number}"}
        self._port = port

    def look(self) -> tuple[Vector, list[float | None]]:
        """The robot's true position, and how far (m) each ray goes from there, level with the middle of its body, until
        another robot or an obstacle; None: beyond its range. Neither the floor nor the robot itself ends a ray."""
        position, height = self._body.state().position, self._body.rigid.motion().position[2]
        place = (position[0], position[1], height)
        (found,) = self._world.look([Eye(place, self._rays, self._range, self._body.rigid.number)])
        return position, [None if r == math.inf else r for r in found.tolist()]

    def step(self, now: float) -> None:
        """See Device."""
        if now < self._next:
            return
        self._next = max(self._next + self._period, now)
        self._port.send(self._turn())

    def _turn(self) -> bytes:
        position, found = self.look()
        gauss, noise, farthest = self._random.gauss, self._range_noise, self._farthest
        ranges = [self._range if r is None else min(farthest, r + gauss(0.0, noise)) for r in found]
        place = Point(*(v + gauss(0.0, self._noise) for v in position))
        self._sequence += 1
        step = math.tau / self._rays
        sweep = Sweep(self._robot, 1, self._sequence, place, 0.0, step, self._range, packed(ranges, self._range))
        return encode(sweep, self._key)

    def close(self) -> None:
        """See Device."""
        self._port.close()
