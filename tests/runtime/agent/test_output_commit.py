"""Outbox: records that wait until they are committed: order, transactions, lives to go back to, bounds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, cast

from koordgen.runtime.agent.output_commit import MOST_WAITING, OutputCommit, has_outputs
from koordgen.runtime.program.program import Effects, Life
from koordgen.runtime.replication.state_machine import StateMachine
from koordgen.runtime.trace.writer import RoundRecord


@dataclass
class Store:
    """The part of a StateMachine that an Outbox looks at."""

    applied: int = 0
    won: dict[int, int] = field(default_factory=dict)
    committed: int = 0

    def as_state(self) -> StateMachine:
        return cast(StateMachine, self)


def life(round_: int) -> Life:
    return Life(round_, {"count": round_}, {}, False)


def did(round_: int, **actuators: Any) -> RoundRecord:
    return RoundRecord(round_, 0.0, 0.0, {}, None, "Event", Effects({}, {}, actuators, False))


def nothing(round_: int) -> RoundRecord:
    return RoundRecord(round_, 0.0, 0.0, {}, None, skipped="no event enabled")


def rounds(records: list[RoundRecord]) -> list[int]:
    return [r.round for r in records]


def box(*records: RoundRecord) -> OutputCommit:
    outbox = OutputCommit(life(0), 0)
    for record in records:
        outbox.add(record, life=None if record.effects is None else life(record.round))
    return outbox


def test_outputs_are_commands_lines_and_a_stop() -> None:
    assert not has_outputs(None) and not has_outputs(Effects({"a": 1}, {"b": 2}, {}, False))
    assert has_outputs(Effects({}, {}, {"m": 1}, False)) and has_outputs(Effects({}, {}, {}, True))
    assert has_outputs(Effects({}, {}, {}, False, (("Log.stdout", "hello"),)))


def test_records_are_returned_in_order_once_they_are_committed() -> None:
    outbox, store = box(nothing(1), did(2, m=1), nothing(3), did(4)), Store(applied=4)
    assert rounds(outbox.ready(store.as_state())) == [1]
    assert outbox.first == 2
    store.committed = 3
    assert rounds(outbox.ready(store.as_state())) == [2, 3]
    assert [outbox.first] == [None], "the event of round 4 has no outputs"
    store.committed = 4
    assert rounds(outbox.ready(store.as_state())) == [4] and outbox.ready(store.as_state()) == []


def test_without_a_store_only_records_before_the_first_event_are_certain() -> None:
    outbox = box(nothing(1), did(2), nothing(3))
    assert rounds(outbox.ready(None)) == [1] and outbox.ready(None) == []


def test_a_transaction_that_won_is_an_event_once_its_round_is_committed() -> None:
    outbox, store = OutputCommit(life(0), 0), Store(applied=4)
    outbox.add(did(5, m=1), 0, life(5))
    assert [outbox.undecided, outbox.decide(store.as_state()), outbox.life] == [True, None, life(0)]
    assert outbox.ready(store.as_state()) == []
    store.applied, store.won = 5, {0: 5}
    assert [outbox.decide(store.as_state()), outbox.life, outbox.undecided] == [True, life(5), False]
    assert outbox.decide(store.as_state()) is None
    assert outbox.ready(store.as_state()) == [] and outbox.first == 5
    store.committed = 5
    assert outbox.ready(store.as_state()) == [did(5, m=1)] and outbox.lives == [life(5)]


def test_a_transaction_that_lost_contention_is_no_event() -> None:
    outbox, store = OutputCommit(life(0), 0), Store(applied=5, won={0: 3})
    outbox.add(did(5, m=1), 0, life(5))
    assert outbox.decide(store.as_state()) is False and outbox.first is None
    [record] = outbox.ready(store.as_state())
    assert (record.round, record.event, record.effects, record.frame) == (5, None, None, None)
    assert record.skipped == "lost contention: Event, to another robot's transaction"
    assert outbox.lives == [life(0)]


def test_lives_are_kept_as_long_as_the_robot_may_have_to_go_back_to_them() -> None:
    outbox, store = box(did(1), did(2), nothing(3), did(4)), Store(applied=4, committed=1)
    assert outbox.lives == [life(0), life(1), life(2), life(4)]
    outbox.ready(store.as_state())
    assert outbox.lives == [life(1), life(2), life(4)]
    store.committed = 4
    outbox.ready(store.as_state())
    assert outbox.lives == [life(4)]


def test_events_that_the_others_did_not_count_are_no_events_after_a_rejoin() -> None:
    outbox = box(did(1, m=1), nothing(2), did(3, m=3), did(4))
    outbox.add(did(5), 0, life(5))
    found, records = outbox.settle(3)
    assert found == life(3) and outbox.lives == [life(3)]
    assert [(r.round, r.event, r.skipped) for r in records] == [
        (1, "Event", None),
        (2, None, "no event enabled"),
        (3, "Event", None),
        (4, None, "not counted: the others went on"),
        (5, None, "not counted: the others went on"),
    ]
    assert not outbox.undecided and outbox.first is None
    assert outbox.settle(3) == (life(3), [])


def test_a_life_that_is_not_known_any_more_is_none() -> None:
    assert box(did(1)).settle(7)[0] is None


def test_a_transaction_whose_outcome_is_not_known_may_have_won() -> None:
    """It was applied by the others before they went on alone, and `acted` names its round."""
    outbox = box(did(1))
    outbox.add(did(5, m=1), 0, life(5))
    found, records = outbox.settle(5)
    assert found == life(5) and [(r.round, r.event) for r in records] == [(1, "Event"), (5, "Event")]


def test_records_without_an_event_wait_only_up_to_a_bound() -> None:
    outbox = box(did(1, m=1), *(nothing(r) for r in range(2, 1000)))
    outbox.add(did(1000), life=life(1000))
    told = rounds(outbox.ready(Store(applied=1000, committed=1000).as_state()))
    assert told == [*range(1, MOST_WAITING + 1), 1000]
