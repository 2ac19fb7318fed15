"""The courier in C against the same in Python, and what only C does: adaptive spinning."""

from __future__ import annotations

import errno
import math
import os
import random
import resource
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import pytest

from koordgen.runtime.net import courier
from koordgen.runtime.net.courier import GROUP, MOST_AT_ONCE, CompiledInbox
from koordgen.runtime.net.inbox import Inbox, PlainInbox
from koordgen.runtime.net.seal import MEMORY, unseal_all
from koordgen.runtime.net.wire import LIMIT, MAX_ROBOTS, Head, Piece, decode, encode, opened
from tests.runtime.net.compiled import sanitized
from tests.runtime.net.compiled.sanitized import needs_compiler
from tests.runtime.net.transports import BODIES, PATIENCE, needs_courier

Pair = tuple[Inbox, list[socket.socket], list[socket.socket], list[int]]


@contextmanager
def inbox(native: bool, count: int = 1) -> Iterator[Pair]:
    """An inbox with so many sockets, those sockets, one that is connected to each, and the errors that it told. What
    goes to the group does not come back."""
    receiving = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    sending = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    troubles: list[int] = []
    for source, target in zip(sending, receiving, strict=True):
        target.bind(("127.0.0.1", 0))
        target.setblocking(False)
        target.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        source.connect(target.getsockname())
    sink = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sink.bind(("127.0.0.1", 0))
    found = courier.COMPILED.library()
    made: Inbox = PlainInbox(receiving, troubles.append)
    if native:
        assert found is not None
        made = CompiledInbox(found, [s.fileno() for s in receiving], troubles.append)
    made.address(GROUP, sink.getsockname())
    try:
        yield made, receiving, sending, troubles
    finally:
        made.close()
        for each in (*receiving, *sending, sink):
            each.close()


def test_the_largest_datagram_is_one_more_than_the_limit() -> None:
    assert courier.LARGEST == LIMIT + 1


@pytest.mark.parametrize(("seconds", "told"), [
    (0.0, 0), (-1.0, 0), (math.nan, 0), (5e-324, 1), (1.5e-6, 2), (0.01, 10_001),
    (1999.9, 1_999_900_001), (2000.0, 2_000_000_000), (1e300, 2_000_000_000), (math.inf, 2_000_000_000),
])  # fmt: skip
def test_no_wait_is_shorter_than_asked_or_longer_than_can_be_told(seconds: float, told: int) -> None:
    assert courier._microseconds(seconds) == told < 2**31


def test_each_robot_has_its_place() -> None:
    assert GROUP == MAX_ROBOTS


def test_both_bodies_take_the_same() -> None:
    """What arrives at two sockets, with own echoes among it, in any lengths; in the order of each socket."""
    chance = random.Random(2)
    for _ in range(20):
        own = [chance.randbytes(chance.choice([0, 1, 15, 16, 17, 300, 1200, 1201, 1300])) for _ in range(18)]
        sent = [
            (i, chance.choice([chance.choice(own), chance.randbytes(chance.randint(0, 1500)), b"", b"\0" * 1201]))
            for i in [chance.randrange(2) for _ in range(chance.randint(0, 150))]
        ]
        found = []
        for native in (True, False) if courier.COMPILED.library() else (False,):
            with inbox(native, 2) as (made, _, sending, troubles):
                for datagram in own:
                    made.send(GROUP, datagram)
                for i, datagram in sent:
                    sending[i].send(datagram)
                made.wait(0.0, 500, 0.0)
                found.append((list(made.receive()), troubles))
        assert found[0] == found[-1]
        assert len(found[0][0]) <= len(sent)


@pytest.mark.parametrize("native", BODIES)
def test_an_echo_is_dropped_once_and_only_of_the_last_sent(native: bool) -> None:
    with inbox(native) as (made, _, sending, _):
        for i in range(courier.MOST_ECHOES + 1):
            made.send(GROUP, b"%d, and its MAC of 16" % i)
        for i in (0, 5, 5, courier.MOST_ECHOES):
            sending[0].send(b"%d, and its MAC of 16" % i)
        sending[0].send(b"5, like its MAC of 16")
        assert list(made.receive()) == [b"%d, and its MAC of 16" % i for i in (0, 5)] + [b"5, like its MAC of 16"]


@pytest.mark.parametrize("native", BODIES)
def test_echoes_alone_are_nothing(native: bool) -> None:
    with inbox(native) as (made, _, sending, _):
        for echoes, others in ((1, 0), (2, 0), (2, 3), (0, 1), (0, 0)):
            for i in range(echoes):
                made.send(GROUP, b"echo %d" % i)
                sending[0].send(b"echo %d" % i)
            for _ in range(others):
                sending[0].send(b"")
            made.wait(0.0)
            taken = made.receive()
            assert (bool(taken), len(taken), list(taken)) == (others > 0, others, [b""] * others)


@pytest.mark.parametrize("native", BODIES)
def test_closed_what_was_not_taken_is_gone(native: bool) -> None:
    with inbox(native) as (made, _, sending, _):
        sending[0].send(b"taken from the socket")
        made.wait(PATIENCE)
        sending[0].send(b"not yet")
        made.close()
        for _ in range(2):
            assert list(made.receive()) == []
            made.wait(0.0, 2, 0.0)


@pytest.mark.parametrize("native", BODIES)
def test_a_flood_at_one_socket_leaves_the_other_its_turn(native: bool) -> None:
    with inbox(native, 2) as (made, _, sending, _):
        for i in range(1500):
            sending[0].send(b"%d" % i)
        sending[1].send(b"other")
        taken = list(made.receive())
        assert len(taken) == MOST_AT_ONCE
        assert taken.index(b"other") == courier.IN_TURN
        assert len(made.receive()) == 1501 - MOST_AT_ONCE


@pytest.mark.parametrize("native", BODIES)
def test_errors_are_told_and_end_nothing(native: bool) -> None:
    with inbox(native) as (made, receiving, sending, troubles):
        receiving[0].connect(("127.0.0.1", 9))  # nobody is there: the echo of what is sent is an error
        receiving[0].send(b"x")
        made.wait(PATIENCE)
        assert list(made.receive()) == []
        receiving[0].connect(sending[0].getsockname())
        sending[0].send(b"still")
        made.wait(PATIENCE)
        assert list(made.receive()) == [b"still"]
        assert troubles == [errno.ECONNREFUSED]


@pytest.mark.parametrize("native", BODIES)
def test_waiting_for_no_time_looks(native: bool) -> None:
    with inbox(native) as (made, _, sending, _):
        for _ in range(3):
            made.wait(0.0)
            assert list(made.receive()) == []
            sending[0].send(b"x")
            made.wait(0.0)
            assert list(made.receive()) == [b"x"]


@pytest.mark.parametrize("native", BODIES)
def test_a_signal_is_seen_while_waiting(native: bool) -> None:
    seen: list[int] = []

    def take(number: int, frame: FrameType | None) -> None:
        seen.append(number)

    before = signal.signal(signal.SIGALRM, take)
    try:
        with inbox(native) as (made, _, sending, _):
            for datagram, expected, gather in ((None, 1, 0.0), (b"one", 2, PATIENCE), (b"", 9, PATIENCE)):
                if datagram is not None:
                    sending[0].send(datagram)
                signal.setitimer(signal.ITIMER_REAL, 0.01, 0.05)  # again: the first may come before it waits
                start = time.monotonic()
                made.wait(PATIENCE if native else 0.05, expected, gather)  # Python's own goes on after the handler
                assert time.monotonic() - start < PATIENCE / 2
                signal.setitimer(signal.ITIMER_REAL, 0.0)
                assert seen
                seen.clear()
                made.receive()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@needs_courier
def test_spinning_that_fails_backs_off() -> None:
    with inbox(True) as (made, _, _, _):
        assert isinstance(made, CompiledInbox)
        for _ in range(199):
            made.wait(0.0002, 1, 0.0002)
        # the 1st, and those after 1, 2, 4, 8, 16, 32 and 64 that did not try; the 200th would be the next
        assert (made.shown.spins, made.shown.failed) == (8, 8)


@needs_courier
def test_spinning_that_succeeds_goes_on() -> None:
    """What is there already when it looks the first time is found by spinning too."""
    with inbox(True) as (made, _, sending, _):
        assert isinstance(made, CompiledInbox)
        for i in range(1, 4):
            made.wait(0.0002, 1, 0.0002)  # fails
            for _ in range(50):
                sending[0].send(b"x")
                made.wait(PATIENCE, 1, 0.0002)
                assert list(made.receive()) == [b"x"]
            assert made.shown.failed == i
        assert made.shown.spins == 3 * 50


@needs_courier
def test_an_idle_robot_costs_little() -> None:
    with inbox(True) as (made, _, _, _):
        began, end = time.process_time(), time.monotonic() + 1.0
        while time.monotonic() < end:
            made.wait(0.01, 1, 0.002)
            made.receive()
        assert time.process_time() - began < 0.05


@pytest.mark.parametrize("native", BODIES)
def test_letting_several_come_costs_little(native: bool) -> None:
    with inbox(native) as (made, _, _, _):
        began = time.process_time()
        made.wait(0.3, 9, 0.3)
        assert time.process_time() - began < 0.15


@needs_courier
def test_gathering_sleeps_as_long_as_the_missing_take() -> None:
    with inbox(True) as (made, _, _, _):
        assert isinstance(made, CompiledInbox)
        made.shown.pace = 100_000
        before = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
        made.wait(0.2, 11, 0.2)
        assert 100 < resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - before < 260  # 200 of 1 ms, if not late


@contextmanager
def gathering(count: int, pause: float) -> Iterator[tuple[CompiledInbox, Callable[[], None]]]:
    """An inbox, and what gathers so many datagrams in it that come one after the other."""
    begin, done = threading.Semaphore(0), threading.Event()
    with inbox(True) as (made, _, sending, _):
        assert isinstance(made, CompiledInbox)
        found = made

        def send() -> None:
            while begin.acquire() and not done.is_set():
                for i in range(count):
                    time.sleep(pause)
                    sending[0].send(b"%d" % i)

        def gather() -> None:
            begin.release()
            lacking = count
            while lacking > 0:
                found.wait(PATIENCE, lacking, PATIENCE)
                lacking -= len(found.receive())

        thread = threading.Thread(target=send)
        thread.start()
        try:
            yield found, gather
        finally:
            done.set()
            begin.release()
            thread.join()


@needs_courier
def test_the_pace_is_that_of_what_comes() -> None:
    """Of what comes, not of what is seen: who has slept too long finds so. It stays within its bounds."""
    with gathering(8, 0.001) as (made, gather):
        for _ in range(30):
            gather()
        slow = made.shown.pace
    assert slow == 150_000
    with gathering(8, 0.0) as (made, gather):
        made.shown.pace = slow
        for _ in range(500):
            gather()
            if made.shown.pace < 50_000:
                break
        assert 5_000 <= made.shown.pace < 50_000


@needs_courier
def test_what_comes_while_the_time_runs_out_is_left_for_the_next_call() -> None:
    """Its robot has something to do then. But of two waits one looks."""
    with inbox(True) as (made, _, sending, _):
        child = os.fork()
        if not child:  # stopped while it waits, it wakes after the end
            made.wait(0.0002)  # spins in vain; the next one does not
            made.wait(0.2)
            found = [list(made.receive())]
            made.wait(1e-9)
            found.append(list(made.receive()))
            os._exit(found != [[], [b"x"]])
        time.sleep(0.1)
        os.kill(child, signal.SIGSTOP)
        sending[0].send(b"x")
        time.sleep(0.3)
        os.kill(child, signal.SIGCONT)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def damaged(datagram: bytes, chance: random.Random) -> bytes:
    """As it is, cut, longer, with a bit flipped, or something else altogether."""
    at = chance.randrange(len(datagram))
    return chance.choice(
        [
            datagram,
            datagram[:at],
            datagram[at:],
            datagram + chance.randbytes(chance.randint(1, 400)),
            datagram[:at] + bytes([datagram[at] ^ 1 << chance.randrange(8)]) + datagram[at + 1 :],
            chance.randbytes(at),
            b"",
        ]
    )


def test_what_is_damaged_is_told_alike() -> None:
    """From the sockets through the MACs to the messages, and as one datagram at a time is decoded."""
    chance, key = random.Random(3), bytes(range(32))
    token = bytes(8)
    for turn in range(30):
        sent = []
        for sequence in range(chance.randint(1, 60)):
            head = Head(1, token, token, 0, token, token, sequence, turn, None, ())
            message = Piece(head, 0, 0, 1, token, 0, 1, chance.randbytes(chance.randint(0, 1100)))
            sent.append(damaged(encode(message, chance.choice([key, key, None])), chance))
        expected = [decode(datagram, key) for datagram in sent]
        for native in (True, False) if courier.COMPILED.library() else (False,):
            with inbox(native) as (made, _, sending, _):
                for datagram in sent:
                    sending[0].send(datagram)
                taken = list(made.receive())
            payloads = unseal_all(key, MEMORY, taken)
            assert [opened(len(d), p) for d, p in zip(taken, payloads, strict=True)] == expected


@pytest.mark.slow
@needs_compiler
def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    sanitized.run("courier_driver.c", courier.SOURCE, courier.FLAGS, tmp_path, 100_000)
