"""Past stores: which are known, which are forgotten."""

from __future__ import annotations

import pytest

from koordgen.runtime.replication.outcome import FORGET_EVERY, Past


def past(count: int, stable: int) -> Past:
    """So many stores, each behind a silent round; rounds up to `stable` are."""
    made = Past(0, {"x": 0}, [0])
    for round_ in range(2, 2 * count, 2):
        made.add(round_, {"x": round_}, [round_], lambda of: of <= stable)
    return made


def test_a_store_is_that_of_the_silent_rounds_behind_it() -> None:
    made = past(5, stable=-1)
    for round_ in range(12):
        last = min(8, round_ // 2 * 2)
        assert made.at(round_) == ({"x": last}, [last])
    assert made.at(-1) is None


def test_few_are_all_kept() -> None:
    assert past(FORGET_EVERY, stable=100).at(0) == ({"x": 0}, [0])


@pytest.mark.parametrize("stable", [0, 2, 4, 12, 28, 30])
def test_of_many_those_before_the_last_stable_round_are_forgotten(stable: int) -> None:
    made = past(FORGET_EVERY + 1, stable)
    assert made.at(stable) == ({"x": stable}, [stable]) and made.at(stable - 1) is None
    assert made.at(32) == ({"x": 32}, [32])


def test_what_is_not_stable_is_never_forgotten() -> None:
    made = past(5 * FORGET_EVERY, stable=-1)
    assert all(made.at(round_) == ({"x": round_}, [round_]) for round_ in range(0, 10 * FORGET_EVERY, 2))
