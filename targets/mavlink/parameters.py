"""Check of an autopilot's parameters on which a flight or a drive depends. The check never writes parameters.

Each parameter is requested by PARAM_REQUEST_READ, alternately under its present and its older names, because an
autopilot does not answer a request for an unknown name.

PARAM_VALUE carries an integer either as a float of that value (ArduPilot) or as the integer's own bytes (PX4). The
autopilot reports its encoding in AUTOPILOT_VERSION.capabilities.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from targets.mavlink.framing import Message
from targets.mavlink.link import Link

EVERY = 0.7  # seconds between two requests for the same parameter
TURNS = 6  # after this many requests without an answer, a parameter counts as missing
WAY_OUT = (
    "correct them with a ground station, or switch on a pilot's remote control; with the robot's setting "
    "`allow_no_failsafe: true` the robot takes off without either"
)
PILOT = "the take-off is allowed because a remote control is there; if the agent dies, its pilot must land the robot"
REREAD = 5.0  # seconds between two readings of parameters that are wrong or missing
_INTEGERS = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<B",
    mavlink.MAV_PARAM_TYPE_INT8: "<b",
    mavlink.MAV_PARAM_TYPE_UINT16: "<H",
    mavlink.MAV_PARAM_TYPE_INT16: "<h",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}


@dataclass(frozen=True, slots=True)
class Wanted:
    """Required value of a parameter."""

    name: str
    older: tuple[str, ...]  # names of the parameter in older firmware versions
    values: tuple[float, ...]  # allowed values, or bits
    why: str  # consequence of a wrong value, or meaning of the parameter
    vital: bool = False  # True: the vehicle must not take off with a wrong value
    bits: bool = False  # True: `values` are bits, and each of them must be set
    versions: tuple[int, int] | None = None  # firmware versions (first, last) that need the parameter; None: all


@dataclass(frozen=True, slots=True)
class Reading:
    """Reported value of a parameter.

    `name`: name of the parameter in the autopilot's answer. `found`: the value; None without an answer."""

    wanted: Wanted
    name: str
    found: float | None

    @property
    def right(self) -> bool:
        if self.wanted.bits and self.found is not None:
            return all(int(self.found) & int(bit) for bit in self.wanted.values)
        return self.found is not None and any(math.isclose(self.found, v, rel_tol=1e-6) for v in self.wanted.values)

    @property
    def expected(self) -> str:
        """Return a text that lists the allowed values."""
        if self.wanted.bits:
            return f"{sum(self.wanted.values):g}, or any number with that bit set"
        return " or ".join(f"{v:g}" for v in self.wanted.values)

    def __str__(self) -> str:
        found = "does not answer" if self.found is None else f"is {self.found:g}"
        return f"{self.name} {found}, wanted {self.expected}: {self.wanted.why}"


@dataclass(slots=True)
class _Asked:
    times: int = 0
    at: float = -math.inf
    name: str = ""  # name of the parameter in the autopilot's answer; "": no answer yet
    raw: bytes = b""
    value: float = 0.0
    type: int = 0


class Parameters:
    """Reader of the required parameters; poll it until it is `done`.

    `bytewise`: True if integers arrive as raw bytes from an autopilot that does not report its encoding."""

    def __init__(self, wanted: tuple[Wanted, ...], bytewise: bool) -> None:
        self._asked = {w: _Asked() for w in wanted}
        self._names = {name: w for w in wanted for name in (w.name, *w.older)}
        self._bytewise = bytewise
        self._version: int | None = None  # firmware version: AUTOPILOT_VERSION.flight_sw_version
        self._asked_version = 0  # number of requests for AUTOPILOT_VERSION

    def handle(self, message: Message) -> None:
        """Handle a message of the vehicle: the value of a parameter, or the autopilot's version."""
        match message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
                self._version = message.flight_sw_version
                if message.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE:
                    self._bytewise = True
                elif message.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST:
                    self._bytewise = False
            case mavlink.MAVLINK_MSG_ID_PARAM_VALUE:
                wanted = self._names.get(message.param_id)
                if wanted is not None:
                    asked = self._asked[wanted]
                    asked.name, asked.value, asked.type = message.param_id, message.param_value, message.param_type
                    asked.raw = _first_field(bytes(message.get_msgbuf()))

    def poll(self, link: Link, now: float) -> None:
        """Request the parameters that have not been received yet."""
        if link.vehicle is None:
            return
        if self._version is None:
            number = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
            self._asked_version = link.ask(now, mavlink.MAV_CMD_REQUEST_MESSAGE, number).times
        for wanted, asked in self._asked.items():
            if self._matters(wanted) and not asked.name and asked.times < TURNS and now - asked.at >= EVERY:
                names = (wanted.name, *wanted.older)
                name = names[asked.times % len(names)]
                asked.times, asked.at = asked.times + 1, now
                link.send(
                    mavlink.MAVLink_param_request_read_message(
                        link.vehicle.system, link.vehicle.component, name.encode("ascii"), -1
                    )
                )

    def done(self, now: float) -> bool:
        """Return whether each required parameter was received, or was requested TURNS times."""
        if self._version is None and self._asked_version < TURNS and any(w.versions for w in self._asked):
            return False
        return all(
            a.name or (a.times >= TURNS and now - a.at >= EVERY) for w, a in self._asked.items() if self._matters(w)
        )

    def _matters(self, wanted: Wanted) -> bool:
        if wanted.versions is None:
            return True
        first, last = wanted.versions
        return self._version is not None and first <= self._version <= last

    def again(self) -> None:
        """Begin a new reading of the parameters that are wrong or missing."""
        for reading in self.readings:
            if not reading.right:
                self._asked[reading.wanted] = _Asked()

    @property
    def readings(self) -> tuple[Reading, ...]:
        """Return the readings of all parameters that this firmware version needs."""
        return tuple(
            Reading(w, a.name, self._value(a)) if a.name else Reading(w, w.name, None)
            for w, a in self._asked.items()
            if self._matters(w)
        )

    @property
    def differences(self) -> tuple[Reading, ...]:
        """Return the readings that are wrong or missing: first those of vital parameters."""
        wrong = [r for r in self.readings if not r.right]
        return tuple(sorted(wrong, key=lambda r: not r.wanted.vital))

    def _value(self, asked: _Asked) -> float:
        form = _INTEGERS.get(asked.type)
        if form is None or not self._bytewise:
            return asked.value
        return float(struct.unpack(form, asked.raw[: struct.calcsize(form)])[0])


class Review:
    """Check of the parameters before a take-off.

    Wrong parameters are read again periodically, because somebody may correct them. Each difference is reported once. A
    wrong vital parameter forbids the take-off unless the autopilot receives a remote control: if the agent dies, a
    pilot or a failsafe must be able to land the vehicle."""

    def __init__(self, wanted: tuple[Wanted, ...], bytewise: bool) -> None:
        self._parameters = Parameters(wanted, bytewise)
        self._differences: tuple[Reading, ...] = ()
        self._reread = -math.inf
        self._reported: tuple[str, ...] = ()
        self._piloted = False  # True: the autopilot receives a remote control
        self.known = False  # True: each parameter was received or counts as missing

    def handle(self, message: Message) -> None:
        """Handle a message of the vehicle: a parameter, or the channels of a remote control."""
        self._parameters.handle(message)
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_RC_CHANNELS:
            self._piloted = message.chancount > 0

    def poll(self, link: Link, now: float) -> None:
        """Request missing parameters; every REREAD seconds, read wrong parameters again."""
        self._parameters.poll(link, now)
        if self._parameters.done(now):
            self.known, self._differences = True, self._parameters.differences
            if self._differences and now - self._reread >= REREAD:
                self._reread = now
                self._parameters.again()
                link.send_once(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_RC_CHANNELS)

    @property
    def forbids(self) -> str:
        """Return a text: the wrong vital parameters that forbid the take-off, and the remedy; "" if none."""
        vital = self._vital
        return f"{vital} ({WAY_OUT})" if vital and not self._piloted else ""

    @property
    def _vital(self) -> str:
        return "; ".join(str(r) for r in self._differences if r.wanted.vital)

    def unreported(self) -> str:
        """Return a text of the wrong parameters if it has changed since the last call, else ""."""
        differences = tuple(map(str, self._differences))
        if self._vital and self._piloted:
            differences = (*differences, PILOT)
        if differences == self._reported:
            return ""
        self._reported = differences
        return f"parameters of the autopilot differ: {'; '.join(differences)}" if differences else ""


def _first_field(frame: bytes) -> bytes:
    """Return the raw bytes of PARAM_VALUE.param_value.

    The bytes may be an integer that is a NaN when read as a float. A conversion to float could change its bits."""
    return frame[10:14] if frame[0] == 0xFD else frame[6:10]
