"""Progress of peers: what their reports change, which rounds are committed, and which reports are impossible."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.fixtures.fleet import Fleet
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.net.wire import View
from koordgen.runtime.replication.progress import Progress, commit_index, majority
from tests.runtime.replication.agents import replica_of

VIEW = View(3, 5, (0,) * 6)
Reports = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 20), st.integers(0, 20), st.booleans()))


def test_majorities() -> None:
    assert [majority(n) for n in range(1, 8)] == [1, 2, 2, 3, 3, 4, 4]


def peer(view: int, applied: int) -> Progress:
    progress = Progress()
    progress.report(view, applied, (), applied, again=False)
    return progress


@given(Reports)
def test_reports_only_move_forward(reports: list[tuple[int, int, int, bool]]) -> None:
    progress = Progress()
    before = progress.view, progress.applied, progress.wanted
    for view, applied, wanted, again in reports:
        progress.report(view, applied, (), wanted, again)
        after = progress.view, progress.applied, progress.wanted
        assert all(a <= b for a, b in zip(before, after, strict=True))
        before = after


def test_a_report_that_came_late_changes_nothing() -> None:
    progress = peer(3, 10)
    progress.report(3, 8, (), 8, again=False)
    progress.report(2, 12, (), 9, again=False)
    assert progress == peer(3, 10)


def test_a_peer_lacks_what_it_wants_and_does_not_hold() -> None:
    progress = Progress()
    progress.report(0, 4, (6, 4, 5), 6, again=False)
    assert [progress.lacks, *map(progress.holds, range(3))] == [True, 6, 4, 5]
    progress.report(0, 6, (), 6, again=True)
    assert [progress.lacks, *map(progress.holds, range(3))] == [False, 6, 6, 6]


def test_a_request_that_is_repeated_is_answered_again() -> None:
    progress = Progress()
    progress.report(0, 4, (), 6, again=False)
    progress.lacks = False  # it was sent the entries
    progress.report(0, 4, (), 6, again=False)
    assert not progress.lacks
    progress.report(0, 4, (), 6, again=True)
    assert progress.lacks


def test_reports_of_a_robot_with_another_incarnation_are_forgotten() -> None:
    progress = peer(3, 10)
    progress.reset()
    assert (progress.view, progress.applied, progress.lacks) == (-1, 0, False)
    progress.report(3, 7, (), 7, again=False)
    assert (progress.view, progress.applied) == (3, 7)


@pytest.mark.parametrize("n", range(1, 8))
def test_a_round_is_committed_once_a_majority_has_applied_it_in_the_present_view(n: int) -> None:
    view = View(3, 5, (0,) * n)
    for seed in range(100):
        rng = Random(seed)
        own, reports = rng.randrange(4, 21), [(rng.choice((2, 3, 3, 3, 4)), rng.randrange(4, 21)) for _ in range(n - 1)]
        index = commit_index([peer(*r) for r in reports], view, own)
        for round_ in range(view.since, 22):
            having = (own >= round_) + sum(number == view.number and last >= round_ for number, last in reports)
            assert (round_ <= index) == (own >= round_ and having >= majority(n)), (own, reports, round_)
        assert min(own, view.since - 1) <= index <= own


def test_rounds_before_the_view_are_committed_but_only_if_they_are_applied() -> None:
    assert commit_index([Progress() for _ in range(5)], VIEW, 9) == VIEW.since - 1
    assert commit_index([peer(3, 9) for _ in range(5)], VIEW, 2) == 2


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_messages_are_judged_by_the_present_round(loss: float) -> None:
    """That holds also for a robot that lacked entries of the last round when this one began. Else it would soon refuse
    the entries of others as too far ahead."""
    fleet, checked = Fleet(conditions=Conditions(loss, delay=0.001, jitter=0.03)).boot_all(), 0

    def all_in_the_present_round() -> bool:
        nonlocal checked
        for robot in fleet.robots.values():
            replica, round_ = replica_of(robot), robot.agent.round
            if round_ and replica is not None:
                assert replica.round == round_
                checked += 1
        return all(robot.agent.round >= 60 for robot in fleet.robots.values())

    fleet.run(60, until=all_in_the_present_round)
    assert checked > 60 * fleet.n
