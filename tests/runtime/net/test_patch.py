"""Patches between encodings: any pair of values, hostile patches, and the sizes that they are there for."""

from __future__ import annotations

from random import Random

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koordgen.runtime.net.patch import WORTH, difference, patched
from koordgen.runtime.values.gridmap import GridMap, area, mark_occupied, merge
from koordgen.runtime.values.points import Grid, Point

encode = msgspec.msgpack.encode


def a_map(seed: int = 1) -> bytes:
    """The cells of a map of 160 x 140, as drives leave them: some known, most not."""
    random = Random(seed)
    m = area(Point(), Point(16, 14, 0), 0.1)
    for _ in range(40):
        m = mark_occupied(m, Grid(random.randrange(160), random.randrange(140), 0.1))
    return encode(m)


@given(st.binary(max_size=200), st.binary(max_size=200))
def test_a_patch_makes_the_new_of_the_old(old: bytes, new: bytes) -> None:
    patch = difference(old, new)
    if patch is None:
        return
    assert len(patch) <= WORTH * len(new)
    assert patched(old, patch, len(new)) == new
    assert patched(old, patch, len(new) - 1) is None


@given(
    st.binary(min_size=60, max_size=300), st.lists(st.tuples(st.integers(0, 299), st.binary(max_size=3)), max_size=5)
)
def test_small_changes_anywhere_come_back(old: bytes, changes: list[tuple[int, bytes]]) -> None:
    changed = bytearray(old)
    for at, data in changes:
        changed[at : at + len(data)] = data
    new = bytes(changed)
    patch = difference(old, new)
    assert patch is None or patched(old, patch, len(new)) == new


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (["some text"] * 12, ["some text"] * 13),
        (list(range(1000, 1060)), list(range(1000, 1061))),
        (list(range(1000, 1060)), list(range(1001, 1060))),
        (list(range(1000, 1060)), [*range(1000, 1030), 7, *range(1030, 1060)]),
        (list(range(1000, 1060)), [*range(1000, 1030), 5000, *range(1031, 1060)]),
        (["task", *["alice"] * 40], ["done", *["alice"] * 41]),
    ],
    ids=["append", "append behind a longer header", "pop the first", "insert", "replace", "header, first and last"],
)
def test_lists_that_change_little_become_short_patches(old: list[object], new: list[object]) -> None:
    patch = difference(encode(old), encode(new))
    assert patch is not None
    assert len(patch) <= 26
    assert patched(encode(old), patch, 1000) == encode(new)


def test_ten_by_ten_cells_of_a_map_of_5600_bytes_take_less_than_200() -> None:
    old = a_map()
    decoded = msgspec.msgpack.decode(old, type=GridMap)
    for x in range(73, 83):
        for y in range(60, 70):
            decoded = mark_occupied(decoded, Grid(x, y, 0.1))
    new = encode(decoded)
    assert len(new) == len(old) > 5600
    patch = difference(old, new)
    assert patch is not None
    assert len(patch) < 200
    assert patched(old, patch, len(new)) == new


def test_what_has_little_in_common_is_no_patch() -> None:
    random = Random(1)
    assert difference(random.randbytes(5000), random.randbytes(5000)) is None
    assert difference(b"", b"x" * 100) is None
    other = encode(merge(area(Point(), Point(16, 14, 0), 0.1), area(Point(-3, -3, 0), Point(20, 20, 0), 0.1)))
    patch = difference(a_map(), other)
    assert patch is None or patched(a_map(), patch, len(other)) == other


def test_the_same_value_is_a_patch_without_runs() -> None:
    same = a_map()
    patch = difference(same, same)
    assert patch == encode([])
    assert patched(same, patch, len(same)) == same


@pytest.mark.parametrize(
    "runs",
    [
        [[-1, 0, b""]],
        [[0, -1, b""]],
        [[5, -3, b""]],
        [[11, 0, b""]],
        [[0, 11, b""]],
        [[6, 0, b""], [5, 0, b""]],
        [[2**63, 2**64 - 1, b""]],
        [[0, 0, b"x" * 11]],
        [[0, 0, b"x" * 6], [0, 0, b"x" * 5]],
        [[0, 0, "text"]],
        [[0, 0]],
        [[0.0, 0, b""]],
        7,
        None,
    ],
)
def test_a_patch_that_does_not_fit_is_none(runs: object) -> None:
    assert patched(b"0123456789", encode(runs), 20) is None


@given(st.binary(max_size=60))
def test_no_patch_raises(patch: bytes) -> None:
    made = patched(b"0123456789" * 3, patch, 40)
    assert made is None or len(made) <= 40


def test_a_header_that_promises_more_than_there_is_takes_no_memory() -> None:
    assert patched(b"0", b"\xdd\xff\xff\xff\xff", 10) is None
    assert patched(b"0", b"\x91\x93\x00\x00\xc6\xff\xff\xff\xff", 10) is None
    assert patched(b"0", b"\x91" * 100_000, 10) is None
