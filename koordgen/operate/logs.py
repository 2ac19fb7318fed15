"""Log lines of all robots of a fleet, ordered by time.

Hosts stamp lines with their own clocks. The offset of a host's clock is measured by requests in its session: the host
reads its clock between request and answer, so the error of one measurement is at most half of its round trip. The
request with the shortest round trip is used.
"""

from __future__ import annotations

import asyncio
import heapq
import math
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from koordgen.lang.node import Node
from koordgen.operate.hosts import HostError, Sessions, SshSession

ASKED = 5  # number of requests for a host's clock; the answer with the shortest round trip is used
EVERY = 0.3  # seconds between two requests for new lines


class Line(Node):
    """One line of a robot's log. `time`: Unix time in seconds, by the clock of this computer."""

    time: float
    robot: str
    text: str


class Offset(Node):
    """Offset of a host's clock from this computer's clock.

    ahead: seconds by which the host's clock is ahead of this computer's clock.
    error: bound of the error of `ahead`, in seconds.
    """

    ahead: float
    error: float


def offset_of(samples: Iterable[tuple[float, float, float]]) -> Offset:
    """Return the clock offset from samples (time of request, host's clock, time of answer), in seconds.

    The sample with the shortest round trip is used.
    """
    sent, clock, received = min(samples, key=lambda sample: sample[2] - sample[0])
    return Offset(clock - (sent + received) / 2, (received - sent) / 2)


async def clock_offset(session: SshSession, now: Callable[[], float] = time.time) -> Offset:
    """Measure the offset of a host's clock from this computer's clock. Raises HostError."""
    samples = []
    for _ in range(ASKED):
        sent = now()
        answer = await session.call("ping")
        samples.append((sent, float(answer["clock"]), now()))
    return offset_of(samples)


def merged(lines: Iterable[Sequence[Line]]) -> list[Line]:
    """Return the lines of several robots, merged by time. Each robot's lines keep their order."""
    return list(heapq.merge(*map(_ascending, lines), key=lambda line: line.time))


def _ascending(lines: Sequence[Line]) -> list[Line]:
    """Return the lines with times that never decrease, so that a clock set back does not reorder them."""
    found: list[Line] = []
    for line in lines:
        latest = found[-1].time if found else line.time
        found.append(line if line.time >= latest else Line(latest, line.robot, line.text))
    return found


class Follower:
    """Ordering of log lines that arrive continuously.

    A line is returned after all robots were asked at a later time than the line's, because then no earlier line can
    arrive.
    """

    def __init__(self) -> None:
        self._waiting: list[Line] = []

    def add(self, lines: Iterable[Line]) -> None:
        """Add lines that were received. Each robot's lines must be in order."""
        self._waiting.extend(lines)

    def ready(self, asked: float) -> list[Line]:
        """Return all lines up to the time `asked`, in order.

        `asked`: time at which the last requests to all robots began.
        """
        ordered = merged(_by_robot([self._waiting]))
        self._waiting = [line for line in ordered if line.time > asked]
        return [line for line in ordered if line.time <= asked]


class Reader:
    """Reader of the log lines of one host's robots; gives them times of this computer's clock.

    The function `reader_of` makes a reader.
    """

    def __init__(self, session: SshSession, offset: Offset) -> None:
        self.session = session
        self._offset = offset
        self._next: dict[str, float] = {}  # robot -> time of the robot's last line, by the host's clock

    async def last(self, count: int) -> list[Line]:
        """Return the last `count` lines of each robot. Raises HostError."""
        return [line for robot in self.session.host.robots for line in await self._read(robot, lines=count)]

    async def new(self) -> list[Line]:
        """Return the lines that were logged since the previous call. Raises HostError."""
        return [line for robot, at in self._next.items() for line in await self._read(robot, since=at)]

    async def _read(self, robot: str, **which: Any) -> list[Line]:
        answer = await self.session.call("logs", robot=robot, **which)
        self._next[robot] = float(answer["next"])
        return [Line(float(at) - self._offset.ahead, robot, str(text)) for at, text in answer["lines"]]


async def reader_of(session: SshSession) -> Reader:
    """Measure the offset of a host's clock, and return a reader of its robots' log lines.

    Raises HostError.
    """
    return Reader(session, await clock_offset(session))


async def show_lines(
    sessions: Sessions, count: int, follow: bool, show: Callable[[Line], None], lost: Callable[[HostError], None]
) -> None:
    """Show the last `count` log lines of each robot.

    With `follow`, new lines are shown as well, as long as a host can be reached.

    show: called for each line, in order.
    lost: called when a host fails; its lines are missing from then on.
    """

    async def ask(one: Callable[[Reader], Any]) -> list[list[Line]]:
        results = await asyncio.gather(*map(one, readers.values()), return_exceptions=True)
        for session, result in zip(list(readers), results, strict=True):
            if isinstance(result, HostError):
                lost(result)
                del readers[session]
            elif isinstance(result, BaseException):
                raise result
        return [result for result in results if not isinstance(result, BaseException)]

    made, failed = await sessions.each(reader_of)
    for error in (*sessions.failed, *failed):
        lost(error)
    readers: dict[SshSession, Reader] = {reader.session: reader for reader in made.values()}
    for line in merged(_by_robot(await ask(lambda reader: reader.last(count)))):
        show(line)
    follower = Follower()
    while follow and readers:
        asked = time.time()
        for lines in await ask(lambda reader: reader.new()):
            follower.add(lines)
        for line in follower.ready(asked if readers else math.inf):
            show(line)
        await asyncio.sleep(EVERY)


def _by_robot(results: Iterable[Iterable[Line]]) -> list[list[Line]]:
    found: dict[str, list[Line]] = {}
    for lines in results:
        for line in lines:
            found.setdefault(line.robot, []).append(line)
    return list(found.values())
