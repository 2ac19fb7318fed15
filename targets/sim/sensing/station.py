"""Simulated base station.

Measures a body's pose and sends it to the robot's agent, as motion capture does."""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from koordgen.runtime.values.points import Point, Pose
from koordgen.runtime.vehicle.datagrams import raw_clock
from koordgen.runtime.vehicle.feed import Sample, encode
from targets.sim.base.bodies import BodyState, DeviceContext

FEED_PERIOD = 0.02  # seconds
BASELINE = 0.33  # metres between the two markers from which the yaw is measured


class MarkerCarrier(Protocol):
    """Body that carries the markers."""

    def state(self) -> BodyState: ...


class BaseStation:
    """Pose measurement with seeded noise, 50 times a second.

    `position_noise`: standard deviation in metres, in each direction; the yaw error is that of two such markers. A
    measurement is sent `position_delay` seconds later, without that delay in its time stamp: real systems do not report
    the latency from camera to network either. Injected faults of the robot add to all errors."""

    def __init__(self, body: MarkerCarrier, context: DeviceContext) -> None:
        self._body = body
        self._robot = context.robot
        self._key, self._application = context.key, context.application
        self._noise = float(context.harness.get("position_noise", 0.0))
        self._delay = float(context.harness.get("position_delay", 0.0))
        self._fault_state = context.fault_state
        self._random = random.Random(f"{context.seed} {context.robot} position")
        self._sequence = 0
        self._next = -math.inf
        self._measured: deque[tuple[float, Pose]] = deque()

    def sample(self, now: float, sent: float) -> bytes | None:
        """Return the datagram that is due, or None. `now` is the world's time, `sent` the sender's clock."""
        if now >= self._next:
            self._next = max(self._next, now - FEED_PERIOD) + FEED_PERIOD
            pose = self._measure()
            if pose is not None:
                self._measured.append((now + self._delay + self._fault_state.positioning.delay, pose))
        if not self._measured or now < self._measured[0][0]:
            return None
        self._sequence += 1
        pose = self._measured.popleft()[1]
        sample = Sample(self._robot, 1, self._sequence, sent, pose, application=self._application)
        return encode(sample, self._key)

    def _measure(self) -> Pose | None:
        state = self._body.state()
        place = self._fault_state.measured(state.position, self._noise, self._random)
        if place is None:
            return None
        return Pose(Point(*place), state.yaw + self._random.gauss(0.0, math.sqrt(2) * self._noise / BASELINE))


class SimulatedFeed:
    """Device of a base station with the port that the agent's `setting` names.

    One process runs the whole world, so its `session` is 1. Samples are stamped by the host's `clock`: with the time of
    a slow world, agents would reject them as old."""

    def __init__(
        self, body: MarkerCarrier, context: DeviceContext, setting: str, clock: Callable[[], float] = raw_clock
    ) -> None:
        self._station = BaseStation(body, context)
        self._clock = clock
        self._port = context.wiring.port()
        self.overrides: Mapping[str, Any] = {setting: f"udp:127.0.0.1:{self._port.number}"}

    def step(self, now: float) -> None:
        """See Device."""
        datagram = self._station.sample(now, self._clock())
        if datagram is not None:
            self._port.send(datagram)

    def close(self) -> None:
        """See Device."""
        self._port.close()


def fed(settings: Mapping[str, Any]) -> str:
    """Return the robot's setting with the address of its pose feed; "" if it has none."""
    if "position" in settings:
        return "position"
    return "feed" if settings.get("positioning", "own") != "own" else ""
