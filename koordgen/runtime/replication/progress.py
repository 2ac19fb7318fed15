"""Progress of the peers by their last reports, and the commit index computed from these reports.

A report says which rounds its sender has applied, and which entries the sender still needs."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from koordgen.runtime.net.wire import HeldFragments, View

LONG_AGO = -(2**62)  # a tick before all ticks of a mission


def majority(n_sys: int) -> int:
    """Return the size of the smallest majority."""
    return n_sys // 2 + 1


@dataclass(slots=True)
class Progress:
    """Progress of one peer, as the peer has reported it.

    Invariant: the pair (view, applied) never decreases within an incarnation of the peer."""

    heard: int = LONG_AGO  # tick of the last message from the peer
    view: int = -1  # view of the peer's last report; -1: no report since the peer was admitted
    applied: int = 0  # last round that the peer has reported as applied in `view`
    wanted: int = 0  # last round whose entries the peer needs
    lacks: bool = False  # the peer has reported missing entries up to `wanted`, and has been sent none since
    held: Sequence[int] = ()  # for each author, the last round whose entries the peer holds; empty: `applied` for all
    informed: int = -1  # tick at which this robot last sent the present view to the peer
    asked_to_join: int = LONG_AGO  # tick of the peer's last request to be admitted
    received: Mapping[int, HeldFragments] = field(
        default_factory=dict
    )  # author -> fragments of the author's next entry that the peer holds

    def reset(self) -> None:
        """Discard the peer's reports, because the peer was removed or has a new incarnation."""
        self.view, self.applied, self.wanted, self.lacks = -1, 0, 0, False

    def report(self, view: int, applied: int, held: Sequence[int], wanted: int, again: bool) -> bool:
        """Record a report. Return whether the peer has applied more rounds or entered a later view.

        view: view of the report.
        applied: last round that the peer has applied in that view.
        held: for each author, the last round whose entries the peer holds; empty: `applied` for all.
        wanted: last round whose entries the peer needs.
        again: the report is a request (Nack). The peer then counts as lacking entries even if `wanted` is unchanged.
        """
        moved = view >= self.view and applied >= self.applied and (applied > self.applied or view > self.view)
        if moved:
            self.view, self.applied = view, applied
        if wanted > self.wanted or (again and wanted == self.wanted):
            self.wanted = wanted
            self.held, self.lacks = held, (min(held) if held else applied) < wanted
        return moved

    def holds(self, author: int) -> int:
        """Return the last round up to which the peer holds all entries of robot `author`."""
        return self.held[author] if self.held else self.applied


def commit_index(peers: Collection[Progress], view: View, applied: int) -> int:
    """Return the last committed round, which no later view can discard.

    A round is committed in two cases: a majority that includes this robot has reported the round as applied in `view`,
    or the round lies before the beginning of `view`. Invariant: the result is at most `applied`.
    """
    needed = majority(len(peers) + 1) - 1  # number of other robots whose reports are needed
    if needed == 0:
        return applied
    number = view.number
    reported = sorted([p.applied if p.view == number else -1 for p in peers])
    return min(applied, max(view.since - 1, reported[-needed]))
