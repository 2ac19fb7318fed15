"""Closings in pieces, of one author at a time."""

from __future__ import annotations

import msgspec

from koordgen.runtime.net.assembly import Assembly
from koordgen.runtime.net.pieces import cut
from koordgen.runtime.net.wire import Closing, Head, Piece, Write, encoder

HEAD = Head(0, bytes(8), bytes(8), 0, bytes(8), bytes(8), 1, 1, None, ())


def closing(round_: int, author: int = 1) -> Closing:
    return Closing(author, 0, round_, round_, writes=(Write(0, msgspec.Raw(encoder.encode("x" * 2000))),))


def pieces(whole: Closing, author: int = 1) -> list[Piece]:
    parts = cut(encoder.encode(whole), 800)
    return [Piece(HEAD, author, whole.incarnation, whole.round, *part) for part in parts]


def wanted(author: int, round_: int) -> bool:
    return True


def test_a_closing_comes_with_its_last_piece_and_then_nothing_is_begun() -> None:
    assembly, whole = Assembly(), closing(5)
    *first, last = pieces(whole)
    assert [assembly.take(p, wanted) for p in first] == [None] * len(first)
    (begun,) = assembly.partly()
    assert (begun.author, begun.round, begun.digest, begun.mask) == (1, 5, last.digest, b"\x03")
    assert assembly.take(last, wanted) == whole
    assert assembly.partly() == ()


def test_one_at_a_time_until_it_is_no_news_any_more() -> None:
    assembly = Assembly()
    assembly.take(pieces(closing(5))[0], wanted)
    assert assembly.take(pieces(closing(6))[0], wanted) is None
    assert [p.round for p in assembly.partly()] == [5]
    assembly.take(pieces(closing(6))[0], lambda author, round_: round_ > 5)
    assert [p.round for p in assembly.partly()] == [6]
    assert assembly.take(pieces(closing(6))[1], lambda author, round_: False) is None


def test_a_closing_of_another_than_its_pieces_say_is_refused() -> None:
    assembly = Assembly()
    *first, last = pieces(closing(5, author=2))
    for piece in first:
        assembly.take(piece, wanted)
    assert assembly.take(last, wanted) == "closing does not fit"
