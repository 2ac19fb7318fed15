"""Socket batch I/O in C: the binding of socket_batch.c, which implements `inbox.Inbox`.

The loader in `native` compiles the library at its first use, keeps it in a cache, and loads it by ctypes.
"""

from __future__ import annotations

import ctypes
import mmap
import socket
import struct
from collections.abc import Callable, Sequence
from ctypes import c_int32, c_int64, c_size_t, c_void_p
from pathlib import Path
from typing import Any

from koordgen.runtime.native.loader import Compiled, NotCompiled, declare
from koordgen.runtime.net.transport import GROUP, IN_TURN, LARGEST, MOST_AT_ONCE, MOST_ECHOES, PLACES, Address

SOURCE = Path(__file__).with_name("socket_batch.c")
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
    f"-DPLACES={PLACES}",
)
_MOST_ERRORS = 16
_LONGEST = 2000.0  # seconds; longest wait that the C library accepts


class Shown(ctypes.Structure):
    """Fields of an inbox that C and Python share; the same layout as `Shown` in socket_batch.c."""

    _fields_ = (
        ("spins", c_int64),
        ("failed", c_int64),
        ("pace", c_int64),
        ("used", c_int32),
        ("arrived", c_int32),
        ("errors", c_int32),
        ("error", c_int32 * _MOST_ERRORS),
        ("length", c_int32 * MOST_AT_ONCE),
    )


def prove(found: ctypes.CDLL) -> None:
    """Declare the functions of a library to ctypes, and test the library.

    Raises NotCompiled if the library does not fit this module.
    """
    declare(found, "socket_batch_", _FUNCTIONS)
    if found.socket_batch_shown_size() != ctypes.sizeof(Shown):
        raise NotCompiled("the compiled socket I/O has another memory layout than Python expects")
    inbox = CompiledInbox(found, [], lambda number: None)
    inbox.wait(0.0)
    if inbox.receive():
        raise NotCompiled("the compiled socket I/O receives datagrams without a socket")


# Only the first argument is declared: ctypes converts undeclared ints and bytes three times as fast as declared ones.
_FUNCTIONS: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "inbox_size": (c_size_t, ()),
    "shown_size": (c_size_t, ()),
    "open": (None, (c_void_p, c_void_p, c_void_p, c_int32)),
    "close": (None, (c_void_p,)),
    "address": (None, (c_void_p,)),
    "send": (c_int32, (c_void_p,)),
    "wait": (c_int32, (c_void_p,)),
    "receive": (c_int32, (c_void_p,)),
}
COMPILED = Compiled(SOURCE, FLAGS, prove)


class CompiledInbox:
    """Implementation of `inbox.Inbox` in C. Python owns the memory, so C has nothing to free.

    C receives each datagram into a slot of LARGEST bytes. The first `shown.used` slots are in use. `shown.length` has
    the number of bytes in each slot; it is negative for a copy of a datagram that this robot sent to the group.
    """

    def __init__(self, found: ctypes.CDLL, sockets: Sequence[socket.socket], trouble: Callable[[int], None],
                 shares: bool = False) -> None:  # fmt: skip
        self._trouble = trouble
        self._slots = mmap.mmap(-1, MOST_AT_ONCE * LARGEST)  # the system allocates memory pages at their first use
        self._state = ctypes.create_string_buffer(found.socket_batch_inbox_size())
        self.shown = Shown.from_buffer(self._state)
        self._at = ctypes.addressof(self._state)
        self._wait, self._receive = found.socket_batch_wait, found.socket_batch_receive
        self._address, self._send, self._close = (
            found.socket_batch_address,
            found.socket_batch_send,
            found.socket_batch_close,
        )
        self._found: int | None = None  # number of datagrams that `wait` has received; negative: errors as well
        slots = ctypes.addressof(ctypes.c_char.from_buffer(self._slots))
        numbers = (c_int32 * len(sockets))(*[each.fileno() for each in sockets])
        found.socket_batch_open(self._at, slots, numbers, len(sockets), shares)

    def address(self, place: int, address: Address) -> None:
        written = as_written(address)
        self._address(self._at, place, written, len(written))

    def send(self, place: int, datagram: bytes) -> int:
        error: int = self._send(self._at, place, datagram, len(datagram))
        return error

    def wait(self, seconds: float, expected: int = 1, gather: float = 0.0) -> None:
        wait, taken, gathering = self._wait, self._found is None, _microseconds(gather) if gather else 0
        self._found = wait(self._at, expected, taken, _microseconds(seconds), gathering)

    def receive(self) -> list[bytes]:
        found, self._found = self._found, None
        if found is None:  # `wait` was not called, so no datagram was received yet
            found = self._receive(self._at)
        if found < 0:
            self._report()
        if not found:
            return []
        shown, slots = self.shown, self._slots
        lengths = shown.length[: shown.used]
        return [
            slots[at : at + length]
            for at, length in zip(range(0, MOST_AT_ONCE * LARGEST, LARGEST), lengths)  # noqa: B905
            if length >= 0
        ]

    def close(self) -> None:
        self._close(self._at)
        self._found = None

    def _report(self) -> None:
        """Report the errors that occurred while datagrams were received."""
        errors, self.shown.errors = self.shown.errors, 0
        for number in self.shown.error[:errors]:
            self._trouble(number)


def _microseconds(seconds: float) -> int:
    """Convert seconds to microseconds: rounded up, at most _LONGEST seconds. NaN becomes 0."""
    return int(seconds * 1e6) + 1 if 0.0 < seconds < _LONGEST else int(_LONGEST * 1e6) if seconds > 0.0 else 0


def as_written(address: Address) -> bytes:
    """Return an address as struct sockaddr_in or sockaddr_in6. Raises OSError for an invalid address."""
    host, port = address[:2]
    if len(address) == 2:
        return struct.pack("=H", socket.AF_INET) + struct.pack("!H4s8x", port, socket.inet_pton(socket.AF_INET, host))
    flow, scope = address[2:]
    inner = struct.pack("!HI16s", port, flow, socket.inet_pton(socket.AF_INET6, host))
    return struct.pack("=H", socket.AF_INET6) + inner + struct.pack("=I", scope)
