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

    It votes in no ballot below `promised`. In ballot `voted` it has voted for `value`.
    Invariant: voted <= promised. Survives the process.
    """

    number: int = 0
    promised: int = 0
    voted: int = 0
    value: View | None = None


class HardState(msgspec.Struct, frozen=True, gc=False):
    """Facts that a robot must not contradict.

    They are on disk before a message that depends on them is sent.

    `applied` is the last round that the robot has reported as applied in `view`, or is about to."""

    view: View
    applied: int
    vote: Vote


class Send(msgspec.Struct, frozen=True, gc=False):
    """A message to some robots: its class in `wire`, and its fields without the head.

    The last field of a Round holds log entries. Of an entry that is longer than a datagram, the fragments in
    `received` (by author) are not sent: the receiver has them.
    """

    to: Sequence[int]
    kind: type[Any]
    fields: tuple[Any, ...]
    received: Mapping[int, HeldFragments] = NO_PARTS


class Applied(msgspec.Struct, frozen=True, gc=False):
    """Progress of the store. Invariant: committed <= applied.

    `applied`: the store contains all rounds up to this one. `committed`: no later view can leave out a round up to this
    one, so its outputs may leave the robot.
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
    rejected: Sequence[str] = ()  # reasons why messages were refused, to be counted
    requested: Sequence[int] = ()  # robots whose entries are missing and were asked for
