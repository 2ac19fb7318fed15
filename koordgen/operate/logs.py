"""Log lines of all robots of a fleet in one order.

Hosts stamp lines with their own clocks. How far a host's clock is off is measured through its session: the tool reads
the clock between the request and its answer, so the quickest of some requests knows it to half of its round trip.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Iterable, Sequence

from koordgen.node import Node
from koordgen.operate.hosts import Session

ASKED = 5  # requests for a host's clock, of which the quickest counts


class Line(Node):
    """One line of a robot's log. `time`: Unix time in seconds, by the clock of this computer."""

    time: float
    robot: str
    text: str


class Offset(Node):
    """How far a host's clock is ahead of this computer's, and the bound of the error, both in seconds."""

    ahead: float
    error: float


def offset_of(samples: Iterable[tuple[float, float, float]]) -> Offset:
    """Return the offset by (sent, the host's clock, received): the sample with the shortest round trip is used."""
    sent, clock, received = min(samples, key=lambda sample: sample[2] - sample[0])
    return Offset(clock - (sent + received) / 2, (received - sent) / 2)


async def clock_offset(session: Session, now: Callable[[], float] = time.time) -> Offset:
    """Measure how far the host's clock is ahead. Raises HostError."""
    samples = []
    for _ in range(ASKED):
        sent = now()
        answer = await session.call("ping")
        samples.append((sent, float(answer["clock"]), now()))
    return offset_of(samples)


def merged(lines: Iterable[Sequence[Line]]) -> list[Line]:
    """Return the lines of several robots by time; each robot's lines keep their order."""
    return list(heapq.merge(*map(_ascending, lines), key=lambda line: line.time))


def _ascending(lines: Sequence[Line]) -> list[Line]:
    """Return lines whose times never decrease: a clock that was set back does not tear a robot's lines apart."""
    found: list[Line] = []
    for line in lines:
        latest = found[-1].time if found else line.time
        found.append(line if line.time >= latest else Line(latest, line.robot, line.text))
    return found


class Follower:
    """Order of lines that arrive while they are written. A line is shown once all robots were asked after its time."""

    def __init__(self) -> None:
        self._waiting: list[Line] = []

    def add(self, lines: Iterable[Line]) -> None:
        """Take in lines, each robot's in their order."""
        self._waiting.extend(lines)

    def ready(self, asked: float) -> list[Line]:
        """Return, in order, all lines until `asked`: the time at which the last questions to all robots began."""
        by_robot: dict[str, list[Line]] = {}
        for line in self._waiting:
            by_robot.setdefault(line.robot, []).append(line)
        ordered = merged(by_robot.values())
        self._waiting = [line for line in ordered if line.time > asked]
        return [line for line in ordered if line.time <= asked]
