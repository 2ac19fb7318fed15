"""What waits until it is certain: order, commits, lives to go back to, bounds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, cast

from koordgen.runtime.agent.outbox import MOST_WAITING, Outbox, has_outputs
from koordgen.runtime.program.program import Effects, Life
from koordgen.runtime.replication.memory import Memory
from koordgen.runtime.trace.writer import Record


@dataclass
class Store:
    """As much of a Memory as an Outbox looks at."""

    applied: int = 0
    won: int = 0
    sure: int = 0
    asked: list[int] = field(default_factory=list)

    def stable(self, round_: int) -> bool:
        self.asked.append(round_)
        return round_ <= self.sure

    def as_memory(self) -> Memory:
        return cast(Memory, self)


def life(round_: int) -> Life:
    return Life(round_, {"count": round_}, {}, False)


def did(round_: int, **actuators: Any) -> Record:
    return Record(round_, 0.0, 0.0, {}, None, "Event", Effects({}, {}, actuators, False))


def nothing(round_: int) -> Record:
    return Record(round_, 0.0, 0.0, {}, None, skipped="no event enabled")


def rounds(records: list[Record]) -> list[int]:
    return [r.round for r in records]


def box(*records: Record) -> Outbox:
    outbox = Outbox(life(0))
    for record in records:
        outbox.add(record, life=None if record.effects is None else life(record.round))
    return outbox


def test_what_leaves_a_robot_are_commands_lines_and_its_stop() -> None:
    assert not has_outputs(None) and not has_outputs(Effects({"a": 1}, {"b": 2}, {}, False))
    assert has_outputs(Effects({}, {}, {"m": 1}, False)) and has_outputs(Effects({}, {}, {}, True))
    assert has_outputs(Effects({}, {}, {}, False, (("Log.stdout", "hello"),)))


def test_records_become_certain_in_order() -> None:
    outbox, store = box(nothing(1), did(2, m=1), nothing(3), did(4)), Store(applied=4)
    assert rounds(outbox.ready(store.as_memory())) == [1]
    assert outbox.first == 2
    store.sure = 3
    assert rounds(outbox.ready(store.as_memory())) == [2, 3]
    assert [outbox.first] == [None], "the event of round 4 has no outputs"
    store.sure = 4
    assert rounds(outbox.ready(store.as_memory())) == [4] and outbox.ready(store.as_memory()) == []


def test_without_a_store_only_what_came_before_the_first_event_is_certain() -> None:
    outbox = box(nothing(1), did(2), nothing(3))
    assert rounds(outbox.ready(None)) == [1] and outbox.ready(None) == []


def test_a_commit_that_won_is_an_event_once_it_is_stable() -> None:
    outbox, store = Outbox(life(0)), Store(applied=4)
    outbox.add(did(5, m=1), 0, life(5))
    assert [outbox.undecided, outbox.decide(store.as_memory()), outbox.life] == [True, None, life(0)]
    assert outbox.ready(store.as_memory()) == []
    store.applied = store.won = 5
    assert [outbox.decide(store.as_memory()), outbox.life, outbox.undecided] == [True, life(5), False]
    assert outbox.decide(store.as_memory()) is None
    assert outbox.ready(store.as_memory()) == [] and outbox.first == 5
    store.sure = 5
    assert outbox.ready(store.as_memory()) == [did(5, m=1)] and outbox.lives == [life(5)]


def test_a_commit_that_lost_never_happened() -> None:
    outbox, store = Outbox(life(0)), Store(applied=5, won=3)
    outbox.add(did(5, m=1), 0, life(5))
    assert outbox.decide(store.as_memory()) is False and outbox.first is None
    [record] = outbox.ready(store.as_memory())
    assert (record.round, record.event, record.effects, record.frame) == (5, None, None, None)
    assert record.skipped == "lost contention: Event, to another robot's transaction"
    assert outbox.lives == [life(0)]


def test_lives_are_kept_as_far_as_they_may_have_to_be_gone_back_to() -> None:
    outbox, store = box(did(1), did(2), nothing(3), did(4)), Store(applied=4, sure=1)
    assert outbox.lives == [life(0), life(1), life(2), life(4)]
    outbox.ready(store.as_memory())
    assert outbox.lives == [life(1), life(2), life(4)]
    store.sure = 4
    outbox.ready(store.as_memory())
    assert outbox.lives == [life(4)]


def test_after_coming_back_what_the_others_did_not_count_never_happened() -> None:
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


def test_a_life_that_is_not_known_any_more_is_told() -> None:
    assert box(did(1)).settle(7)[0] is None


def test_a_commit_of_which_there_was_no_news_may_have_won() -> None:
    """It was applied by the others before they went on alone, and `acted` names its round."""
    outbox = box(did(1))
    outbox.add(did(5, m=1), 0, life(5))
    found, records = outbox.settle(5)
    assert found == life(5) and [(r.round, r.event) for r in records] == [(1, "Event"), (5, "Event")]


def test_rounds_without_an_event_pile_up_only_so_far() -> None:
    outbox = box(did(1, m=1), *(nothing(r) for r in range(2, 1000)))
    outbox.add(did(1000), life=life(1000))
    told = rounds(outbox.ready(Store(applied=1000, sure=1000).as_memory()))
    assert told == [*range(1, MOST_WAITING + 1), 1000]
