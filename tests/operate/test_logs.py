"""Lines of all robots in the order of one clock."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from koordgen.operate.logs import Follower, Line, clock_offset, merged, offset_of
from tests.operate.fakes import FakeSession


def test_the_quickest_request_says_how_far_a_clock_is_ahead() -> None:
    found = offset_of([(100.0, 107.0, 104.0), (110.0, 115.1, 110.2), (120.0, 127.0, 123.0)])
    assert (found.ahead, found.error) == (pytest.approx(5.0), pytest.approx(0.1))


def test_a_host_is_asked_several_times() -> None:
    times = iter([0.0, 1.0, 2.0, 2.2, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0])

    class Clock(FakeSession):
        def answer_ping(self) -> dict[str, Any]:
            return {"clock": 62.1}

    assert asyncio.run(clock_offset(Clock("alice"), lambda: next(times))).ahead == pytest.approx(60.0)


def lines(robot: str, *times: float) -> list[Line]:
    return [Line(time, robot, f"{robot} at {time}") for time in times]


def test_lines_of_all_robots_are_in_order_and_those_of_one_stay_as_they_were() -> None:
    found = merged([lines("alice", 1.0, 4.0, 2.0), lines("bert", 0.5, 3.0, 5.0)])
    assert [line.text for line in found] == [
        "bert at 0.5", "alice at 1.0", "bert at 3.0", "alice at 4.0", "alice at 2.0", "bert at 5.0",
    ]  # fmt: skip
    assert merged([]) == [] and merged([[], lines("alice", 1.0)]) == lines("alice", 1.0)


def test_a_line_that_is_followed_waits_until_all_were_asked_after_its_time() -> None:
    follower = Follower()
    follower.add(lines("alice", 1.0, 2.5))
    follower.add(lines("bert", 1.5))
    assert [line.time for line in follower.ready(2.0)] == [1.0, 1.5]
    follower.add(lines("bert", 2.2, 3.0))
    assert [(line.robot, line.time) for line in follower.ready(3.0)] == [("bert", 2.2), ("alice", 2.5), ("bert", 3.0)]
    assert follower.ready(9.0) == []
