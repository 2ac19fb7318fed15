"""What a robot knows of its peers' boots: who was adopted, which of their datagrams were taken, what clocks learn from.

Columns with an entry for each robot, by pid: the compiled gate (gate.c) reads and writes the same ones.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping

REPLAY_WINDOW = 1024  # datagrams that may arrive out of order
WORDS = REPLAY_WINDOW // 64 + 1  # of 64 bits: the newest one is not full
_ALL = 2**64 - 1


class Sessions:
    """Of a fleet of `n_sys`. Of a boot's datagrams: the `newest` sequence number; a bit for each of the last ones that
    arrived in `seen`, a ring of WORDS (RFC 6479); when the newest one was `sent` (-1: none) and `arrived` here, in
    microseconds; and the latest `round` in which it said to be. When the clock is `due` to learn from it again, by the
    local clock; and how many `lessons` for it wait in the gate, in an array of one."""

    def __init__(self, n_sys: int) -> None:
        none = bytes(8 * n_sys)
        self.boots: dict[int, bytes] = {}
        self.newest, self.round, self.arrived = array("q", none), array("q", none), array("q", none)
        self.sent = array("q", [-1] * n_sys)
        self.seen = array("Q", none * WORDS)
        self.due = array("d", [float("-inf")] * n_sys)
        self.lessons = array("q", [0])

    def columns(self) -> Mapping[str, array[int] | array[float]]:
        """Those that the gate shares."""
        return {name: getattr(self, name) for name in ("newest", "sent", "arrived", "round", "seen", "due", "lessons")}

    def adopt(self, pid: int, boot: bytes, sequence: int = 0, sent: int = -1, arrived: int = 0) -> None:
        """From now on this boot counts, and what it sent up to that sequence number, perhaps recorded, does not."""
        self.boots[pid] = boot
        self.newest[pid], self.sent[pid], self.arrived[pid], self.round[pid] = sequence, sent, arrived, 0
        self.due[pid] = float("-inf")
        for word in range(WORDS):
            self.seen[pid * WORDS + word] = _ALL
        self.seen[pid * WORDS + (sequence >> 6) % WORDS] = (2 << (sequence & 63)) - 1

    def fresh(self, pid: int, sequence: int) -> bool:
        """Take a sequence number; False when it was taken before or is older than the window."""
        newest, seen, at = self.newest[pid], self.seen, pid * WORDS
        if sequence <= newest - REPLAY_WINDOW:
            return False
        last = sequence >> 6
        if sequence > newest:
            for block in range(max(newest >> 6, last - WORDS) + 1, last + 1):
                seen[at + block % WORDS] = 0
            self.newest[pid] = sequence
        place, bit = at + last % WORDS, 1 << (sequence & 63)
        if seen[place] & bit:
            return False
        seen[place] |= bit
        return True
