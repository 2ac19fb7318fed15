"""MAVLink frames out of bytes: what is damaged or unknown is counted and skipped byte by byte, so that no good frame
behind it is lost. (pymavlink's own parser skips as many bytes as the damaged header claims, and mavutil, which wraps
it, costs 118 ms to import, sleeps, and reconnects in its own way; the dialect module alone is light and pure. Being
the v2.0 dialect it needs no MAVLINK20 in the environment: only mavutil reads that.)
"""

from __future__ import annotations

import re
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

Message = Any  # one of the dialect's generated classes

_HEADER = {0xFD: 10, 0xFE: 6}
_SIGNED = 0x01
_MARKER = re.compile(rb"[\xfd\xfe]")


class Framer:
    """Decodes frames of MAVLink 2, and 1: an autopilot may begin with those. `rejected` counts bytes and frames."""

    def __init__(self) -> None:
        self._mavlink = mavlink.MAVLink(None)
        self._rest = b""
        self.rejected: dict[str, int] = {}

    def datagram(self, data: bytes) -> list[Message]:
        """Return the messages of a datagram, which by convention holds whole frames."""
        return self._scan(data, whole=True)[0]

    def stream(self, data: bytes) -> list[Message]:
        """Return the messages that a stream's next bytes complete."""
        messages, self._rest = self._scan(self._rest + data, whole=False)
        return messages

    def _scan(self, data: bytes, whole: bool) -> tuple[list[Message], bytes]:
        """Return the messages, and what may be the beginning of one that is still on its way (never when `whole`)."""
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
        except Exception:  # generated code on hostile bytes: whatever it raises, the frame is bad
            self._count("frames")
            return None
        return message

    def _count(self, reason: str) -> None:
        self.rejected[reason] = self.rejected.get(reason, 0) + 1


def _frame_size(data: bytes, at: int) -> int | None:
    """How long the frame is that begins at `at`, or None when none does. A header cut short claims one byte more."""
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
