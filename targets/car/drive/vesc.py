"""The serial protocol of a VESC motor controller: the few messages that a car needs, their frames and checksum.

A frame is 0x02 and one length byte (or 0x03 and two), the payload, its CRC-16/XMODEM, 0x03; a payload's first byte is
the command. Numbers are big-endian. Formula and layout sources: the open VESC firmware's `packet.c`, `commands.c`
(COMM_PACKET_ID, COMM_FW_VERSION, COMM_GET_VALUES) and `crc.c`.
"""

from __future__ import annotations

import binascii
import math
import struct
from dataclasses import dataclass

FW_VERSION, GET_VALUES, SET_CURRENT_BRAKE, SET_RPM, SET_SERVO_POS = 0, 4, 7, 8, 12
SHORT, LONG, END = 0x02, 0x03, 0x03
# The firmware's own largest packet; a longer length field is noise, and waiting for its end would deafen the decoder.
LARGEST = 512
_INT32 = 2**31 - 1
# GET_VALUES: temperatures FET and motor, currents motor, input, d and q, duty, ERPM, voltage, four charges and
# energies, two tachometers, fault. Newer firmware appends fields; these have stayed where they are since 2.18.
_VALUES = struct.Struct(">hhiiiihihiiiiiiB")


@dataclass(frozen=True, slots=True)
class SetErpm:
    """Hold an electrical speed, in electrical revolutions a minute; negative is reverse."""

    erpm: float


@dataclass(frozen=True, slots=True)
class SetServo:
    """Move the servo to a position from 0 to 1."""

    position: float


@dataclass(frozen=True, slots=True)
class Brake:
    """Brake with a current, in amperes. At standstill it gives no torque: it is the neutral of this target, too."""

    current: float


@dataclass(frozen=True, slots=True)
class AskValues:
    """Ask the controller for its values."""


@dataclass(frozen=True, slots=True)
class Values:
    """What the controller says of itself: ERPM, supply voltage, and a fault code, 0 when all is well."""

    erpm: float
    voltage: float = 0.0
    fault: int = 0


@dataclass(frozen=True, slots=True)
class AskVersion:
    """Ask which firmware it runs."""


@dataclass(frozen=True, slots=True)
class Version:
    """The controller's firmware."""

    major: int
    minor: int


Message = SetErpm | SetServo | Brake | AskValues | Values | AskVersion | Version


def encode(message: Message) -> bytes:
    """One frame. Numbers outside their field's range are brought to its end; NaN raises ValueError: nothing that is
    not a number may ever reach a motor."""
    match message:
        case SetErpm(erpm):
            payload = struct.pack(">Bi", SET_RPM, _field(erpm, 1, _INT32))
        case SetServo(position):
            payload = struct.pack(">Bh", SET_SERVO_POS, max(0, _field(position, 1000, 1000)))
        case Brake(current):
            payload = struct.pack(">Bi", SET_CURRENT_BRAKE, _field(current, 1000, _INT32))
        case AskValues():
            payload = bytes([GET_VALUES])
        case Values(erpm, voltage, fault):
            fields = [0] * 7 + [_field(erpm, 1, _INT32), _field(voltage, 10, 2**15 - 1)] + [0] * 6 + [fault]
            payload = bytes([GET_VALUES]) + _VALUES.pack(*fields)
        case AskVersion():
            payload = bytes([FW_VERSION])
        case Version(major, minor):
            payload = bytes([FW_VERSION, major & 0xFF, minor & 0xFF])
    return frame(payload)


def frame(payload: bytes) -> bytes:
    """Return a frame with a payload of 1 to 512 bytes."""
    size = len(payload)
    head = bytes([SHORT, size]) if size < 256 else struct.pack(">BH", LONG, size)
    return head + payload + struct.pack(">H", checksum(payload)) + bytes([END])


def checksum(payload: bytes) -> int:
    """CRC-16/XMODEM: polynomial 0x1021, start 0."""
    return binascii.crc_hqx(payload, 0)


class Decoder:
    """Takes the byte stream in pieces of any size and finds the messages in it. Whatever the bytes, it never raises
    and keeps at most one frame's worth of them. `dropped` counts bytes that belonged to no good frame."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self.dropped = 0

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that these bytes complete; unknown kinds and wrong sizes are skipped."""
        self._bytes += data
        found: list[Message] = []
        while (payload := self._next()) is not None:
            message = _decode(payload)
            if message is not None:
                found.append(message)
        return found

    def _next(self) -> bytes | None:
        """Cut the next good frame off the front, dropping what cannot be the start of one; None: more bytes needed."""
        start, held = 0, self._bytes
        try:
            while start < len(held):
                head = {SHORT: 2, LONG: 3}.get(held[start], 0)
                if head and len(held) - start < head:
                    return None
                size = int.from_bytes(held[start + 1 : start + head], "big") if head else 0
                if 0 < size <= LARGEST:
                    end = start + head + size
                    if len(held) < end + 3:
                        return None
                    payload = bytes(held[start + head : end])
                    if held[end + 2] == END and checksum(payload) == int.from_bytes(held[end : end + 2], "big"):
                        self.dropped -= end + 3 - start
                        start = end + 3
                        return payload
                start += 1
            return None
        finally:
            self.dropped += start
            del held[:start]


def _decode(payload: bytes) -> Message | None:
    match payload[0], len(payload):
        case 0, 1:
            return AskVersion()
        case 0, size if size > 2:  # newer firmware goes on with names
            return Version(payload[1], payload[2])
        case 4, 1:
            return AskValues()
        case 4, size if size > _VALUES.size:
            fields = _VALUES.unpack_from(payload, 1)
            return Values(float(fields[7]), fields[8] / 10, fields[-1])
        case 7, 5:
            return Brake(_int32(payload) / 1000)
        case 8, 5:
            return SetErpm(float(_int32(payload)))
        case 12, 3:
            return SetServo(int.from_bytes(payload[1:], "big", signed=True) / 1000)
    return None


def _int32(payload: bytes) -> int:
    return int.from_bytes(payload[1:5], "big", signed=True)


def _field(value: float, scale: int, most: int) -> int:
    if math.isnan(value):
        raise ValueError("not a number")
    return round(max(-most, min(most, value * scale)))
