"""Closings that are longer than a datagram, put together from their pieces: one of each author at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from koordgen.runtime.net.pieces import Gathering
from koordgen.runtime.net.wire import Closing, Partly, Piece, closing_of

MOST_PARTLY = 8  # that one question speaks of


@dataclass(frozen=True, slots=True)
class _Begun:
    incarnation: int
    round: int
    pieces: Gathering


class Assembly:
    """What is begun, by its author."""

    def __init__(self) -> None:
        self._begun: dict[int, _Begun] = {}

    def clear(self) -> None:
        self._begun.clear()

    def partly(self) -> tuple[Partly, ...]:
        """Which pieces are there, for those who are asked for the others."""
        begun = [Partly(author, b.round, b.pieces.name, b.pieces.mask) for author, b in self._begun.items()]
        return tuple(begun[:MOST_PARTLY])

    def take(self, piece: Piece, wanted: Callable[[int, int], bool]) -> Closing | str | None:
        """Take a piece: the closing once it is complete, or why the piece is refused. `wanted` tells whether the
        closing of an author and round would be news."""
        author = piece.author
        if not wanted(author, piece.round):
            return None
        known = self._begun.get(author)
        if known is None or (known.round != piece.round and not wanted(author, known.round)):
            known = _Begun(piece.incarnation, piece.round, Gathering(piece.digest, piece.count))
            self._begun[author] = known
        if (known.incarnation, known.round) != (piece.incarnation, piece.round):
            return None  # one at a time; it will be asked for again
        refused = known.pieces.take((piece.digest, piece.index, piece.count, piece.data))
        if refused is not None:
            return refused
        blob = known.pieces.blob()
        if blob is None:
            return None
        del self._begun[author]
        closing = closing_of(blob)
        return closing if closing is not None and closing.author == author else "closing does not fit"
