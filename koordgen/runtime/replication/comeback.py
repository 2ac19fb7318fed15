"""How a robot that does not count, or has lost the store, comes back: it asks to be let in, then for the store.

Rejoin and state transfer.

It is in again when a view has admitted it under a new incarnation. From then on it closes the rounds, in which it does
nothing, so that nobody waits for it; and it gathers the store, piece by piece, from one member at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from koordgen.runtime.net.pieces import Gathering, cut, lacking
from koordgen.runtime.net.wire import Closing, State, StatePiece, View, Want, encoder, state_of
from koordgen.runtime.replication.views import Out

PATIENCE = 5  # ticks without a new piece, then another member is asked
BURST = 16  # pieces for one request
KEPT = 2  # stores kept in pieces for those who have begun to gather them


@dataclass(slots=True)
class Comeback:
    """`since` is the view that was known when it fell out; the rounds closed since there is no store are `silent`."""

    pid: int
    since: int
    gathering: Gathering | None = None
    round: int = 0
    source: int = 0
    news: int = 0  # the tick of the last new piece, or of the last change of the source
    silent: Closing | None = None

    def incarnation(self, view: View) -> int:
        """Under which it is in again; -1: not yet."""
        own = view.members[self.pid]
        return own if own > self.since else -1

    def silence(self, round_: int, view: View) -> Closing | None:
        """The closing of one that is in again and has no store yet: it does nothing."""
        incarnation = self.incarnation(view)
        if incarnation < 0 or round_ < view.since:
            return None
        first = self.silent.first if self.silent is not None else view.since
        self.silent = Closing(self.pid, incarnation, first, round_)
        return self.silent

    def poll(self, tick: int, view: View) -> list[Out]:
        """What to ask for at this tick."""
        others = [p for p, m in enumerate(view.members) if p != self.pid]
        incarnation = self.incarnation(view)
        if incarnation < 0:
            return [(others, Want, (view.number, -1, 0, b"", b""))]
        members = [p for p in others if view.members[p] >= 0]
        if tick - self.news > PATIENCE:
            self.news, self.source, self.gathering = tick, self.source + 1, None
        if not members:
            return []
        known = self.gathering
        place = (0, b"", b"") if known is None else (self.round, known.name, known.mask)
        return [([members[self.source % len(members)]], Want, (view.number, incarnation, *place))]

    def take(self, piece: StatePiece, tick: int) -> State | str | None:
        """Take a piece: the store once it is complete, or why the piece is refused."""
        if self.gathering is None:
            self.gathering, self.round = Gathering(piece.digest, piece.count), piece.round
        refused = self.gathering.take((piece.digest, piece.index, piece.count, piece.data))
        if refused is not None:
            return refused
        self.news = tick
        blob = self.gathering.blob()
        if blob is None:
            return None
        self.gathering = None
        return state_of(blob) or "store does not fit"


class Store:
    """The other side: hands the store to those who come in."""

    def __init__(self) -> None:
        self._kept: list[tuple[int, list[tuple[bytes, int, int, bytes]]]] = []

    def answer(self, sender: int, want: Want, applied: int, make: Callable[[], State], room: int) -> list[Out]:
        """The pieces that `sender` lacks, of the store it has begun to gather, or else of the present one, which has
        `applied` so many rounds; it is made when it is needed."""
        known = [k for k in self._kept if k[0] == want.round and k[1][0][0] == want.digest]
        if not known and (not self._kept or self._kept[-1][0] != applied):
            self._kept = [*self._kept[1 - KEPT :], (applied, cut(encoder.encode(make()), room))]
        round_, pieces = known[0] if known else self._kept[-1]
        wanted: Sequence[int] = lacking(len(pieces), want.mask if known else b"")
        return [((sender,), StatePiece, (round_, *pieces[index])) for index in wanted[:BURST]]
