"""Simulated lidar of a robot: ranges in the simulated world, sent in the format of a real driver."""

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
from targets.sim.physics.ray_casting import LidarMount
from targets.sim.physics.world import Rigid, SimulatedWorld

SETTING = "scans"  # setting of a robot that holds the lidar's address


class LidarCarrier(Protocol):
    """Body on which a lidar is mounted."""

    rigid: Rigid

    def state(self) -> BodyState: ...


class SimulatedLidar:
    """Device that simulates a lidar with `lidar.rate` turns a second.

    Ranges have `lidar.noise` (m, standard deviation; None: the harness's `position_noise`), the position sent with them
    has `position_noise`. The first turn begins at a random time, so that the lidars of all robots do not turn in the
    same step. Raises BadScenario."""

    def __init__(
        self,
        world: SimulatedWorld,
        body: LidarCarrier,
        context: DeviceContext,
        lidar: Lidar | None = None,
        port: Port | None = None,
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
        # A noisy hit must never reach the value that stands for no hit.
        self._farthest = lidar.range * (1 - 1e-6)
        self._random = random.Random(f"{context.seed} {context.robot} lidar")
        self._next = self._random.uniform(0.0, self._period)
        self._sequence = 0
        self.overrides: Mapping[str, Any] = {}
        if port is None:
            port = context.wiring.port()
            self.overrides = {SETTING: f"udp:127.0.0.1:{port.number}"}
        self._port = port

    def cast_rays(self) -> tuple[Vector, list[float | None]]:
        """Return the robot's true position and the range (m) of each ray, None without a hit.

        Rays start there, at the height of the middle of the body, and end at another robot or an obstacle, not at the
        floor or the robot itself."""
        position, height = self._body.state().position, self._body.rigid.motion().position[2]
        place = (position[0], position[1], height)
        (found,) = self._world.cast_rays([LidarMount(place, self._rays, self._range, self._body.rigid.number)])
        return position, [None if r == math.inf else r for r in found.tolist()]

    def step(self, now: float) -> None:
        """See Device."""
        if now < self._next:
            return
        self._next = max(self._next + self._period, now)
        self._port.send(self._turn())

    def _turn(self) -> bytes:
        position, found = self.cast_rays()
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
