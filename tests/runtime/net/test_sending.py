"""Sending through the courier, in C and in Python: to which address, and what is told of what cannot be sent."""

from __future__ import annotations

import ctypes
import errno
import socket
import struct
import time

import pytest

from koordgen.runtime.net import courier
from koordgen.runtime.net.courier import GROUP, CompiledInbox, as_written
from koordgen.runtime.net.inbox import Inbox, PlainInbox
from tests.runtime.net.compiled.test_courier import inbox
from tests.runtime.net.transports import BODIES, LINK_LOCAL, PATIENCE, needs_ipv6


@pytest.mark.parametrize("native", BODIES)
def test_a_place_gets_what_is_sent_to_it_from_the_first_socket(native: bool) -> None:
    with inbox(native, 2) as (made, receiving, sending, _):
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


@pytest.mark.parametrize("native", BODIES)
def test_what_cannot_be_sent_is_told(native: bool) -> None:
    """By the number that a socket of Python's own raises."""
    with inbox(native) as (made, receiving, sending, troubles):
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


@pytest.mark.parametrize("native", BODIES)
def test_what_goes_to_the_group_and_fails_is_an_echo_too(native: bool) -> None:
    """The system may tell of a failure after it has given it back."""
    with inbox(native) as (made, _, sending, _):
        for place, datagram in ((GROUP, b"to all"), (0, b"to one")):
            made.address(place, ("127.255.255.255", 9))
            assert made.send(place, datagram) == errno.EACCES
            sending[0].send(datagram)
        assert list(made.receive()) == [b"to one"]


@pytest.mark.parametrize("native", BODIES)
def test_a_send_never_blocks(native: bool) -> None:
    """Shown by sockets within the host, where what was sent has to wait for its reader; a network card is too fast."""
    near, far = (socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(2))
    far.bind("")  # the system finds a name
    found = courier.COMPILED.library()
    made: Inbox
    if native:
        assert found is not None
        near.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("@ll", int(PATIENCE), 0))
        made = CompiledInbox(found, [near.fileno()], lambda number: None)  # one that would block
        written = struct.pack("=H", socket.AF_UNIX) + far.getsockname()
        found.courier_address(made.at, 0, written, len(written))
    else:
        near.setblocking(False)
        made = PlainInbox([near], lambda number: None)
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
def test_what_is_no_address_raises(address: courier.Address) -> None:
    with pytest.raises(OSError):
        as_written(address)
