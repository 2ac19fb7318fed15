"""The motor controller as the car's platform sees it: speeds and angles out, a measured speed and faults in."""

from __future__ import annotations

from koordgen.runtime.platform import Unready
from targets.car import vesc
from targets.car.links import ByteLink
from targets.car.mpc import Command
from targets.car.settings import CarSettings

STUCK = 1.0  # seconds for which the device may take no bytes
SILENT = 2.0  # seconds without an answer after which the controller counts as lost


class Drive:
    """One VESC. Speeds in m/s, steering in radians, times in seconds on the agent's clock."""

    def __init__(self, settings: CarSettings, link: ByteLink) -> None:
        self._settings = settings
        self._link = link
        self._decoder = vesc.Decoder()
        self._unsent = b""
        self._stuck_since: float | None = None
        self._unanswered_since: float | None = None
        self.heard = False  # whether it has answered since the link was opened
        self.fault = 0
        self.voltage = 0.0
        self.version = ""

    def read(self, now: float) -> float | None:
        """Take what arrived; a newly measured speed, or None. Raises Unready when the controller has fallen silent."""
        speed = None
        for message in self._decoder.feed(self._link.read()):
            if isinstance(message, vesc.Values):
                self.heard, self._unanswered_since = True, None
                self.fault, self.voltage = message.fault, message.voltage
                speed = message.erpm / self._settings.speed_to_erpm_gain
            elif isinstance(message, vesc.Version):
                self.version = f"{message.major}.{message.minor}"
        since = self._unanswered_since
        if self.heard and since is not None and now - since > SILENT:
            raise Unready(
                f"the motor controller at {self._settings.drive} has not answered for {now - since:.1f} s",
                "check its supply and cable; it brakes by itself when commands stop",
            )
        return speed

    def ask(self, now: float) -> None:
        """Ask for its values, and for its version until that is known; moves nothing."""
        self._send(b"" if self.version else vesc.encode(vesc.AskVersion()), now)

    def go(self, command: Command, now: float) -> None:
        """Drive like this until the next command; without one the VESC's own time-out brakes (set it to 0.5 s, and its
        time-out brake current, which is 0 as delivered, to `brake_current`)."""
        settings = self._settings
        servo = settings.steering_to_servo_offset + settings.steering_to_servo_gain * command.steering
        erpm = settings.speed_to_erpm_gain * command.speed
        self._send(vesc.encode(vesc.SetServo(servo)) + vesc.encode(vesc.SetErpm(erpm)), now)

    def brake(self, now: float) -> None:
        """Brake; at standstill: neutral."""
        self._send(vesc.encode(vesc.Brake(self._settings.brake_current)), now)

    def _send(self, commands: bytes, now: float) -> None:
        """Send commands and ask for the values."""
        if self._unanswered_since is None:
            self._unanswered_since = now
        # What is left of a frame goes first, or its first half would spoil the next; a queue would only age.
        data = self._unsent or commands + vesc.encode(vesc.AskValues())
        self._unsent = data[self._link.write(data) :]
        if not self._unsent:
            self._stuck_since = None
        elif self._stuck_since is None:
            self._stuck_since = now
        elif now - self._stuck_since > STUCK:
            raise Unready(f"the motor controller at {self._settings.drive} takes no commands", "check its cable")

    def close(self) -> None:
        self._link.close()
