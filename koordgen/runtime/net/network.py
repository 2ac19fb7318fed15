"""Simulated network in memory: seeded loss, delay, jitter, duplication and reordering."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from random import Random
from types import MappingProxyType

from koordgen.runtime.net.transport import MOST_AT_ONCE
from koordgen.runtime.net.wire import LIMIT
from koordgen.runtime.values.clock import Clock

EACH: Mapping[int, Sequence[int]] = MappingProxyType({})
OVERTAKEN = 0.05  # seconds; largest additional delay of a reordered datagram


@dataclass(frozen=True, slots=True)
class Conditions:
    """Simulated conditions of a link: probabilities from 0 to 1, times in seconds.

    `jitter` is the largest random addition to `delay`; the addition is uniformly distributed. A reordered datagram is
    delayed by up to OVERTAKEN seconds more."""

    loss: float = 0.0
    delay: float = 0.001
    jitter: float = 0.0
    duplication: float = 0.0
    reordering: float = 0.0

    def delays(self, dice: Random) -> list[float]:
        """Return the delays of the zero, one or two copies of a datagram that arrive."""
        found = []
        for _ in range(2 if dice.random() < self.duplication else 1):
            lost = dice.random() < self.loss
            delay = self.delay + self.jitter * dice.random()
            if self.reordering and dice.random() < self.reordering:
                delay += OVERTAKEN * dice.random()
            if not lost:
                found.append(delay)
        return found


Queue = list[tuple[float, int, bytes]]  # heap of (time of arrival, number of the datagram, datagram)


class MemoryNetwork:
    """Simulated network that connects MemoryTransports. Equal seeds and equal sends give equal arrivals.

    conditions: conditions of every link that is not in `links`.
    links: (sender, receiver) -> conditions of a link.
    cut: function that returns whether datagrams from one pid to another are lost now.
    group: a datagram to several robots reaches all other robots, as with multicast."""

    def __init__(self, clock: Clock, seed: int, conditions: Conditions = Conditions(), group: bool = False) -> None:
        self._clock = clock
        self._random = Random(seed)
        self.conditions = conditions
        self.links: dict[tuple[int, int], Conditions] = {}
        self.cut: Callable[[int, int], bool] = lambda sender, receiver: False
        self.group = group
        self.sent = 0
        self._queues: dict[int, Queue] = {}

    def transport(self, pid: int, places: Mapping[int, Sequence[int]] = EACH) -> MemoryTransport:
        """Return a new transport for robot `pid`. Datagrams on the way to its previous transport are dropped.

        places: receiver that is a fleet -> the places of its robots in this network, which all get its datagrams. Every
            other receiver has its pid as its place."""
        queue: Queue = []
        self._queues[pid] = queue
        return MemoryTransport(self, pid, queue, places)

    def others(self, pid: int) -> list[int]:
        return sorted(self._queues.keys() - {pid})

    def send(self, sender: int, receiver: int, datagram: bytes) -> None:
        self.sent += 1
        now = self._clock.now()
        for delay in self.links.get((sender, receiver), self.conditions).delays(self._random):
            if receiver in self._queues and not self.cut(sender, receiver):
                heapq.heappush(self._queues[receiver], (now + delay, self.sent, datagram[: LIMIT + 1]))

    def arrived(self, queue: Queue) -> list[bytes]:
        now = self._clock.now()
        taken: list[bytes] = []
        while queue and queue[0][0] <= now and len(taken) < MOST_AT_ONCE:
            taken.append(heapq.heappop(queue)[2])
        return taken

    def next_arrival(self, pid: int, count: int = 1) -> float:
        """Return the time at which `count` datagrams will have arrived at robot `pid`; inf if fewer are sent."""
        queue = self._queues.get(pid, [])
        if len(queue) < count:
            return float("inf")
        return queue[0][0] if count == 1 else heapq.nsmallest(count, queue)[-1][0]

    def leave(self, pid: int, queue: Queue) -> None:
        queue.clear()
        if self._queues.get(pid) is queue:
            del self._queues[pid]


class MemoryTransport:
    """Transport of one robot in a MemoryNetwork."""

    def __init__(
        self, network: MemoryNetwork, pid: int, queue: Queue, places: Mapping[int, Sequence[int]] = EACH
    ) -> None:
        self._network, self._places = network, places
        self._pid = pid
        self._queue = queue
        self._closed = False
        self.troubles: dict[str, int] = {}

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        if self._closed:
            self.troubles["send: closed"] = self.troubles.get("send: closed", 0) + 1
            return
        for pid in self._network.others(self._pid) if self._network.group and len(to) > 1 else to:
            for place in self._places.get(pid, (pid,)):
                self._network.send(self._pid, place, datagram)

    def receive(self) -> Sequence[bytes]:
        return self._network.arrived(self._queue)

    def wait(self, seconds: float, expected: int = 1, gather: float = 0.0) -> None:
        """Return at once, because the simulation advances the time."""

    def close(self) -> None:
        self._closed = True
        self._network.leave(self._pid, self._queue)
