"""Sender that holds messages until the state on which they depend is safe from the loss of this robot.

A robot persists its state before it sends a message that depends on this state. If the state is persisted by the rounds
of another fleet, that takes a while. Messages are made when they leave, so their time stamps are right."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

from koordgen.runtime.net.sender import NOTHING, Sending
from koordgen.runtime.net.wire import Entry, HeldFragments

MOST_HELD = 256  # messages; the oldest ones are dropped, which is like a loss on the network


class HeldSender:
    """Sender in front of a robot's own sender. Implements Sending.

    version: function that returns the version of the state that all messages of this moment depend on.
    """

    def __init__(self, sender: Sending, version: Callable[[], int], committed: int) -> None:
        self.room = sender.room
        self._sender, self._version, self._committed = sender, version, committed
        self._held: deque[tuple[int, bytes, Callable[[], None]]] = deque(maxlen=MOST_HELD)

    @property
    def epoch(self) -> bytes:
        return self._sender.epoch

    @epoch.setter
    def epoch(self, epoch: bytes) -> None:
        self._sender.epoch = epoch

    def hello(self, to: int, challenge: bytes, answer: bytes, holds: tuple[int, ...], init: Entry | None,
              start: int | None) -> None:  # fmt: skip
        self._send(partial(self._sender.hello, to, challenge, answer, holds, init, start))

    def send(self, to: Collection[int], kind: type[Any], *fields: Any) -> None:
        self._send(partial(self._sender.send, to, kind, *fields))

    def round(self, to: Sequence[int], fields: Any, received: Mapping[int, HeldFragments] = NOTHING) -> None:
        self._send(partial(self._sender.round, to, fields, received))

    def _send(self, send: Callable[[], None]) -> None:
        needed = self._version()
        if needed <= self._committed:
            send()
        else:
            self._held.append((needed, self._sender.epoch, send))

    def hold_nothing(self) -> None:
        """Send all messages at once from now on. The caller ends the mission, so nothing depends on them any more."""
        self.release(sys.maxsize)

    def release(self, committed: int) -> None:
        """Send the messages that depend on this version or an earlier one.

        A message of another mission than the present one is dropped: the head names the present mission."""
        self._committed = max(self._committed, committed)
        while self._held and self._held[0][0] <= self._committed:
            _, epoch, send = self._held.popleft()
            if epoch == self._sender.epoch:
                send()
