"""What drives the car, as its platform sees it: speeds and angles out, a measured speed and troubles in."""

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
    """One drive, open. Speeds in m/s, steering in radians, times in seconds on the agent's clock."""

    @property
    def heard(self) -> bool:
        """Return whether the drive has reported all that must be known before the car moves."""
        ...

    @property
    def fault(self) -> str:
        """What of it is broken, in words; "" when nothing is."""
        ...

    @property
    def blocked(self) -> str:
        """Why the car must not be driven now, in words; "" when it may."""
        ...

    @property
    def about(self) -> str:
        """What it is and says of itself, for the doctor."""
        ...

    @property
    def doubt(self) -> str:
        """What of that is not as it should be, and why; "" when all is."""
        ...

    @property
    def asked(self) -> float:
        """The speed, m/s, that the motor was asked for last: of a rover that which its throttle should give."""
        ...

    @property
    def battery(self) -> float | None:
        """The charge that the drive reports, 0 to 1; None: not known."""
        ...

    def read(self, now: float) -> float | None:
        """Take what arrived; a newly measured speed, or None. Raises Unready when it has been gone or silent for too
        long; it may come back, so go on calling it."""
        ...

    def ask(self, now: float) -> None:
        """Ask for what it tells; moves nothing."""
        ...

    def checks(self, now: float) -> list[Finding] | None:
        """For the doctor: look at the drive's own settings, in as many calls as it takes; None: not done yet."""
        ...

    def fixes(self) -> Sequence[tuple[Pose, float]]:
        """Return where the drive itself says that the car is, and when that was true, since this was asked last."""
        ...

    def go(self, command: Command, speed: float | None, now: float) -> None:
        """Drive like this until the next command, which the watchdog expects within its time. `speed` is measured, for
        a drive that does not hold speeds by itself; None: nobody knows it."""
        ...

    def brake(self, now: float) -> None:
        """Brake; at standstill: neutral."""
        ...

    def news(self) -> list[str]:
        """Return events since the last call, for the log."""
        ...

    def close(self, standing: bool) -> None:
        """Give back the device; a car that does not stand is left to the watchdog, which brakes. Idempotent."""
        ...


def opened(settings: CarSettings, links: Links, frame: LocalFrame) -> Drive:
    """Open the drive that the settings name; `frame` is the fleet's. Raises Unready, saying what to do."""
    kind, _, place = settings.drive.partition(":")
    if kind == "vesc" and place:
        return VescDrive(place, settings, links)
    if kind == "rover" and place:
        from targets.car.drive.rover import RoverDrive  # a VESC's car does not pay for pymavlink

        return RoverDrive(settings, links.mavlink(place), links.watchdog(), frame)
    hint = "write `drive: vesc:DEVICE`, as in vesc:/dev/ttyACM0, or rover:URL, as in rover:serial:/dev/ttyACM0:115200"
    raise Unready(f"drive {settings.drive!r} is not understood", hint)
