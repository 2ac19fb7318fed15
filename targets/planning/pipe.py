"""Messages between an agent and its planner's process, sent through pipes.

Each message is MessagePack with a length prefix.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from koordgen.runtime.values.points import Point
from targets.planning.world import Path, Scene, World

HEAD = 4  # bytes of a message's length prefix, big-endian
LONGEST = 1 << 24  # maximum bytes of a message; a larger length prefix is an error


class Order(msgspec.Struct, frozen=True, array_like=True):
    """First message to the planner's process: it names the planner to create."""

    name: str  # name of a built-in planner, or "module:Class"
    world: World
    judge: (
        str  # "module:Class" that calls the planner and checks its paths, such as `targets.planning.ask:PlannerJudge`
    )


class Question(msgspec.Struct, frozen=True, array_like=True):
    """Call of the planner, which asks for a path from `start` to `goal` within `seconds`.

    The answer has the `number` of the question."""

    number: int
    start: Point
    goal: Point
    scene: Scene
    seconds: float
    more: bytes = b""  # additional data for a target's own judge


class Answer(msgspec.Struct, frozen=True, array_like=True):
    """Answer of the planner's process to a Question with this number, or to the Order (number 0).

    An empty `reason` in an answer to the Order means that the planner was created."""

    number: int
    path: Path
    reason: str
    more: bytes = b""  # further data from the judge of a target


def framed(message: Order | Question | Answer) -> bytes:
    data = msgspec.msgpack.encode(message)
    return len(data).to_bytes(HEAD, "big") + data


class Unframed:
    """Splitter of a byte stream into messages."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Add received bytes, and yield the messages that are now complete.

        Raises ValueError if a length prefix is above LONGEST."""
        self._waiting += data
        while len(self._waiting) >= HEAD:
            end = HEAD + int.from_bytes(self._waiting[:HEAD], "big")
            if end > HEAD + LONGEST:
                raise ValueError(f"a message of {end - HEAD} bytes is too long")
            if len(self._waiting) < end:
                return
            message = bytes(self._waiting[HEAD:end])
            del self._waiting[:end]
            yield message
