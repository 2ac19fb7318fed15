"""Sessions with peers: the adopted boot of each, its replay window, and the stamps that the fleet clock learns from."""

from __future__ import annotations

import math
from dataclasses import dataclass

REPLAY_WINDOW = 1024  # datagrams that may arrive out of order
_FULL = (1 << REPLAY_WINDOW) - 1


@dataclass(slots=True)
class PeerSession:
    """State of one boot of one peer, from its adoption on.

    `newest` is the highest sequence number received. Bit i of `seen` tells whether `newest - i` was received or must
    not be received any more: at adoption all bits are set, so nothing up to that number, perhaps recorded, counts.
    `sent` is the latest stamp received in microseconds of the peer's clock (-1: none), `arrived` when it arrived here,
    and `round` the highest round that the peer reported. From local time `due` (seconds) on the fleet clock wants
    another exchange.
    """

    boot: bytes
    newest: int = 0
    sent: int = -1
    arrived: int = 0
    round: int = 0
    due: float = -math.inf
    seen: int = _FULL

    def accept(self, sequence: int) -> bool:
        """Record a sequence number. False if it was recorded before, or is REPLAY_WINDOW or more behind the newest."""
        ahead = sequence - self.newest
        if ahead > 0:
            self.seen = (self.seen << ahead & _FULL) | 1 if ahead < REPLAY_WINDOW else 1
            self.newest = sequence
            return True
        bit = 1 << -ahead if ahead > -REPLAY_WINDOW else 0
        if not bit or self.seen & bit:
            return False
        self.seen |= bit
        return True
