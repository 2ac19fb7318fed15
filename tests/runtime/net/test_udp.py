"""Sockets: which addresses and groups can be opened, and what is told of those that cannot."""

from __future__ import annotations

import socket
import time
from contextlib import ExitStack
from typing import Any

import pytest

from koordgen.runtime.config.settings import Network, Peer
from koordgen.runtime.net import udp
from koordgen.runtime.net.inbox import PythonInbox
from koordgen.runtime.net.transport import GROUP, CannotOpen, Transport
from koordgen.runtime.ops.set_up import open_transport
from tests.runtime.net.transports import (
    BROADCAST,
    IMPLEMENTATIONS,
    LINK_LOCAL,
    MULTICAST,
    free_ports,
    implemented,
    needs_ipv6,
    open_as,
    opened,
    settings,
)

UNICAST = Network()


def open_one(ports: list[int], network: Network = UNICAST, **changes: Any) -> Transport:
    return open_transport(settings(0, ports, network, **changes))


def groups() -> list[Network]:
    port = free_ports(1)[0]
    return [
        Network(transport="multicast", group=MULTICAST, port=port),
        Network(transport="multicast", group=MULTICAST, port=port, interface="127.0.0.1"),
        Network(transport="multicast", group=MULTICAST, port=port, interface="lo"),
        Network(transport="broadcast", group=BROADCAST, port=port),
    ]


@pytest.mark.parametrize("network", [Network(), *groups()])
def test_a_port_in_use_names_robot_and_address(network: Network) -> None:
    ports = free_ports(2)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", ports[0]))
        with pytest.raises(CannotOpen, match=rf"^127.0.0.1:{ports[0]}, the address of robot r0: the address is in use"):
            open_one(ports, network)


@pytest.mark.parametrize("network", groups())
def test_a_group_port_in_use_by_something_else(network: Network) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("", network.port))
        place = rf"^{network.group}:{network.port}, the {network.transport} group of robot r0: another program uses"
        with pytest.raises(CannotOpen, match=place):
            open_one(free_ports(2), network)


@pytest.mark.parametrize("native", IMPLEMENTATIONS)
@pytest.mark.parametrize("network", groups())
def test_robots_of_one_host_share_a_group(network: Network, native: bool) -> None:
    with ExitStack() as stack:
        transports = opened(stack, free_ports(3), network, native=native)
        transports[2].send([0, 1], b"x")
        for transport in transports[:2]:
            transport.wait(5)
            assert list(transport.receive()) == [b"x"]
        assert list(transports[2].receive()) == []


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"transport": "multicast", "group": "10.0.0.1"}, "10.0.0.1:47000, the multicast group of robot r0: not a mul"),
        ({"transport": "multicast", "group": "ff02::1"}, "not an IPv4 address"),
        ({"transport": "multicast", "group": ""}, "not an IPv4 address"),
        ({"transport": "multicast", "group": MULTICAST, "port": 0}, "not a port"),
        ({"transport": "multicast", "group": MULTICAST, "port": 65536}, "not a port"),
        ({"transport": "multicast", "group": MULTICAST, "interface": "nope9"}, "set `interface` to the address"),
        ({"transport": "multicast", "group": MULTICAST, "interface": "192.0.2.77"}, "set `interface` to the address"),
        ({"transport": "broadcast", "group": MULTICAST}, "set `transport` to multicast"),
        ({"transport": "broadcast", "group": "192.0.2.77"}, "not a broadcast address of this computer"),
    ],
)
def test_groups_that_cannot_be(changes: dict[str, Any], told: str) -> None:
    with pytest.raises(CannotOpen) as raised:
        open_one(free_ports(2), Network(**changes))
    assert told in str(raised.value)


@pytest.mark.parametrize("port", [0, -1, 65536, 99999])
@pytest.mark.parametrize("own", [True, False])
def test_ports_that_cannot_be(port: int, own: bool) -> None:
    ports = [port, *free_ports(1)] if own else [*free_ports(1), port]
    with pytest.raises(CannotOpen, match=rf"robot r{int(not own)}: 127.0.0.1:{port} is no address"):
        open_one(ports)


def test_an_address_of_another_host() -> None:
    with pytest.raises(CannotOpen, match=r"192.0.2.77:\d+, the address of robot r0: not an address of this computer"):
        open_one(free_ports(2), bind="192.0.2.77")


def test_listening_everywhere() -> None:
    ports = free_ports(2)
    transport = open_one(ports, bind="0.0.0.0")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(b"x", ("127.0.0.1", ports[0]))
    transport.wait(5)
    assert list(transport.receive()) == [b"x"]
    transport.close()


@pytest.mark.parametrize("native", IMPLEMENTATIONS)
def test_what_cannot_be_sent_is_counted_by_reason(native: bool) -> None:
    transport = open_as(settings(0, free_ports(2), UNICAST), native)
    transport.send([1], bytes(70_000))
    transport.send([1, 1], bytes(70_000))
    assert transport.troubles == {"send: EMSGSIZE": 3}
    transport.close()


@pytest.mark.parametrize("native", IMPLEMENTATIONS)
@pytest.mark.parametrize("host", [pytest.param("::1", marks=needs_ipv6), "localhost", "127.0.0.1"])
def test_every_kind_of_address(host: str, native: bool) -> None:
    check_unicast(host, native)


@pytest.mark.parametrize("native", IMPLEMENTATIONS)
@pytest.mark.skipif(not LINK_LOCAL, reason="no network interface has a link-local address")
def test_addresses_of_one_link(native: bool) -> None:
    check_unicast(LINK_LOCAL, native)


def check_unicast(host: str, native: bool) -> None:
    peers = [Peer(f"r{i}", host, port) for i, port in enumerate(free_ports(2))]
    with implemented(native):
        first, second = (udp.UnicastTransport(peers, pid) for pid in range(2))
    for source, target in ((first, second), (second, first), (first, first)):
        source.send([0 if target is first else 1], b"x")
        target.wait(5)
        assert list(target.receive()) == [b"x"]
        assert source.troubles == {}
    first.close()
    second.close()


@pytest.mark.parametrize("native", IMPLEMENTATIONS)
def test_sending_fails_alike_for_one_and_for_several(native: bool) -> None:
    """Of several, the others still get theirs."""
    ports = free_ports(3)
    first = open_as(settings(0, ports, UNICAST), native)
    second = open_as(settings(1, ports, UNICAST), native)
    first.send([2], b"nobody listens, and UDP does not tell")
    first.send([2, 2, 1], b"x")
    second.wait(5)
    assert list(second.receive()) == [b"x"]
    first.send([1, 2], bytes(70_000))
    assert first.troubles == {"send: EMSGSIZE": 2}
    first.close()
    first.send([1, 2], b"x")
    first.send([2], b"x")
    assert first.troubles == {"send: EMSGSIZE": 2, "send: EBADF": 3}
    second.close()


def test_a_group_takes_one_datagram_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[int] = []
    monkeypatch.setattr(PythonInbox, "send", lambda self, place, datagram: sent.append(place))
    ports, network = free_ports(4), groups()[0]
    transport = open_as(settings(0, ports, network), False)
    for to in ([1, 2, 3], [2, 3], [2], []):
        transport.send(to, b"x")
    assert sent == [GROUP, GROUP, 2]
    transport.close()


@pytest.mark.parametrize("native", IMPLEMENTATIONS)
def test_waiting_is_finer_than_a_millisecond(native: bool) -> None:
    transport = open_as(settings(0, free_ports(2), UNICAST), native)

    def late() -> float:
        start = time.monotonic()
        transport.wait(0.0031)
        return time.monotonic() - start - 0.0031

    # A poll alone would always be 0.9 ms late. On a loaded host nearly all waits are.
    assert any(late() < 0.0007 for _ in range(2000))
    transport.close()


def test_nothing_stays_open_after_a_failure() -> None:
    port = free_ports(1)[0]
    network = Network(transport="multicast", group=MULTICAST, port=port, interface="nope9")
    ports = free_ports(2)
    with pytest.raises(CannotOpen):
        open_one(ports, network)
    open_one(ports).close()  # its own port is free again; a socket left open would also be a ResourceWarning
