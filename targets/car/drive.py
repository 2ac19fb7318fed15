"""What drives the car, as its platform sees it: speeds and angles out, a measured speed and troubles in."""

from __future__ import annotations

from typing import Protocol

from koordgen.runtime.platform import Unready
from targets.car.links import Links
from targets.car.mpc import Command
from targets.car.settings import CarSettings
from targets.car.vesc_drive import VescDrive


class Drive(Protocol):
    """One drive, open. Speeds in m/s, steering in radians, times in seconds on the agent's clock."""

    @property
    def heard(self) -> bool:
        """Whether it has told, since its link was opened, all that must be known before the car moves."""
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

    def read(self, now: float) -> float | None:
        """Take what arrived; a newly measured speed, or None. Raises Unready when it has been gone or silent for too
        long; it may come back, so go on calling it."""
        ...

    def ask(self, now: float) -> None:
        """Ask for what it tells; moves nothing."""
        ...

    def go(self, command: Command, now: float) -> None:
        """Drive like this until the next command, which the watchdog expects within its time."""
        ...

    def brake(self, now: float) -> None:
        """Brake; at standstill: neutral."""
        ...

    def news(self) -> list[str]:
        """What happened since this was asked last, for the log."""
        ...

    def close(self) -> None:
        """Give back the device. Idempotent."""
        ...


def opened(settings: CarSettings, links: Links) -> Drive:
    """Open the drive that the settings name. Raises Unready, saying what to do."""
    kind, _, place = settings.drive.partition(":")
    if kind != "vesc" or not place:
        hint = "write `drive: vesc:DEVICE`, as in vesc:/dev/ttyACM0"
        raise Unready(f"drive {settings.drive!r} is not understood", hint)
    return VescDrive(place, settings, links)
