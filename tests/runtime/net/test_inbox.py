"""Inbox: the same tests for its two implementations, and what only the one in C does."""

from __future__ import annotations

import ctypes
import errno
import math
import os
import random
import resource
import signal
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import pytest

from koordgen.runtime.net import inbox, socket_batch
from koordgen.runtime.net.inbox import Inbox, PythonInbox
from koordgen.runtime.net.socket_batch import CompiledInbox, as_written
from koordgen.runtime.net.transport import GROUP, IN_TURN, LARGEST, MOST_AT_ONCE, MOST_ECHOES, Address
from koordgen.runtime.net.wire import LIMIT, MAX_ROBOTS
from tests.runtime.net.transports import (
    COMPILER,
    IMPLEMENTATIONS,
    LINK_LOCAL,
    PATIENCE,
    implemented,
    needs_compiler,
    needs_ipv6,
)

Opened = tuple[Inbox, list[socket.socket], list[socket.socket], list[int]]


@contextmanager
def opened(native: bool, count: int = 1) -> Iterator[Opened]:
    """Yield an inbox with so many sockets, those sockets, one that is connected to each, and the errors that the inbox
    reports. What goes to the group does not come back."""
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
    with implemented(native):
        made = inbox.open_inbox(receiving, troubles.append, shares=False)
    assert isinstance(made, CompiledInbox if native else PythonInbox)
    made.address(GROUP, sink.getsockname())
    try:
        yield made, receiving, sending, troubles
    finally:
        made.close()
        for each in (*receiving, *sending, sink):
            each.close()


@contextmanager
def in_c() -> Iterator[tuple[CompiledInbox, list[socket.socket]]]:
    with opened(True) as (made, _, sending, _):
        assert isinstance(made, CompiledInbox)
        yield made, sending


def test_limits_fit_the_wire_format() -> None:
    assert (LARGEST, GROUP) == (LIMIT + 1, MAX_ROBOTS)


@needs_compiler
def test_where_there_is_a_compiler_the_inbox_is_in_c() -> None:
    assert inbox.accelerator() == ""


@pytest.mark.parametrize("native", IMPLEMENTATIONS)
class TestInbox:
    def test_datagrams_are_received_in_order_cut_and_without_echoes(self, native: bool) -> None:
        """Of any lengths, at two sockets; the order is that of each socket."""
        chance = random.Random(2)
        for _ in range(20):
            own = [chance.randbytes(chance.choice([16, 17, 300, 1200, 1201, 1300])) for _ in range(MOST_ECHOES)]
            sent: list[list[bytes]] = [[], []]
            with opened(native, 2) as (made, _, sending, troubles):
                for datagram in own:
                    made.send(GROUP, datagram)
                waiting = [datagram for datagram in own if len(datagram) <= LARGEST]
                for i in [chance.randrange(2) for _ in range(chance.randint(0, 150))]:
                    others = [chance.randbytes(chance.randint(0, 1500)), b"", b"\0" * 1201]
                    datagram = chance.choice([chance.choice(own), *others])
                    sending[i].send(datagram)
                    sent[i].append(datagram)
                made.wait(0.0, 500, 0.0)
                found = made.receive()
            assert troubles == []
            expected = [datagram[:LARGEST] for datagram in read_in_turn(sent)]
            for datagram in waiting:
                if datagram in expected:
                    expected.remove(datagram)
            assert found == expected

    def test_an_echo_is_dropped_once_and_only_of_the_last_sent(self, native: bool) -> None:
        with opened(native) as (made, _, sending, _):
            for i in range(MOST_ECHOES + 1):
                made.send(GROUP, b"%d, and its MAC of 16" % i)
            for i in (0, 5, 5, MOST_ECHOES):
                sending[0].send(b"%d, and its MAC of 16" % i)
            sending[0].send(b"5, like its MAC of 16")
            assert made.receive() == [b"%d, and its MAC of 16" % i for i in (0, 5)] + [b"5, like its MAC of 16"]

    def test_echoes_alone_are_nothing(self, native: bool) -> None:
        with opened(native) as (made, _, sending, _):
            for echoes, others in ((1, 0), (2, 0), (2, 3), (0, 1), (0, 0)):
                for i in range(echoes):
                    made.send(GROUP, b"echo %d" % i)
                    sending[0].send(b"echo %d" % i)
                for _ in range(others):
                    sending[0].send(b"")
                made.wait(0.0)
                taken = made.receive()
                assert (bool(taken), len(taken), list(taken)) == (others > 0, others, [b""] * others)

    def test_closed_what_was_not_taken_is_gone(self, native: bool) -> None:
        with opened(native) as (made, _, sending, _):
            sending[0].send(b"taken from the socket")
            made.wait(PATIENCE)
            sending[0].send(b"not yet")
            made.close()
            for _ in range(2):
                assert made.receive() == []
                made.wait(0.0, 2, 0.0)

    def test_a_flood_at_one_socket_leaves_the_other_its_turn(self, native: bool) -> None:
        with opened(native, 2) as (made, _, sending, _):
            for i in range(1500):
                sending[0].send(b"%d" % i)
            sending[1].send(b"other")
            taken = made.receive()
            assert len(taken) == MOST_AT_ONCE
            assert taken.index(b"other") == IN_TURN
            assert len(made.receive()) == 1501 - MOST_AT_ONCE

    def test_errors_are_told_and_end_nothing(self, native: bool) -> None:
        with opened(native) as (made, receiving, sending, troubles):
            receiving[0].connect(("127.0.0.1", 9))  # nobody is there: the echo of what is sent is an error
            receiving[0].send(b"x")
            made.wait(PATIENCE)
            assert made.receive() == []
            receiving[0].connect(sending[0].getsockname())
            sending[0].send(b"still")
            made.wait(PATIENCE)
            assert made.receive() == [b"still"]
            assert troubles == [errno.ECONNREFUSED]

    def test_waiting_for_no_time_looks(self, native: bool) -> None:
        with opened(native) as (made, _, sending, _):
            for _ in range(3):
                made.wait(0.0)
                assert made.receive() == []
                sending[0].send(b"x")
                made.wait(0.0)
                assert made.receive() == [b"x"]

    def test_a_signal_is_seen_while_waiting(self, native: bool) -> None:
        seen: list[int] = []

        def take(number: int, frame: FrameType | None) -> None:
            seen.append(number)

        before = signal.signal(signal.SIGALRM, take)
        try:
            with opened(native) as (made, _, sending, _):
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

    def test_letting_several_come_costs_little(self, native: bool) -> None:
        with opened(native) as (made, _, _, _):
            began = time.process_time()
            made.wait(0.3, 9, 0.3)
            assert time.process_time() - began < 0.15

    def test_a_place_gets_what_is_sent_to_it_from_the_first_socket(self, native: bool) -> None:
        with opened(native, 2) as (made, receiving, sending, _):
            for place, at in ((0, 0), (1, 1), (GROUP - 1, 0), (GROUP, 1)):
                made.address(place, sending[at].getsockname())
                sending[at].connect(receiving[0].getsockname())  # it hears nobody else
                sending[at].settimeout(PATIENCE)
                for datagram in (b"", b"\0", b"x\0y", bytes(range(256)) * 5):
                    assert made.send(place, datagram) == 0
                    assert sending[at].recv(2000) == datagram
            made.address(0, sending[1].getsockname())
            made.send(0, b"moved")
            assert sending[1].recv(2000) == b"moved"

    def test_what_cannot_be_sent_is_told(self, native: bool) -> None:
        """By the number that a socket of Python's own raises."""
        with opened(native) as (made, receiving, sending, troubles):
            made.address(0, sending[0].getsockname())
            assert made.send(0, bytes(70_000)) == errno.EMSGSIZE
            assert made.send(1, b"x") == made.send(GROUP - 1, b"x") == errno.EDESTADDRREQ
            for place, host in ((2, "255.255.255.255"), (3, "127.255.255.255"), (4, "192.0.2.1"), (5, "240.0.0.1")):
                with pytest.raises(OSError) as raised:
                    receiving[0].sendto(b"x", (host, 9))
                made.address(place, (host, 9))
                assert made.send(place, b"x") == raised.value.errno
            made.address(1, ("127.0.0.1", 9))  # nobody is there
            receiving[0].connect(("127.0.0.1", 9))
            assert [made.send(1, b"x"), made.send(1, b"x"), made.send(0, b"x")] == [0, errno.ECONNREFUSED, 0]
            made.close()
            assert made.send(0, b"x") == made.send(7, b"x") == errno.EBADF
            assert troubles == []

    def test_what_goes_to_the_group_and_fails_is_an_echo_too(self, native: bool) -> None:
        """The system may tell of a failure after it has given it back."""
        with opened(native) as (made, _, sending, _):
            for place, datagram in ((GROUP, b"to all"), (0, b"to one")):
                made.address(place, ("127.255.255.255", 9))
                assert made.send(place, datagram) == errno.EACCES
                sending[0].send(datagram)
            assert made.receive() == [b"to one"]

    def test_a_send_never_blocks(self, native: bool) -> None:
        """Shown by sockets within the host, where a datagram waits for its reader; a network card is too fast."""
        near, far = (socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(2))
        far.bind("")  # the system finds a name
        made: Inbox
        if native:
            found = socket_batch.COMPILED.library()
            assert found is not None
            near.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("@ll", int(PATIENCE), 0))
            made = CompiledInbox(found, [near], lambda number: None)  # one that would block
            written = struct.pack("=H", socket.AF_UNIX) + far.getsockname()
            found.socket_batch_address(made._at, 0, written, len(written))
        else:
            near.setblocking(False)
            made = PythonInbox([near], lambda number: None)
            made.address(0, far.getsockname())
        told: list[int] = []
        began = time.monotonic()
        while not told or (told[-1] == 0 and len(told) < 10_000):
            told.append(made.send(0, b"x"))
        assert time.monotonic() - began < PATIENCE / 2
        assert told[-1] == errno.EAGAIN and len(told) > 1
        assert far.recv(9) == b"x"
        assert made.send(0, b"there is room again") == 0
        made.close()
        near.close()
        far.close()


def read_in_turn(sent: list[list[bytes]]) -> list[bytes]:
    """Return what waits at several sockets in the order in which an inbox reads it."""
    rest, found = [list(each) for each in sent], list[bytes]()
    while any(rest):
        for each in rest:
            found += each[:IN_TURN]
            del each[:IN_TURN]
    return found


@needs_compiler
class TestInC:
    """Adaptive polling, the pace of a gathering, and what ctypes is told."""

    def test_spinning_that_fails_backs_off(self) -> None:
        with in_c() as (made, _):
            for _ in range(199):
                made.wait(0.0002, 1, 0.0002)
            # the 1st, and those after 1, 2, 4, 8, 16, 32 and 64 that did not try; the 200th would be the next
            assert (made.shown.spins, made.shown.failed) == (8, 8)

    def test_spinning_that_succeeds_goes_on(self) -> None:
        """Spinning counts as successful also if the datagram is there at the first look."""
        with in_c() as (made, sending):
            for i in range(1, 4):
                made.wait(0.0002, 1, 0.0002)  # fails
                for _ in range(50):
                    sending[0].send(b"x")
                    made.wait(PATIENCE, 1, 0.0002)
                    assert made.receive() == [b"x"]
                assert made.shown.failed == i
            assert made.shown.spins == 3 * 50

    def test_an_idle_robot_costs_little(self) -> None:
        with in_c() as (made, _):
            began, end = time.process_time(), time.monotonic() + 1.0
            while time.monotonic() < end:
                made.wait(0.01, 1, 0.002)
                made.receive()
            assert time.process_time() - began < 0.05

    def test_gathering_sleeps_as_long_as_the_missing_take(self) -> None:
        with in_c() as (made, _):
            made.shown.pace = 100_000
            before = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
            made.wait(0.2, 11, 0.2)
            assert 100 < resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - before < 260  # 200 of 1 ms, if not late

    def test_the_pace_is_that_of_what_comes(self) -> None:
        """The pace follows the arrival times, also if the inbox woke after them, and stays within bounds."""
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

    def test_what_comes_while_the_time_runs_out_is_left_for_the_next_call(self) -> None:
        """Its robot has something to do then. But of two waits one looks."""
        with in_c() as (made, sending):
            child = os.fork()
            if not child:  # it is stopped while it waits, and goes on after the wait should have ended
                made.wait(0.0002)  # spins in vain; the next one does not
                made.wait(0.2)
                found = [made.receive()]
                made.wait(1e-9)
                found.append(made.receive())
                os._exit(found != [[], [b"x"]])
            time.sleep(0.1)
            os.kill(child, signal.SIGSTOP)
            sending[0].send(b"x")
            time.sleep(0.3)
            os.kill(child, signal.SIGCONT)
            assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0

    @pytest.mark.slow
    def test_sanitizers_find_nothing(self, tmp_path: Path) -> None:
        """Random datagrams through socket_batch.c under the address and undefined-behaviour sanitizers."""
        program, driver = tmp_path / "driver", Path(__file__).with_name("socket_batch_driver.c")
        own = [flag for flag in socket_batch.FLAGS if flag not in ("-shared", "-fPIC", "-O2")]
        strict = ["-O1", "-g", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror"]
        sanitizers = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
        files = ["-I", str(socket_batch.SOURCE.parent), "-o", str(program), str(driver)]
        subprocess.run([str(COMPILER), *own, *strict, *sanitizers, *files], check=True)
        for seed in ("1", "2"):
            subprocess.run([program, "100000", seed], check=True, timeout=300)


@contextmanager
def gathering(count: int, pause: float) -> Iterator[tuple[CompiledInbox, Callable[[], None]]]:
    """An inbox, and what gathers so many datagrams in it that come one after the other."""
    begin, done = threading.Semaphore(0), threading.Event()
    with in_c() as (made, sending):

        def send() -> None:
            while begin.acquire() and not done.is_set():
                for i in range(count):
                    time.sleep(pause)
                    sending[0].send(b"%d" % i)

        def gather() -> None:
            begin.release()
            lacking = count
            while lacking > 0:
                made.wait(PATIENCE, lacking, PATIENCE)
                lacking -= len(made.receive())

        thread = threading.Thread(target=send)
        thread.start()
        try:
            yield made, gather
        finally:
            done.set()
            begin.release()
            thread.join()


@pytest.mark.parametrize(("seconds", "told"), [
    (0.0, 0), (-1.0, 0), (math.nan, 0), (5e-324, 1), (1.5e-6, 2), (0.01, 10_001),
    (1999.9, 1_999_900_001), (2000.0, 2_000_000_000), (1e300, 2_000_000_000), (math.inf, 2_000_000_000),
])  # fmt: skip
def test_no_wait_is_shorter_than_asked_or_longer_than_can_be_told(seconds: float, told: int) -> None:
    assert socket_batch._microseconds(seconds) == told < 2**31


def written_by_the_system(opened: socket.socket) -> bytes:
    room, size = ctypes.create_string_buffer(100), ctypes.c_uint32(100)
    assert ctypes.CDLL(None).getsockname(opened.fileno(), room, ctypes.byref(size)) == 0
    return room.raw[: size.value]


@pytest.mark.parametrize("family", [socket.AF_INET, pytest.param(socket.AF_INET6, marks=needs_ipv6)])
def test_addresses_are_written_as_the_system_writes_them(family: socket.AddressFamily) -> None:
    with socket.socket(family, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1" if family == socket.AF_INET else "::1", 0))
        assert as_written(opened.getsockname()) == written_by_the_system(opened)


@pytest.mark.skipif(not LINK_LOCAL, reason="no network interface has a link-local address")
def test_an_address_of_one_link_names_it() -> None:
    """Its flow is the sender's own, so no socket tells it."""
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as opened:
        opened.bind(socket.getaddrinfo(LINK_LOCAL, 0, type=socket.SOCK_DGRAM)[0][4])
        host, port, flow, scope = opened.getsockname()
        assert scope > 0
        assert as_written((host, port, flow, scope)) == written_by_the_system(opened)
        assert as_written((host, port, 0x12345, scope))[4:8] == bytes.fromhex("00012345")


@pytest.mark.parametrize("address", [("r1", 9), ("", 9), ("127.1", 9), ("::g", 9, 0, 0), ("127.0.0.1", 9, 0, 0)])
def test_what_is_no_address_raises(address: Address) -> None:
    with pytest.raises(OSError):
        as_written(address)
