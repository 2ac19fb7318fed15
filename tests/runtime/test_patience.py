"""When a robot asks for what it lacks."""

from __future__ import annotations

from koordgen.runtime.patience import FEW, Patience, many

Slots = list[tuple[int, bool]]  # round, timely


def asked(slots: Slots, lost: bool = True) -> list[int]:
    """The rounds in which a robot asks that lacks something at each of these slots."""
    patience, found = Patience(), []
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
    patience = Patience()
    assert not patience.strained(1)
    patience.wakes(5, timely=False)
    assert [patience.strained(round_) for round_ in (5, 6, 7)] == [True, True, False]
