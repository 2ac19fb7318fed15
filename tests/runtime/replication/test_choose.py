"""What a proposer makes of the promises it got."""

from __future__ import annotations

import pytest

from koordgen.runtime.net.wire import View
from koordgen.runtime.replication.views import Word, choose

ALL = View(0, 1, (0, 0, 0, 0, 0))


def word(applied: int, state: bool = True, view: int = 0) -> Word:
    return Word(view, applied, state)


def test_who_has_promised_is_in_it_and_the_rounds_go_on_behind_the_last_applied_one() -> None:
    assert choose(ALL, {0: word(7), 2: word(8), 4: word(6)}) == View(1, 9, (0, -1, 0, -1, 0))


def test_no_majority_makes_no_view() -> None:
    assert choose(ALL, {0: word(7), 2: word(8)}) is None


def test_a_robot_without_its_store_is_let_in_anew() -> None:
    assert choose(ALL, {0: word(7), 1: word(7), 2: word(7), 3: word(5, state=False)}) == View(1, 8, (0, 0, 0, 1, -1))


def test_a_robot_that_went_by_an_older_view_is_let_in_anew() -> None:
    before = View(3, 5, (0, 0, 0, 2, -1))
    words = {0: word(7, view=3), 1: word(7, view=3), 2: word(7, view=3), 4: word(99, view=1)}
    assert choose(before, words) == View(4, 8, (0, 0, 0, -1, 4))


def test_a_round_that_only_a_restarted_robot_had_applied_need_not_be_waited_for() -> None:
    """Nobody else has its closing of that round any more; as no majority has applied it, nothing depends on it."""
    words = {0: word(7), 1: word(7), 2: word(7), 3: word(8, state=False), 4: word(7)}
    assert choose(ALL, words) == View(1, 8, (0, 0, 0, 1, 0))


@pytest.mark.parametrize(
    "words",
    [
        {0: word(7), 3: word(8, state=False), 4: word(7)},  # the two silent ones may have applied 8 as well
        {0: word(7), 1: word(7), 2: word(8, state=False), 3: word(8, state=False), 4: word(8, state=False)},
    ],
)
def test_a_round_that_may_be_stable_is_waited_for(words: dict[int, Word]) -> None:
    assert choose(ALL, words) is None


def test_a_view_never_begins_before_the_one_that_it_follows() -> None:
    before = View(1, 10, (0, 0, 0, 0, -1))
    behind = {0: word(7, view=1), 1: word(8, view=1), 2: word(7, view=1)}
    assert choose(before, behind) is None
    assert choose(before, behind | {3: word(9, view=1)}) == View(2, 10, (0, 0, 0, 0, -1))


def test_what_had_a_vote_is_put_to_the_vote_again() -> None:
    earlier = View(1, 6, (0, 0, 0, -1, -1))
    words = {0: word(7), 1: Word(0, 7, True, 129, earlier), 2: Word(0, 7, True, 128, View(1, 5, (0, 0, 0, 0, -1)))}
    assert choose(ALL, words) == earlier


def test_a_value_that_too_few_can_have_voted_for_binds_nobody() -> None:
    earlier = View(1, 6, (0, 0, 0, -1, -1))
    words = {p: word(7) for p in range(1, 5)} | {0: Word(0, 7, True, 129, earlier)}
    assert choose(ALL, words) == View(1, 8, (0, 0, 0, 0, 0))
    del words[4], words[3]  # the two that are silent may have voted for it as well
    assert choose(ALL, words) == earlier
