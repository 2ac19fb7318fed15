"""Records that survive a crash of a robot's process; `checkpoint` stores them in a file."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import msgspec

KEPT = 8  # number of last rounds whose private variables can be recovered after a crash


class Mission(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Record of the mission that this robot takes part in.

    epoch: id of the mission.
    start: start of round 1 in microseconds of fleet time.
    init: the robot's encoded round-0 entry.
    """

    epoch: bytes
    start: int
    init: bytes


class Locals(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Record of the private states of a robot's instances after the events of a round.

    round: round of the last event.
    incarnation: incarnation of the robot when it ran the event.
    locals, actuators: private variables and latest actuator values, encoded by LocalsCodec.
    stopped: whether the programs of all instances have stopped.
    """

    round: int
    incarnation: int
    locals: bytes
    actuators: bytes
    stopped: bool


class Acceptor(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Record of a robot's state as a Paxos acceptor of views.

    view: present view, encoded.
    applied: last round that the robot has reported as applied in the present view.
    number: number of the view that `promised`, `accepted_ballot` and `accepted` are about.
    promised: ballot for which the robot has promised.
    accepted_ballot: ballot in which the robot has voted.
    accepted: view that the robot has voted for, encoded; empty without a vote.
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
    """Records of a checkpoint: the newest of each kind.

    `locals` has the newest record of each of the last KEPT rounds, ascending.
    """

    mission: Mission | None = None
    locals: tuple[Locals, ...] = ()
    acceptor: Acceptor | None = None


NOTHING = Loaded()


class MemoryStore:
    """Store of records in memory, which outlives an agent. Implements checkpoint.CheckpointStore."""

    def __init__(self, kept: Loaded = NOTHING) -> None:
        self._mission, self._acceptor = kept.mission, kept.acceptor
        self._locals: deque[Locals] = deque(kept.locals, maxlen=KEPT + 1)

    def write(self, record: Kept) -> bool:
        match record:
            case Mission():
                self._mission = record
            case Acceptor():
                self._acceptor = record
            case Locals():
                self._locals.append(record)
        return True

    def load(self) -> Loaded:
        newest = {record.round: record for record in self._locals}
        return Loaded(self._mission, tuple([newest[r] for r in sorted(newest)[-KEPT:]]), self._acceptor)

    def clear(self) -> None:
        self._mission = self._acceptor = None
        self._locals.clear()


class Identity(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Identity of a checkpoint file: format, program and robot.

    rooms: for each kind of record, the largest size in bytes.
    token: random bytes, new after each erasure. Digests of records depend on the token, so erased records are invalid.
    """

    format: int
    app: str
    program: str
    robot: str
    pid: int
    n_sys: int
    rooms: tuple[int, ...]
    token: bytes = b""
