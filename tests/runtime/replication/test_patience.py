"""When a robot asks for what it lacks, and how long it waits for it."""

from __future__ import annotations

from koordgen.runtime.replication.patience import ASKERS, FEW, LOSSY, SMALL, Patience, many

Slots = list[tuple[int, bool]]  # round, timely


def asked(slots: Slots, lost: bool = True, pid: int = 0, n_sys: int = 3) -> list[int]:
    """The rounds in which a robot asks that lacks something at each of these slots."""
    patience, found = Patience(pid, n_sys), []
    for round_, timely in slots:
        patience.wakes(round_, timely)
        if patience.asks(round_, timely, lost):
            found.append(round_)
    return found


def test_a_punctual_robot_asks_at_every_slot() -> None:
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


def test_loss_leaves_more_than_half() -> None:
    assert [n for n in range(2, 20) if many(FEW + 1, n)] == list(range(2, 2 * FEW + 2))
    assert not many(FEW, 2) and not many(64, 128) and many(65, 128)


def test_it_is_strained_in_the_round_in_which_it_was_late_and_the_next() -> None:
    patience = Patience(0, 3)
    assert not patience.strained(1)
    patience.wakes(5, timely=False)
    assert [patience.strained(round_) for round_ in (5, 6, 7)] == [True, True, False]


def test_of_a_large_fleet_few_ask_in_a_round_for_what_may_be_late_all_in_turn() -> None:
    rounds = range(1, 200)
    punctual = [(r, True) for r in rounds]
    for n_sys, share in [(SMALL, 1.0), (SMALL + 1, ASKERS / (SMALL + 1)), (96, ASKERS / 96)]:
        asks = [asked(punctual, False, pid, n_sys) for pid in range(n_sys)]
        each_round = {sum(r in rounds for rounds in asks) for r in rounds}
        assert each_round == {round(share * n_sys)} and all(asks)
    assert asked(punctual, True, 5, 96) == [*rounds]


def test_where_something_was_lost_lately_nobody_waits_for_its_turn() -> None:
    patience = Patience(5, 96)
    assert not patience.asks(100, True, lost=False)
    assert patience.asks(100, True, lost=True)
    assert [r for r in range(101, 140) if patience.asks(r, True, lost=False)] == [*range(101, 101 + LOSSY)]


def test_who_is_hurried_waits_in_the_first_round_that_lacks_something_and_not_in_the_next_ones() -> None:
    patience = Patience(0, 3)
    waits = []
    lacking, late = {7, 8, 9, 11, 12, 14, 15}, {7, 9, 11, 12}
    for round_ in range(7, 16):
        if round_ in lacking:
            waits.append((round_, patience.waits(round_)))
            assert patience.waits(round_) == waits[-1][1], "asked again in the same round"
        patience.wakes(round_, round_ not in late)
    assert waits == [(7, True), (8, False), (9, True), (11, True), (12, False), (14, True), (15, True)]


def test_who_has_lost_something_lately_is_not_hurried() -> None:
    patience = Patience(0, 3)
    patience.asks(20, True, lost=True)
    for round_ in (20 + LOSSY, 21 + LOSSY):
        patience.wakes(round_, timely=False)
        assert patience.strained(round_) and patience.hurried(round_) == (round_ > 20 + LOSSY)
        assert patience.waits(round_) == (round_ == 20 + LOSSY)
