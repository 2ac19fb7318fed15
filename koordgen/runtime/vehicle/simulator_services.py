"""Services of a lockstep simulator for a robot's platform in its process: links and a clock.

A target's manifest names the function that creates such a platform ([simulation], `inside`). It is called with the
robot's settings, the fleet's key and a `SimulatorServices`, and returns a platform that opens no socket, device or
process, and uses no other clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class Exchange(Protocol):
    """Datagrams in both directions. No call blocks or raises; after `close`, none passes."""

    def receive(self) -> bytes | None:
        """Return the next datagram; None if there is none now."""
        ...

    def send(self, data: bytes) -> bool:
        """Send a datagram. Return False if it could not be accepted."""
        ...

    def close(self) -> None: ...


class Stream(Protocol):
    """Serial device: bytes in both directions. `write` accepts what fits, and returns the number of bytes."""

    def read(self) -> bytes: ...

    def write(self, data: bytes) -> int: ...

    def fileno(self) -> int:
        """Return -1: there is no descriptor."""
        ...

    def close(self) -> None: ...


class SimulatorServices(Protocol):
    """Services for one robot's platform; new ones for each start of its agent.

    `seed`: for its random numbers. `iterations`: bounds planners' work instead of seconds."""

    seed: int
    iterations: int

    def now(self) -> float:
        """Return the agent's clock in seconds."""
        ...

    def today(self) -> float:
        """Return the time of day in seconds since 1970: the same in every run."""
        ...

    def exchange(self, url: str) -> Exchange:
        """Open the port of a setting, "udp:HOST:PORT" or "udpin:HOST:PORT". Raises Unready if there is none."""
        ...

    def stream(self, device: str) -> Stream:
        """Open the serial device of this name. Raises Unready if there is none."""
        ...

    def beside(self, step: Callable[[float], None]) -> None:
        """Register a function that runs beside the agent, as a process of its own does on a robot.

        It is called 240 times a second with `now`, also while the agent is frozen, and after its death."""
        ...
