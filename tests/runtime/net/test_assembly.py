"""Entries in fragments, of one author at a time."""

from __future__ import annotations

import msgspec

from koordgen.runtime.net.assembly import Assembly
from koordgen.runtime.net.codec import encoder
from koordgen.runtime.net.fragments import cut
from koordgen.runtime.net.wire import Entry, Fragment, Head, Write

HEAD = Head(0, bytes(8), bytes(8), 0, bytes(8), bytes(8), 1, 1, None, ())


def entry(round_: int, author: int = 1) -> Entry:
    return Entry(author, 0, round_, round_, writes=(Write(0, msgspec.Raw(encoder.encode("x" * 2000))),))


def fragments(whole: Entry, author: int = 1) -> list[Fragment]:
    parts = cut(encoder.encode(whole), 800)
    return [Fragment(HEAD, author, whole.incarnation, whole.round, *part) for part in parts]


def wanted(author: int, round_: int) -> bool:
    return True


def test_a_entry_comes_with_its_last_fragment_and_then_nothing_is_begun() -> None:
    assembly, whole = Assembly(), entry(5)
    *first, last = fragments(whole)
    assert [assembly.add(p, wanted) for p in first] == [None] * len(first)
    (begun,) = assembly.received()
    assert (begun.author, begun.round, begun.digest, begun.mask) == (1, 5, last.digest, b"\x03")
    assert assembly.add(last, wanted) == whole
    assert assembly.received() == ()


def test_one_at_a_time_until_it_is_no_news_any_more() -> None:
    assembly = Assembly()
    assembly.add(fragments(entry(5))[0], wanted)
    assert assembly.add(fragments(entry(6))[0], wanted) is None
    assert [p.round for p in assembly.received()] == [5]
    assembly.add(fragments(entry(6))[0], lambda author, round_: round_ > 5)
    assert [p.round for p in assembly.received()] == [6]
    assert assembly.add(fragments(entry(6))[1], lambda author, round_: False) is None


def test_a_entry_of_another_than_its_fragments_say_is_refused() -> None:
    assembly = Assembly()
    *first, last = fragments(entry(5, author=2))
    for fragment in first:
        assembly.add(fragment, wanted)
    assert assembly.add(last, wanted) == "entry does not fit"
