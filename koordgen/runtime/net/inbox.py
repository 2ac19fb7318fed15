"""What arrives at a robot's sockets and leaves from them: waiting for it, taking it, sending. In Python;
`courier.CompiledInbox` is the same as C."""

from __future__ import annotations

import errno
import os
import select
import socket
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from koordgen.runtime.net.courier import (
    COMPILED,
    GROUP,
    IN_TURN,
    LARGEST,
    MOST_AT_ONCE,
    MOST_ECHOES,
    Address,
    CompiledInbox,
)

NAP = 20e-6  # seconds for each datagram that is missing


class Inbox(Protocol):
    """Of one thread. No call raises."""

    def address(self, place: int, address: Address) -> None:
        """Where a place is: a robot's, by its pid, or GROUP."""
        ...

    def send(self, place: int, datagram: bytes) -> int:
        """From the first of its sockets, without blocking; what goes to the group comes back, and the inbox drops it
        then; if it `shares` the computer, others go first after that. Returns 0, or errno: it was not sent."""
        ...

    def wait(self, seconds: float, expected: int = 1, gather: float = 0.0) -> None:
        """See Transport. What comes while the time runs out may be left for the next call."""
        ...

    def receive(self) -> Sequence[bytes]:
        """See Transport."""
        ...

    def close(self) -> None:
        """Before its sockets are."""
        ...


def open_inbox(sockets: Sequence[socket.socket], trouble: Callable[[int], None], native: bool, shares: bool) -> Inbox:
    """Of sockets that do not block; `trouble` gets the errno of what went wrong when receiving; `shares`: others of the
    group are on this computer. Compiled, if `native` and there is a compiler."""
    found = COMPILED.library() if native else None
    if found is None:
        return PlainInbox(sockets, trouble, shares)
    return CompiledInbox(found, [each.fileno() for each in sockets], trouble, shares)


class PlainInbox:
    def __init__(self, sockets: Sequence[socket.socket], trouble: Callable[[int], None], shares: bool = False) -> None:
        self._trouble, self._shares = trouble, shares
        self._poll = select.poll()
        self._sockets = {each.fileno(): each for each in sockets}
        for number in self._sockets:
            self._poll.register(number, select.POLLIN)
        self._addresses: dict[int, Address] = {}
        self._echoes: deque[bytes | None] = deque(maxlen=MOST_ECHOES)
        self._arrived: list[bytes] = []
        self._troubled = False

    def address(self, place: int, address: Address) -> None:
        self._addresses[place] = address

    def send(self, place: int, datagram: bytes) -> int:
        if not self._sockets:
            return errno.EBADF
        if place not in self._addresses:
            return errno.EDESTADDRREQ
        if place == GROUP:  # also when it fails: the system may have given it back by then
            self._echoes.append(datagram)
        try:
            next(iter(self._sockets.values())).sendto(datagram, self._addresses[place])
        except OSError as error:
            return error.errno or errno.EIO
        if place == GROUP and self._shares:  # all wait for the last of those that share the core and have not sent
            os.sched_yield()
        return 0

    def wait(self, seconds: float, expected: int = 1, gather: float = 0.0) -> None:
        begin = time.monotonic()
        end, until = begin + seconds, begin + min(gather, seconds)
        self._drain()
        while 1 < expected > len(self._arrived) < MOST_AT_ONCE and (left := until - time.monotonic()) > 0:
            missing = expected - len(self._arrived)
            if missing > 1:
                time.sleep(min(NAP * missing, left))
            else:
                self._ready(left)
            self._drain()
        while not self._some() and self._ready(end - time.monotonic()):
            self._drain()

    def receive(self) -> list[bytes]:
        self._drain()
        taken, self._arrived, self._troubled = self._arrived, [], False
        return taken

    def close(self) -> None:
        for number in self._sockets:
            self._poll.unregister(number)
        self._sockets = {}
        self._arrived = []

    def _some(self) -> bool:
        return bool(self._arrived) or self._troubled

    def _ready(self, seconds: float) -> bool:
        """Whether something is at a socket within that time."""
        # poll takes milliseconds and rounds up: the last of them is select's, or rounds would begin late.
        end = time.monotonic() + seconds
        if seconds >= 0.001 and self._poll.poll(int(seconds * 1000)):
            return True
        rest = end - time.monotonic()
        return rest > 0 and bool(select.select(tuple(self._sockets), (), (), rest)[0])

    def _drain(self) -> None:
        while len(self._arrived) < MOST_AT_ONCE:
            ready = self._poll.poll(0)
            if not ready:
                return
            for number, _ in ready:
                self._take(self._sockets[number])

    def _take(self, source: socket.socket) -> None:
        """What waits there, until it is the turn of others."""
        try:
            for _ in range(min(IN_TURN, MOST_AT_ONCE - len(self._arrived))):
                datagram = source.recv(LARGEST)
                if not self._is_echo(datagram):
                    self._arrived.append(datagram)
        except BlockingIOError:
            pass
        except OSError as error:  # an earlier send's, nothing about what waits
            self._troubled = True
            self._trouble(error.errno or 0)

    def _is_echo(self, datagram: bytes) -> bool:
        """Whether it is our own: each comes back once, and its sequence number makes it unlike all others."""
        if datagram not in self._echoes:
            return False
        self._echoes[self._echoes.index(datagram)] = None
        return True
