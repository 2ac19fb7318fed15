"""The seam between the simulated world, its bodies and the devices that stand in for real ones.

A body lives in the simulated world and moves; a device (a simulated autopilot, a simulated motor controller) talks to
the robot's agent exactly as the real one would and drives its body. Frames: local ENU metres, yaw in radians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import msgspec

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.vehicle.inside import Inside
from koordgen.runtime.vehicle.platform import Platform
from targets.sim.base.ports import Loopback, Wiring
from targets.sim.base.upset import Upset

Vector = tuple[float, float, float]


class BodyState(msgspec.Struct, frozen=True):
    """The truth about a body: position (m), velocity (m/s), both ENU; yaw (rad) and its rate (rad/s)."""

    position: Vector
    velocity: Vector
    yaw: float
    yaw_rate: float


class Asked(msgspec.Struct, frozen=True, array_like=True):
    """What a body is to do, told from another process: the name of its method, and the numbers that this takes."""

    what: str
    values: tuple[float, ...]


class Quadrotor(Protocol):
    """A multicopter that follows an acceleration: the attitude loop is the body's own."""

    def state(self) -> BodyState: ...

    def accelerate(self, acceleration: Vector, yaw_rate: float) -> None:
        """Ask for an acceleration of the body's centre (m/s^2, ENU, gravity already compensated) and a yaw rate,
        until told otherwise. The body limits both and needs time to follow."""
        ...

    def motors(self, on: bool) -> None:
        """Without motors there is no thrust: the body rests or falls."""
        ...


class Car(Protocol):
    """A car that follows a speed and a steering angle; the reference point is the middle of the rear axle."""

    wheelbase: float

    def state(self) -> BodyState: ...

    def drive(self, speed: float, steering: float) -> None:
        """Ask for a speed (m/s, negative is reverse) and a steering angle (rad, positive to the left)."""
        ...

    def brake(self, deceleration: float) -> None:
        """Brake the wheels with so much (m/s^2) until `drive` is asked for; the steering stays as it is."""
        ...


@dataclass(frozen=True, slots=True)
class DeviceContext:
    """What a device is made with. `settings` are the robot's own (`body` in its settings.json), `harness` those of
    the sim target, `origin` is WGS-84 (degrees, degrees, metres), `noise` the standard deviation of sensed
    positions (m), `key` the run's fleet key, `wiring` makes its ends of what connects it with the agent, `upset` is
    what is wrong at the moment, `application` the fleet's application_id."""

    robot: str
    settings: Mapping[str, Any]
    harness: Mapping[str, Any]
    origin: tuple[float, float, float]
    seed: int
    key: bytes
    wiring: Wiring = field(default_factory=Loopback)
    upset: Upset = field(default_factory=Upset)
    application: int = 0


class Device(Protocol):
    """Stands in for one real device. `overrides` is laid over the robot's `body` settings, so that its agent finds
    it (a port on loopback, a pseudo-terminal)."""

    overrides: Mapping[str, Any]

    def step(self, now: float) -> None:
        """Called once a physics step (240 Hz) with the world's time in seconds: read commands, run the loops, drive the
        body, send what is due. Never blocks, never raises on what it received."""
        ...

    def close(self) -> None: ...


@runtime_checkable
class Embodied(Protocol):
    """A device that acts on its body directly, with nothing of the real one between: in lockstep the robot's agent has
    this platform, and not its target's."""

    def platform(self, settings: Settings, key: bytes | None, inside: Inside) -> Platform:
        """See koordgen.runtime.vehicle.inside; a new one for each start of the agent."""
        ...
