"""A robot that lacks something asks for it at each slot and waits for it; seldom and once if it wakes late, as all
others may do then."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from msgspec.structs import replace

from koordgen.runtime.net.wire import Entry, Nack, RoundMessage
from koordgen.runtime.replication.replica import Replica
from tests.model.lab import SENSED, Fleet, Flight
from tests.model.test_found import rounds_of_all


def alone(late: float, lost: bool = False, until: float = 8.0) -> Iterator[tuple[float, int, bool]]:
    """Robot 0 hears nothing of the others from round 4 on, but for what shows, if something is `lost`, that robot 1 has
    closed round 5. It wakes so `late`, in rounds, `until` then; a fifth of a round is a slot. For each time that it
    should wake, until the end of round 8, the round that it has closed then, and whether it has asked."""
    fleet = Fleet(3)
    rounds_of_all(fleet, 3)
    fleet.poll(1, 3.0)
    (said,) = fleet.take(lambda f: f.to == 0 and isinstance(f.message, RoundMessage) and f.message.head.pid == 1)[-1:]
    fleet.flights.clear()
    if lost:
        fleet.deliver(Flight(0, replace(said.message, entries=(Entry(1, 0, 5, 5),))))
    due = 3.0
    while due < 7.99:
        next_ = fleet.robots[0].rounds.poll(due + (late if due < until else 0.01), lambda t: SENSED, None)
        state = fleet.robots[0].state
        assert state is not None
        yield round(due, 3), state.held[0], any(isinstance(f.message, Nack) for f in fleet.take(lambda f: True))
        due = next_


@pytest.mark.parametrize(
    ("late", "lost", "rounds"),
    [
        (0.01, False, [4, 5, 6, 7, 8]),
        (0.01, True, [4, 5, 6, 7, 8]),
        (0.15, False, [5]),  # what is as late as itself comes by itself
        (0.15, True, [4, 6, 8]),
    ],
)
def test_who_wakes_late_asks_seldom_and_once_in_a_round(late: float, lost: bool, rounds: list[int]) -> None:
    asked = [1 + int(due) for due, _, asks in alone(late, lost) if asks]
    assert sorted(set(asked)) == rounds
    assert (len(asked) == len(rounds)) == (late > 0.1)


@pytest.mark.parametrize("late", [0.01, 0.15])
def test_who_wakes_late_again_and_again_closes_at_once_what_it_lacks_the_last_round_for(late: float) -> None:
    """Others leave each round open for half of it: 4 is the first that entries are missing of."""
    closed: dict[int, float] = {}
    for due, round_, _ in alone(late):
        closed.setdefault(round_, due)
    assert closed == {4: 3.0, 5: 4.5, 6: 5.5 - (late > 0.1) / 2, 7: 6.5 - (late > 0.1) / 2, 8: 7.5 - (late > 0.1) / 2}


def test_who_wakes_late_and_waits_wakes_when_something_is_due_and_not_at_each_slot() -> None:
    slots = [0.0, 0.2, 0.4, 0.5, 0.6, 0.8]
    punctual = [3.0, 3.6, 3.8, *(round(round_ + slot, 3) for round_ in (4, 5, 6, 7) for slot in slots)]
    assert [due for due, *_ in alone(0.01)] == punctual
    assert [due for due, *_ in alone(0.15, lost=True)] == [due for due in punctual if due % 1 != 0.5]
    assert [due for due, *_ in alone(0.15)] == [3.0, 3.6, 4.0, 4.5, 5.0, 6.0, 7.0]


def test_who_comes_when_its_entry_is_due_is_not_late() -> None:
    """It was in round 4, and shares a busy computer in 5, but no longer in 6."""
    closed: dict[int, float] = {}
    for due, round_, _ in alone(0.15, until=4.0):
        closed.setdefault(round_, due)
    assert closed == {4: 3.0, 5: 4.5, 6: 5.5, 7: 6.5, 8: 7.5}


def test_while_a_view_is_changing_who_is_late_wakes_at_each_slot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Replica, "is_busy", property(lambda self: True))
    assert len([due for due, *_ in alone(0.15)]) >= 20


def test_who_is_late_and_current_waits_for_its_last_event_to_be_confirmed() -> None:
    """All entries come in time, and nobody says to have applied any."""
    fleet = Fleet(3, lambda pid: "plain" if pid == 0 else "")
    opened: list[float] = []
    for round_ in range(1, 6):
        for pid in (1, 2, 0):
            fleet.poll(pid, round_ - 1 + 0.15)
        state = fleet.robots[0].state
        assert state is not None
        opened += [round_] * (state.held[0] < round_)
        fleet.poll(0, round_ - 1 + 0.52)
        for flight in fleet.take(lambda f: isinstance(f.message, RoundMessage)):
            unsaid = flight.to == 0 and isinstance(flight.message, RoundMessage)
            fleet.deliver(Flight(flight.to, replace(flight.message, applied=0) if unsaid else flight.message))
        fleet.flights.clear()
        for pid in range(3):
            fleet.poll(pid, round_ - 1 + 0.9)
    assert opened == [2, 3, 4, 5]


def test_each_robot_is_patient_for_itself_from_the_first_round_on() -> None:
    fleet = Fleet(3)
    for pid, robot in enumerate(fleet.robots):
        robot.rounds.poll(-0.5, lambda t: SENSED, None)
        robot.rounds.poll(0.01 + 0.14 * (pid == 1), lambda t: SENSED, None)
    patience = [robot.replica.policy for robot in fleet.robots]
    assert [p.is_strained(1) for p in patience] == [False, True, False]
    assert [(p.pid, p.n_sys) for p in patience] == [(0, 3), (1, 3), (2, 3)]
