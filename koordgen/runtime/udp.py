"""UDP: unicast to the peer table of the settings, and groups (multicast, broadcast) for what goes to several."""

from __future__ import annotations

import errno
import select
import socket
import struct
import time
from collections import deque
from collections.abc import Sequence
from ipaddress import AddressValueError, IPv4Address

from koordgen.runtime.settings import Network, Peer
from koordgen.runtime.transport import MOST_AT_ONCE, CannotOpen
from koordgen.runtime.wire import LIMIT

RECEIVE_BUFFER = 1 << 20
IN_TURN = 64  # datagrams taken from one socket before another is looked at
MOST_ECHOES = 16  # own datagrams under way back from the group; more than one round sends


class UnicastTransport:
    """One socket, on the robot's own address. Raises CannotOpen."""

    def __init__(
        self, peers: Sequence[Peer], pid: int, bind: str = "", family: socket.AddressFamily = socket.AF_UNSPEC
    ) -> None:
        own = peers[pid]
        family, address = _resolve(Peer(own.name, bind or own.host, own.port), family)
        self._addresses = [_resolve(peer, family)[1] for peer in peers]
        self.troubles: dict[str, int] = {}
        self._poll = select.poll()
        self._sockets: dict[int, socket.socket] = {}
        self._own = self._listen(family, address, f"{bind or own.host}:{own.port}, where robot {own.name} listens")

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        for pid in to:
            self._send(datagram, self._addresses[pid])

    def receive(self) -> Sequence[bytes]:
        arrived: list[bytes] = []
        while len(arrived) < MOST_AT_ONCE:
            ready = self._poll.poll(0)
            if not ready:
                break
            for number, _ in ready:
                self._drain(self._sockets[number], arrived)
        return arrived

    def _drain(self, source: socket.socket, arrived: list[bytes]) -> None:
        """What waits there, until it is the turn of others."""
        receive, take = source.recv, arrived.append
        try:
            for _ in range(IN_TURN):
                take(receive(LIMIT + 1))
        except BlockingIOError:
            pass
        except OSError as error:  # an earlier send's echo, nothing about what waits
            self._count("receive", error)

    def wait(self, seconds: float, gather: float = 0.0) -> None:
        end = time.monotonic() + seconds
        # poll takes milliseconds and rounds up: the last of them is select's, or rounds would begin late.
        if seconds < 0.001 or not self._poll.poll(int(seconds * 1000)):
            rest = end - time.monotonic()
            if rest <= 0 or not select.select(tuple(self._sockets), (), (), rest)[0]:
                return
        rest = min(gather, end - time.monotonic())
        if rest > 0:
            time.sleep(rest)

    def close(self) -> None:
        for number, each in self._sockets.items():
            self._poll.unregister(number)
            each.close()
        self._sockets = {}

    def _send(self, datagram: bytes, address: tuple[str, int]) -> None:
        try:
            self._own.sendto(datagram, address)
        except OSError as error:
            self._count("send", error)

    def _listen(
        self, family: socket.AddressFamily, address: tuple[str, int], what: str, shared: bool = False
    ) -> socket.socket:
        """A socket that `receive` and `wait` look at; `shared`: other robots of this host listen there too."""
        opened = socket.socket(family, socket.SOCK_DGRAM)
        try:
            opened.setblocking(False)
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            if shared:
                opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            opened.bind(address)
        except OSError as error:
            opened.close()
            self.close()
            raise CannotOpen(f"{what}{_reason(error, shared)}") from None
        self._sockets[opened.fileno()] = opened
        self._poll.register(opened, select.POLLIN)
        return opened

    def _count(self, what: str, error: OSError) -> None:
        reason = f"{what}: {errno.errorcode.get(error.errno or 0, 'error')}"
        self.troubles[reason] = self.troubles.get(reason, 0) + 1


class GroupTransport(UnicastTransport):
    """What goes to several goes once, to a multicast group (which it does not leave the local network for) or a
    broadcast address, on a port that all robots share; what goes to one goes to it alone. Robots of one host hear each
    other too, and a robot's own datagrams, which come back to it, are dropped. IPv4 only. Raises CannotOpen."""

    def __init__(self, peers: Sequence[Peer], pid: int, bind: str, network: Network) -> None:
        multicast = network.transport == "multicast"
        place = f"{network.group}:{network.port}, the {network.transport} group of robot {peers[pid].name}"
        _check_group(network, place)
        super().__init__(peers, pid, bind, socket.AF_INET)
        self._group = (network.group, network.port)
        self._echoes: deque[bytes] = deque(maxlen=MOST_ECHOES)
        group = self._listen(socket.AF_INET, self._group, place, shared=True)
        try:
            if multicast:
                self._join(group, network.interface or self._own.getsockname()[0])
            else:
                self._own.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        except OSError as error:
            self.close()
            raise CannotOpen(
                f"{place}: {error.strerror or error}: set `interface` to the address or name of the network interface "
                "that leads to the other robots"
            ) from None

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        if len(to) > 1:
            self._echoes.append(datagram)
            self._send(datagram, self._group)
        else:
            super().send(to, datagram)

    def receive(self) -> Sequence[bytes]:
        arrived = super().receive()
        return [datagram for datagram in arrived if not self._is_echo(datagram)] if self._echoes else arrived

    def _is_echo(self, datagram: bytes) -> bool:
        """Whether it is our own: each comes back once, and its sequence number makes it unlike all others."""
        if datagram not in self._echoes:
            return False
        self._echoes.remove(datagram)
        return True

    def _join(self, group: socket.socket, interface: str) -> None:
        """Listen and send on one interface, given by its address or its name. Raises OSError."""
        try:
            address, index = IPv4Address(interface), 0
        except AddressValueError:
            address, index = IPv4Address(0), socket.if_nametoindex(interface)
        group.setsockopt(
            socket.IPPROTO_IP,
            socket.IP_ADD_MEMBERSHIP,
            struct.pack("4s4si", IPv4Address(self._group[0]).packed, address.packed, index),
        )
        own = self._own
        own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, struct.pack("4s4si", bytes(4), address.packed, index))
        own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
        own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)


def _check_group(network: Network, place: str) -> None:
    try:
        address = IPv4Address(network.group)
    except AddressValueError:
        raise CannotOpen(f"{place}: not an IPv4 address") from None
    if network.transport == "multicast" and not address.is_multicast:
        raise CannotOpen(f"{place}: not a multicast address, which are 224.0.0.0 to 239.255.255.255")
    if network.transport == "broadcast" and address.is_multicast:
        raise CannotOpen(f"{place}: a multicast address: set `transport` to multicast")
    if not 1 <= network.port <= 65535:
        raise CannotOpen(f"{place}: not a port, which are 1 to 65535")


def _reason(error: OSError, shared: bool) -> str:
    """Why a socket could not be bound, and the way out."""
    if error.errno == errno.EADDRINUSE:
        if shared:
            return ", is in use by something else: set another `port` for all robots"
        return ", is in use: does the robot's program run already?"
    if error.errno == errno.EADDRNOTAVAIL:
        if shared:
            return ", is no broadcast address of a network of this host: `ip address` lists them behind `brd`"
        return ", is no address of this host: set `bind` in its settings"
    return f": {error.strerror or error}"


def _resolve(peer: Peer, family: socket.AddressFamily) -> tuple[socket.AddressFamily, tuple[str, int]]:
    """Its address, once for all: a name server that fails later is of no concern."""
    if not 1 <= peer.port <= 65535:
        raise CannotOpen(f"robot {peer.name}: {peer.host}:{peer.port} is no address: ports are 1 to 65535")
    try:
        found = socket.getaddrinfo(peer.host, peer.port, family=family, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise CannotOpen(f"robot {peer.name}: no address for {peer.host}:{peer.port}: {error}") from None
    actual, _, _, _, address = found[0]
    return actual, (str(address[0]), int(address[1]))
