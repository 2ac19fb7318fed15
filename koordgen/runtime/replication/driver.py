"""Driver of a replica: passes messages and ticks to the replica, then persists and sends its output.

Only the driver persists hard states and sends replica messages. It persists before it sends, so that a restarted
process never contradicts a message that was sent.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Protocol

from koordgen.runtime.net.wire import HeldFragments, ReplicaMessage, RoundMessage
from koordgen.runtime.replication.messages import HardState
from koordgen.runtime.replication.replica import Replica


class Sender(Protocol):
    """The methods of `net.sender.MessageSender` that a driver calls."""

    def round(self, to: Sequence[int], fields: tuple[Any, ...], received: Mapping[int, HeldFragments]) -> None: ...

    def send(self, to: Collection[int], kind: type[Any], *fields: Any) -> None: ...


class Counters(Protocol):
    """The methods of `net.metrics.Metrics` that a driver calls."""

    def repeated(self, pid: int) -> None: ...


class Outlet(Protocol):
    """The properties and methods of `net.link.Link` that a driver uses."""

    @property
    def sender(self) -> Sender: ...

    @property
    def metrics(self) -> Counters: ...

    def reject(self, reason: str) -> None: ...


class Driver:
    """Driver of one replica.

    persist: function that writes a hard state.
    persist_private: function that writes the robot's private variables after an event.
    Both functions return only after the data are safe from a crash of the process.
    """

    def __init__(
        self,
        replica: Replica,
        link: Outlet,
        persist: Callable[[HardState], None],
        persist_private: Callable[[Any], None],
    ) -> None:
        self.replica = replica
        self._link, self._sender = link, link.sender
        self._persist, self.persist_private = persist, persist_private

    def receive(self, messages: Sequence[ReplicaMessage]) -> None:
        """Pass received messages to the replica, and apply the rounds that they complete."""
        step = self.replica.step
        for message in messages:
            step(message)
        self.replica.apply_rounds()
        self.flush()

    def tick(self, tick: int) -> None:
        """Pass a tick to the replica, and do the work that results."""
        if self.replica.tick(tick):
            self.run()

    def run(self) -> None:
        """Persist and send, then apply complete rounds. Messages go first, because other robots wait for them."""
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
                self._sender.round(send.to, send.fields, send.received)
            else:
                self._sender.send(send.to, send.kind, *send.fields)
        for reason in ready.rejected:
            self._link.reject(reason)
        for pid in ready.requested:
            self._link.metrics.repeated(pid)
