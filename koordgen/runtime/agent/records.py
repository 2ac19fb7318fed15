"""Records that a robot finds again after its process was killed; `store` keeps them in a file."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

KEPT = 8  # rounds whose locals can be found again


class Mission(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The mission this robot is in: its name, the start of round 1 (microseconds of fleet time), the robot's own
    entry of round 0 as it goes over the wire."""

    epoch: bytes
    start: int
    init: bytes


class Locals(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The robot's own variables after its event of `round`, as LocalsCodec encodes them."""

    round: int
    incarnation: int
    locals: bytes
    actuators: bytes
    stopped: bool


class Acceptor(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Facts about views that the robot has announced: the present view (encoded) and the last round applied in it; for
    the view `number` that is to come, the ballots promised and accepted and the value (encoded) accepted."""

    view: bytes
    applied: int
    number: int
    promised: int
    accepted_ballot: int
    accepted: bytes


Kept = Mission | Locals | Acceptor


@dataclass(frozen=True, slots=True)
class Loaded:
    """The newest of each kind; `locals` are the last KEPT rounds', ascending, the newest record of each."""

    mission: Mission | None = None
    locals: tuple[Locals, ...] = ()
    acceptor: Acceptor | None = None


class Identity(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Owner of a file. `token` is new whenever all records are forgotten; digests depend on it."""

    format: int
    app: str
    program: str
    robot: str
    pid: int
    n_sys: int
    rooms: tuple[int, ...]
    token: bytes = b""
