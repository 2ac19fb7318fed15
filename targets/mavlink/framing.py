"""Decoder of MAVLink frames from bytes.

Damaged and unknown frames are counted and skipped byte by byte, so that no valid frame behind them is lost.

Reasons not to use more of pymavlink than its dialect module: its own parser skips as many bytes as a damaged header
claims. Its module mavutil takes 118 ms to import, sleeps, and reconnects by its own rules. The v2.0 dialect does not
depend on the environment variable MAVLINK20, which only mavutil reads.
"""

from __future__ import annotations

import re
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

Message = Any  # a message: an object of one of the dialect's generated classes

_HEADER = {0xFD: 10, 0xFE: 6}
_SIGNED = 0x01
_MARKER = re.compile(rb"[\xfd\xfe]")


class Framer:
    """Decoder of MAVLink 2 frames, and of MAVLink 1 frames, which an autopilot may send first.

    `rejected`: numbers of bytes and frames that were dropped, by reason."""

    def __init__(self) -> None:
        self._mavlink = mavlink.MAVLink(None)
        self._unparsed = b""
        self.rejected: dict[str, int] = {}

    def datagram(self, data: bytes) -> list[Message]:
        """Return the messages of a datagram, which by convention holds whole frames."""
        return self._scan(data, whole=True)[0]

    def stream(self, data: bytes) -> list[Message]:
        """Return the messages that a stream's next bytes complete."""
        messages, self._unparsed = self._scan(self._unparsed + data, whole=False)
        return messages

    def _scan(self, data: bytes, whole: bool) -> tuple[list[Message], bytes]:
        """Return the messages, and the bytes at the end that may begin a frame.

        With `whole`, incomplete frames are dropped, so no bytes are returned."""
        messages = []
        at, end, skipped = 0, len(data), 0
        while at < end:
            size = _frame_size(data, at)
            if size is not None and at + size > end:
                if not whole:
                    break
                size = None
            message = None if size is None else self._decoded(data[at : at + size])
            if message is None or size is None:
                marker = _MARKER.search(data, at + 1)
                onwards = end if marker is None else marker.start()
                skipped += onwards - at
                at = onwards
            else:
                messages.append(message)
                at += size
        if skipped:
            self.rejected["bytes"] = self.rejected.get("bytes", 0) + skipped
        return messages, data[at:]

    def _decoded(self, frame: bytes) -> Message | None:
        number = frame[5] if frame[0] == 0xFE else int.from_bytes(frame[7:10], "little")
        if number not in mavlink.mavlink_map:
            self._count("unknown")
            return None
        try:
            message = self._mavlink.decode(bytearray(frame))
        except Exception:  # the dialect's generated code may raise any exception for damaged bytes: drop the frame
            self._count("frames")
            return None
        return message

    def _count(self, reason: str) -> None:
        self.rejected[reason] = self.rejected.get(reason, 0) + 1


def _frame_size(data: bytes, at: int) -> int | None:
    """Return the size of the frame that begins at index `at`; None if no frame begins at this index.

    If the header is incomplete, return a size one byte larger than the available data."""
    header = _HEADER.get(data[at])
    if header is None:
        return None
    if at + 3 > len(data):
        return len(data) - at + 1
    if header == 6:
        return data[at + 1] + 8
    flags = data[at + 2]
    if flags & ~_SIGNED:
        return None
    return int(data[at + 1]) + 12 + (13 if flags else 0)
