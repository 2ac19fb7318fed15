"""A quad without an autopilot: the ports of a quad over a body that flies at the velocity it is asked for.

For simulators, of fidelity `simple`. A program meets the same as on a quad: it takes off before it is ready, targets
are raised to the flight height and kept inside the geofence, paths are planned and refused, it holds, it lands to rest.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from functools import partial
from typing import Protocol

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.datagrams import DatagramLink
from koordgen.runtime.vehicle.platform import Finding, Unready
from koordgen.runtime.vehicle.scans import listen_for_scans
from koordgen.runtime.vehicle.simulator_services import SimulatorServices
from targets.planning.process import Beside, bounded
from targets.quad.autopilot.telemetry import Telemetry
from targets.quad.motion.avoidance import MakePlanning
from targets.quad.motion.motion import Motion
from targets.quad.motion.yaw import heading
from targets.quad.platform.platform import Quad

LAG = 0.15  # s in which the body follows a velocity
GAIN = 2.0  # 1/s: velocity by distance from the reference
TURNING_GAIN, MAX_TURNING = 2.0, 1.5  # 1/s, rad/s
SINKING = 0.5  # m/s, landing
ARRIVED = 0.05  # m below the flight height at which the climb is over
LANDED, SETTLING = 0.05, 0.5  # m, s: below this height for this long, it counts as landed
GONE = 10.0  # s without a word of the body after which a landing quad waits no longer: its simulator has ended


class Seen(Protocol):
    """What is known of a body: position (m) and velocity (m/s), ENU, and yaw (rad)."""

    @property
    def position(self) -> tuple[float, float, float]: ...

    @property
    def velocity(self) -> tuple[float, float, float]: ...

    @property
    def yaw(self) -> float: ...


class Flyer(Protocol):
    """The body. It flies on with what it was asked for last."""

    def state(self) -> Seen | None:
        """None: its position is not known now."""
        ...

    def fly(self, velocity: tuple[float, float, float], yaw_rate: float) -> None: ...

    def motors(self, on: bool) -> None: ...


class Phase(enum.Enum):
    """They follow in this order."""

    GROUNDED = "waiting to take off"
    CLIMBING = "climbing"
    FLYING = "flying"
    LANDING = "landing"
    RESTED = "at rest"


class SimpleMotion(Motion):
    """Follows its reference with a body instead of an autopilot."""

    def fly(self, body: Flyer, state: Telemetry, now: float) -> None:
        """Ask for the next velocity."""
        position = state.position
        if position is None:
            return
        self._attend(position, state.velocity, now)
        self.followed = True
        # Asked for as much earlier as it will be late.
        velocity = self._reference.at(LAG).velocity + (self._reference.at(0.0).position - position) * GAIN
        v = self._limits.limited(velocity)
        yaw = self._yaw.command(state, self._reference.at(0.0).velocity, now)
        body.fly((v.x, v.y, v.z), turning(state.yaw, yaw))
        self._judge(position, state.velocity, now)


def turning(yaw: float | None, wanted: float | None) -> float:
    """Return the yaw rate towards a heading."""
    if yaw is None or wanted is None:
        return 0.0
    off = (wanted - yaw + math.pi) % math.tau - math.pi
    return max(-MAX_TURNING, min(MAX_TURNING, TURNING_GAIN * off))


class SimpleQuad(Quad):
    """Implements koordgen.runtime.vehicle.platform.Platform."""

    def __init__(
        self, settings: Settings, key: bytes | None, flyer: Flyer, *,
        scans: Callable[[str], DatagramLink] = listen_for_scans, planning: MakePlanning = Beside,
    ) -> None:  # fmt: skip
        super().__init__(settings, key, scans=scans, planning=planning)
        self._flyer = flyer
        self._positioning = None  # its place is known
        own = self._body
        self._motion = self._direct = SimpleMotion(
            self._frame, settings.geofence, own.flight_height, own.max_speed, own.max_acceleration, own.max_climb,
            own.reached_radius, own.reached_dwell, heading(own.yaw), ways=self._avoidance,
            action=settings.safety.missed_action,
        )  # fmt: skip
        self._phase = Phase.GROUNDED
        self._started = False
        self._descent = 0.0  # when it began to land
        self._low: float | None = None  # since when it is as low as the ground, landing

    def diagnose(self) -> list[Finding]:
        """See Platform: there is nothing to look at."""
        return [Finding("body", "ok", "a simple one")]

    def start(self, now: float) -> None:
        """See Platform."""
        self._now, self._started = now, True
        self._avoidance.start()
        self._lidar.open()

    def poll(self, now: float) -> None:
        """See Platform."""
        if not self._started:
            raise Unready("the quad was not started")
        self._now, self._steered = now, False
        self._lidar.poll(now)
        self._avoidance.poll()
        self._see(now)
        if self._phase is Phase.FLYING:
            if self._telemetry.fresh(now):
                self._direct.fly(self._flyer, self._telemetry, now)
                self._steered = True
                return
            self._motion.coast(now)
            self._flyer.fly((0.0, 0.0, 0.0), 0.0)
        elif self._telemetry.position is not None:
            self._move(self._telemetry.position, now)
        if self._phase is Phase.LANDING and now - max(self._descent, self._telemetry.time or 0.0) > GONE:
            raise Unready(f"nothing has been heard of the simulated body for {GONE:g} s", "did its simulator end?")

    def _see(self, now: float) -> None:
        seen, known = self._flyer.state(), self._telemetry
        if seen is not None:
            known.position, known.velocity = Point(*seen.position), Point(*seen.velocity)
            known.yaw, known.time = seen.yaw, now

    def _move(self, position: Point, now: float) -> None:
        """Up or down."""
        match self._phase:
            case Phase.GROUNDED if not self._held:
                self._phase = Phase.CLIMBING
                self._flyer.motors(True)
            case Phase.CLIMBING:
                self._flyer.motors(True)  # again: what goes to another process may be lost
                left = self._body.flight_height - position.z
                self._flyer.fly((0.0, 0.0, min(self._body.max_climb, GAIN * max(left, ARRIVED))), 0.0)
                if left < ARRIVED:
                    self._phase = Phase.FLYING
            case Phase.LANDING:
                self._flyer.fly((0.0, 0.0, -SINKING), 0.0)
                low = position.z < LANDED and abs(self._telemetry.velocity.z) < SINKING / 2
                self._low = None if not low else now if self._low is None else self._low
                if self._low is not None and now - self._low >= SETTLING:
                    self._flyer.motors(False)
                    self._phase = Phase.RESTED

    @property
    def ready(self) -> bool:
        """See Platform."""
        there = self._phase is Phase.FLYING and self._telemetry.fresh(self._now) and self._motion.followed
        return there and not self._lidar.waiting and not self._avoidance.waiting

    @property
    def progress(self) -> str:
        """See Platform."""
        waiting = "".join(f"; {what}" for what in (self._lidar.waiting, self._avoidance.waiting) if what)
        return self._phase.value + waiting

    def hold(self, on: bool, now: float) -> None:
        """See Platform."""
        self._held = on
        self._motion.hold(on, now)

    def rest(self, now: float) -> None:
        """See Platform: lands."""
        if self._moves_aside(now):
            return
        if self._phase in (Phase.CLIMBING, Phase.FLYING):
            self._phase, self._descent = Phase.LANDING, now
            self._motion.coast(now)
        elif self._phase is Phase.GROUNDED:
            self._phase = Phase.RESTED

    @property
    def rested(self) -> bool:
        """See Platform."""
        return self._phase is Phase.RESTED or not self._started

    def close(self) -> None:
        """See Platform. A body in the air is left to what it does when nothing more comes."""
        self._lidar.close()
        self._avoidance.close()


def inside(settings: Settings, key: bytes | None, surroundings: SimulatorServices, flyer: Flyer) -> SimpleQuad:
    """In a simulator that owns time; see koordgen.runtime.vehicle.simulator_services."""
    return SimpleQuad(
        settings, key, flyer, scans=surroundings.exchange, planning=partial(bounded, surroundings)
    )  # fmt: skip
