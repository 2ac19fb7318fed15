"""Interface of a drive: it receives commands of speed and steering, and reports measured speed and faults."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Pose
from koordgen.runtime.vehicle.platform import Finding, Unready
from targets.car.base.settings import CarSettings
from targets.car.control.mpc import Command
from targets.car.drive.links import Links
from targets.car.drive.vesc_drive import VescDrive


class Drive(Protocol):
    """Interface of an opened drive. Speeds in m/s, steering in radians, times in seconds on the agent's clock."""

    @property
    def heard(self) -> bool:
        """Return whether the drive has sent all reports that the platform needs before the car moves."""
        ...

    @property
    def fault(self) -> str:
        """Fault that the drive reports, in words; "" without a fault."""
        ...

    @property
    def blocked(self) -> str:
        """Reason why the car must not be driven now, in words; "" if it may be driven."""
        ...

    @property
    def about(self) -> str:
        """Description of the drive for a pre-flight check: kind, firmware version, supply voltage."""
        ...

    @property
    def doubt(self) -> str:
        """Warning of a pre-flight check, such as a low battery; "" without a warning."""
        ...

    @property
    def asked(self) -> float:
        """Last commanded speed (m/s) of the motor; for a rover, the speed that its throttle should give."""
        ...

    @property
    def battery(self) -> float | None:
        """Battery charge that the drive reports, 0 to 1; None if unknown."""
        ...

    def read(self, now: float) -> float | None:
        """Process received messages. Return a newly measured speed, or None.

        Raises Unready if the drive has been unplugged or silent for too long. The caller should then call `read` again
        and again, because the drive may answer again later."""
        ...

    def ask(self, now: float) -> None:
        """Request the drive's reports, without a command that moves the car."""
        ...

    def checks(self, now: float) -> list[Finding] | None:
        """Check the drive's own parameters, before a mission. Return None while the check is incomplete."""
        ...

    def fixes(self) -> Sequence[tuple[Pose, float]]:
        """Return poses that the drive has estimated since the last call, each with its time."""
        ...

    def go(self, command: Command, speed: float | None, now: float) -> None:
        """Drive with this speed and steering until the next command. If no command comes in time, the watchdog brakes.

        `speed`: measured speed, which a drive without speed control of its own needs; None if unknown."""
        ...

    def brake(self, now: float) -> None:
        """Brake the car; at standstill, command neutral."""
        ...

    def log_lines(self) -> list[str]:
        """Return messages about events since the last call, for the log."""
        ...

    def close(self, standing: bool) -> None:
        """Close the device. If the car is not `standing`, the watchdog brakes it. Idempotent."""
        ...


def opened(settings: CarSettings, links: Links, frame: LocalFrame) -> Drive:
    """Open the drive that the settings name. `frame`: the fleet's local frame. Raises Unready with a hint."""
    kind, _, place = settings.drive.partition(":")
    if kind == "vesc" and place:
        return VescDrive(place, settings, links)
    if kind == "rover" and place:
        from targets.car.drive.rover import (
            RoverDrive,
        )  # imported here, so that a car with a VESC does not load pymavlink

        return RoverDrive(settings, links.mavlink(place), links.watchdog(), frame)
    hint = "write `drive: vesc:DEVICE`, as in vesc:/dev/ttyACM0, or rover:URL, as in rover:serial:/dev/ttyACM0:115200"
    raise Unready(f"drive {settings.drive!r} is not understood", hint)
