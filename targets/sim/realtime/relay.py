"""Relay between agent processes: loses, delays, duplicates and reorders their datagrams.

It has a port for each robot, to which the other robots send. It recognises a sender by the source port, because an
agent sends from the port on which it listens. It is a process of its own, so that neither the world's steps nor the
agents' work delay datagrams. The harness writes the medium's conditions as lines of JSON to its standard input, and
ends the relay by closing it."""

from __future__ import annotations

import errno
import heapq
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from random import Random

import msgspec

from koordgen.runtime.net.wire import LIMIT
from targets.sim.base.medium import Medium

LOOPBACK = "127.0.0.1"
MOST_WAITING = 200_000  # datagrams in flight: a flooding agent must not fill the memory
RECEIVE_BUFFER = 1 << 20
AT_ONCE = 256  # datagrams read from one port before the other ports are served


class Relay:
    """The harness's handle of the relay process.

    `ports`: where agents send to, by pid. `targets`: where the robots listen."""

    def __init__(self, targets: Sequence[int], seed: int, medium: Medium) -> None:
        sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in targets]
        try:
            for each in sockets:
                each.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
                each.bind((LOOPBACK, 0))
            self.ports = [int(each.getsockname()[1]) for each in sockets]
            handed = [each.fileno() for each in sockets]
            words = [f"{fileno}:{port}" for fileno, port in zip(handed, targets, strict=True)]
            self._process = subprocess.Popen(
                [sys.executable, "-m", "targets.sim.realtime.relay", str(seed), *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                pass_fds=handed,
                start_new_session=True,  # the harness forwards Ctrl-C itself
                cwd=Path(__file__).resolve().parents[3],  # the folder that contains `targets`
            )
        finally:
            for each in sockets:
                each.close()
        self.change(medium)

    def change(self, medium: Medium) -> None:
        """Change the medium. Raises OSError if the relay has ended."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(msgspec.json.encode(medium) + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise OSError(errno.EPIPE, "the relay between the agents has ended") from None

    def close(self) -> None:
        """End the relay process."""
        if self._process.stdin is not None:
            with suppress(OSError):  # already gone
                self._process.stdin.close()
        self._process.wait()


class Router:
    """Schedule of deliveries, without sockets. Times in seconds of any clock."""

    def __init__(self, count: int, seed: int) -> None:
        self._count = count
        self._dice = Random(seed)
        self._waiting: list[tuple[float, int, int, bytes]] = []  # a heap: due, number, receiver, datagram
        self._number = 0
        self.change(Medium())

    def change(self, medium: Medium) -> None:
        """Change the medium. Datagrams in flight still arrive."""
        self._medium = medium
        self._links = medium.by_link()

    def forward(self, sender: int, receiver: int, datagram: bytes, now: float) -> None:
        if self._medium.cut(sender, receiver):
            return
        for delay in self._links.get((sender, receiver), self._medium.all).delays(self._dice):
            if len(self._waiting) < MOST_WAITING:
                self._number += 1
                heapq.heappush(self._waiting, (now + delay, self._number, receiver, datagram))

    def due(self, now: float) -> list[tuple[int, bytes]]:
        """Return the datagrams that are due, with their receivers, in order."""
        found = []
        while self._waiting and self._waiting[0][0] <= now:
            _, _, receiver, datagram = heapq.heappop(self._waiting)
            found.append((receiver, datagram))
        return found

    @property
    def next(self) -> float | None:
        return self._waiting[0][0] if self._waiting else None


def main(seed: str, *places: str) -> None:
    """Run the relay process. Each argument is "FILENO:PORT": an open socket, and the port of its robot."""
    pairs = [place.split(":") for place in places]
    sockets = [socket.socket(fileno=int(fileno)) for fileno, _ in pairs]
    targets = [(LOOPBACK, int(port)) for _, port in pairs]
    pids = {target: pid for pid, target in enumerate(targets)}
    router = Router(len(targets), int(seed))
    decoder = msgspec.json.Decoder(Medium)
    poll = select.poll()
    told = sys.stdin.fileno()
    os.set_blocking(told, False)
    poll.register(told, select.POLLIN)
    receivers = {each.fileno(): pid for pid, each in enumerate(sockets)}
    for each in sockets:
        each.setblocking(False)
        poll.register(each, select.POLLIN)
    text = b""
    while True:
        rest = None if router.next is None else max(0.0, router.next - time.monotonic()) * 1000
        for fileno, _ in poll.poll(rest):
            if fileno == told:
                more = os.read(told, 65536)
                if not more:
                    return
                *lines, text = (text + more).split(b"\n")
                for line in lines:
                    router.change(decoder.decode(line))
            else:
                pid = receivers[fileno]
                _drain(sockets[pid], pid, pids, router)
        for receiver, datagram in router.due(time.monotonic()):
            _pass_on(sockets[receiver], datagram, targets[receiver])


def _drain(own: socket.socket, receiver: int, pids: Mapping[tuple[str, int], int], router: Router) -> None:
    for _ in range(AT_ONCE):
        try:
            datagram, source = own.recvfrom(LIMIT + 1)
        except OSError:  # nothing left, or an ICMP error of a robot that is gone
            return
        sender = pids.get(source)
        if sender is not None:
            router.forward(sender, receiver, datagram, time.monotonic())


def _pass_on(own: socket.socket, datagram: bytes, target: tuple[str, int]) -> None:
    with suppress(OSError):  # lost, as on any network
        own.sendto(datagram, target)


if __name__ == "__main__":
    main(*sys.argv[1:])
