"""Peer session: the adopted boot of one peer, with its replay window and its time stamps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

REPLAY_WINDOW = 1024  # largest number of sequence numbers by which a datagram may be late


@dataclass(slots=True)
class PeerSession:
    """State of one boot of one peer, from its adoption on.

    newest: highest sequence number received.
    skipped: lower sequence numbers that may still be accepted. A number that is at most `newest` at the adoption is
        never accepted, because its datagram may be a replay.
    sent: latest time stamp received, in microseconds of the peer's clock; -1: none.
    arrived: arrival time of that stamp, in microseconds of the local clock.
    round: highest round that the peer has reported.
    due: local time (s) from which on the fleet clock needs another exchange of time stamps with the peer.
    """

    boot: bytes
    newest: int = 0
    sent: int = -1
    arrived: int = 0
    round: int = 0
    due: float = -math.inf
    skipped: set[int] = field(default_factory=set)

    def accept(self, sequence: int) -> bool:
        """Record the sequence number of a received datagram. Return whether the datagram may be accepted.

        A number is refused if it was recorded before, or is REPLAY_WINDOW or more behind the newest number."""
        newest, skipped = self.newest, self.skipped
        if sequence == newest + 1:  # the usual case: datagrams arrive in order
            self.newest = sequence
            return True
        if sequence <= newest:
            if sequence not in skipped or sequence <= newest - REPLAY_WINDOW:
                return False
            skipped.remove(sequence)
            return True
        oldest = sequence - REPLAY_WINDOW + 1
        if len(skipped) > REPLAY_WINDOW:
            skipped.difference_update([number for number in skipped if number < oldest])
        skipped.update(range(max(newest + 1, oldest), sequence))
        self.newest = sequence
        return True
