"""Messages that wait until the state on which they depend is committed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from koordgen.runtime.agent.held_sender import MOST_HELD, HeldSender
from koordgen.runtime.net.sender import NOTHING
from koordgen.runtime.net.wire import Decided, Entry, HeldFragments


class Sent:
    """Sender that remembers what left."""

    epoch, room = b"one", 100

    def __init__(self) -> None:
        self.left: list[Any] = []

    def hello(self, to: int, challenge: bytes, answer: bytes, holds: tuple[int, ...], init: Entry | None,
              start: int | None) -> None:  # fmt: skip
        self.left.append(("hello", to))

    def send(self, to: Collection[int], kind: type[Any], *fields: Any) -> None:
        self.left.append((kind, *to, *fields))

    def round(self, to: Sequence[int], fields: Any, received: Mapping[int, HeldFragments] = NOTHING) -> None:
        self.left.append(("round", *to, fields))


def test_a_message_leaves_when_what_was_written_before_it_is_committed() -> None:
    sent, version = Sent(), [3]
    held = HeldSender(sent, lambda: version[0], 3)
    held.send([1], Decided, "at once")
    version[0] = 4
    held.round([1, 2], "waits for 4")
    version[0] = 6
    held.hello(2, b"", b"", (), None, None)
    assert sent.left == [(Decided, 1, "at once")]
    held.release(4)
    assert sent.left[1:] == [("round", 1, 2, "waits for 4")]
    held.release(5)
    assert len(sent.left) == 2
    held.release(6)
    held.release(4)
    held.send([1], Decided, "6 is committed")
    assert sent.left[2:] == [("hello", 2), (Decided, 1, "6 is committed")]


def test_a_message_of_another_mission_is_dropped() -> None:
    """Its head would name the present mission, which may not be committed."""
    sent, version = Sent(), [1]
    held = HeldSender(sent, lambda: version[0], 0)
    held.send([1], Decided, "of mission one")
    held.epoch, version[0] = b"two", 2
    held.send([1], Decided, "of mission two")
    held.release(2)
    assert sent.epoch == b"two" and sent.left == [(Decided, 1, "of mission two")]


def test_the_oldest_messages_are_dropped_while_nothing_is_committed() -> None:
    sent = Sent()
    held = HeldSender(sent, lambda: 1, 0)
    for number in range(MOST_HELD + 2):
        held.send([1], Decided, number)
    held.release(1)
    assert [message[-1] for message in sent.left] == list(range(2, MOST_HELD + 2))
