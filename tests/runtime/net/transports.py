"""Fleets of transports of every kind, opened for one test on the loopback or in memory."""

from __future__ import annotations

import importlib.util
import os
import shutil
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from ipaddress import IPv6Address
from pathlib import Path
from typing import Any

import pytest

from koordgen.runtime.config.settings import Box, Network, Origin, Peer, Settings
from koordgen.runtime.native.loader import COMPILERS
from koordgen.runtime.net import inbox, socket_batch
from koordgen.runtime.net.network import Conditions, MemoryNetwork
from koordgen.runtime.net.transport import Transport
from koordgen.runtime.ops.set_up import open_transport
from koordgen.runtime.values.clock import SimulatedClock

NO_ZENOH = importlib.util.find_spec("zenoh") is None
COMPILER = next((found for name in COMPILERS if (found := shutil.which(name))), None)
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
IMPLEMENTATIONS = [pytest.param(True, marks=needs_compiler, id="c"), pytest.param(False, id="python")]  # of an inbox
needs_zenoh = pytest.mark.skipif(NO_ZENOH, reason="the package eclipse-zenoh is not installed")
_INTERFACES = [line.split() for line in Path("/proc/net/if_inet6").read_text().splitlines()] if socket.has_ipv6 else []
needs_ipv6 = pytest.mark.skipif(not _INTERFACES, reason="this host has no IPv6")
LINK_LOCAL = next(
    (f"{IPv6Address(bytes.fromhex(a[0]))}%{a[5]}" for a in _INTERFACES if a[0].startswith("fe80") and a[4] == "80"), ""
)
PATIENCE = 30.0  # seconds until a test gives up; never waited for when all is well
MULTICAST = "239.255.71.1"
BROADCAST = "127.255.255.255"


@contextmanager
def implemented(native: bool) -> Iterator[None]:
    """Open inboxes of C in this block, or of Python. Where there is a compiler, C that cannot be used is a failure."""
    if native:
        assert inbox.accelerator() == ""
        yield
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket_batch.COMPILED, "found", "not wanted")
        yield


def open_as(given: Settings, native: bool) -> Transport:
    """Open the transport that the settings name, with that implementation of an inbox."""
    with implemented(native):
        return open_transport(given)


def free_ports(n: int) -> list[int]:
    with ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(n)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [int(each.getsockname()[1]) for each in sockets]


def settings(pid: int, ports: Sequence[int], network: Network, **changes: Any) -> Settings:
    peers = tuple(Peer(f"r{i}", "127.0.0.1", port) for i, port in enumerate(ports))
    box = Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))  # type: ignore[arg-type]
    changes.setdefault("application_id", os.getpid())  # another run of these tests on this host is another fleet
    return Settings("app", f"r{pid}", pid, 0.1, peers, Origin(0.0, 0.0, 0.0), box, network=network, **changes)


class Opened:
    """`transports` by pid. `tick` lets a moment pass, where time is simulated; `inject` sends a robot something that
    no transport would: from nobody, to the address at which it hears what goes to `several` or to it alone."""

    def __init__(
        self,
        transports: list[Transport],
        inject: Callable[[int, bytes, bool], None],
        tick: Callable[[], None] = lambda: None,
    ) -> None:
        self.transports = transports
        self.inject = inject
        self.tick = tick

    def collect(self, pid: int, count: int) -> list[bytes]:
        """What arrives at a robot until there are so many, or patience ends."""
        found: list[bytes] = []
        end = time.monotonic() + PATIENCE
        while len(found) < count and time.monotonic() < end:
            self.tick()
            self.transports[pid].wait(0.05)
            found += self.transports[pid].receive()
        return found

    def is_quiet(self, pid: int) -> bool:
        """Whether nothing but a mark that it is sent now arrives; what was sent before would be there by then."""
        sender = (pid + 1) % len(self.transports)
        self.transports[sender].send([pid], b"mark")
        return self.collect(pid, 1) == [b"mark"]


def memory(stack: ExitStack, n: int) -> Opened:
    clock = SimulatedClock()
    network = MemoryNetwork(clock, 1, Conditions(delay=0.001))

    def tick() -> None:
        clock.time += 0.01

    transports: list[Transport] = [network.transport(pid) for pid in range(n)]
    return Opened(transports, lambda pid, data, several: network.send(-1, pid, data), tick)


def udp(stack: ExitStack, n: int, kind: str, native: bool) -> Opened:
    *ports, port = free_ports(n + 1)
    group = {"unicast": "", "multicast": MULTICAST, "broadcast": BROADCAST}[kind]
    network = Network(transport=kind, group=group, port=port)  # type: ignore[arg-type]
    transports = opened(stack, ports, network, native=native)
    out = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    out.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))

    def inject(pid: int, data: bytes, several: bool) -> None:
        out.sendto(data, (group, port) if several and group else ("127.0.0.1", ports[pid]))

    return Opened(transports, inject)


def zenoh(stack: ExitStack, n: int) -> Opened:
    import zenoh as package

    ports = free_ports(n)
    found = Opened(opened(stack, ports, Network(transport="zenoh")), lambda pid, data, several: None)
    config = package.Config()
    for key, value in (("scouting/multicast/enabled", "false"), ("listen/endpoints", "[]")):
        config.insert_json5(key, value)
    config.insert_json5("connect/endpoints", str([f"udp/127.0.0.1:{port}" for port in ports]))
    session = stack.enter_context(package.open(config))

    def inject(pid: int, data: bytes, several: bool) -> None:
        session.put(f"koordgen/{os.getpid()}/{'all' if several else pid}", data)

    found.inject = inject
    for pid in range(n):
        meet(found, pid, lambda pid=pid: inject(pid, b"", False))  # type: ignore[misc]
        for sender in range(n):
            if sender != pid:
                meet(found, pid, lambda s=sender, p=pid: found.transports[s].send([p], b""))  # type: ignore[misc]
                meet(found, pid, lambda s=sender: found.transports[s].send(range(n), b""))  # type: ignore[misc]
    for pid in range(n):  # what is still under way, to one and to all, comes before these
        inject(pid, b"end", False)
        found.transports[pid].send(range(n), b"all%d" % pid)
        for other in range(n):
            if other != pid:
                found.transports[pid].send([other], b"end%d" % pid)
    for pid in range(n):
        ends = {kind % sender for kind in (b"end%d", b"all%d") for sender in range(n) if sender != pid} | {b"end"}
        while ends:
            ends -= set(found.collect(pid, 1))
    return found


def meet(found: Opened, pid: int, send: Callable[[], None]) -> None:
    """Send until it is heard: Zenoh's sessions get to know one another in the background."""
    end = time.monotonic() + PATIENCE
    heard = False
    while not heard:
        assert time.monotonic() < end, "the sessions do not find each other"
        send()
        found.transports[pid].wait(0.02)
        heard = bool(found.transports[pid].receive())


def opened(stack: ExitStack, ports: Sequence[int], *networks: Network, native: bool = True) -> list[Transport]:
    """One for each port; all of one network, or each of its own."""
    transports = []
    for pid in range(len(ports)):
        transport = open_as(settings(pid, ports, networks[pid % len(networks)]), native)
        stack.callback(transport.close)
        transports.append(transport)
    return transports
