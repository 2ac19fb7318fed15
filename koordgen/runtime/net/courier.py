"""The courier: what sends and waits for datagrams and drains sockets as C (courier.c), and how Python calls it.

It is compiled at the process's first use of it, kept in a cache, and loaded by ctypes: see `native`. Without a compiler
`inbox` does the same in Python. What it has taken stays in its slots, where the gate judges it.
"""

from __future__ import annotations

import ctypes
import mmap
import socket
import struct
from collections.abc import Callable, Iterator, Sequence
from ctypes import c_int32, c_size_t, c_void_p
from pathlib import Path
from typing import Any, overload

from koordgen.runtime.native.loader import Compiled, NotCompiled, declare

MOST_AT_ONCE = 1024  # datagrams taken in one go: a flood must not keep the robot from its control loop


SOURCE = Path(__file__).with_name("courier.c")
LARGEST = 1201  # bytes of a datagram that are taken: one more than wire.LIMIT, which tells that it was too long
IN_TURN = 64  # datagrams taken from one socket before another is looked at
MOST_ECHOES = 16  # own datagrams under way back from the group; more than one round sends
GROUP = 128  # the place of the group; those before it are the robots', by pid
Address = tuple[str, int] | tuple[str, int, int, int]  # as Python's sockets have it: of IPv4, of IPv6
FLAGS = (
    "-std=c99",
    "-O2",
    "-shared",
    "-fPIC",
    f"-DLARGEST={LARGEST}",
    f"-DMOST_AT_ONCE={MOST_AT_ONCE}",
    f"-DIN_TURN={IN_TURN}",
    f"-DMOST_ECHOES={MOST_ECHOES}",
    f"-DGROUP={GROUP}",
)
_MOST_ERRORS = 16
_LONGEST = 2000.0  # seconds that C can be told to wait


class Shown(ctypes.Structure):
    """What C and Python tell one another of an inbox: see Shown in courier.c."""

    _fields_ = (
        ("spins", ctypes.c_int64),
        ("failed", ctypes.c_int64),
        ("pace", ctypes.c_int64),
        ("used", ctypes.c_int32),
        ("arrived", ctypes.c_int32),
        ("judged", ctypes.c_int32),
        ("errors", ctypes.c_int32),
        ("error", ctypes.c_int32 * _MOST_ERRORS),
        ("length", ctypes.c_int32 * MOST_AT_ONCE),
    )


def prove(found: ctypes.CDLL) -> None:
    """Declares the functions, and raises NotCompiled where the library is not the one that this module goes with."""
    declare(found, "courier_", _FUNCTIONS)
    if found.courier_shown_size() != ctypes.sizeof(Shown):
        raise NotCompiled("the compiled courier lays its memory out otherwise than Python reads it")
    inbox = CompiledInbox(found, [], lambda number: None)
    inbox.wait(0.0)
    if inbox.receive():
        raise NotCompiled("the compiled courier finds datagrams where there is no socket")


# Where ints and bytes follow the inbox, ctypes converts them as it does unasked: in a third of the time.
_FUNCTIONS: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "inbox_size": (c_size_t, ()),
    "shown_size": (c_size_t, ()),
    "open": (None, (c_void_p, c_void_p, c_void_p, c_int32)),
    "close": (None, (c_void_p,)),
    "address": (None, (c_void_p,)),
    "send": (c_int32, (c_void_p,)),
    "clock": (ctypes.c_double, ()),
    "wait": (c_int32, (c_void_p,)),
    "receive": (c_int32, (c_void_p,)),
    "listen": (None, (c_void_p, c_void_p, c_void_p)),
}
COMPILED = Compiled(SOURCE, FLAGS, prove)


class Slots(Sequence[bytes]):
    """Datagrams as C received them: in the first `used` slots (which is also at an address), LARGEST bytes apart from
    address `at` on, so many bytes in each as `lengths` say (-1: nothing for us). To be read before the inbox waits or
    receives again; it is the same object then."""

    def __init__(self, slots: mmap.mmap, shown: Shown) -> None:
        self._slots, self._shown = slots, shown
        self.at = ctypes.addressof(ctypes.c_char.from_buffer(slots))
        self.lengths: ctypes.Array[ctypes.c_int32] = shown.length
        self.at_used = ctypes.addressof(shown) + Shown.used.offset
        self.at_judged = ctypes.addressof(shown) + Shown.judged.offset

    @property
    def used(self) -> int:
        count: int = self._shown.used
        return count

    def __len__(self) -> int:
        count: int = self._shown.arrived
        return count

    @overload
    def __getitem__(self, index: int) -> bytes: ...
    @overload
    def __getitem__(self, index: slice) -> list[bytes]: ...
    def __getitem__(self, index: int | slice) -> bytes | list[bytes]:
        return list(self)[index]

    def __iter__(self) -> Iterator[bytes]:
        for slot in range(self.used):
            if self.lengths[slot] >= 0:
                yield self.slot(slot)

    def slot(self, number: int) -> bytes:
        at = number * LARGEST
        return self._slots[at : at + self.lengths[number]]


class CompiledInbox:
    """See inbox.open_inbox. Its memory is Python's own, so nothing is to be given back. `sends` is the address of what
    sends, which wants to be called with `at`."""

    def __init__(self, found: ctypes.CDLL, sockets: Sequence[int], trouble: Callable[[int], None],
                 shares: bool = False) -> None:  # fmt: skip
        self._trouble = trouble
        room = mmap.mmap(-1, MOST_AT_ONCE * LARGEST)  # the system makes its pages when they are used
        self._state = ctypes.create_string_buffer(found.courier_inbox_size())
        self.shown = Shown.from_buffer(self._state)
        self.slots = Slots(room, self.shown)
        self.at = ctypes.addressof(self._state)
        self._wait, self._receive = found.courier_wait, found.courier_receive
        self._address, self._send, self._close = found.courier_address, found.courier_send, found.courier_close
        self.sends, self._listen = address_of(self._send), found.courier_listen
        self.clock = address_of(found.courier_clock)
        self._judging: object = None
        self._found: int | None = None  # what waiting has found, and nobody has taken yet: so many; -1: also errors
        found.courier_open(self.at, self.slots.at, (c_int32 * len(sockets))(*sockets), len(sockets), shares)

    def address(self, place: int, address: Address) -> None:
        written = as_written(address)
        self._address(self.at, place, written, len(written))

    def send(self, place: int, datagram: bytes) -> int:
        error: int = self._send(self.at, place, datagram, len(datagram))
        return error

    def wait(self, seconds: float, expected: int = 1, gather: float = 0.0) -> None:
        wait, taken, patience = self._wait, self._found is None, _microseconds(gather) if gather else 0
        self._found = wait(self.at, expected, taken, _microseconds(seconds), patience)

    def receive(self) -> Sequence[bytes]:
        found, self._found = self._found, None
        if found is None:  # else waiting has looked already
            receive = self._receive
            found = receive(self.at)
        if found < 0:
            found = self._tell()
        return self.slots if found else ()

    def listen(self, judge: int | None, at: int, judging: object) -> None:
        """From now on the function at address `judge` (a Judge, see courier.c; None: nobody), called with `at`, judges
        what comes while `wait` waits. `judging` is what it needs to live."""
        self._judging = judging
        self._listen(self.at, judge, at)

    def close(self) -> None:
        self._close(self.at)
        self._found = None

    def _tell(self) -> int:
        """What went wrong; returns how many datagrams there are all the same."""
        errors, self.shown.errors = self.shown.errors, 0
        for number in self.shown.error[:errors]:
            self._trouble(number)
        return len(self.slots)


def _microseconds(seconds: float) -> int:
    """No shorter, and no longer than can be waited; not a number is nothing."""
    return int(seconds * 1e6) + 1 if 0.0 < seconds < _LONGEST else int(_LONGEST * 1e6) if seconds > 0.0 else 0


def address_of(function: Any) -> int:
    """Of a function of a library."""
    return ctypes.cast(function, c_void_p).value or 0


def as_written(address: Address) -> bytes:
    """As the system reads it: struct sockaddr_in or sockaddr_in6. Raises OSError: that is no address."""
    host, port = address[:2]
    if len(address) == 2:
        return struct.pack("=H", socket.AF_INET) + struct.pack("!H4s8x", port, socket.inet_pton(socket.AF_INET, host))
    flow, scope = address[2:]
    inner = struct.pack("!HI16s", port, flow, socket.inet_pton(socket.AF_INET6, host))
    return struct.pack("=H", socket.AF_INET6) + inner + struct.pack("=I", scope)
