"""Connections that break: when they are opened anew, and that nobody waits for them. No socket is opened here."""

from __future__ import annotations

import errno
import socket
from itertools import pairwise

import pytest

from targets.mavlink.transport import FIRST_WAIT, LONGEST_WAIT, SILENT, Tcp


class Peer:
    """A TCP peer as a non-blocking socket sees it, and the times at which it was connected to."""

    def __init__(self) -> None:
        self.now = 0.0
        self.attempts: list[float] = []
        self.open = 0
        self.answers: bytes | OSError = ConnectionRefusedError()
        self.connecting = errno.EINPROGRESS
        self.takes = 1 << 20

    def make(self, family: int, kind: int) -> Peer:
        if self.connecting == errno.EMFILE:
            raise OSError(errno.EMFILE, "too many open files")
        self.open += 1
        return self

    def setblocking(self, on: bool) -> None:
        assert not on

    def setsockopt(self, *option: int) -> None:
        pass

    def connect_ex(self, peer: object) -> int:
        self.attempts.append(round(self.now, 3))
        return self.connecting

    def recv(self, size: int) -> bytes:
        if isinstance(self.answers, OSError):
            raise self.answers
        data, self.answers = self.answers, BlockingIOError()
        return data

    def send(self, data: bytes) -> int:
        return min(len(data), self.takes)

    def fileno(self) -> int:
        return 7

    def close(self) -> None:
        self.open -= 1


def run(tcp: Tcp, peer: Peer, seconds: float) -> None:
    for _ in range(round(seconds / 0.05)):
        peer.now += 0.05
        tcp.receive(peer.now)


def client() -> tuple[Tcp, Peer]:
    peer = Peer()
    return Tcp(("127.0.0.1", 5760), socket.AF_INET, peer.make), peer  # type: ignore[arg-type]


def test_a_refused_connection_is_tried_less_and_less_often_and_soon_again_when_it_had_answered() -> None:
    tcp, peer = client()
    run(tcp, peer, 20.0)
    gaps = [b - a for a, b in pairwise(peer.attempts)]
    assert gaps[:3] == pytest.approx([FIRST_WAIT, 2 * FIRST_WAIT, 4 * FIRST_WAIT], abs=0.06)
    assert gaps[3:] == pytest.approx([LONGEST_WAIT] * len(gaps[3:]), abs=0.06)
    assert peer.open == 0
    peer.answers = b"frame"
    run(tcp, peer, 2.1)  # it answers, and is silent then
    assert peer.open == 1
    peer.answers = ConnectionResetError()
    broke = peer.now
    run(tcp, peer, 0.5)
    assert peer.attempts[-1] == pytest.approx(broke + FIRST_WAIT, abs=0.11)


def test_a_connection_on_which_nothing_comes_is_given_up_for_another() -> None:
    """Its peer vanished without a word, or an attempt is answered by nobody: TCP itself waits for minutes."""
    tcp, peer = client()
    peer.answers = BlockingIOError()
    run(tcp, peer, 1.0)
    assert len(peer.attempts) == 1
    run(tcp, peer, SILENT + FIRST_WAIT)
    assert len(peer.attempts) == 2 and peer.open == 1
    for _ in range(20):
        peer.answers = b"x"
        run(tcp, peer, 1.0)
    assert len(peer.attempts) == 2


def test_no_file_descriptor_left_is_no_end() -> None:
    tcp, peer = client()
    peer.connecting = errno.EMFILE
    run(tcp, peer, 5.0)
    assert not tcp.send(b"frame") and peer.open == 0
    peer.connecting, peer.answers = errno.EINPROGRESS, b"frame"
    run(tcp, peer, 3.0)
    assert peer.attempts and tcp.send(b"frame")


def test_a_frame_that_was_cut_is_sent_to_its_end_or_not_at_all() -> None:
    tcp, peer = client()
    peer.answers = b"x"
    run(tcp, peer, 0.1)
    peer.takes = 3
    assert tcp.send(b"abcdef") and tcp._unsent == b"def"
    peer.answers = ConnectionResetError()
    run(tcp, peer, 0.5)
    assert tcp._unsent == b"", "its half would spoil the next connection"


def test_the_way_for_another_process_is_another_after_each_opening() -> None:
    peer = Peer()
    tcp = Tcp(("127.0.0.1", 5760), socket.AF_INET, peer.make)  # type: ignore[arg-type]
    peer.answers = BlockingIOError()
    assert tcp.way() is None
    tcp.receive(0.0)
    first = tcp.way()
    peer.answers = ConnectionResetError()
    tcp.receive(0.1)
    assert tcp.way() is None
    peer.answers = BlockingIOError()
    tcp.receive(1.0)
    second = tcp.way()
    assert first is not None and second is not None
    assert first.descriptor == second.descriptor and first != second
