"""Socket batch I/O of one robot: sends datagrams, waits for datagrams and receives them in batches.

`Inbox` is the interface. `PythonInbox` implements it in Python, and `socket_batch.CompiledInbox` in C. `open_inbox`
chooses between these two classes."""

from __future__ import annotations

import errno
import os
import select
import socket
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from koordgen.runtime.net import socket_batch
from koordgen.runtime.net.transport import GROUP, IN_TURN, LARGEST, MOST_AT_ONCE, MOST_ECHOES, Address

NAP = 20e-6  # seconds of sleep for each datagram that is still missing


class Inbox(Protocol):
    """Interface of socket batch I/O. Only one thread may use an inbox. No call raises."""

    def address(self, place: int, address: Address) -> None:
        """Set the address of a receiver: `place` is a robot's pid, or GROUP."""
        ...

    def send(self, place: int, datagram: bytes) -> int:
        """Send from the first socket without blocking. Return 0, or the errno of the failure.

        A datagram to the group also comes back to its sender, and the inbox drops that copy. If other robots run on the
        same computer, the inbox yields the core after a send to the group, because all robots wait for the last one."""
        ...

    def wait(self, seconds: float, expected: int = 1, gather: float = 0.0) -> None:
        """Wait as Transport.wait does. A datagram at the very end may be left for the next call."""
        ...

    def receive(self) -> list[bytes]:
        """Return the datagrams received since the last call, as Transport.receive does."""
        ...

    def close(self) -> None:
        """Stop using the sockets. Call this method before the sockets are closed."""
        ...


def open_inbox(sockets: Sequence[socket.socket], trouble: Callable[[int], None], shares: bool) -> Inbox:
    """Return an inbox for non-blocking sockets: a CompiledInbox if its C source can be compiled.

    trouble: function that is called with the errno of each failure to receive.
    shares: other robots of the fleet run on this computer."""
    found = socket_batch.COMPILED.library()
    if found is None:
        return PythonInbox(sockets, trouble, shares)
    return socket_batch.CompiledInbox(found, sockets, trouble, shares)


PYTHON_COSTS = "sockets are read by Python: a round takes about 10 % more CPU, a round trip 2 to 3 times as long"


def accelerator() -> str:
    """Return the reason why inboxes are not in C, or "". The first call may spend 0.3 s on compilation."""
    return socket_batch.COMPILED.why()


class PythonInbox:
    """Implementation of Inbox in Python."""

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
        if place == GROUP:  # before the send, because the system may return the copy at once
            self._echoes.append(datagram)
        try:
            next(iter(self._sockets.values())).sendto(datagram, self._addresses[place])
        except OSError as error:
            return error.errno or errno.EIO
        if place == GROUP and self._shares:  # other robots on this core also have to send
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
        received, self._arrived, self._troubled = self._arrived, [], False
        return received

    def close(self) -> None:
        for number in self._sockets:
            self._poll.unregister(number)
        self._sockets = {}
        self._arrived = []

    def _some(self) -> bool:
        return bool(self._arrived) or self._troubled

    def _ready(self, seconds: float) -> bool:
        """Return whether a datagram arrives at a socket within `seconds`."""
        # `poll` counts in milliseconds, so `select` waits for the last fraction. Otherwise rounds would begin late.
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
                self._read(self._sockets[number])

    def _read(self, source: socket.socket) -> None:
        """Receive at most IN_TURN datagrams from one socket, so that other sockets are served soon."""
        try:
            for _ in range(min(IN_TURN, MOST_AT_ONCE - len(self._arrived))):
                datagram = source.recv(LARGEST)
                if not self._is_echo(datagram):
                    self._arrived.append(datagram)
        except BlockingIOError:
            pass
        except OSError as error:  # error of an earlier send; the socket may still have datagrams
            self._troubled = True
            self._trouble(error.errno or 0)

    def _is_echo(self, datagram: bytes) -> bool:
        """Return whether a datagram is the copy of one that this robot sent to the group.

        Each copy comes back once, and no two datagrams of a robot are equal.
        """
        if datagram not in self._echoes:
            return False
        self._echoes[self._echoes.index(datagram)] = None
        return True
