"""Serial protocol of a VESC motor controller: the messages that a car needs, their frames and checksum.

A frame consists of 0x02 and one length byte (or 0x03 and two length bytes), the payload, the payload's CRC-16/XMODEM,
and 0x03. The first byte of a payload is the command. Numbers are big-endian. Sources of layout and checksum:
`packet.c`, `commands.c` (COMM_PACKET_ID, COMM_FW_VERSION, COMM_GET_VALUES) and `crc.c` of the open VESC firmware.
"""

from __future__ import annotations

import binascii
import math
import struct
from dataclasses import dataclass

FW_VERSION, GET_VALUES, SET_CURRENT_BRAKE, SET_RPM, SET_SERVO_POS = 0, 4, 7, 8, 12
SHORT, LONG, END = 0x02, 0x03, 0x03
# Bytes of the largest payload, as in the firmware. A larger length field is noise; if the decoder waited for the end of
# such a frame, it would miss real ones.
LARGEST = 512
_INT32 = 2**31 - 1
# Fields of an answer to GET_VALUES: temperatures of FETs and motor; currents of motor, input, d and q axis; duty cycle,
# ERPM, voltage; four charges and energies; two tachometers; fault code. Newer firmware appends fields; the offsets of
# these have not changed since version 2.18.
_VALUES = struct.Struct(">hhiiiihihiiiiiiB")


@dataclass(frozen=True, slots=True)
class SetErpm:
    """Command to hold an electrical speed, in electrical revolutions per minute (ERPM); negative is reverse."""

    erpm: float


@dataclass(frozen=True, slots=True)
class SetServo:
    """Command to move the steering servo to a position from 0 to 1."""

    position: float


@dataclass(frozen=True, slots=True)
class Brake:
    """Command to brake with a current, in amperes. At standstill it gives no torque, so it also serves as neutral."""

    current: float


@dataclass(frozen=True, slots=True)
class AskValues:
    """Request for the controller's values."""


@dataclass(frozen=True, slots=True)
class Values:
    """Values that the controller reports: ERPM, supply voltage (V), and a fault code (0: no fault)."""

    erpm: float
    voltage: float = 0.0
    fault: int = 0


@dataclass(frozen=True, slots=True)
class AskVersion:
    """Request for the controller's firmware version."""


@dataclass(frozen=True, slots=True)
class Version:
    """Version of the controller's firmware."""

    major: int
    minor: int


Message = SetErpm | SetServo | Brake | AskValues | Values | AskVersion | Version


def encode(message: Message) -> bytes:
    """Return the frame of a message. Numbers are clamped to their field's range.

    Raises ValueError for NaN, so that no such value can reach a motor."""
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
    """Return the CRC-16/XMODEM of a payload: polynomial 0x1021, initial value 0."""
    return binascii.crc_hqx(payload, 0)


class Decoder:
    """Decoder of the byte stream, in pieces of any size. It raises for no input, and buffers one frame at most.

    `dropped`: number of bytes that belonged to no valid frame."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self.dropped = 0

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that these bytes complete. Unknown commands and wrong sizes are skipped."""
        self._bytes += data
        found: list[Message] = []
        while (payload := self._next()) is not None:
            message = _decode(payload)
            if message is not None:
                found.append(message)
        return found

    def _next(self) -> bytes | None:
        """Return the next valid frame's payload and remove it from the buffer; None if more bytes are needed.

        Bytes that cannot be the start of a frame are dropped."""
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
        case 0, size if size > 2:  # newer firmware appends names
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
