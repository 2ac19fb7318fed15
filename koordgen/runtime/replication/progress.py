"""Progress of the peers according to their last reports, and the commit index that follows from it.

A report says which rounds its sender has applied, and which entries it still needs."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from koordgen.runtime.net.wire import HeldFragments, View

LONG_AGO = -(2**62)  # a tick


def majority(n_sys: int) -> int:
    """Return the size of the smallest majority."""
    return n_sys // 2 + 1


@dataclass(slots=True)
class Progress:
    """Progress of one peer.

    Its reports only move forward: (view, applied) never decreases within an incarnation."""

    heard: int = LONG_AGO  # tick of the last message from the peer
    view: int = -1  # view of its last report; -1: none since it was admitted
    applied: int = 0  # the last round that it has reported as applied in that view
    wanted: int = 0  # the last round whose entries it needs
    lacks: bool = False  # the peer lacks entries up to `wanted`, and none were sent to it since its report
    held: Sequence[int] = ()  # at that report: for each author, the last round held; empty: `applied` for all
    informed: int = -1  # tick at which the present view was last sent to it
    asked_to_join: int = LONG_AGO  # tick of its last request to be admitted
    received: Mapping[int, HeldFragments] = field(
        default_factory=dict
    )  # by author: fragments that the peer has of the author's next entry

    def reset(self) -> None:
        """Forget the reports: the peer is no member any more, or has a new incarnation."""
        self.view, self.applied, self.wanted, self.lacks = -1, 0, 0, False

    def report(self, view: int, applied: int, held: Sequence[int], wanted: int, again: bool) -> bool:
        """Record a report. Return whether the peer has applied more rounds or entered a later view.

        view: view of the report.
        applied: last round that the peer has applied in that view.
        held: for each author, the last round whose entries the peer holds; empty: `applied` for all.
        wanted: last round whose entries the peer needs.
        again: the peer repeats its request.
        """
        moved = view >= self.view and applied >= self.applied and (applied > self.applied or view > self.view)
        if moved:
            self.view, self.applied = view, applied
        if wanted > self.wanted or (again and wanted == self.wanted):
            self.wanted = wanted
            self.held, self.lacks = held, (min(held) if held else applied) < wanted
        return moved

    def holds(self, author: int) -> int:
        """Return the last round up to which the peer holds the entries of a robot."""
        return self.held[author] if self.held else self.applied


def commit_index(peers: Collection[Progress], view: View, applied: int) -> int:
    """Return the last committed round: no later view can discard it.

    A round is committed if a majority, this robot included, has reported it as applied in `view`, or if it is before
    the beginning of `view`. Invariant: the result is at most `applied`.
    """
    needed = majority(len(peers) + 1) - 1  # reports of others
    if needed == 0:
        return applied
    number = view.number
    reported = sorted([p.applied if p.view == number else -1 for p in peers])
    return min(applied, max(view.since - 1, reported[-needed]))
