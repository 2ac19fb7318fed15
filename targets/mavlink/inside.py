"""MAVLink transport in memory, for a simulator that controls time and runs in the same process."""

from __future__ import annotations

from koordgen.runtime.vehicle.simulator_services import Exchange
from targets.mavlink.transport import Address, Chunk, Way


class Direct:
    """Transport over the simulator's exchange of datagrams: implements `transport.Transport`."""

    datagrams = True

    def __init__(self, exchange: Exchange) -> None:
        self._exchange = exchange

    def receive(self, now: float) -> list[Chunk]:
        chunks: list[Chunk] = []
        while (data := self._exchange.receive()) is not None:
            chunks.append((data, None))
        return chunks

    def answer(self, source: Address | None) -> None:
        pass

    def way(self) -> Way | None:
        """Return an invalid file descriptor, because another process cannot write to a transport in memory."""
        return Way(0, -1)

    def send(self, data: bytes) -> bool:
        return self._exchange.send(data)

    def close(self) -> None:
        self._exchange.close()
