"""Links and a clock that a lockstep simulator offers to the platforms of robots in the simulator's process.

A target's manifest names a function that creates a simulated platform (section [simulation], key `inside`). The
function gets the robot's settings, the fleet's key and a `SimulatorServices`. It returns a platform that opens no
socket, device or process, and reads no clock except `SimulatorServices.now` and `today`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class Exchange(Protocol):
    """Link that transports datagrams in both directions. No method blocks or raises.

    No datagram passes after `close`."""

    def receive(self) -> bytes | None:
        """Return the next datagram that has arrived, or None."""
        ...

    def send(self, data: bytes) -> bool:
        """Send a datagram. Return False if the link did not accept it."""
        ...

    def close(self) -> None: ...


class Stream(Protocol):
    """Serial device that transports bytes in both directions. `write` returns the number of bytes that it accepted."""

    def read(self) -> bytes: ...

    def write(self, data: bytes) -> int: ...

    def fileno(self) -> int:
        """Return -1, because a simulated device has no file descriptor."""
        ...

    def close(self) -> None: ...


class SimulatorServices(Protocol):
    """Services of the simulator for the platform of one robot. Each start of the agent gets new services.

    `seed`: seed of the platform's random numbers. `iterations`: largest number of a planner's iterations, in place of a
    limit in seconds."""

    seed: int
    iterations: int

    def now(self) -> float:
        """Return the time of the agent's clock in seconds."""
        ...

    def today(self) -> float:
        """Return the simulated time of day in seconds since 1970; it is equal in all runs."""
        ...

    def exchange(self, url: str) -> Exchange:
        """Open the port that `url` names, "udp:HOST:PORT" or "udpin:HOST:PORT".

        Raises Unready if the simulator has no such port."""
        ...

    def stream(self, device: str) -> Stream:
        """Open the serial device `device`. Raises Unready if the simulator has no device of this name."""
        ...

    def beside(self, step: Callable[[float], None]) -> None:
        """Register a function that runs independently of the agent, as a separate process does on a robot.

        The simulator calls `step` with the present time 240 times a second, even while the agent is frozen, and after
        the agent's end."""
        ...
