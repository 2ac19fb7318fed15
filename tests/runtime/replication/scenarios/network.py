"""Network of a scenario: messages in flight, and the rules by which they are dropped, delayed, doubled or reordered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tests.runtime.replication.core import Sent

ROUNDS_OF_TALK = 50  # passes within one slot after which robots that still talk are at fault


@dataclass(frozen=True, slots=True)
class Link:
    """Messages of one kind (None: of all kinds) from some robots to some robots."""

    pairs: frozenset[tuple[int, int]]
    kind: str | None = None

    def covers(self, message: Sent) -> bool:
        return (message.sender, message.to) in self.pairs and self.kind in (None, message.kind)


class Network:
    """`delayed` messages wait for `take_delayed`. Each rule holds until `heal`."""

    def __init__(self) -> None:
        self.flying: list[Sent] = []
        self.delayed: list[Sent] = []
        self.sent: list[Sent] = []  # all, dropped ones too, since `forget_sent`
        self.rules: list[tuple[str, Link]] = []
        self.newest_first = False

    def send(self, messages: list[Sent]) -> None:
        self.sent += messages
        for message in messages:
            if not self._is("drop", message):
                self.flying += [message] * (2 if self._is("duplicate", message) else 1)

    def arriving(self) -> list[Sent]:
        """Take what arrives now."""
        arrived, self.flying = self.flying, []
        self.delayed += [m for m in arrived if self._is("delay", m)]
        arrived = [m for m in arrived if not self._is("delay", m)]
        return arrived[::-1] if self.newest_first else arrived

    def take_delayed(self, wanted: Callable[[Sent], bool]) -> list[Sent]:
        found = [m for m in self.delayed if wanted(m)]
        self.delayed = [m for m in self.delayed if not wanted(m)]
        return found[::-1] if self.newest_first else found

    def lose(self, pid: int) -> None:
        """Drop what is on its way to a robot whose process has died."""
        self.flying = [m for m in self.flying if m.to != pid]
        self.delayed = [m for m in self.delayed if m.to != pid]

    def heal(self) -> None:
        self.rules, self.newest_first = [], False
        self.flying, self.delayed = self.delayed + self.flying, []

    def _is(self, rule: str, message: Sent) -> bool:
        return any(name == rule and link.covers(message) for name, link in self.rules)
