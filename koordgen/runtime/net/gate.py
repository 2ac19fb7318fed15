"""The gate: what judges datagrams as C (gate.c), and how Python calls it.

It checks their MACs, drops replays, keeps the counts of sessions.py and metrics.py, and hands on the usual ones, nearly
all, as one list. Without a compiler `link` does the same in Python, one after the other. Compiled and loaded as the
courier is.
"""

from __future__ import annotations

import ctypes
import math
import mmap
from array import array
from collections.abc import Mapping, Sequence
from ctypes import c_char_p, c_double, c_int32, c_int64, c_size_t, c_uint32, c_void_p
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from koordgen.runtime.native.loader import Compiled, NotCompiled, declare
from koordgen.runtime.net import ledger
from koordgen.runtime.net.courier import LARGEST, MOST_AT_ONCE, CompiledInbox, Slots, address_of
from koordgen.runtime.net.ledger import Ledger
from koordgen.runtime.net.metrics import BUCKETS, PER_OCTAVE, RECENT
from koordgen.runtime.net.seal import KEY_SIZE, MAC_SIZE
from koordgen.runtime.net.sessions import WORDS
from koordgen.runtime.net.wire import (
    LIMIT,
    MAX_ECHOES,
    MAX_ROBOTS,
    Closing,
    Echo,
    MaybePerRobot,
    Natural,
    Pid,
    Wired,
)

SOURCE = Path(__file__).with_name("gate.c")
FLAGS = (
    "-std=c99",
    "-O3",
    "-shared",
    "-fPIC",
    *(
        f"-D{name}={number}"
        for name, number in {
            "LIMIT": LIMIT,
            "LARGEST": LARGEST,
            "MOST_AT_ONCE": MOST_AT_ONCE,
            "MAC_SIZE": MAC_SIZE,
            "MAX_ROBOTS": MAX_ROBOTS,
            "MAX_ECHOES": MAX_ECHOES,
            "WORDS": WORDS,
            "BUCKETS": BUCKETS,
            "PER_OCTAVE": PER_OCTAVE,
            "RECENT": RECENT,
            **ledger.GIVEN,
        }.items()
    ),
    "-lm",
)
USUAL, OTHER, FALSE, TOO_LONG, REPLAYED, NOTHING, NOTED = range(7)  # verdicts; NOTED: in the ledger, nobody is told
NOT_POSSIBLE, NOT_STAMPED = -1, -2
_LESSON = 7  # numbers of one
_ROOM = MOST_AT_ONCE * (LARGEST + 32)
_COLUMNS = (
    "newest", "sent", "arrived", "round", "seen",
    "received", "expected", "heard", "longest", "delays", "most", "due", "lessons",
)  # fmt: skip


class Usual(Wired, frozen=True):
    """What nearly all datagrams say: see wire.Round; by the present view, and without an emergency."""

    sender: Pid
    round: Natural
    applied: Natural
    settled: Natural
    held: MaybePerRobot
    closings: tuple[Closing, ...]


class Lesson(NamedTuple):
    """What the clock learns from, in microseconds: when something was sent to `pid` and received there, then answered,
    and the answer arrived; what is to be added to that robot's clock for fleet time, where it is known."""

    pid: int
    answered: int
    sent: int
    received: int
    fleet: int
    known: int
    arrived: int


class Judged(NamedTuple):
    """The `usual` ones, as they arrived, but for those that the ledger noted; None: one of them is malformed, or there
    has been another view since. Where not all is well and usual, a verdict on each datagram."""

    usual: list[Usual] | None
    verdicts: Sequence[int]


_NOTED = Judged([], ())  # all


class _Columns(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_void_p) for name in _COLUMNS)


class _Shown(ctypes.Structure):
    """What C and Python tell one another: see Shown in gate.c."""

    _fields_ = (
        ("local", ctypes.c_double),
        ("fleet", ctypes.c_double),
        ("others", ctypes.c_int32),
        ("bytes", ctypes.c_int32),
        ("past", ctypes.c_int32),
        ("count", ctypes.c_int32),
        ("verdict", ctypes.c_uint8 * MOST_AT_ONCE),
        ("rows", ctypes.c_void_p),
        ("lesson", ctypes.c_int64 * (_LESSON * MAX_ROBOTS)),
    )


class Stamped(ctypes.Structure):
    """What own words are stamped with: see Stamped in voice.h."""

    _fields_ = (
        ("until", ctypes.c_double),
        ("sequence", ctypes.c_int64),
        ("fleet", ctypes.c_int64),
        ("known", ctypes.c_int32),
    )


def prove(found: ctypes.CDLL) -> None:
    """Declares the functions, and raises NotCompiled where the library is not the one that this module goes with."""
    declare(found, "gate_", _FUNCTIONS)
    declare(found, "voice_", _VOICE)
    ledger.prove(found)
    sizes = found.gate_shown_size(), found.gate_columns_size(), found.voice_stamped_size()
    if sizes != (ctypes.sizeof(_Shown), ctypes.sizeof(_Columns), ctypes.sizeof(Stamped)):
        raise NotCompiled("the compiled gate lays its memory out otherwise than Python reads it")


_FUNCTIONS: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "size": (c_size_t, ()),
    "shown_size": (c_size_t, ()),
    "columns_size": (c_size_t, ()),
    "open": (None, (c_void_p, c_int32, c_int32, c_void_p, c_void_p, c_char_p, c_uint32, c_char_p)),
    "begin": (None, (c_void_p, c_char_p, c_int32)),
    "adopt": (None, (c_void_p, c_int32, c_char_p, c_int32)),
    "follow": (None, (c_void_p, c_int64)),
    "attach": (None, (c_void_p, c_void_p)),
    "take": (None, (c_void_p, c_void_p, c_int32, c_void_p, c_int32, c_double, c_double)),
    "listen": (None, (c_void_p, c_void_p, c_void_p, c_void_p, c_void_p)),
    "look": (None, (c_void_p,)),
    "judge": (c_int32, (c_void_p, c_int32, c_int32, c_double)),
}
_VOICE: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "introduce": (None, (c_void_p, c_char_p, c_int32)),
    "said": (c_void_p, (c_void_p,)),
    "stamped_size": (c_size_t, ()),
    "stamped": (c_void_p, (c_void_p,)),
    "say": (c_int32, (c_void_p, c_char_p, c_int32, c_void_p, c_int64)),
    "couple": (None, (c_void_p, c_void_p, c_void_p, c_void_p)),
    "send": (c_int32, (c_void_p,)),  # bytes and a length follow: see courier.py
}
COMPILED = Compiled(SOURCE, FLAGS, prove)

Fields = tuple[int, int, int, int, bool, tuple[int, ...]]  # of wire.Round, between its head and its closings
# The same from wire.Head.sequence on.
Said = tuple[int, int, int | None, tuple[Echo, ...], int, int, int, int, bool, tuple[int, ...]]

_encode = msgspec.msgpack.Encoder().encode
_rows: msgspec.msgpack.Decoder[list[Usual]] = msgspec.msgpack.Decoder(list[Usual])


class Gate:
    """Of robot `pid` among `n_sys`; `columns` are those that it shares, which must not be resized."""

    def __init__(
        self,
        found: ctypes.CDLL,
        n_sys: int,
        pid: int,
        columns: Mapping[str, array[int] | array[float]],
        key: bytes | None,
        purpose: bytes,
    ) -> None:
        assert key is None or len(key) == KEY_SIZE
        self._found, self._n = found, n_sys
        self._columns = columns  # they live as long as their addresses are known
        self._rows = mmap.mmap(-1, _ROOM)  # the system makes its pages when they are used
        self._state = ctypes.create_string_buffer(found.gate_size())
        self._shown = _Shown.from_buffer(self._state)
        self._at = ctypes.addressof(self._state)
        addresses = _Columns(*(columns[name].buffer_info()[0] for name in _COLUMNS))
        rows = ctypes.addressof(ctypes.c_char.from_buffer(self._rows))
        key = key or b""
        found.gate_open(self._at, n_sys, pid, ctypes.addressof(addresses), rows, key, len(key), purpose)
        self._take, self._look = found.gate_take, found.gate_look
        self._say, self._send = found.voice_say, found.voice_send
        self._heard: Slots | None = None  # where gate_look finds what it judges
        self.ledger: Ledger | None = None
        self.stamped = Stamped.from_address(found.voice_stamped(self._at))  # in `_state`
        said: Any = (ctypes.c_char * LIMIT).from_address(found.voice_said(self._at))  # there, too
        self._said: bytes = said  # parts of it are

    def begin(self, common: bytes) -> None:
        """How words of this mission begin, up to their sender; empty: none is usual."""
        self._found.gate_begin(self._at, common, len(common))

    def adopt(self, pid: int, tail: bytes) -> None:
        """How a peer's head goes on behind its pid, boot and epoch; empty: nothing of it is usual."""
        self._found.gate_adopt(self._at, pid, tail, len(tail))

    def follow(self, view: int) -> None:
        """The number of the present view."""
        self._found.gate_follow(self._at, view)

    def attach(self, noting: Ledger | None) -> None:
        """Where usual words are noted from now on; None: nowhere."""
        if noting is not None:
            assert noting.n_sys == self._n
            noting.attach(self._found)
        self.ledger = noting  # it lives as long as its address is known
        self._found.gate_attach(self._at, None if noting is None else noting.at)

    def introduce(self, begin: bytes) -> None:
        """How own words of this mission begin, up to their sequence number; empty: none is said here."""
        self._found.voice_introduce(self._at, begin, len(begin))

    def say(self, fields: Said, ledger: int, own: int) -> bytes:
        """A word, sealed; with the own closing of round `own` (0: with none) out of the ledger at that address. Empty:
        that is not possible here."""
        told = _encode(fields)
        return self._said[: self._say(self._at, told, len(told), ledger, own)]

    def couple(self, courier: CompiledInbox, on_time: bool) -> None:
        """From now on words can be sent by this. `on_time`: the robot's clock is the system's; then what the ledger can
        note is noted while the courier waits, and is not among what is taken then, and words are stamped here."""
        self._found.voice_couple(self._at, courier.sends, courier.at, courier.clock if on_time else None)
        self._listen(courier.slots)
        courier.listen(address_of(self._found.gate_judge) if on_time else None, self._at, self)

    def send(self, place: int, fields: Fields | Said, own: int) -> int:
        """Say a word and send it there, with the own closing of round `own` (0: with none) out of the attached ledger.
        Returns 0, or errno: it was not sent; NOT_POSSIBLE here; NOT_STAMPED: only with stamps."""
        told, send = _encode((place, own, fields)), self._send
        error: int = send(self._at, told, len(told))
        return error

    def take(self, datagrams: Sequence[bytes], local: float, fleet: float | None) -> Judged:
        """Judge what arrived by `local` seconds of the robot's clock, which is `fleet` of the fleet's."""
        shown, time = self._shown, math.nan if fleet is None else fleet
        if isinstance(datagrams, Slots):
            if datagrams is not self._heard:
                self._listen(datagrams)
            shown.local, shown.fleet = local, time
            self._look(self._at)
            count = datagrams.used
        else:
            count = len(datagrams)
            if count > MOST_AT_ONCE:
                raise ValueError(f"{count} datagrams at once, of at most {MOST_AT_ONCE}")
            lengths = array("i", map(len, datagrams))
            slots = b"".join([each[:LARGEST].ljust(LARGEST, b"\0") for each in datagrams])
            self._take(self._at, slots, LARGEST, lengths.buffer_info()[0], count, local, time)
        bytes_, verdicts = shown.bytes, shown.verdict[:count] if shown.others else ()
        if not bytes_:
            return Judged([], verdicts) if verdicts else _NOTED
        if shown.past:
            return Judged(None, shown.verdict[:count])
        try:
            return Judged(_rows.decode(self._rows[:bytes_]), verdicts)
        except (ValueError, RecursionError):
            return Judged(None, shown.verdict[:count])

    def lessons(self) -> list[Lesson]:
        """What the clock learns from, of what was judged since this was asked last: of a robot what it said last."""
        count = self._columns["lessons"]
        numbers = self._shown.lesson[: _LESSON * int(count[0])]
        count[0] = 0
        return [Lesson(*numbers[at : at + _LESSON]) for at in range(0, len(numbers), _LESSON)]

    def _listen(self, slots: Slots) -> None:
        """From now on this is where datagrams arrive."""
        self._heard = slots  # they live as long as their addresses are known
        self._found.gate_listen(self._at, slots.at, ctypes.addressof(slots.lengths), slots.at_used, slots.at_judged)
