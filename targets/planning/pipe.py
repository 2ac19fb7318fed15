"""Messages between an agent and its planner's process: MessagePack with a length prefix, through pipes."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from koordgen.runtime.values.points import Point
from targets.planning.world import Path, Scene, World

HEAD = 4  # bytes of the length prefix, big-endian
LONGEST = 1 << 24  # maximum bytes of a message; a larger length is an error


class Order(msgspec.Struct, frozen=True, array_like=True):
    """First message to the child process: the planner to create."""

    name: str  # name of a built-in planner, or "module:Class"
    world: World
    judge: str  # "module:Class" that calls the planner and checks its paths, such as `targets.planning.ask:Asked`


class Question(msgspec.Struct, frozen=True, array_like=True):
    """Call of the planner. Its answer has the same number."""

    number: int
    start: Point
    goal: Point
    scene: Scene
    seconds: float
    more: bytes = b""  # further data for a target's own judge


class Answer(msgspec.Struct, frozen=True, array_like=True):
    """Answer to a question, or to the order (number 0; an empty reason means that the planner was created)."""

    number: int
    path: Path
    reason: str
    more: bytes = b""  # further data from a target's own judge


def framed(message: Order | Question | Answer) -> bytes:
    data = msgspec.msgpack.encode(message)
    return len(data).to_bytes(HEAD, "big") + data


class Unframed:
    """Splitter of a byte stream into messages. Raises ValueError for an impossible length."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def take(self, data: bytes) -> Iterator[bytes]:
        """Yield the messages that these bytes complete."""
        self._waiting += data
        while len(self._waiting) >= HEAD:
            end = HEAD + int.from_bytes(self._waiting[:HEAD], "big")
            if end > HEAD + LONGEST:
                raise ValueError(f"a message of {end - HEAD} bytes")
            if len(self._waiting) < end:
                return
            message = bytes(self._waiting[HEAD:end])
            del self._waiting[:end]
            yield message
