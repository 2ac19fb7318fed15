"""Datagrams that must change nothing, made of genuine ones that were overheard."""

from __future__ import annotations

import heapq
from random import Random

from benchmarks.fixtures.fleet import Fleet
from koordgen.runtime.net.seal import MAC_SIZE, MEMORY, seal
from koordgen.runtime.net.wire import LIMIT

KINDS = ("noise", "cut", "flipped", "replayed", "foreign key", "oversized", "grown")
HEARD = 400  # genuine datagrams that the attacker keeps


class Attacker:
    """Hears all that robots of a fleet send and makes bad datagrams of it."""

    def __init__(self, fleet: Fleet, seed: int) -> None:
        self.fleet = fleet
        self.made = dict.fromkeys(KINDS, 0)
        self._random = Random(seed)
        self._heard: list[tuple[float, int, bytes]] = []
        self._send = fleet.network.send
        fleet.network.send = self._overhear  # type: ignore[method-assign]

    def play(self, receiver: int, count: int) -> None:
        """So many arrive at a robot now."""
        queue, now = self.fleet.network._queues[receiver], self.fleet.time.time
        for number in range(count):
            heapq.heappush(queue, (now, number, self.bad(receiver)))

    def bad(self, receiver: int) -> bytes:
        chance = self._random
        kind = chance.choice(KINDS)
        genuine, known = self._one(receiver)
        for _ in range(20):
            if known or kind != "replayed":
                break
            genuine, known = self._one(receiver)
        else:
            kind = "flipped"  # replayed it may be new to this robot
        self.made[kind] += 1
        match kind:
            case "noise":
                return chance.randbytes(chance.randrange(LIMIT + 10))
            case "cut":
                return genuine[: chance.randrange(len(genuine))]
            case "flipped":
                bit = chance.randrange(len(genuine) * 8)
                damaged = bytearray(genuine)
                damaged[bit // 8] ^= 1 << bit % 8
                return bytes(damaged)
            case "foreign key":
                return seal(chance.choice([None, chance.randbytes(32)]), MEMORY, genuine[:-MAC_SIZE])
            case "oversized":
                return genuine + chance.randbytes(chance.randrange(LIMIT, 4 * LIMIT))
            case "grown":
                return genuine + chance.randbytes(chance.randrange(1, 9))
            case _:
                return genuine

    def _one(self, receiver: int) -> tuple[bytes, bool]:
        """A genuine datagram, and whether this robot has certainly taken it already."""
        at, to, datagram = self._random.choice(self._heard)
        return datagram, to == receiver and at < self.fleet.time.time - 0.5

    def _overhear(self, sender: int, receiver: int, datagram: bytes) -> None:
        heard = (self.fleet.time.time, receiver, datagram)
        if len(self._heard) < HEARD:
            self._heard.append(heard)
        else:
            self._heard[self._random.randrange(HEARD)] = heard
        self._send(sender, receiver, datagram)
