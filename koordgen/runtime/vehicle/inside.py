"""What a simulator that owns time gives to a robot's platform that lives in its process: links in memory, a clock.

A target says in its manifest which function makes such a platform ([simulation], `inside`): it is called with the
robot's settings, the fleet's key and an `Inside`, and answers a platform that opens no socket, no device and no
process, and asks for no other time than this.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class Exchange(Protocol):
    """Datagrams both ways. Nothing blocks or raises; after `close`, nothing comes or goes."""

    def receive(self) -> bytes | None:
        """The next that has arrived; None: there is none now."""
        ...

    def send(self, data: bytes) -> bool:
        """False when it could not be taken."""
        ...

    def close(self) -> None: ...


class Stream(Protocol):
    """Bytes both ways: a serial device. `write` takes what fits, and says how many bytes it took."""

    def read(self) -> bytes: ...

    def write(self, data: bytes) -> int: ...

    def fileno(self) -> int:
        """-1: there is no descriptor."""
        ...

    def close(self) -> None: ...


class Inside(Protocol):
    """The surroundings of one robot's platform; new ones for each start of its agent. `seed` is for what it does at
    random, `iterations` bounds planners' work instead of seconds."""

    seed: int
    iterations: int

    def now(self) -> float:
        """The agent's clock, seconds."""
        ...

    def today(self) -> float:
        """The time of day, seconds since 1970: the same in every run."""
        ...

    def exchange(self, url: str) -> Exchange:
        """What a setting names, "udp:HOST:PORT" or "udpin:HOST:PORT". Raises Unready when there is no such port."""
        ...

    def stream(self, device: str) -> Stream:
        """The serial device of that name. Raises Unready when there is none."""
        ...

    def beside(self, step: Callable[[float], None]) -> None:
        """What runs beside the agent, in a process of its own on a robot: it is called 240 times a second with `now`,
        also while the agent is frozen, and after its death."""
        ...
