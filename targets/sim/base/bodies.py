"""Interfaces of simulated bodies and of the devices that stand in for real hardware.

A body moves in the simulated world. A device (a simulated autopilot or motor controller) talks to the robot's agent as
the real one would, and drives the body. Frames: local ENU, metres, yaw in radians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import msgspec

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.vehicle.platform import Platform
from koordgen.runtime.vehicle.simulator_services import SimulatorServices
from targets.sim.base.fault_state import FaultState
from targets.sim.base.ports import Loopback, Wiring

Vector = tuple[float, float, float]


class BodyState(msgspec.Struct, frozen=True):
    """True state of a body: position (m) and velocity (m/s) in ENU; yaw (rad) and its rate (rad/s)."""

    position: Vector
    velocity: Vector
    yaw: float
    yaw_rate: float


class BodyCommand(msgspec.Struct, frozen=True, array_like=True):
    """Command for a body from another process: the name of a method and its arguments."""

    what: str
    values: tuple[float, ...]


class Quadrotor(Protocol):
    """Multicopter that follows an acceleration: the body has its own attitude loop."""

    def state(self) -> BodyState: ...

    def accelerate(self, acceleration: Vector, yaw_rate: float) -> None:
        """Command an acceleration of the body's centre (m/s^2, ENU, gravity compensated) and a yaw rate.

        They hold until the next command. The body limits both and needs time to follow."""
        ...

    def motors(self, on: bool) -> None:
        """Switch the motors. Without motors there is no thrust: the body rests or falls."""
        ...


class CarBody(Protocol):
    """Car that follows a speed and a steering angle; the reference point is the middle of the rear axle."""

    wheelbase: float

    def state(self) -> BodyState: ...

    def drive(self, speed: float, steering: float) -> None:
        """Command a speed (m/s, negative is reverse) and a steering angle (rad, positive to the left)."""
        ...

    def brake(self, deceleration: float) -> None:
        """Brake the wheels with this deceleration (m/s^2) until the next `drive`; the steering stays as it is."""
        ...


@dataclass(frozen=True, slots=True)
class DeviceContext:
    """Arguments of a device's constructor.

    `settings`: the robot's own (`body` in its settings.json). `harness`: settings of the sim target. `origin`: WGS-84
    (degrees, degrees, metres). `key`: the run's fleet key. `wiring`: creates the device's ends of its connections to
    the agent. `fault_state`: faults that are present now. `application`: the fleet's application_id."""

    robot: str
    settings: Mapping[str, Any]
    harness: Mapping[str, Any]
    origin: tuple[float, float, float]
    seed: int
    key: bytes
    wiring: Wiring = field(default_factory=Loopback)
    fault_state: FaultState = field(default_factory=FaultState)
    application: int = 0


class Device(Protocol):
    """Stand-in for one real device.

    `overrides` replaces entries of the robot's `body` settings, so that its agent finds the device (a port on loopback,
    a pseudo-terminal)."""

    overrides: Mapping[str, Any]

    def step(self, now: float) -> None:
        """Read commands, run the control loops, drive the body and send what is due.

        Called once per physics step (240 Hz) with the world's time in seconds. Never blocks; never raises on received
        data."""
        ...

    def close(self) -> None: ...


@runtime_checkable
class DirectlyDriven(Protocol):
    """Device that commands its body directly, without a simulated autopilot.

    In lockstep the agent uses this device's platform instead of its target's."""

    def platform(self, settings: Settings, key: bytes | None, inside: SimulatorServices) -> Platform:
        """Create the agent's platform, anew for each start. See koordgen.runtime.vehicle.simulator_services."""
        ...
