"""Driver of a replica: passes messages and ticks to it, and persists and sends what it returns.

This is the only place that persists and sends. It always persists first, so that a restarted process never contradicts
a message that was sent.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Protocol

from koordgen.runtime.net.wire import HeldFragments, ReplicaMessage, RoundMessage
from koordgen.runtime.replication.messages import HardState
from koordgen.runtime.replication.replica import Replica


class Sender(Protocol):
    """See `net.sender.MessageSender`."""

    def round(self, to: Sequence[int], fields: tuple[Any, ...], received: Mapping[int, HeldFragments]) -> None: ...

    def say(self, to: Collection[int], kind: type[Any], *fields: Any) -> None: ...


class Counters(Protocol):
    """See `net.metrics.Metrics`."""

    def repeated(self, pid: int) -> None: ...


class Outlet(Protocol):
    """The part of `net.link.Link` that a driver needs."""

    @property
    def speech(self) -> Sender: ...

    @property
    def metrics(self) -> Counters: ...

    def reject(self, reason: str) -> None: ...


class Driver:
    """Driver of one replica.

    persist: writes a hard state.
    persist_private: writes the robot's private variables after an event.
    Both return only after the data are safe from a crash of the process.
    """

    def __init__(
        self,
        replica: Replica,
        link: Outlet,
        persist: Callable[[HardState], None],
        persist_private: Callable[[Any], None],
    ) -> None:
        self.replica = replica
        self._link, self._speech = link, link.speech
        self._persist, self.persist_private = persist, persist_private

    def receive(self, messages: Sequence[ReplicaMessage]) -> None:
        """Pass received messages to the replica, and apply the rounds that they complete."""
        step = self.replica.step
        for message in messages:
            step(message)
        self.replica.apply_rounds()
        self.flush()

    def tick(self, tick: int) -> None:
        """See Replica.tick."""
        if self.replica.tick(tick):
            self.run()

    def run(self) -> None:
        """Persist and send, then apply complete rounds. Sending comes first, because other robots wait for it."""
        self.flush()
        if self.replica.apply_rounds():
            self.flush()

    def flush(self) -> None:
        """Persist the replica's pending state, then send its pending messages."""
        ready = self.replica.ready()
        if ready.private is not None:
            self.persist_private(ready.private)
        if ready.persist is not None:
            self._persist(ready.persist)
        for send in ready.send:
            if send.kind is RoundMessage:
                self._speech.round(send.to, send.fields, send.received)
            else:
                self._speech.say(send.to, send.kind, *send.fields)
        for reason in ready.rejected:
            self._link.reject(reason)
        for pid in ready.requested:
            self._link.metrics.repeated(pid)
