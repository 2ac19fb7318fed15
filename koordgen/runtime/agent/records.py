"""Records that survive a crash of a robot's process; `checkpoint` stores them in a file."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

KEPT = 8  # rounds whose locals are recoverable


class Mission(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Mission of this robot.

    Epoch, start of round 1 (microseconds of fleet time), own round-0 entry as on the wire."""

    epoch: bytes
    start: int
    init: bytes


class Locals(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Private variables after the robot's event of `round`, encoded by LocalsCodec."""

    round: int
    incarnation: int
    locals: bytes
    actuators: bytes
    stopped: bool


class Acceptor(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """State of the robot as a Paxos acceptor of views.

    The present view (encoded) and the last round applied in it. For the next view, `number`: ballot promised, ballot
    and value (encoded) accepted."""

    view: bytes
    applied: int
    number: int
    promised: int
    accepted_ballot: int
    accepted: bytes


Kept = Mission | Locals | Acceptor


@dataclass(frozen=True, slots=True)
class Loaded:
    """The newest record of each kind; `locals`: those of the last KEPT rounds, ascending."""

    mission: Mission | None = None
    locals: tuple[Locals, ...] = ()
    acceptor: Acceptor | None = None


class Identity(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Owner of a checkpoint file. `token` is new after each erasure; digests depend on it."""

    format: int
    app: str
    program: str
    robot: str
    pid: int
    n_sys: int
    rooms: tuple[int, ...]
    token: bytes = b""
