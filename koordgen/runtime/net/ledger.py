"""What a robot's memory looks at in every round, in columns that the compiled gate shares (ledger.h): how far each
robot's closings are held, what the others last said of themselves, and the closings of the last rounds as they came.
"""

from __future__ import annotations

import ctypes
import mmap
from array import array
from collections.abc import Sequence
from ctypes import c_int32, c_int64, c_size_t, c_void_p
from typing import Any

import msgspec

from koordgen.runtime.native.loader import NotCompiled, declare
from koordgen.runtime.net.wire import LIMIT, MAX_ROBOTS

NUMBERS = 13
OPEN, LAST, TICK, APPLIED, SETTLED, LACKING, WATCHED, REACHED, TOLD, NEXT, LEAST, PRESENT, WANTING = range(NUMBERS)
LONG_AGO = -(2**62)  # a tick
DEPTH = 32  # rounds of each robot whose closings are kept as they came
ROW = LIMIT  # bytes of one
GIVEN = {"DEPTH": DEPTH, "ROW": ROW, "MOST_WRITES": 256}  # to the compiler
_BY_PID = ("held", "floor", "view", "incarnation", "applied", "through", "heard", "wanting", "gap")


class Collected(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """The closings of a round: in which robots an event ended, who waits to hear that the round was applied, and what
    was written: by ascending index of the variable its writers and, as encoded in one array, their values. Pids are
    ascending."""

    acted: list[int]
    prompt: tuple[int, ...]
    writes: list[tuple[int, list[int], msgspec.Raw]]


class _Columns(ctypes.Structure):
    """Ledger in ledger.h."""

    _fields_ = (
        *((name, c_void_p) for name in (*_BY_PID, "number", "lacks", "rows", "length")),
        ("robots", c_int32),
        ("own", c_int32),
    )


_FUNCTIONS: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "size": (c_size_t, ()),
    "room": (c_size_t, (c_int32,)),
    "collect": (c_int32, (c_void_p, c_int64, c_void_p)),
    "close": (c_int32, (c_void_p,)),  # bytes and a length follow: see courier.py
}
_collected: msgspec.msgpack.Decoder[Collected] = msgspec.msgpack.Decoder(Collected)


def prove(found: ctypes.CDLL) -> None:
    """Declares the functions, and raises NotCompiled where the library is not the one that this module goes with."""
    declare(found, "ledger_", _FUNCTIONS)
    if found.ledger_size() != ctypes.sizeof(_Columns):
        raise NotCompiled("the compiled ledger lays its memory out otherwise than Python reads it")


class Ledger:
    """Of robot `pid` in a fleet of `n_sys`. Columns by pid: closings are `held` without a gap up to a round, those up
    to `floor` not here but in the robot's log; there is a `gap`: some are kept beyond `held`. The `incarnation` that
    counts, or -1. Of the last word: by which `view` (-1: none), `applied` up to there, wanted closings up to `through`,
    and is `wanting`: lacks something that it was not sent, and what it held then of each robot's closings is in its row
    of `lacks`. It was `heard` at a tick.

    `number` holds, by OPEN and so on: whether the gate may note; the last round that may be heard of now; the tick;
    the rounds up to which all is applied, and everyone holds everything; how many members lack the next round; a
    watched round (-1: none), and how many have said to have applied it since; how far all is settled, as the gate was
    told; as `collect` found them, how many members lack the round after, and the least that another has applied in the
    present view (-1: one was not heard in it); that view's number, which the gate sets; and how many are wanting.

    It is `native`, and has an address `at`, once it is attached to the library. Columns must not be resized."""

    def __init__(self, pid: int, n_sys: int, applied: int = 0) -> None:
        assert n_sys <= MAX_ROBOTS
        self.pid, self.n_sys = pid, n_sys
        none = bytes(8 * n_sys)
        self.held, self.floor = array("q", [applied] * n_sys), array("q", [applied] * n_sys)
        self.view, self.incarnation = array("q", [-1] * n_sys), array("q", [-1] * n_sys)
        self.applied, self.through = array("q", none), array("q", none)
        self.heard = array("q", [LONG_AGO] * n_sys)
        self.wanting, self.gap = array("B", bytes(n_sys)), array("B", bytes(n_sys))
        self.lacks = array("q", none * n_sys)
        self.number = array("q", [0] * NUMBERS)
        self.native, self.at = False, 0

    def attach(self, found: ctypes.CDLL) -> None:
        """From now on closings can be kept here."""
        if self.native:
            return
        self._length = array("i", [0] * (self.n_sys * DEPTH))
        self._rows = mmap.mmap(-1, self.n_sys * DEPTH * ROW)  # the system makes its pages when they are used
        self._out = mmap.mmap(-1, found.ledger_room(self.n_sys))
        self._found = memoryview(self._out)
        columns = [getattr(self, name).buffer_info()[0] for name in (*_BY_PID, "number", "lacks")]
        rows, self._place = (ctypes.addressof(ctypes.c_char.from_buffer(each)) for each in (self._rows, self._out))
        self._columns = _Columns(*columns, rows, self._length.buffer_info()[0], self.n_sys, self.pid)
        self.native, self.at = True, ctypes.addressof(self._columns)
        self._close, self._collect = found.ledger_close, found.ledger_collect

    def close(self, row: bytes) -> bool:
        """Keep this encoded own closing. False: it is not the next one, or there is no room for it."""
        if not self.native:
            return False
        close = self._close
        return bool(close(self.at, row, len(row)))

    def lost(self, pids: Sequence[int]) -> bool:
        """Whether somebody has what is missing of these robots: more of one came, or another has applied more."""
        applied = max(self.applied)
        return any(self.gap[p] or self.held[p] < applied for p in pids)

    def collect(self, round_: int) -> Collected | None:
        """All members' closings of a round; None where not all are here, or such as must be looked at one by one. The
        values lie where the next call puts its own."""
        if not self.native:
            return None
        collect = self._collect
        size = collect(self.at, round_, self._place)
        if not size:
            return None
        try:
            return _collected.decode(self._found[:size])
        except (ValueError, RecursionError):  # a value that nests too deeply
            return None

    def rows(self, pid: int) -> list[bytes]:
        """The encoded closings of one author that are here, which from now on are in the robot's log: of each round
        one, that of several rounds at each of them."""
        rows, self.floor[pid] = self.peek(pid, 0), self.held[pid]
        return rows

    def peek(self, pid: int, low: int) -> list[bytes]:
        """The same from round `low` on, and they stay here."""
        if not self.native:
            return []
        held = self.held[pid]
        first = max(self.floor[pid], held - DEPTH, low - 1) + 1  # everyone holds what was before it
        return [self.row(pid, round_) for round_ in range(first, held + 1)]

    def own(self, round_: int) -> bool:
        """Whether the own closing of a round is here."""
        pid, held = self.pid, self.held[self.pid]
        return self.native and max(self.floor[pid], held - DEPTH) < round_ <= held

    def row(self, pid: int, round_: int) -> bytes:
        """The encoded closing of a round that is here, and maybe of others, in which nothing was done either."""
        slot = round_ % DEPTH * self.n_sys + pid
        return self._rows[slot * ROW : slot * ROW + self._length[slot]]
