"""Non-blocking links of the car to its serial device, MAVLink, position feed, lidar and watchdog."""

from __future__ import annotations

import errno
import os
import select
import termios
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from koordgen.runtime.vehicle.datagrams import DatagramLink
from koordgen.runtime.vehicle.feed import listen_for_poses
from koordgen.runtime.vehicle.platform import Unready
from koordgen.runtime.vehicle.scans import listen_for_scans
from targets.car.base.settings import FROM_DRIVE
from targets.car.drive.watched import Watch, WatchdogProcess

if TYPE_CHECKING:
    from targets.car.drive.rover import ConsoleTransport

BAUD = 115_200


class ByteLink(Protocol):
    """Non-blocking byte stream in both directions.

    `read` returns the bytes that have arrived. `write` returns the number of bytes that it wrote. Both raise Unready if
    the device is gone. `fileno` is the descriptor for the watchdog, which writes to the same device."""

    def read(self) -> bytes: ...

    def write(self, data: bytes) -> int: ...

    def fileno(self) -> int: ...

    def close(self) -> None: ...


class Links(Protocol):
    """Factory of the car's links. Its methods raise Unready with a hint."""

    def serial(self, device: str) -> ByteLink: ...

    def mavlink(self, url: str) -> ConsoleTransport: ...

    def position(self, setting: str) -> DatagramLink: ...

    def scans(self, setting: str) -> DatagramLink: ...

    def watchdog(self) -> Watch: ...

    def wait(self, seconds: float) -> None:
        """Sleep. Only `diagnose` calls this, because no other call may block."""
        ...

    def remember(self, lag: float) -> None:
        """Store the motor's lag (s) for later pre-flight checks, which cannot measure it. Raises nothing."""
        ...

    def remembered(self) -> float | None:
        """Return the lag (s) that `remember` stored last, in this or an earlier run; None if there is none."""
        ...


class SerialLink:
    """Serial device (or pseudo-terminal) that is opened with pyserial."""

    def __init__(self, device: str) -> None:
        import serial

        self._device = device
        self._errors: tuple[type[Exception], ...] = (OSError, TypeError, termios.error, serial.SerialException)
        try:
            self._port = serial.Serial(device, BAUD, timeout=0, write_timeout=0, exclusive=True)
        except (*self._errors, ValueError) as error:
            number = getattr(error, "errno", None)
            # EAGAIN from flock means that another process has locked the device, which strerror would not explain.
            reason = "another program has it" if number == errno.EAGAIN else os.strerror(number) if number else error
            hint = "connect the motor controller, free its device, or correct `drive` in the robot's settings"
            raise Unready(f"cannot open the motor controller at {device}: {reason}", hint) from None

    def read(self) -> bytes:
        try:
            return bytes(self._port.read(4096))
        except self._errors as error:
            raise self._lost(error) from None

    def write(self, data: bytes) -> int:
        # pyserial's own non-blocking write would spin, and never return, while the device accepts no bytes.
        try:
            return os.write(self._port.fileno(), data)
        except BlockingIOError:
            return 0
        except self._errors as error:
            raise self._lost(error) from None

    def fileno(self) -> int:
        return int(self._port.fileno())

    def _lost(self, error: Exception) -> Unready:
        return Unready(f"the motor controller at {self._device} is gone: {error}", "check its cable and supply")

    def close(self) -> None:
        with suppress(*self._errors):
            self._port.close()


class Nowhere:
    """Empty position feed, for a drive that reports the position itself."""

    def receive(self) -> bytes | None:
        return None

    def close(self) -> None:
        pass


class RealLinks:
    """Links to real devices. `notes`: file that stores the motor's lag; None: the lag is not stored."""

    def __init__(self, notes: Path | None = None) -> None:
        self._notes = notes

    def serial(self, device: str) -> ByteLink:
        return SerialLink(device)

    def mavlink(self, url: str) -> ConsoleTransport:
        from targets.mavlink.transport import opened

        return opened(url)

    def position(self, setting: str) -> DatagramLink:
        return Nowhere() if setting == FROM_DRIVE else listen_for_poses("position", setting)

    def scans(self, setting: str) -> DatagramLink:
        return listen_for_scans(setting)

    def watchdog(self) -> Watch:
        return WatchdogProcess()

    def wait(self, seconds: float) -> None:
        select.select([], [], [], seconds)

    def remember(self, lag: float) -> None:
        if self._notes is not None:
            with suppress(OSError):
                self._notes.parent.mkdir(exist_ok=True)
                self._notes.write_text(f"{lag:.3f}\n", encoding="ascii")

    def remembered(self) -> float | None:
        try:
            return float(self._notes.read_text(encoding="ascii")) if self._notes is not None else None
        except (OSError, ValueError):
            return None
