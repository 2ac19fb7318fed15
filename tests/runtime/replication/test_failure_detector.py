"""Failure detector: robots whose entries are missing for too long are suspected."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from koordgen.runtime.replication.failure_detector import FailureDetector

Arrivals = st.lists(st.tuples(st.booleans(), st.booleans(), st.booleans()), max_size=30)


@given(Arrivals, st.integers(0, 40))
def test_robots_are_suspected_by_the_round_of_their_last_new_entry(
    arrivals: list[tuple[bool, bool, bool]], since: int
) -> None:
    detector, last = FailureDetector(3, 0), [0, 0, 0]
    for round_, arrived in enumerate(arrivals, 1):
        for pid in range(3):
            if arrived[pid]:
                last[pid] = round_
    assert detector.suspects((0, 1, 2), last, since) == [pid for pid in range(3) if last[pid] + 1 < since]


def test_only_robots_that_are_asked_about_are_suspected() -> None:
    assert FailureDetector(4, 1).suspects((3, 1), [0] * 4, 9) == [3, 1]


def test_a_robot_begins_anew_when_its_membership_changes() -> None:
    detector = FailureDetector(2, 1)
    assert detector.suspects((0, 1), [12, 0], 12) == [1]
    detector.restart(1, 14)
    assert detector.suspects((0, 1), [12, 0], 14) == [0]


def test_all_robots_begin_anew_after_this_robot_was_cut_off() -> None:
    detector = FailureDetector(2, 1)
    detector.restart_all(9)
    assert detector.suspects((0, 1), [0, 0], 9) == [] and detector.suspects((0, 1), [0, 0], 10) == [0, 1]
