"""Fragments: a blob longer than a datagram is split, and reassembled in any order of arrival.

A receiver that lacks fragments reports those that it has, so only the others are repeated. No input raises, or makes a
robot store more than MOST_FRAGMENTS fragments of at most LIMIT bytes for one blob."""

from __future__ import annotations

from hashlib import blake2s

from koordgen.runtime.net.wire import LIMIT, MOST_FRAGMENTS

Cut = tuple[bytes, int, int, bytes]  # digest of the blob, number of the fragment, number of fragments, data


def digest(blob: bytes) -> bytes:
    """Return eight bytes that identify a blob."""
    return blake2s(blob, digest_size=8, person=b"k-piece").digest()


def cut(blob: bytes, room: int) -> list[Cut]:
    """Return a blob in fragments of `room` bytes, the last one shorter.

    Raises ValueError for an empty blob and for too many fragments.
    """
    count = -(-len(blob) // room)
    if not 1 <= count <= MOST_FRAGMENTS or room > LIMIT:
        raise ValueError(f"{len(blob)} bytes do not go into 1 to {MOST_FRAGMENTS} fragments of {room} bytes")
    name = digest(blob)
    return [(name, i, count, blob[i * room : (i + 1) * room]) for i in range(count)]


def lacking(count: int, mask: bytes) -> list[int]:
    """Return the numbers of the fragments that a mask lacks, ascending.

    Bit i of byte i // 8 of the mask stands for fragment i. A mask may be shorter or longer than `count`."""
    held = int.from_bytes(mask, "little")
    return [i for i in range(count) if not held >> i & 1]


class Reassembly:
    """Fragments of one blob, as they arrive.

    The first one determines digest and count; fragments that differ from it are refused. All fragments but the last
    have one length; the last one is not longer."""

    def __init__(self, name: bytes, count: int) -> None:
        self.name = name
        self.count = count
        self._room = 0  # length of all fragments but the last; 0 until one of them has arrived
        self._parts: dict[int, bytes] = {}

    def take(self, fragment: Cut) -> str | None:
        """Add a fragment. Return None, or why it is refused. A known fragment is no error."""
        name, index, count, data = fragment
        if name != self.name or count != self.count:
            return "fragment of something else"
        if not 0 <= index < count <= MOST_FRAGMENTS or not 0 < len(data) <= LIMIT or not self._even(index, len(data)):
            return "fragment does not fit"
        if index not in self._parts:
            self._parts[index] = bytes(data)
            if index < count - 1:
                self._room = len(data)
        return None

    def blob(self) -> bytes | None:
        """Return the blob once all fragments have arrived. If its digest is wrong, drop them all."""
        if len(self._parts) < self.count or not self._parts:
            return None
        whole = b"".join(self._parts[i] for i in range(self.count))
        if digest(whole) == self.name:
            return whole
        self._parts.clear()
        self._room = 0
        return None

    @property
    def mask(self) -> bytes:
        """Mask of the fragments received, as `lacking` reads it."""
        held = sum(1 << i for i in self._parts)
        return held.to_bytes((held.bit_length() + 7) // 8, "little")

    def _even(self, index: int, length: int) -> bool:
        """Return whether a fragment's length agrees with those received."""
        if index == self.count - 1:
            return not self._room or length <= self._room
        last = self._parts.get(self.count - 1, b"")
        return length == self._room if self._room else length >= len(last)
