"""Choice of the next view from the promises that its proposer got."""

from __future__ import annotations

import pytest

from koordgen.runtime.net.wire import View
from koordgen.runtime.replication.views import Report, choose

ALL = View(0, 1, (0, 0, 0, 0, 0))


def report(applied: int, has_store: bool = True, view: int = 0) -> Report:
    return Report(view, applied, has_store)


def test_members_are_those_that_promised_and_rounds_go_on_after_the_last_applied_one() -> None:
    assert choose(ALL, {0: report(7), 2: report(8), 4: report(6)}) == View(1, 9, (0, -1, 0, -1, 0))


def test_without_a_majority_there_is_no_view() -> None:
    assert choose(ALL, {0: report(7), 2: report(8)}) is None


def test_a_robot_without_its_store_gets_a_new_incarnation() -> None:
    assert choose(ALL, {0: report(7), 1: report(7), 2: report(7), 3: report(5, has_store=False)}) == View(
        1, 8, (0, 0, 0, 1, -1)
    )


def test_a_robot_of_an_older_view_gets_a_new_incarnation() -> None:
    before = View(3, 5, (0, 0, 0, 2, -1))
    reports = {0: report(7, view=3), 1: report(7, view=3), 2: report(7, view=3), 4: report(99, view=1)}
    assert choose(before, reports) == View(4, 8, (0, 0, 0, -1, 4))


def test_a_round_that_only_a_restarted_robot_had_applied_is_left_out() -> None:
    """No other robot has its entry of that round any more. No majority has applied it, so nothing depends on it."""
    reports = {0: report(7), 1: report(7), 2: report(7), 3: report(8, has_store=False), 4: report(7)}
    assert choose(ALL, reports) == View(1, 8, (0, 0, 0, 1, 0))


@pytest.mark.parametrize(
    "reports",
    [
        {0: report(7), 3: report(8, has_store=False), 4: report(7)},  # the two absent robots may have applied 8, too
        {
            0: report(7),
            1: report(7),
            2: report(8, has_store=False),
            3: report(8, has_store=False),
            4: report(8, has_store=False),
        },
    ],
)
def test_a_round_that_may_be_committed_is_waited_for(reports: dict[int, Report]) -> None:
    assert choose(ALL, reports) is None


def test_a_view_never_begins_before_its_predecessor() -> None:
    before = View(1, 10, (0, 0, 0, 0, -1))
    behind = {0: report(7, view=1), 1: report(8, view=1), 2: report(7, view=1)}
    assert choose(before, behind) is None
    assert choose(before, behind | {3: report(9, view=1)}) == View(2, 10, (0, 0, 0, 0, -1))


def test_a_value_that_had_a_vote_is_put_to_the_vote_again() -> None:
    earlier = View(1, 6, (0, 0, 0, -1, -1))
    reports = {
        0: report(7),
        1: Report(0, 7, True, 129, earlier),
        2: Report(0, 7, True, 128, View(1, 5, (0, 0, 0, 0, -1))),
    }
    assert choose(ALL, reports) == earlier


def test_a_value_that_too_few_can_have_voted_for_binds_nobody() -> None:
    earlier = View(1, 6, (0, 0, 0, -1, -1))
    reports = {p: report(7) for p in range(1, 5)} | {0: Report(0, 7, True, 129, earlier)}
    assert choose(ALL, reports) == View(1, 8, (0, 0, 0, 0, 0))
    del reports[4], reports[3]  # the two absent robots may have voted for it, too
    assert choose(ALL, reports) == earlier
