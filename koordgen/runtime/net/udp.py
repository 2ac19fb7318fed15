"""UDP transports: unicast to the peers in the settings, and groups (multicast or broadcast)."""

from __future__ import annotations

import errno
import os
import socket
import struct
from collections.abc import Sequence
from ipaddress import AddressValueError, IPv4Address
from typing import cast

from koordgen.runtime.config.settings import Network, Peer
from koordgen.runtime.net.inbox import open_inbox
from koordgen.runtime.net.transport import FURTHER, GROUP, PLACES, Address, CannotOpen

RECEIVE_BUFFER = 1 << 20


class UnicastTransport:
    """Unicast transport with one socket on the robot's own address. Raises CannotOpen."""

    def __init__(
        self,
        peers: Sequence[Peer],
        pid: int,
        bind: str = "",
        family: socket.AddressFamily = socket.AF_UNSPEC,
    ) -> None:
        own = peers[pid]
        family, address = _resolve(Peer(own.name, bind or own.host, own.port), family)
        self._addresses = dict(enumerate(_resolve(peer, family)[1] for peer in peers))  # pid -> address
        self._further: dict[int, list[int]] = {}  # pid of a robot that is a fleet -> places of its further addresses
        self._add_further(peers, pid, family)
        self.troubles: dict[str, int] = {}
        hosts = [address[0] for address in self._addresses.values()]
        self._shares = hosts.count(hosts[pid]) > 1  # other robots share this computer
        self._sockets: list[socket.socket] = []
        self._own = self._listen(family, address, f"{bind or own.host}:{own.port}, the address of robot {own.name}")
        self._open_inbox()

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        for pid in to:
            if error := self._inbox.send(pid, datagram):
                self._count("send", error)
            if self._further:
                for place in self._further.get(pid, ()):
                    if error := self._inbox.send(place, datagram):
                        self._count("send", error)
        if self._shares and len(to) > 1:
            os.sched_yield()  # other robots on this core also have to send

    def close(self) -> None:
        self._inbox.close()
        self._close_sockets()

    def _add_further(self, peers: Sequence[Peer], own: int, family: socket.AddressFamily) -> None:
        """Look up the further addresses of the other robots. Raises CannotOpen."""
        place = FURTHER
        for pid, peer in enumerate(peers):
            for address in peer.also if pid != own else ():
                if place == PLACES:
                    raise CannotOpen(f"robot {peer.name}: the fleet has more than {PLACES - FURTHER} further addresses")
                self._addresses[place] = _resolve(Peer(peer.name, address.host, address.port), family)[1]
                self._further.setdefault(pid, []).append(place)
                place += 1

    def _open_inbox(self) -> None:
        """Open one inbox for all sockets. It sends from the first socket, which has the robot's address."""
        self._inbox = open_inbox(self._sockets, self._received_badly, self._shares)
        for place, address in self._addresses.items():
            self._inbox.address(place, address)
        self.wait, self.receive = self._inbox.wait, self._inbox.receive

    def _listen(self, family: socket.AddressFamily, address: Address, what: str, shared: bool = False) -> socket.socket:
        """Open a socket for the inbox, bound to `address`.

        what: description of the address, for messages.
        shared: other robots on this computer listen on the same address.
        """
        opened = socket.socket(family, socket.SOCK_DGRAM)
        try:
            opened.setblocking(False)
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            if shared:
                opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            opened.bind(address)
        except OSError as error:
            opened.close()
            self._close_sockets()
            raise CannotOpen(f"{what}{_reason(error, shared)}") from None
        self._sockets.append(opened)
        return opened

    def _close_sockets(self) -> None:
        for each in self._sockets:
            each.close()
        self._sockets = []

    def _received_badly(self, number: int) -> None:
        self._count("receive", number)

    def _count(self, what: str, number: int) -> None:
        reason = f"{what}: {errno.errorcode.get(number, 'error')}"
        self.troubles[reason] = self.troubles.get(reason, 0) + 1


class GroupTransport(UnicastTransport):
    """Transport that sends one datagram for several robots to a multicast group or a broadcast address.

    All robots use the same group port. A multicast datagram does not leave the local network. A datagram to one robot
    is sent by unicast. Robots on one computer also receive each other's datagrams. Copies of a robot's own datagrams
    come back and are dropped. IPv4 only. Raises CannotOpen."""

    def __init__(self, peers: Sequence[Peer], pid: int, bind: str, network: Network) -> None:
        multicast = network.transport == "multicast"
        place = f"{network.group}:{network.port}, the {network.transport} group of robot {peers[pid].name}"
        _check_group(network, place)
        super().__init__(peers, pid, bind, socket.AF_INET)
        self._group = self._addresses[GROUP] = (network.group, network.port)
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
        self._open_inbox()

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        if len(to) <= 1:
            super().send(to, datagram)
        elif error := self._inbox.send(GROUP, datagram):
            self._count("send", error)

    def _join(self, group: socket.socket, interface: str) -> None:
        """Send and receive on one network interface, given by its address or name. Raises OSError."""
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
        raise CannotOpen(f"{place}: not a multicast address; multicast addresses are 224.0.0.0 to 239.255.255.255")
    if network.transport == "broadcast" and address.is_multicast:
        raise CannotOpen(f"{place}: this is a multicast address; set `transport` to multicast")
    if not 1 <= network.port <= 65535:
        raise CannotOpen(f"{place}: {network.port} is not a port; ports are 1 to 65535")


def _reason(error: OSError, shared: bool) -> str:
    """Return the reason why a socket could not be bound, and how to fix it."""
    if error.errno == errno.EADDRINUSE:
        if shared:
            return ": another program uses the port; set another `port` for all robots"
        return ": the address is in use; check whether the robot's program is already running"
    if error.errno == errno.EADDRNOTAVAIL:
        if shared:
            return ": not a broadcast address of this computer; `ip address` lists broadcast addresses behind `brd`"
        return ": not an address of this computer; set `bind` in the robot's settings"
    return f": {error.strerror or error}"


def _resolve(peer: Peer, family: socket.AddressFamily) -> tuple[socket.AddressFamily, Address]:
    """Look up the address of a peer, only once, so that later failures of a name server have no effect."""
    if not 1 <= peer.port <= 65535:
        raise CannotOpen(f"robot {peer.name}: {peer.host}:{peer.port} is no address; ports are 1 to 65535")
    try:
        found = socket.getaddrinfo(peer.host, peer.port, family=family, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise CannotOpen(f"robot {peer.name}: no address for {peer.host}:{peer.port}: {error}") from None
    actual, _, _, _, address = found[0]
    return actual, cast(Address, address)
