"""Writes as they go over the wire: whole or as patches, and what is refused of either."""

from __future__ import annotations

from enum import IntEnum
from random import Random
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koordgen.runtime.net.codec import encoder, overhead
from koordgen.runtime.net.layout import MOST_ENTRY, MOST_SHARED, Layout, TooLarge, Unpatched, most_entry
from koordgen.runtime.net.patch import difference
from koordgen.runtime.net.wire import LIMIT, MAX_ROBOTS, MOST_FRAGMENTS, Entry, Write
from koordgen.runtime.program.program import Variable
from koordgen.runtime.values.bounds import Cells, Distinct, Fixed, Many, Text
from koordgen.runtime.values.gridmap import GridMap, area, mark_occupied
from koordgen.runtime.values.points import Grid, Point

INT, NUMBER = Fixed(9), Fixed(9)
SHARED = (
    Variable("map", "allwrite", GridMap, Cells(160 * 140), GridMap),
    Variable("seen", "allread", GridMap, Cells(160 * 140), GridMap),
    Variable("ids", "allwrite", tuple[int, ...], Distinct(100, INT), lambda: ()),
    Variable("ways", "allread", tuple[float, ...], Many(60, NUMBER), lambda: ()),
    Variable("note", "allwrite", str, Text(300), str),
)
MAP = mark_occupied(area(Point(), Point(16, 14, 0), 0.1), Grid(80, 70, 0.1))
MORE = mark_occupied(MAP, Grid(81, 70, 0.1))


def store(layout: Layout, **values: Any) -> dict[str, Any]:
    return {**layout.initial(), **values}


def entry(*writes: Write, **changes: Any) -> Entry:
    return Entry(**{"author": 1, "incarnation": 0, "first": 4, "round": 4, "writes": writes, **changes})


def received(entry: Entry) -> Entry:
    """As it comes over the network."""
    return msgspec.msgpack.decode(encoder.encode(entry), type=Entry)


def values(layout: Layout, entry: Entry) -> list[tuple[int, Any]] | None:
    """Return the values of the only event in an entry; None if the entry is refused."""
    events = layout.read(entry)
    return None if events is None else [pair for event in events for pair in event.values]


def through(layout: Layout, written: dict[str, Any], before: dict[str, Any], author: int = 1) -> dict[str, Any]:
    """What others make of an event's writes."""
    items = values(layout, received(entry(*layout.written(written, before, author)[0], author=author)))
    assert items is not None
    return {layout.names[i]: layout.resolve(i, item, layout.base(i, before, author)) for i, item in items}


def test_a_large_value_that_changes_little_goes_as_a_patch() -> None:
    layout = Layout(SHARED, 3)
    before = store(layout, map=MAP, seen=(GridMap(), MAP, GridMap()), note="a")
    written = {"map": MORE, "seen": MORE, "note": "b"}
    writes = layout.written(written, before, 1)[0]
    assert [(w.index, w.patch) for w in writes] == [(0, True), (1, True), (4, False)]
    assert len(encoder.encode(entry(*writes))) < 60
    assert through(Layout(SHARED, 3), written, before) == written


def test_the_base_of_an_allread_variable_is_the_authors_slot() -> None:
    layout = Layout(SHARED, 3)
    before = store(layout, seen=(GridMap(), MAP, GridMap()))
    (write,) = layout.written({"seen": MORE}, before, 0)[0]
    assert not write.patch
    (write,) = layout.written({"seen": MORE}, before, 1)[0]
    assert write.patch
    assert layout.base(1, before, 2) == GridMap()


def test_without_a_base_all_goes_whole() -> None:
    layout = Layout(SHARED, 3)
    (write,) = layout.written({"map": MORE})[0]
    assert (write.patch, bytes(write.value)) == (False, encoder.encode(MORE))


def test_a_short_value_goes_whole() -> None:
    layout = Layout(SHARED, 3)
    (write,) = layout.written({"note": "x" * 240 + "a"}, {"note": "x" * 240 + "b"})[0]
    assert not write.patch
    (write,) = layout.written({"note": "x" * 270 + "a"}, {"note": "x" * 270 + "b"})[0]
    assert write.patch


@given(st.randoms(use_true_random=False))
def test_whatever_is_written_arrives(random: Random) -> None:
    layout, remote = Layout(SHARED, 3), Layout(SHARED, 3)
    before = store(layout)
    for _ in range(5):
        cells = [Grid(random.randrange(160), random.randrange(140), 0.1) for _ in range(random.randrange(5))]
        changed = before["map"] if random.random() < 0.5 and before["map"].width else MAP
        for cell in cells:
            changed = mark_occupied(changed, cell)
        ways = (*before["ways"][1], *[random.random() for _ in range(random.randrange(4))])[-60:]
        ids = tuple(sorted({*before["ids"], random.randrange(-9, 1 << 40)}))
        written = {"map": changed, "ways": ways, "ids": ids, "note": random.choice("ab") * random.randrange(200)}
        arrived = through(layout, written, before)
        assert arrived == through(remote, written, before) == written
        before = {**before, **written, "ways": (before["ways"][0], ways, before["ways"][2])}


class Odd(IntEnum):
    """No value of ours, but encoded like one."""

    ONE = 1


SCALARS = (
    Variable("count", "allread", int, INT, lambda: 0),
    Variable("share", "allwrite", float, NUMBER, lambda: 0.0),
    Variable("on", "allwrite", bool, NUMBER, lambda: False),
    Variable("text", "allwrite", str, Text(4), str),
    Variable("at", "allwrite", Point, Fixed(28), Point),
    Variable("note", "allwrite", str, Text(600), str),
)
_number = st.integers(-(2**63), 2**64 - 1) | st.booleans() | st.just(Odd.ONE) | st.floats()


@given(
    st.fixed_dictionaries(
        {},
        optional={
            "count": _number,
            "share": _number,
            "on": _number,
            "text": st.text(max_size=6) | _number,
            "at": st.builds(Point, _number, _number, _number),
            "note": st.text("ab", min_size=250, max_size=400),
        },
    )
)
def test_what_an_author_keeps_of_its_writes_is_what_the_others_read(written: dict[str, Any]) -> None:
    layout = Layout(SCALARS, 3)
    writes, kept = layout.written(written, store(layout, note="ab" * 150), 1)
    read = values(Layout(SCALARS, 3), received(entry(*writes)))
    assert (kept is None) == (read is None) and repr(list(kept or ())) == repr(list(read or ()))


def patch_of(value: Any, base: Any) -> bytes:
    made = difference(encoder.encode(base), encoder.encode(value))
    assert made is not None
    return made


IDS = tuple(range(1000, 1060))


@pytest.mark.parametrize(
    "patch",
    [
        patch_of((*IDS[:30], 7, *IDS[31:]), IDS),
        patch_of((*IDS, *range(2000, 2041)), IDS),
        encoder.encode([(0, 0, b"\xc0")]),
        encoder.encode([(0, 1000, b"")]),
        encoder.encode([(4, 2, b"\xcb\x7f\xf0")]),
        b"",
        b"\xc0",
        b"\xdd\xff\xff\xff\xff",
    ],
    ids=["out of order", "too many", "not the type", "beyond the end", "no encoding", "none", "nil", "bomb"],
)
def test_a_patch_that_makes_no_value_of_the_program_is_dropped(patch: bytes) -> None:
    layout = Layout(SHARED, 3)
    assert layout.resolve(2, Unpatched(patch), IDS) is None


def test_a_patch_makes_no_more_bytes_than_the_variable_may_have() -> None:
    layout = Layout((Variable("note", "allwrite", str, Text(200), str),), 3)
    assert layout.resolve(0, Unpatched(encoder.encode([(2, 0, b"x")])), "a" * 10) is None, "one byte too many"
    assert (
        layout.resolve(0, Unpatched(encoder.encode([(0, 1, b"\xdb\0\0\0\xff"), (9, 1, b"x" * 247)])), "a" * 10) is None
    )


def test_a_value_that_came_whole_stays() -> None:
    assert Layout(SHARED, 3).resolve(2, (1, 2), None) == (1, 2)


def test_one_base_serves_all_who_patch_it() -> None:
    """It is encoded once; another value, equal or not, anew."""
    layout = Layout(SHARED, 3)
    others = [mark_occupied(MAP, Grid(k, k, 0.1)) for k in range(5)]
    for other in others:
        assert layout.resolve(0, Unpatched(patch_of(other, MAP)), MAP) == other
    assert layout._encoding(0, MAP) is layout._encoding(0, MAP)
    assert layout.resolve(0, Unpatched(patch_of(MORE, others[0])), others[0]) == MORE
    assert layout.resolve(0, Unpatched(patch_of(MORE, others[1])), others[1]) == MORE


VALUE = msgspec.Raw(encoder.encode("a"))


@pytest.mark.parametrize(
    "wrong",
    [
        entry(author=3),
        entry(first=5),
        entry(Write(4, VALUE), first=3),
        entry(first=3, acted=True),
        entry(Write(5, VALUE)),
        entry(Write(5, VALUE, True)),
        entry(Write(4, VALUE), Write(4, VALUE)),
        entry(Write(4, VALUE), Write(4, VALUE, True)),
        entry(Write(4, VALUE), Write(2, VALUE)),
        entry(Write(2, VALUE)),
        entry(Write(4, msgspec.Raw(b"\xc0"))),
        entry(Write(4, msgspec.Raw(b""))),
    ],
)
def test_a_entry_that_does_not_fit_is_refused(wrong: Entry) -> None:
    assert Layout(SHARED, 3).read(wrong) is None


def test_what_is_read_keeps_no_datagram_alive() -> None:
    data = encoder.encode(entry(Write(0, msgspec.Raw(b"\xc0"), True)))
    items = values(Layout(SHARED, 3), msgspec.msgpack.decode(memoryview(data), type=Entry))
    assert items == [(0, Unpatched(b"\xc0"))]


def lists(count: int) -> tuple[Variable, ...]:
    """Ten thousand bytes each, about."""
    return tuple(Variable(f"x{i}", "allwrite", str, Text(10_000), str) for i in range(count))


def test_what_no_robot_can_send_in_a_round_is_told() -> None:
    Layout(lists(13), 5)
    with pytest.raises(TooLarge, match="take up to 140150 bytes; with 5 robots at most 131072 can be sent"):
        Layout(lists(14), 5)
    with pytest.raises(TooLarge, match=f"{MOST_SHARED + 1} shared variables; at most {MOST_SHARED}"):
        Layout(tuple(Variable(f"b{i}", "allwrite", bool, Fixed(1), bool) for i in range(MOST_SHARED + 1)), 5)
    with pytest.raises(TooLarge, match=f"a fleet of {MAX_ROBOTS + 1} robots"):
        Layout((), MAX_ROBOTS + 1)


def test_every_entry_goes_into_so_many_fragments() -> None:
    for n in range(1, MAX_ROBOTS + 1):
        assert 0 < most_entry(n) <= min(MOST_ENTRY, MOST_FRAGMENTS * (LIMIT - overhead(n)))


def test_no_entry_is_longer_than_is_reckoned() -> None:
    layout = Layout(SHARED, 3)
    top = 2**53
    far, cells = 2**62, (160 * 140) // 4
    longest = {
        "map": GridMap(0.1, far, far, 160, 140, bytes(cells)),
        "seen": GridMap(0.1, far, far, 160, 140, bytes(cells)),
        "ids": tuple(range(-(2**63), -(2**63) + 100)),
        "ways": tuple(0.1 * k for k in range(60)),
        "note": "x" * 300,
    }
    made = Entry(MAX_ROBOTS - 1, top, top, top, True, True, True, 65535, layout.written(longest)[0])
    assert layout.entry_bytes - 80 < len(encoder.encode(made)) <= layout.entry_bytes


@pytest.mark.parametrize(
    "text", ["", "nine char", "ten chars!", "\u00e9" * 4, "\u00e9" * 5, "\u20ac" * 3, "\u20ac" * 4]
)
def test_a_text_fits_by_its_bytes(text: str) -> None:
    layout = Layout((Variable("text", "allread", str, Text(9), str),), 1)
    entry = Entry(0, 0, 1, 1, writes=(Write(0, msgspec.Raw(encoder.encode(text))),))
    assert values(layout, entry) == ([(0, text)] if len(text.encode()) <= 9 else None)
