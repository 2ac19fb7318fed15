"""Retransmission policy: when a robot asks for missing entries, whom, and how long it waits for them."""

from __future__ import annotations

from koordgen.runtime.replication.retransmission import (
    ASKERS,
    FEW,
    HELPERS,
    LOSSY_FOR,
    SMALL,
    RetransmissionPolicy,
    is_fleet_late,
    is_helper,
    recipients,
    some,
)

Ticks = list[tuple[int, bool]]  # round, on time


def asked(ticks: Ticks, lost: bool = True, pid: int = 0, n_sys: int = 3) -> list[int]:
    """Return the rounds in which a robot asks that lacks entries at each of these ticks."""
    policy, found = RetransmissionPolicy(pid, n_sys), []
    for round_, on_time in ticks:
        policy.wakes(round_, on_time)
        if policy.asks(round_, on_time, lost):
            found.append(round_)
    return found


def test_a_punctual_robot_asks_at_every_tick() -> None:
    assert asked([(1, True), (1, True), (1, True), (2, True)]) == [1, 1, 1, 2]


def test_a_robot_that_was_late_asks_once_a_round() -> None:
    assert asked([(1, True), (2, False), (2, True), (2, True), (3, True), (3, True)]) == [1, 2, 3]
    assert asked([(1, False), (1, True), (2, True), (2, True), (3, True), (3, True)]) == [1, 2, 3, 3]


def test_a_robot_that_is_always_late_asks_in_every_second_round() -> None:
    assert asked([(r, False) for r in range(1, 8) for _ in range(2)]) == [2, 4, 6]


def test_a_late_robot_that_has_not_asked_lately_asks_at_once() -> None:
    assert asked([(9, False), (9, True)]) == [9]


def test_a_late_robot_that_does_not_know_of_a_loss_asks_seldom() -> None:
    assert asked([(r, False) for r in range(1, 20) for _ in range(2)], lost=False) == [5, 10, 15]
    assert asked([(r, r % 2 > 0) for r in range(1, 20) for _ in range(2)], lost=False) == [1, 1, 6, 11, 16]
    assert asked([(r, True) for r in range(1, 4)], lost=False) == [1, 2, 3]


def test_a_fleet_is_late_if_more_than_half_of_the_entries_are_missing() -> None:
    assert [n for n in range(2, 20) if is_fleet_late(FEW + 1, n)] == list(range(2, 2 * FEW + 2))
    assert not is_fleet_late(FEW, 2) and not is_fleet_late(64, 128) and is_fleet_late(65, 128)


def test_a_robot_is_strained_in_the_round_in_which_it_was_late_and_in_the_next() -> None:
    policy = RetransmissionPolicy(0, 3)
    assert not policy.is_strained(1)
    policy.wakes(5, on_time=False)
    assert [policy.is_strained(round_) for round_ in (5, 6, 7)] == [True, True, False]


def test_in_a_large_fleet_few_robots_ask_in_each_round_for_late_entries_and_all_in_turn() -> None:
    rounds = range(1, 200)
    punctual = [(r, True) for r in rounds]
    for n_sys, share in [(SMALL, 1.0), (SMALL + 1, ASKERS / (SMALL + 1)), (96, ASKERS / 96)]:
        asks = [asked(punctual, False, pid, n_sys) for pid in range(n_sys)]
        each_round = {sum(r in rounds for rounds in asks) for r in rounds}
        assert each_round == {round(share * n_sys)} and all(asks)
    assert asked(punctual, True, 5, 96) == [*rounds]


def test_while_something_was_lost_lately_no_robot_waits_for_its_turn() -> None:
    policy = RetransmissionPolicy(5, 96)
    assert not policy.asks(100, True, lost=False)
    assert policy.asks(100, True, lost=True)
    assert [r for r in range(101, 140) if policy.asks(r, True, lost=False)] == [*range(101, 101 + LOSSY_FOR)]


def test_a_hurried_robot_waits_in_the_first_round_that_lacks_entries_but_not_in_the_next_ones() -> None:
    policy = RetransmissionPolicy(0, 3)
    waits = []
    lacking, late = {7, 8, 9, 11, 12, 14, 15}, {7, 9, 11, 12}
    for round_ in range(7, 16):
        if round_ in lacking:
            waits.append((round_, policy.waits(round_)))
            assert policy.waits(round_) == waits[-1][1], "asked again in the same round"
        policy.wakes(round_, round_ not in late)
    assert waits == [(7, True), (8, False), (9, True), (11, True), (12, False), (14, True), (15, True)]


def test_a_robot_that_has_lost_entries_lately_is_not_hurried() -> None:
    policy = RetransmissionPolicy(0, 3)
    policy.asks(20, True, lost=True)
    for round_ in (20 + LOSSY_FOR, 21 + LOSSY_FOR):
        policy.wakes(round_, on_time=False)
        assert policy.is_strained(round_) and policy.is_hurried(round_) == (round_ > 20 + LOSSY_FOR)
        assert policy.waits(round_) == (round_ == 20 + LOSSY_FOR)


def test_authors_of_missing_entries_are_asked_and_one_robot_more_that_may_hold_them() -> None:
    for turn in range(4):
        authors, groups = recipients([1, 2], [], [1, 2, 3, 4, 5, 6], turn)
        assert authors == [1, 2] and groups == [[1], [2], [(3, 4, 5, 6)[turn]]]


def test_a_request_to_many_is_one_message_and_a_request_to_few_goes_to_each_alone() -> None:
    """A message to a group reaches all robots, and all would answer."""
    assert recipients([1], [], [1, 2], 0) == ([1], [[1, 2]])
    assert recipients([1], [], [1, 2, 3, 4], 0) == ([1], [[1], [2]])


def test_if_much_is_missing_one_author_is_asked_another_one_each_turn() -> None:
    others = range(1, 20)
    asked = [recipients([*others], [], others, turn)[0] for turn in range(19)]
    assert sorted(author for [author] in asked) == [*others]


def test_robots_whose_reports_are_missing_are_asked_but_no_others() -> None:
    assert recipients([], [2, 3], [1, 2, 3, 4, 5, 6], 0) == ([], [[2], [3]])


def test_few_robots_repeat_the_entries_of_third_robots_and_all_in_turn() -> None:
    for n in (3, HELPERS, 20):
        helpers = [{pid for pid in range(n) if is_helper(pid, 1, round_, n)} for round_ in range(n)]
        assert all(len(h) == min(n, HELPERS) for h in helpers) and set.union(*helpers) == set(range(n))


def test_of_many_robots_one_is_taken_in_turn() -> None:
    assert some([1, 2, 3], 7) == [1, 2, 3]
    assert [some(range(FEW + 1), turn) for turn in range(FEW + 2)] == [[turn % (FEW + 1)] for turn in range(FEW + 2)]
