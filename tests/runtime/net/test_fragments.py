"""Fragments in any order, twice, lost, forged."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from koordgen.runtime.net.fragments import Reassembly, cut, digest, lacking
from koordgen.runtime.net.wire import LIMIT, MOST_FRAGMENTS


@given(st.binary(min_size=1, max_size=400), st.integers(2, 50), st.randoms(use_true_random=False))
def test_fragments_in_any_order_make_the_blob(blob: bytes, room: int, random: Random) -> None:
    fragments = cut(blob, room)
    assert all(0 < len(data) <= room for *_, data in fragments)
    gathering = Reassembly(fragments[0][0], fragments[0][2])
    arrived = [*fragments, *fragments[: len(fragments) // 2]]
    random.shuffle(arrived)
    missing = set(range(len(fragments)))
    for fragment in arrived:
        assert gathering.blob() == (None if missing else blob)
        assert gathering.add(fragment) is None
        missing.discard(fragment[1])
        assert lacking(len(fragments), gathering.mask) == sorted(missing)
    assert gathering.blob() == blob


def test_only_what_is_lacking_is_repeated() -> None:
    fragments = cut(bytes(range(100)), 10)
    gathering = Reassembly(fragments[0][0], 10)
    for i in (0, 3, 9):
        gathering.add(fragments[i])
    repeated = lacking(10, gathering.mask)
    assert repeated == [1, 2, 4, 5, 6, 7, 8]
    for i in repeated:
        gathering.add(fragments[i])
    assert gathering.blob() == bytes(range(100))
    assert gathering.mask == b"\xff\x03"
    assert lacking(10, gathering.mask) == []
    assert lacking(3, b"") == [0, 1, 2]
    assert lacking(3, b"\x02" + b"\xff" * 40) == [0, 2]


def test_a_blob_of_256_kib_goes_through() -> None:
    blob = Random(1).randbytes(256 * 1024)
    fragments = cut(blob, 1024)
    gathering = Reassembly(digest(blob), len(fragments))
    for fragment in reversed(fragments):
        assert gathering.add(fragment) is None
    assert (gathering.blob(), len(fragments)) == (blob, MOST_FRAGMENTS)


@pytest.mark.parametrize(("length", "room"), [(0, 10), (MOST_FRAGMENTS * 10 + 1, 10), (5000, LIMIT + 1)])
def test_what_cannot_be_cut_is_refused(length: int, room: int) -> None:
    with pytest.raises(ValueError, match=f"{length} bytes do not go into"):
        cut(bytes(length), room)


def test_what_does_not_go_with_the_others_is_refused() -> None:
    name, *_ = cut(b"0123456789", 4)[0]
    gathering = Reassembly(name, 3)
    assert gathering.add((bytes(8), 0, 3, b"0123")) == "fragment of another blob"
    assert gathering.add((name, 0, 4, b"0123")) == "fragment of another blob"
    for index, data in ((3, b"0123"), (-1, b"0123"), (0, b""), (0, b"x" * (LIMIT + 1))):
        assert gathering.add((name, index, 3, data)) == "fragment does not fit"
    assert gathering.add((name, 2, 3, b"89")) is None
    assert gathering.add((name, 0, 3, b"0")) == "fragment does not fit", "shorter than the last"
    assert gathering.add((name, 0, 3, b"0123")) is None
    assert gathering.add((name, 1, 3, b"456")) == "fragment does not fit", "not as long as the first"
    assert gathering.mask == b"\x05"


def test_the_last_fragment_is_no_longer_than_the_others() -> None:
    gathering = Reassembly(bytes(8), 2)
    assert gathering.add((bytes(8), 0, 2, b"01")) is None
    assert gathering.add((bytes(8), 1, 2, b"234")) == "fragment does not fit"


@pytest.mark.parametrize("count", [-1, 0, MOST_FRAGMENTS + 1, 1 << 60])
def test_a_count_that_no_blob_has_takes_nothing(count: int) -> None:
    gathering = Reassembly(bytes(8), count)
    for index in (-2, -1, 0, 1, MOST_FRAGMENTS, 1 << 59):
        assert gathering.add((bytes(8), index, count, b"x")) == "fragment does not fit"
    assert (gathering.mask, gathering.blob()) == (b"", None)


def test_a_forged_fragment_costs_a_repeat_and_nothing_else() -> None:
    fragments = cut(b"0123456789", 4)
    gathering = Reassembly(fragments[0][0], 3)
    forged = (*fragments[1][:3], b"4x67")
    for fragment in (fragments[0], forged, fragments[2]):
        assert gathering.add(fragment) is None
    assert gathering.blob() is None
    assert gathering.mask == b""
    for fragment in fragments:
        assert gathering.add(fragment) is None
    assert gathering.blob() == b"0123456789"
