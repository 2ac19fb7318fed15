"""Zenoh: endpoints, hops, and what is told when it cannot be used."""

from __future__ import annotations

import socket
import sys
from contextlib import ExitStack

import pytest

from koordgen.runtime.config.settings import Network
from koordgen.runtime.net.transport import CannotOpen
from koordgen.runtime.ops.set_up import open_transport
from tests.runtime.net.transports import Opened, free_ports, meet, needs_zenoh, opened, settings


def test_without_the_package_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)
    monkeypatch.delitem(sys.modules, "koordgen.runtime.net.zenoh_transport", raising=False)
    with pytest.raises(CannotOpen, match=r"robot r0: transport zenoh needs a package .* pip install 'eclipse-zenoh"):
        open_transport(settings(0, free_ports(2), Network(transport="zenoh")))


def test_unicast_does_not_load_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)
    open_transport(settings(0, free_ports(2), Network())).close()


@needs_zenoh
def test_a_port_in_use_names_robot_and_address() -> None:
    ports = free_ports(2)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", ports[0]))
        with pytest.raises(CannotOpen, match=rf"^zenoh of robot r0 \(127.0.0.1:{ports[0]}\): .* already in use"):
            open_transport(settings(0, ports, Network(transport="zenoh")))


@needs_zenoh
@pytest.mark.parametrize("network", [
    Network(transport="zenoh", listen=("nowhere",)),
    Network(transport="zenoh", connect=("pigeon/roof:1",), listen=()),
    Network(transport="zenoh", mode="client", connect=("tcp/127.0.0.1:1",)),
])  # fmt: skip
def test_endpoints_that_cannot_be(network: Network) -> None:
    with pytest.raises(CannotOpen, match=r"^zenoh of robot r0"):
        open_transport(settings(0, free_ports(2), network)).close()


@needs_zenoh
def test_routers_pass_on_what_goes_further() -> None:
    """Robots 0 and 2 have links to robot 1 only."""
    ports = free_ports(3)
    middle = (f"udp/127.0.0.1:{ports[1]}",)
    with ExitStack() as stack:
        networks = [Network(transport="zenoh", mode="router", connect=connect) for connect in (middle, (), middle)]
        net = Opened(opened(stack, ports, *networks), lambda pid, data, several: None)
        meet(net, 2, lambda: net.transports[0].send([2], b"x"))
        meet(net, 0, lambda: net.transports[2].send([0, 1], b"x"))


@needs_zenoh
def test_a_client_needs_only_its_router() -> None:
    ports = free_ports(3)
    router = Network(transport="zenoh", mode="router", connect=())
    client = Network(transport="zenoh", mode="client", connect=(f"udp/127.0.0.1:{ports[0]}",))
    with ExitStack() as stack:
        net = Opened(opened(stack, ports, router, client, client), lambda pid, data, several: None)
        meet(net, 2, lambda: net.transports[1].send([2], b"x"))
        meet(net, 1, lambda: net.transports[0].send([1, 2], b"x"))


@needs_zenoh
def test_fleets_are_told_apart_by_their_application_id() -> None:
    ports = free_ports(2)
    network = Network(transport="zenoh")
    with ExitStack() as stack:
        ours, theirs = (open_transport(settings(pid, ports, network, application_id=pid)) for pid in range(2))
        stack.callback(ours.close)
        stack.callback(theirs.close)
        for _ in range(20):
            theirs.send([0], b"x")
            ours.wait(0.02)
        assert ours.receive() == []
