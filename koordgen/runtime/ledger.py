"""What a robot's memory looks at in every round, in columns that the compiled gate shares (ledger.h): how far each
robot's closings are held, what the others last said of themselves, and the closings of the last rounds as they came.
"""

from __future__ import annotations

from array import array

OPEN, LAST, TICK, APPLIED, SETTLED, LACKING, WATCHED, REACHED, TOLD, NEXT, LEAST = range(11)  # of `number`
NUMBERS = 11


class Ledger:
    """Of robot `pid` in a fleet of `n_sys`. Columns by pid: closings are `held` without a gap up to a round, those up
    to `floor` not here but in the robot's log; there is a `gap`: some are kept beyond `held`. The `incarnation` that
    counts, or -1. Of the last word: by which `view` (-1: none), `applied` up to there, wanted closings up to `through`,
    and is `wanting`: lacks something that it was not sent. It was `heard` at a tick."""

    def __init__(self, pid: int, n_sys: int, applied: int = 0) -> None:
        self.pid, self.n_sys = pid, n_sys
        none = bytes(8 * n_sys)
        self.held, self.floor = array("q", [applied] * n_sys), array("q", [applied] * n_sys)
        self.view, self.incarnation = array("q", [-1] * n_sys), array("q", [-1] * n_sys)
        self.applied, self.through, self.heard = array("q", none), array("q", none), array("q", none)
        self.wanting, self.gap = array("B", bytes(n_sys)), array("B", bytes(n_sys))
        self.number = array("q", [0] * NUMBERS)
