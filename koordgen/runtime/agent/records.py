"""Records that survive a crash of a robot's process; `checkpoint` stores them in a file."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

KEPT = 8  # number of last rounds whose private variables can be recovered after a crash


class Mission(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Mission that this robot takes part in.

    epoch: id of the mission.
    start: start of round 1 in microseconds of fleet time. init: the robot's encoded round-0 entry.
    """

    epoch: bytes
    start: int
    init: bytes


class Locals(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Private state of a robot after its event of a round.

    round: the event's round.
    incarnation: incarnation of the robot that ran the event.
    locals: private variables, encoded by LocalsCodec.
    actuators: latest actuator values, encoded by LocalsCodec.
    stopped: whether the program has stopped the robot.
    """

    round: int
    incarnation: int
    locals: bytes
    actuators: bytes
    stopped: bool


class Acceptor(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """State of the robot as a Paxos acceptor of views.

    view: present view, encoded.
    applied: last round that the robot has reported as applied in the present view.
    number: number of the view that the promise and the vote below are for.
    promised: ballot promised.
    accepted_ballot: ballot in which the robot has voted.
    accepted: view that it has voted for, encoded; empty without a vote.
    """

    view: bytes
    applied: int
    number: int
    promised: int
    accepted_ballot: int
    accepted: bytes


Kept = Mission | Locals | Acceptor


@dataclass(frozen=True, slots=True)
class Loaded:
    """Records of a checkpoint: the newest of each kind; in `locals`, of the last KEPT rounds, ascending."""

    mission: Mission | None = None
    locals: tuple[Locals, ...] = ()
    acceptor: Acceptor | None = None


class Identity(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Identity of a checkpoint file: format, program and robot.

    rooms: largest size in bytes of a record of each kind.
    token: random, new after each erasure. The digests of records depend on it, so older records become invalid.
    """

    format: int
    app: str
    program: str
    robot: str
    pid: int
    n_sys: int
    rooms: tuple[int, ...]
    token: bytes = b""
