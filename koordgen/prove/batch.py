"""Many queries at once: a room's facts are told once for all its obligations, and z3 works while the next room is made.

An answer counts when exactly as many words came as were asked for, each at its place.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from koordgen.prove.obligation import Obligation
from koordgen.prove.smtlib import together

if TYPE_CHECKING:
    from koordgen.prove.solve import Result, Solver

BRIEF = 0.5  # seconds for each query: what takes longer is asked alone, with all the time that it may have
MARK = "koordgen-batch"
WORDS: frozenset[str] = frozenset(("sat", "unsat", "unknown"))


class Batch:
    """The queries that were sent to one process, in their order."""

    def __init__(self, solver: Solver) -> None:
        self.solver = solver
        self.sent: list[tuple[Obligation, int, float]] = []  # how many goals each has, and when they were sent

    def add(self, room: Sequence[Obligation]) -> None:
        """Sends a room's obligations. Raises Broken."""
        parts = [self.solver.parts(obligation) for obligation in room]
        head, goals = together(room, parts)
        asked = [f'(push)\n{goal}(check-sat)\n(echo "{MARK}")\n(pop)\n' for each in goals for goal in each]
        self.solver.send(self.solver.room(room[0].logic, False, False, BRIEF) + head + "".join(asked))
        now = time.monotonic()
        self.sent += [(obligation, len(each), now) for obligation, each in zip(room, parts, strict=True)]

    def answers(self) -> dict[int, tuple[Result, float]]:
        """By the obligation's id, what is said of it, and after how many seconds it came: of answers that come at
        once, the first. None where anything but answers was said. Raises Broken."""
        count = sum(goals for _, goals, _ in self.sent)
        said, came = self.solver.rest(MARK, BRIEF * count)
        words, marks = said[::2], said[1::2]
        if len(said) != 2 * count or len(came) != count or not WORDS.issuperset(words) or set(marks) != {MARK}:
            return {}
        found: dict[int, tuple[Result, float]] = {}
        at, last = 0, 0.0
        for obligation, goals, sent in self.sent:
            own = words[at : at + goals]
            at += goals
            result: Result = "sat" if "sat" in own else "unknown" if "unknown" in own else "unsat"
            found[id(obligation)] = result, max(0.0, came[at - 1] - max(last, sent))
            last = came[at - 1]
        return found
