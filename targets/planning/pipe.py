"""What goes through the pipes between an agent and its planner's process: MessagePack behind its length."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from koordgen.runtime.values.points import Point
from targets.planning.world import Path, Scene, World

HEAD = 4  # bytes of a length, big-endian
LONGEST = 1 << 24  # bytes of a message; what says that it is longer is none


class Order(msgspec.Struct, frozen=True, array_like=True):
    """The first message to the child: which planner to be."""

    name: str
    world: World
    judge: str  # "module:Class" that asks the planner, as `targets.planning.ask:Asked` does


class Question(msgspec.Struct, frozen=True, array_like=True):
    """A call; its answer has its number."""

    number: int
    start: Point
    goal: Point
    scene: Scene
    seconds: float
    more: bytes = b""  # what a target's own judge is told besides


class Answer(msgspec.Struct, frozen=True, array_like=True):
    """To the order (number 0: an empty reason when the planner was made) or to a question."""

    number: int
    path: Path
    reason: str
    more: bytes = b""  # what it tells besides


def framed(message: Order | Question | Answer) -> bytes:
    data = msgspec.msgpack.encode(message)
    return len(data).to_bytes(HEAD, "big") + data


class Unframed:
    """Bytes as they come, to messages. Raises ValueError for what is no message."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def take(self, data: bytes) -> Iterator[bytes]:
        """The messages that end within these bytes."""
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
