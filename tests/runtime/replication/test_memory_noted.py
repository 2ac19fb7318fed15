"""What the gate notes in the memory without a word to Python: rounds go on by it, and what does not fit after all is
dropped as if it had never come."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from koordgen.runtime.net import gate
from koordgen.runtime.net.layout import PATCH_FROM, Layout
from koordgen.runtime.net.link import Usuals
from koordgen.runtime.net.wire import Closing, View, Write
from koordgen.runtime.program.program import Variable
from koordgen.runtime.replication.log import Log
from koordgen.runtime.replication.memory import AHEAD, Memory
from koordgen.runtime.replication.replica import Replica
from koordgen.runtime.replication.views import Vote
from koordgen.runtime.values.bounds import Text
from tests.runtime.net.compiled.gates import ADOPTED, OWN, VIEW, Ear, N, head, needs_gate, sealed, word
from tests.runtime.replication.memories import layout, one, silence, write

pytestmark = needs_gate
LIVES = (0, 3, 200, -1, -1)  # robots 0 to 2 count, and all have been heard
NOW = 30


class Robot:
    """A memory behind a gate. In the words of others everything up to the last round is applied."""

    def __init__(self) -> None:
        self.ear, self.sequence = Ear(True), ADOPTED
        view = View(VIEW.number, VIEW.since, LIVES)
        self.memory = Memory(layout(N), OWN, view, layout(N).initial(), NOW - 1)
        self.memory.present(NOW, 7)
        self.ear.link.follow(view)
        self.ear.link.attach(self.memory.ledger)
        assert self.hear(0, NOW - 1) == self.hear(2, NOW - 1) == 0

    def hear(self, pid: int, round_: int, *closings: Closing, held: Sequence[int] = ()) -> int:
        """How many words the memory itself had to take."""
        self.sequence += 1
        said = word(head(pid, self.sequence), round_, closings, settled=0, held=tuple(held))
        self.ear.waiting = [sealed(said)]
        taken = 0
        for message in self.ear.link.receive():
            assert isinstance(message, Usuals)
            assert self.memory.usual(message.rows, message.view, NOW) == []
            taken += len(message.rows)
        return taken

    def close(self, round_: int, value: int) -> None:
        self.memory.close(round_, {"x": value}, stopped=False, acted=True)


def single(pid: int, round_: int, *writes: Write) -> Closing:
    return one(pid, round_, *writes, incarnation=LIVES[pid])


def test_usual_rounds_go_on_without_a_word_to_python(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Robot()
    memory = robot.memory
    for name in ("usual", "take", "heard", "_apply"):
        monkeypatch.setattr(Memory, name, None)
    monkeypatch.setattr(Log, "fetch", None)
    for round_ in range(NOW, NOW + AHEAD):
        assert not memory.advance(round_ + 1) and memory.lacking() == 3
        robot.close(round_, round_)
        assert robot.hear(0, round_, single(0, round_, write(0, -round_))) == 0
        assert robot.hear(2, round_, single(2, round_, write(1, round_))) == 0
        assert memory.lacking() == 0 and memory.advance(round_ + 1)
        assert memory.shared == {"x": (-round_, round_, 0, 0, 0), "last": round_}
        assert memory.acted == [round_] * 3 + [0, 0] and memory.held == (round_,) * 3 + (NOW - 1,) * 2


@pytest.mark.parametrize(
    "wrong", [(write(0, "text"),), (write(2, 3),), (write(0, 1), write(1, 2**63))], ids=("type", "index", "size")
)
@pytest.mark.parametrize("first", ["apply", "repeat", "vote"])
def test_what_does_not_fit_is_dropped_with_what_follows(wrong: tuple[Write, ...], first: str) -> None:
    """Its author is asked again, as for one that never came; and it is counted."""
    robot = Robot()
    memory = robot.memory
    robot.close(NOW, 5)
    assert robot.hear(0, NOW, single(0, NOW, write(0, 1))) == 0
    assert robot.hear(2, NOW, single(2, NOW, *wrong)) == 0
    assert robot.hear(2, NOW, single(2, NOW + 1)) == 0
    assert memory.lacking() == 0 and memory.held[2] == NOW + 1 and memory.misfits() == 0
    if first == "repeat":
        assert memory._logs[2].between(NOW - 1, NOW + 1) == []
    if first == "vote":
        assert memory.fetch() == 1
    assert not memory.advance(NOW + 1) and memory.shared == layout(N).initial()
    assert memory.misfits() == 1 and memory.misfits() == 0
    assert memory.lacking() == 1 and memory.missing(NOW) == [2] and memory.held[2] == NOW - 1
    robot.hear(2, NOW, single(2, NOW, write(0, 9)))
    assert memory.advance(NOW + 1) and memory.shared == {"x": (1, 5, 9, 0, 0), "last": -1}


def test_closings_that_were_noted_are_repeated_to_who_lacks_them() -> None:
    robot = Robot()
    memory = robot.memory
    robot.close(NOW, 5)
    noted = single(0, NOW, write(0, 1))
    assert robot.hear(0, NOW, noted) == 0
    lacks = (NOW - 1,) * N
    assert memory.heard(2, VIEW.number, NOW - 1, lacks, NOW, 0, NOW, asks=True) is None
    assert memory.repeat(2) == [single(OWN, NOW, write(0, 5)), noted]
    assert robot.hear(2, NOW, single(2, NOW)) == 0, "who was sent what it lacks says nothing to think of any more"
    assert memory.advance(NOW + 1) and memory.shared["x"] == (1, 5, 0, 0, 0)


def test_rounds_of_silence_and_answers_go_on_without_a_word_to_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a fleet that is late: each closes several rounds at once, one speaks for another, and one asks."""
    robot = Robot()
    memory = robot.memory
    lacks = (NOW - 1,) * N
    assert memory.heard(2, VIEW.number, NOW - 1, lacks, NOW + 3, 0, NOW, asks=True) is None
    for name in ("usual", "take", "heard", "_apply"):
        monkeypatch.setattr(Memory, name, None)
    monkeypatch.setattr(Log, "fetch", None)
    memory.close(NOW + 2, {}, stopped=False)
    assert memory.closed == (NOW, NOW + 2)
    robot.close(NOW + 3, 5)
    answer = silence(0, NOW, NOW + 1, LIVES[0]), silence(0, NOW + 2, NOW + 3, LIVES[0])
    assert robot.hear(2, NOW, *answer, single(2, NOW, write(0, 7))) == 0
    assert robot.hear(2, NOW, silence(2, NOW, NOW + 3, LIVES[2])) == 0, "it has heard of the first of these"
    assert memory.lacking() == 0 and memory.held[:3] == (NOW + 3,) * 3
    ours = silence(OWN, NOW, NOW + 2, LIVES[OWN])
    assert memory.repeat(2)[:3] == [ours, single(OWN, NOW + 3, write(0, 5)), single(2, NOW, write(0, 7))]
    assert memory.own(NOW) == [ours, single(OWN, NOW + 3, write(0, 5))]
    assert memory.own(NOW + 1)[0] == silence(OWN, NOW + 1, NOW + 2, LIVES[OWN])
    assert memory._logs[0].between(NOW, NOW + 9) == [silence(0, NOW, NOW + 3, LIVES[0])]
    assert memory.advance(NOW + 4) and memory.shared == {"x": (0, 5, 7, 0, 0), "last": -1}
    assert memory.acted == [0, NOW + 3, NOW, 0, 0]


def test_what_is_in_rows_goes_to_the_log_as_one() -> None:
    robot = Robot()
    memory = robot.memory
    for first, last in ((NOW, NOW + 1), (NOW + 2, NOW + 3)):
        assert robot.hear(0, NOW, silence(0, first, last, LIVES[0])) == 0
    assert [e.closing for e in memory._logs[0].entries] == [silence(0, NOW, NOW + 3, LIVES[0])]
    assert robot.hear(0, NOW, silence(0, NOW + 3, NOW + 5, LIVES[0])) == 0
    assert memory._logs[0].between(NOW + 2, NOW + 9) == [silence(0, NOW + 2, NOW + 5, LIVES[0])]
    assert [e.closing for e in memory._logs[0].entries] == [silence(0, NOW, NOW + 5, LIVES[0])]


def test_a_view_cuts_what_was_noted_of_who_does_not_count_in_it() -> None:
    robot = Robot()
    memory = robot.memory
    robot.close(NOW, 5)
    assert robot.hear(0, NOW, single(0, NOW, write(0, 1))) == robot.hear(2, NOW, single(2, NOW)) == 0
    memory.adopt(View(VIEW.number + 1, NOW, (0, 3, -1, -1, -1)))
    assert memory.held == (NOW, NOW, NOW - 1, NOW - 1, NOW - 1) and memory.lacking() == 0
    assert memory.advance(NOW + 1) and memory.shared["x"] == (1, 5, 0, 0, 0)


def test_a_memory_goes_back_to_where_a_view_begins_with_what_was_noted() -> None:
    robot = Robot()
    memory = robot.memory
    for round_ in (NOW, NOW + 1):
        robot.close(round_, round_)
        robot.hear(0, round_, single(0, round_, write(0, 1)))
        robot.hear(2, round_, single(2, round_, write(0, 2)))
        assert memory.advance(round_ + 1)
    again = memory.rewound(View(VIEW.number + 1, NOW + 1, (0, 3, -1, -1, -1)))
    assert again is not None and again.shared["x"] == (1, NOW, 2, 0, 0) and again.applied == NOW
    assert again.advance(NOW + 2) and again.shared["x"] == (1, NOW + 1, 2, 0, 0)


def test_own_rounds_without_events_before_one_are_closed_too() -> None:
    robot = Robot()
    memory = robot.memory
    robot.close(NOW + 2, 5)
    assert memory.held[OWN] == NOW + 2 and memory.lacking() == 2
    for pid in (0, 2):
        robot.hear(pid, NOW, silence(pid, NOW, NOW + 2, LIVES[pid]))
    assert memory.advance(NOW + 3) and memory.shared["x"][OWN] == 5


@pytest.mark.parametrize(("written", "votes"), [(write(0, 2), True), (write(0, "text"), False)])
def test_who_votes_for_a_view_has_looked_at_what_it_says_to_hold(written: Write, votes: bool) -> None:
    robot = Robot()
    robot.close(NOW, 5)
    for pid, each in ((0, write(0, 1)), (2, written)):
        assert robot.hear(pid, NOW, single(pid, NOW, each)) == 0
    link, view = robot.ear.link, robot.memory.view
    replica = Replica(link, layout(N), robot.memory, view, Vote(), NOW - 1, 10, lambda *_: None)
    assert replica._holds(View(VIEW.number + 1, NOW + 1, LIVES)) == votes


@pytest.mark.parametrize("length", [PATCH_FROM - 40, PATCH_FROM + 40])
def test_a_long_text_that_changes_little_goes_as_a_patch(length: int) -> None:
    found = gate.COMPILED.library()
    assert found is not None
    texts = Layout([Variable("text", "allwrite", str, Text(600), str)], 1)
    memory = Memory(texts, 0, View(0, 1, (0,)), texts.initial())
    memory.ledger.attach(found)
    for round_ in (1, 2):
        memory.close(round_, {"text": "a" * length + str(round_)}, stopped=False, acted=True)
        assert memory.advance(round_ + 1) and memory.shared == {"text": "a" * length + str(round_)}
    assert [write.patch for write in memory.own(2)[0].writes] == [length > PATCH_FROM]
