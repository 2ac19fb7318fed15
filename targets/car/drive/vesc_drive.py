"""Drive of a car with a VESC motor controller on a serial device, which is reopened after it was unplugged."""

from __future__ import annotations

import math

from koordgen.runtime.vehicle.platform import Finding, Unready
from targets.car.base.settings import CarSettings
from targets.car.control.mpc import Command
from targets.car.drive import battery, vesc
from targets.car.drive.links import ByteLink, Links

STUCK = 1.0  # seconds for which the device may accept no bytes before it counts as lost
STARTING = 5.0  # seconds within which the controller must give its first answer
SILENT = 2.0  # seconds without an answer, or without the device, after which the controller counts as lost
REPLUG = 0.5  # seconds between two attempts to reopen the device

# Oldest supported major version of the firmware. In older versions, the number of the servo command belongs to a
# command that changes the configuration.
OLDEST = 3
_FAULTS = {
    1: "over-voltage",
    2: "under-voltage",
    3: "gate driver",
    4: "over-current",
    5: "its transistors are too hot",
    6: "the motor is too hot",
}  # names of the firmware's mc_fault_code, fmt: skip


class VescDrive:
    """Drive with a VESC motor controller: implements `drive.Drive`."""

    battery = None  # a VESC measures its supply voltage, but reports no battery charge

    def __init__(self, device: str, settings: CarSettings, links: Links) -> None:
        self._device, self._settings, self._links = device, settings, links
        self._watch = links.watchdog()
        self._brake = vesc.encode(vesc.Brake(settings.brake_current))
        self._decoder = vesc.Decoder()
        self._unsent = b""
        self.asked = 0.0  # last commanded speed, m/s
        self._values: vesc.Values | None = None  # last values received since the link was opened
        self._version: vesc.Version | None = None
        self._stuck_since: float | None = None
        self._unanswered_since: float | None = None
        self._lost_since: float | None = None
        self._loss = ""  # reason why the device is gone, in words
        self._retry = -math.inf
        self._ever = False  # whether the controller has ever answered
        self._log_lines: list[str] = []
        self._link: ByteLink | None = self._opened()

    def _opened(self) -> ByteLink:
        link = self._links.serial(self._device)
        self._decoder, self._unsent = vesc.Decoder(), b""
        self._values = self._version = None
        self._watch.hold(link.fileno(), self._brake)
        return link

    @property
    def heard(self) -> bool:
        return self._values is not None and self._version is not None

    @property
    def blocked(self) -> str:
        if self._link is None:
            return f"braking: {self._loss}"
        if self._values is None or self._version is None:
            return f"waiting for the motor controller on {self._settings.drive}"
        return f"braking: the motor controller reports {self.fault}" if self.fault else self._watch.trouble

    @property
    def fault(self) -> str:
        code = self._values.fault if self._values is not None else 0
        words = f" ({_FAULTS[code]})" if code in _FAULTS else ""
        return f"fault {code}{words}" if code else ""

    @property
    def about(self) -> str:
        if self._values is None or self._version is None:
            return "a motor controller that does not report its firmware version"
        version = f"{self._version.major}.{self._version.minor}"
        return f"VESC firmware {version} answers on {self._settings.drive}, supply {self._values.voltage:.1f} V"

    @property
    def doubt(self) -> str:
        return battery.doubt(self._values.voltage) if self._values is not None else ""

    def read(self, now: float) -> float | None:
        """Implement `Drive.read`."""
        self._watch.poll()
        speed = None
        for message in self._decoder.feed(self._received(now)):
            if isinstance(message, vesc.Values):
                self._values = message
                speed = message.erpm / self._settings.speed_to_erpm_gain
            elif isinstance(message, vesc.Version):
                self._version = message
            if self.heard:
                self._unanswered_since, self._ever = None, True
        self._judge(now)
        return speed

    def _judge(self, now: float) -> None:
        if self._version is not None and self._version.major < OLDEST:
            version = f"{self._version.major}.{self._version.minor}"
            hint = "update it with the VESC tool: in this version, the steering command would change the configuration"
            raise Unready(f"the motor controller's firmware {version} is too old", hint)
        if self._lost_since is not None and now - self._lost_since > SILENT:
            raise Unready(self._loss, "check its cable and supply; the controller brakes by itself when commands stop")
        since = self._unanswered_since
        if since is not None and now - since > (SILENT if self._ever else STARTING):
            raise Unready(
                f"the motor controller on {self._settings.drive} has not answered for {now - since:.1f} s",
                "switch its supply on; check that `drive` names the VESC and that its USB or UART app is enabled",
            )

    def _received(self, now: float) -> bytes:
        if self._link is None:
            self._reopen(now)
        if self._link is None:
            return b""
        try:
            return self._link.read()
        except Unready as error:
            self._lose(error, now)
            return b""

    def _reopen(self, now: float) -> None:
        if now < self._retry:
            return
        self._retry = now + REPLUG
        try:
            self._link = self._opened()
        except Unready:
            return
        self._lost_since = self._unanswered_since = self._stuck_since = None
        self._log_lines.append(f"the motor controller at {self._device} is there again")

    def _lose(self, error: Unready, now: float) -> None:
        self._watch.release()
        if self._link is not None:
            self._link.close()
        self._link, self._loss, self._lost_since = None, error.message, now
        self._retry, self._unanswered_since = now + REPLUG, None
        self._log_lines.append(f"{error.message}: braking")

    def ask(self, now: float) -> None:
        """Implement `Drive.ask`."""
        self._send(b"", now)

    def checks(self, now: float) -> list[Finding]:
        """Return no checks, because this drive does not read the settings of the VESC."""
        return []

    def fixes(self) -> tuple[()]:
        """Return no poses, because a VESC does not know the car's pose."""
        return ()

    def go(self, command: Command, speed: float | None, now: float) -> None:
        """Implement `Drive.go`. If commands cease, the VESC brakes by its own time-out.

        For this, the VESC needs two settings: a time-out of 0.5 s, and a time-out brake current of `brake_current`,
        whose default is 0."""
        settings = self._settings
        servo = settings.steering_to_servo_offset + settings.steering_to_servo_gain * command.steering
        erpm = settings.speed_to_erpm_gain * command.speed
        self.asked = command.speed
        self._send(vesc.encode(vesc.SetServo(servo)) + vesc.encode(vesc.SetErpm(erpm)), now)

    def brake(self, now: float) -> None:
        """Implement `Drive.brake`."""
        self._send(self._brake, now)

    def _send(self, commands: bytes, now: float) -> None:
        """Send commands, and request the controller's values."""
        if self._link is None:
            return
        if self._unanswered_since is None:
            self._unanswered_since = now
        asked = vesc.encode(vesc.AskValues())
        if self._version is None:
            asked += vesc.encode(vesc.AskVersion())
        # First write the rest of a partly written frame, which would corrupt the next frame. In this case new commands
        # are dropped instead of queued, because they would be outdated when sent.
        data = self._unsent or commands + asked
        fresh = not self._unsent
        try:
            self._unsent = data[self._link.write(data) :]
        except Unready as error:
            self._lose(error, now)
            return
        if not self._unsent:
            self._stuck_since = None
            if commands and fresh:
                self._watch.beat()
        elif self._stuck_since is None:
            self._stuck_since = now
        elif now - self._stuck_since > STUCK:
            raise Unready(f"the motor controller at {self._device} takes no commands", "check its cable")

    def log_lines(self) -> list[str]:
        """Implement `Drive.log_lines`."""
        told, self._log_lines = self._log_lines + self._watch.log_lines(), []
        return told

    def close(self, standing: bool) -> None:
        """Implement `Drive.close`."""
        self._watch.close(standing)
        if self._link is not None:
            self._link.close()
