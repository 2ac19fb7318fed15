"""Output of the protocol core: what must be persisted, sent and applied, in that order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import msgspec

from koordgen.runtime.net.wire import HeldFragments, View

NO_PARTS: Mapping[int, HeldFragments] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Vote:
    """A robot's promise and vote on view `number`, as an acceptor of Paxos.

    The robot votes in no ballot below `promised`. In ballot `voted` it has voted for `value`.
    Invariant: voted <= promised. It is persisted, so that a restarted process keeps the promise.
    """

    number: int = 0
    promised: int = 0
    voted: int = 0
    value: View | None = None


class HardState(msgspec.Struct, frozen=True, gc=False):
    """Facts that a robot must not contradict, also after a restart.

    They are persisted before a message that depends on them is sent.

    view: latest view known to be decided.
    applied: last round that the robot has reported as applied in `view`, or is about to report.
    vote: promise and vote on a later view.
    """

    view: View
    applied: int
    vote: Vote


class Send(msgspec.Struct, frozen=True, gc=False):
    """A message to some robots.

    to: pids of the receivers.
    kind: class of the message in `wire`.
    fields: its fields without the head. The last field of a RoundMessage holds log entries.
    received: by author, fragments that the receiver has of an entry longer than a datagram; they are not sent again.
    """

    to: Sequence[int]
    kind: type[Any]
    fields: tuple[Any, ...]
    received: Mapping[int, HeldFragments] = NO_PARTS


class Applied(msgspec.Struct, frozen=True, gc=False):
    """Progress of the store. Invariant: committed <= applied.

    applied: the store contains all rounds up to this one.
    committed: no later view can discard a round up to this one, so the outputs of these rounds may leave the robot.
    """

    applied: int
    committed: int


class Ready(msgspec.Struct, frozen=True, gc=False):
    """Work for the driver, in this order.

    1. Persist `persist` and `private`. 2. Send `send`. 3. Apply: act on `apply`.
    """

    persist: HardState | None = None
    private: object = None  # the robot's own variables after the event whose entry is in `send`
    send: Sequence[Send] = ()
    apply: Applied | None = None
    rejected: Sequence[str] = ()  # reasons why messages were refused, for the statistics
    requested: Sequence[int] = ()  # robots whose missing entries were requested, for the statistics
