"""Output of a `Replica`: state to persist, messages to send and progress to act on, in this order."""

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
    Invariant: voted <= promised. The vote is persisted, so that a restarted process keeps the promise.
    """

    number: int = 0
    promised: int = 0
    voted: int = 0
    value: View | None = None


class HardState(msgspec.Struct, frozen=True, gc=False):
    """Facts that a robot must not contradict, even after a restart.

    The driver persists a hard state before it sends a message that depends on the state.

    view: latest view that the robot knows to be decided.
    applied: last round that the robot has reported as applied in `view`, or is about to report.
    vote: the robot's promise and vote on a later view.
    """

    view: View
    applied: int
    vote: Vote


class Send(msgspec.Struct, frozen=True, gc=False):
    """A message to some robots.

    to: pids of the receivers.
    kind: class of the message in `wire`.
    fields: fields of the message without the head. The last field of a RoundMessage holds log entries.
    received: author -> fragments of that author's long entry that the receiver already has; these are not sent again.
    """

    to: Sequence[int]
    kind: type[Any]
    fields: tuple[Any, ...]
    received: Mapping[int, HeldFragments] = NO_PARTS


class Applied(msgspec.Struct, frozen=True, gc=False):
    """Progress of a robot's store. Invariant: committed <= applied.

    applied: the store contains all rounds up to this one.
    committed: no later view can discard a round up to this one, so the outputs of these rounds may leave the robot.
    """

    applied: int
    committed: int


class Ready(msgspec.Struct, frozen=True, gc=False):
    """Work for the driver in three steps, in this order.

    1. Persist `persist` and `private`. 2. Send `send`. 3. Act on the progress in `apply`.
    """

    persist: HardState | None = None
    private: object = None  # the robot's private variables after the event whose entry is in `send`
    send: Sequence[Send] = ()
    apply: Applied | None = None
    rejected: Sequence[str] = ()  # for the statistics: reasons why received messages were refused
    requested: Sequence[int] = ()  # for the statistics: pids of the robots whose entries were requested
