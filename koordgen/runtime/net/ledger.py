"""Table of a robot's replica: how far each robot's log entries are held, and what each peer acknowledged last."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

from koordgen.runtime.net.wire import MAX_ROBOTS

SETTLED, LACKING, WATCHED, REACHED, WANTING = range(5)
NUMBERS = 5


class Ledger:
    """Of robot `pid` in a fleet of `n_sys`. Columns by pid: entries are `held` without a gap up to a round; there is a
    `gap`: some are kept beyond `held`. Of the last acknowledgement: by which `view` (-1: none), `applied` up to there,
    wanted entries up to `through`, and is `wanting`: lacks something that it was not sent; its row of `lacks` is what
    it held then of each robot's entries.

    `number` holds, by SETTLED and so on: the round up to which everyone holds everything; how many members' entries of
    the next round are missing; a watched round (-1: none), and how many have acknowledged it; how many are wanting.
    """

    def __init__(self, pid: int, n_sys: int, applied: int = 0) -> None:
        assert n_sys <= MAX_ROBOTS
        self.pid, self.n_sys = pid, n_sys
        none = bytes(8 * n_sys)
        self.held, self.view = array("q", [applied] * n_sys), array("q", [-1] * n_sys)
        self.applied, self.through = array("q", none), array("q", none)
        self.wanting, self.gap = array("B", bytes(n_sys)), array("B", bytes(n_sys))
        self.lacks = array("q", none * n_sys)
        self.number = array("q", [0] * NUMBERS)

    def lost(self, pids: Sequence[int]) -> bool:
        """Return whether a peer has what is missing of these robots: more of one came, or a peer has applied more."""
        applied = max(self.applied)
        return any(self.gap[p] or self.held[p] < applied for p in pids)
