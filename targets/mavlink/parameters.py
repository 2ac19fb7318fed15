"""Check of an autopilot's parameters on which a flight or a drive depends: they are read and compared, never written.

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
TURNS = 6  # requests after which a parameter counts as one that does not answer
WAY_OUT = (
    "set it by a ground station, or switch on a pilot's remote control; the robot's setting `allow_no_failsafe: true` "
    "takes off all the same"
)
PILOT = "it takes off because a remote control is there: should the agent die, its pilot must land it"
REREAD = 5.0  # seconds after which parameters that were wrong are read again
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
    older: tuple[str, ...]  # its names in older firmware versions
    values: tuple[float, ...]  # the right values
    why: str  # consequence of a wrong value, or meaning of the parameter
    vital: bool = False  # whether the vehicle must not take off with a wrong value
    bits: bool = False  # whether `values` are bits, each of which must be set
    versions: tuple[int, int] | None = None  # first and last flight_sw_version that need it; None: all versions


@dataclass(frozen=True, slots=True)
class Reading:
    """Value of a parameter that the autopilot reported, and the name under which it did; None: no answer."""

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
        """The right values, in words."""
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
    name: str = ""  # the name under which the autopilot answered; "": no answer yet
    raw: bytes = b""
    value: float = 0.0
    type: int = 0


class Parameters:
    """Reader of the required parameters; poll it until it is `done`.

    `bytewise`: whether integers arrive as raw bytes, if the autopilot does not report its encoding."""

    def __init__(self, wanted: tuple[Wanted, ...], bytewise: bool) -> None:
        self._asked = {w: _Asked() for w in wanted}
        self._names = {name: w for w in wanted for name in (w.name, *w.older)}
        self._bytewise = bytewise
        self._version: int | None = None  # AUTOPILOT_VERSION.flight_sw_version
        self._asked_version = 0  # number of requests for AUTOPILOT_VERSION

    def take(self, message: Message) -> None:
        """Take one of the vehicle's messages."""
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
        """Return whether each required parameter has answered or was requested often enough."""
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
        """Read the parameters that were wrong or missing again."""
        for reading in self.readings:
            if not reading.right:
                self._asked[reading.wanted] = _Asked()

    @property
    def readings(self) -> tuple[Reading, ...]:
        """Readings of all parameters that this firmware version needs."""
        return tuple(
            Reading(w, a.name, self._value(a)) if a.name else Reading(w, w.name, None)
            for w, a in self._asked.items()
            if self._matters(w)
        )

    @property
    def differences(self) -> tuple[Reading, ...]:
        """Readings that are wrong or missing, the vital ones first."""
        wrong = [r for r in self.readings if not r.right]
        return tuple(sorted(wrong, key=lambda r: not r.wanted.vital))

    def _value(self, asked: _Asked) -> float:
        form = _INTEGERS.get(asked.type)
        if form is None or not self._bytewise:
            return asked.value
        return float(struct.unpack(form, asked.raw[: struct.calcsize(form)])[0])


class Review:
    """Check of the parameters before a take-off.

    As long as some are wrong, they are read again, in case somebody corrects them. Each difference is reported once. A
    wrong vital parameter forbids the take-off only if there is no remote control either, because a pilot or a failsafe
    must be able to land the vehicle if the agent dies."""

    def __init__(self, wanted: tuple[Wanted, ...], bytewise: bool) -> None:
        self._parameters = Parameters(wanted, bytewise)
        self._differences: tuple[Reading, ...] = ()
        self._reread = -math.inf
        self._told: tuple[str, ...] = ()
        self._piloted = False  # whether the autopilot receives a remote control
        self.known = False  # whether each parameter was read, or does not answer

    def take(self, message: Message) -> None:
        """Take one of the vehicle's messages."""
        self._parameters.take(message)
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_RC_CHANNELS:
            self._piloted = message.chancount > 0

    def poll(self, link: Link, now: float) -> None:
        """Request the missing parameters, and those that were wrong every REREAD seconds."""
        self._parameters.poll(link, now)
        if self._parameters.done(now):
            self.known, self._differences = True, self._parameters.differences
            if self._differences and now - self._reread >= REREAD:
                self._reread = now
                self._parameters.again()
                link.tell(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_RC_CHANNELS)

    @property
    def forbids(self) -> str:
        """Wrong vital parameters that forbid the take-off, with the remedy, in words; "" if none does."""
        vital = self._vital
        return f"{vital} ({WAY_OUT})" if vital and not self._piloted else ""

    @property
    def _vital(self) -> str:
        return "; ".join(str(r) for r in self._differences if r.wanted.vital)

    def news(self) -> str:
        """Return differences that were not reported yet, and mark them as reported."""
        differences = tuple(map(str, self._differences))
        if self._vital and self._piloted:
            differences = (*differences, PILOT)
        if differences == self._told:
            return ""
        self._told = differences
        return f"parameters of the autopilot differ: {'; '.join(differences)}" if differences else ""


def _first_field(frame: bytes) -> bytes:
    """Return the raw bytes of PARAM_VALUE.param_value.

    They may be an integer whose bits form a NaN as a float; converting that would change the bits."""
    return frame[10:14] if frame[0] == 0xFD else frame[6:10]
