"""Fragments of a blob that is longer than a datagram: split, and reassembled in any order of arrival.

A receiver reports the fragments that it has, so only the missing fragments are sent again. No received fragment raises
an exception. A robot stores at most MOST_FRAGMENTS fragments of at most LIMIT bytes for one blob."""

from __future__ import annotations

from hashlib import blake2s

from koordgen.runtime.net.wire import LIMIT, MOST_FRAGMENTS

Cut = tuple[bytes, int, int, bytes]  # digest of the blob, index of the fragment, number of fragments, data


def digest(blob: bytes) -> bytes:
    """Return eight bytes that identify a blob."""
    return blake2s(blob, digest_size=8, person=b"k-piece").digest()


def cut(blob: bytes, room: int) -> list[Cut]:
    """Split a blob into fragments of `room` bytes; the last fragment may be shorter.

    Raises ValueError if the blob is empty or needs more than MOST_FRAGMENTS fragments.
    """
    count = -(-len(blob) // room)
    if not 1 <= count <= MOST_FRAGMENTS or room > LIMIT:
        raise ValueError(f"{len(blob)} bytes do not go into 1 to {MOST_FRAGMENTS} fragments of {room} bytes")
    name = digest(blob)
    return [(name, i, count, blob[i * room : (i + 1) * room]) for i in range(count)]


def lacking(count: int, mask: bytes) -> list[int]:
    """Return the indices of the fragments whose bit in `mask` is 0, in ascending order.

    Bit i % 8 of byte i // 8 stands for fragment i. The mask may have fewer or more than `count` bits."""
    held = int.from_bytes(mask, "little")
    return [i for i in range(count) if not held >> i & 1]


class Reassembly:
    """Reassembly of one blob from its fragments.

    Fragments with another digest `name` or another `count` are refused. All fragments but the last must have the same
    length, and the last fragment must not be longer."""

    def __init__(self, name: bytes, count: int) -> None:
        self.name = name
        self.count = count
        self._room = 0  # length of all fragments but the last; 0 until such a fragment has arrived
        self._parts: dict[int, bytes] = {}

    def add(self, fragment: Cut) -> str | None:
        """Add a fragment. Return None, or the reason for a refusal. A repeated fragment is not refused."""
        name, index, count, data = fragment
        if name != self.name or count != self.count:
            return "fragment of another blob"
        if not 0 <= index < count <= MOST_FRAGMENTS or not 0 < len(data) <= LIMIT or not self._even(index, len(data)):
            return "fragment does not fit"
        if index not in self._parts:
            self._parts[index] = bytes(data)
            if index < count - 1:
                self._room = len(data)
        return None

    def blob(self) -> bytes | None:
        """Return the blob once all fragments have arrived. If its digest is wrong, drop all fragments."""
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
        """Mask of the received fragments, in the format that `lacking` reads."""
        held = sum(1 << i for i in self._parts)
        return held.to_bytes((held.bit_length() + 7) // 8, "little")

    def _even(self, index: int, length: int) -> bool:
        """Return whether a fragment's length agrees with the lengths of the received fragments."""
        if index == self.count - 1:
            return not self._room or length <= self._room
        last = self._parts.get(self.count - 1, b"")
        return length == self._room if self._room else length >= len(last)
