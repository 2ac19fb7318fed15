"""A network in memory, on a simulated clock: seeded loss, delay, jitter (and so reordering) and duplication."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from random import Random

from koordgen.runtime.clock import Clock


@dataclass(frozen=True, slots=True)
class Conditions:
    """Probabilities between 0 and 1; seconds."""

    loss: float = 0.0
    delay: float = 0.001
    jitter: float = 0.0
    duplication: float = 0.0


class MemoryNetwork:
    """Connects the transports it hands out. `cut` tells whether a datagram from one pid to another is lost now; the
    same seed and the same sends give the same arrivals."""

    def __init__(self, clock: Clock, seed: int, conditions: Conditions = Conditions()) -> None:
        self._clock = clock
        self._random = Random(seed)
        self.conditions = conditions
        self.cut: Callable[[int, int], bool] = lambda sender, receiver: False
        self.sent = 0
        self._queues: dict[int, list[tuple[float, int, bytes]]] = {}

    def transport(self, pid: int) -> MemoryTransport:
        """The transport of one robot; taking it anew drops what was under way to its predecessor."""
        self._queues[pid] = []
        return MemoryTransport(self, pid)

    def send(self, sender: int, receiver: int, datagram: bytes) -> None:
        self.sent += 1
        now, c = self._clock.now(), self.conditions
        copies = 2 if self._random.random() < c.duplication else 1
        for _ in range(copies):
            lost = self._random.random() < c.loss
            delay = c.delay + c.jitter * self._random.random()
            if not lost and receiver in self._queues and not self.cut(sender, receiver):
                heapq.heappush(self._queues[receiver], (now + delay, self.sent, datagram))

    def receive(self, pid: int) -> list[bytes]:
        queue, now = self._queues[pid], self._clock.now()
        arrived = []
        while queue and queue[0][0] <= now:
            arrived.append(heapq.heappop(queue)[2])
        return arrived

    def next_arrival(self, pid: int) -> float:
        """When the next datagram arrives at a robot, by the network's clock."""
        queue = self._queues[pid]
        return queue[0][0] if queue else float("inf")


class MemoryTransport:
    """One robot's end of a MemoryNetwork."""

    def __init__(self, network: MemoryNetwork, pid: int) -> None:
        self._network = network
        self._pid = pid
        self.troubles: dict[str, int] = {}

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        for pid in to:
            self._network.send(self._pid, pid, datagram)

    def receive(self) -> Sequence[bytes]:
        return self._network.receive(self._pid)

    def wait(self, seconds: float) -> None:
        """Simulated time is moved by its owner, not by waiting."""

    def close(self) -> None:
        """Nothing to give back."""
