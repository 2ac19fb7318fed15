"""Platform of a quad without an autopilot, on a simulated vehicle that flies at a commanded velocity.

The platform serves simulations of fidelity `simple`. A program observes the same behaviour as on a real quad:

- The quad takes off before it reports that it is ready.
- Targets are raised to the flight height and kept inside the geofence.
- Paths are planned around obstacles, and paths that lead into obstacles are refused.
- The quad holds its position on request, and its safe stop is a landing.
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

LAG = 0.15  # s, lag of the simulated vehicle's velocity behind the commanded one
GAIN = 2.0  # 1/s, proportional gain from position error (m) to velocity (m/s)
TURNING_GAIN, MAX_TURNING = 2.0, 1.5  # 1/s, proportional gain from yaw error to yaw rate; rad/s, maximum yaw rate
SINKING = 0.5  # m/s, descent rate of a landing
ARRIVED = 0.05  # m; the climb ends when the quad is less than this distance below the flight height
LANDED, SETTLING = 0.05, 0.5  # m, s: a quad that stays below the height LANDED for the time SETTLING counts as landed
GONE = 10.0  # s; if the simulator sends no vehicle state for this long during a landing, the simulator has ended


class QuadTruth(Protocol):
    """State of the simulated vehicle: position (m) and velocity (m/s) in ENU, and yaw (rad)."""

    @property
    def position(self) -> tuple[float, float, float]: ...

    @property
    def velocity(self) -> tuple[float, float, float]: ...

    @property
    def yaw(self) -> float: ...


class Flyer(Protocol):
    """Interface of a simulated vehicle, which keeps flying at the last commanded velocity."""

    def state(self) -> QuadTruth | None:
        """Return the vehicle's state, or None while the vehicle's position is unknown."""
        ...

    def fly(self, velocity: tuple[float, float, float], yaw_rate: float) -> None: ...

    def motors(self, on: bool) -> None: ...


class SimplePhase(enum.Enum):
    """Phases of a flight, in their order."""

    GROUNDED = "waiting to take off"
    CLIMBING = "climbing"
    FLYING = "flying"
    LANDING = "landing"
    STOPPED = "at rest"


class SimpleMotion(Motion):
    """Motion control that commands velocities to a simulated vehicle instead of setpoints to an autopilot."""

    def fly(self, body: Flyer, state: Telemetry, now: float) -> None:
        """Command the simulated vehicle's next velocity and yaw rate."""
        position = state.position
        if position is None:
            return
        self._attend(position, state.velocity, now)
        self.followed = True
        # The command is the reference's velocity LAG seconds ahead, because the vehicle's velocity lags by this time.
        velocity = self._reference.at(LAG).velocity + (self._reference.at(0.0).position - position) * GAIN
        v = self._limits.limited(velocity)
        yaw = self._yaw.command(state, self._reference.at(0.0).velocity, now)
        body.fly((v.x, v.y, v.z), turning(state.yaw, yaw))
        self._judge(position, state.velocity, now)


def turning(yaw: float | None, wanted: float | None) -> float:
    """Return the yaw rate (rad/s) that turns a vehicle from `yaw` to `wanted` (rad).

    The rate is 0 if `yaw` or `wanted` is None."""
    if yaw is None or wanted is None:
        return 0.0
    off = (wanted - yaw + math.pi) % math.tau - math.pi
    return max(-MAX_TURNING, min(MAX_TURNING, TURNING_GAIN * off))


class SimpleQuad(Quad):
    """Platform of a quad that is simulated without an autopilot.

    Implements koordgen.runtime.vehicle.platform.Platform."""

    def __init__(
        self, settings: Settings, key: bytes | None, flyer: Flyer, *,
        scans: Callable[[str], DatagramLink] = listen_for_scans, planning: MakePlanning = Beside,
    ) -> None:  # fmt: skip
        super().__init__(settings, key, scans=scans, planning=planning)
        self._flyer = flyer
        self._positioning = None  # no external positioning, because the simulator reports the position
        own = self._body
        self._motion = self._direct = SimpleMotion(
            self._frame, settings.geofence, own.flight_height, own.max_speed, own.max_acceleration, own.max_climb,
            own.reached_radius, own.reached_dwell, heading(own.yaw), space=self._avoidance,
            action=settings.safety.missed_action,
        )  # fmt: skip
        self._phase = SimplePhase.GROUNDED
        self._started = False
        self._descent = 0.0  # s, time at which the landing began
        self._low: float | None = None  # s, time at which the landing quad came below the height LANDED

    def diagnose(self) -> list[Finding]:
        """Return one passed check, because a simulated vehicle has nothing to check before a mission."""
        return [Finding("body", "ok", "a simple one")]

    def start(self, now: float) -> None:
        """Start the planner's process, and open the lidar's port. `poll` then takes off."""
        self._now, self._started = now, True
        self._avoidance.start()
        self._lidar.open()

    def poll(self, now: float) -> None:
        """Read the simulated vehicle's state, and command its next motion. Raises Unready."""
        if not self._started:
            raise Unready("the quad was not started")
        self._now, self._steered = now, False
        self._lidar.poll(now)
        self._avoidance.poll()
        self._see(now)
        if self._phase is SimplePhase.FLYING:
            if self._telemetry.fresh(now):
                self._direct.fly(self._flyer, self._telemetry, now)
                self._steered = True
                return
            self._motion.coast(now)
            self._flyer.fly((0.0, 0.0, 0.0), 0.0)
        elif self._telemetry.position is not None:
            self._move(self._telemetry.position, now)
        if self._phase is SimplePhase.LANDING and now - max(self._descent, self._telemetry.time or 0.0) > GONE:
            raise Unready(
                f"the simulator has sent no vehicle state for {GONE:g} s", "check whether the simulator has ended"
            )

    def _see(self, now: float) -> None:
        seen, known = self._flyer.state(), self._telemetry
        if seen is not None:
            known.position, known.velocity = Point(*seen.position), Point(*seen.velocity)
            known.yaw, known.time = seen.yaw, now

    def _move(self, position: Point, now: float) -> None:
        """Control the vehicle on the ground, in the climb and in the landing."""
        match self._phase:
            case SimplePhase.GROUNDED if not self._held:
                self._phase = SimplePhase.CLIMBING
                self._flyer.motors(True)
            case SimplePhase.CLIMBING:
                self._flyer.motors(True)  # sent in each poll, because a command to the simulator may be lost
                left = self._body.flight_height - position.z
                self._flyer.fly((0.0, 0.0, min(self._body.max_climb, GAIN * max(left, ARRIVED))), 0.0)
                if left < ARRIVED:
                    self._phase = SimplePhase.FLYING
            case SimplePhase.LANDING:
                self._flyer.fly((0.0, 0.0, -SINKING), 0.0)
                low = position.z < LANDED and abs(self._telemetry.velocity.z) < SINKING / 2
                self._low = None if not low else now if self._low is None else self._low
                if self._low is not None and now - self._low >= SETTLING:
                    self._flyer.motors(False)
                    self._phase = SimplePhase.STOPPED

    @property
    def ready(self) -> bool:
        """True if the quad flies with a fresh position, and lidar and planner are ready."""
        there = self._phase is SimplePhase.FLYING and self._telemetry.fresh(self._now) and self._motion.followed
        return there and not self._lidar.waiting and not self._avoidance.waiting

    @property
    def progress(self) -> str:
        """Phase of the flight, and the devices that the quad still waits for, for the log."""
        waiting = "".join(f"; {what}" for what in (self._lidar.waiting, self._avoidance.waiting) if what)
        return self._phase.value + waiting

    def hold(self, on: bool, now: float) -> None:
        """Hold the position, or end the hold. A held quad on the ground does not take off."""
        self._held = on
        self._motion.hold(on, now)

    def stop(self, now: float) -> None:
        """Make the safe stop: land, at first moving aside if another robot may be below."""
        if self._moves_aside(now):
            return
        if self._phase in (SimplePhase.CLIMBING, SimplePhase.FLYING):
            self._phase, self._descent = SimplePhase.LANDING, now
            self._motion.coast(now)
        elif self._phase is SimplePhase.GROUNDED:
            self._phase = SimplePhase.STOPPED

    @property
    def stopped(self) -> bool:
        """True if the quad's safe stop is complete, or the quad was never started."""
        return self._phase is SimplePhase.STOPPED or not self._started

    def close(self) -> None:
        """Close the lidar's port, and end the planner's process. A vehicle in the air is not landed."""
        self._lidar.close()
        self._avoidance.close()


def inside(settings: Settings, key: bytes | None, surroundings: SimulatorServices, flyer: Flyer) -> SimpleQuad:
    """Return a simple quad for a simulator that controls time. `key`: the fleet's key.

    `surroundings`: the simulator's services, described in koordgen.runtime.vehicle.simulator_services."""
    return SimpleQuad(
        settings, key, flyer, scans=surroundings.exchange, planning=partial(bounded, surroundings)
    )  # fmt: skip
