"""Lines of all robots in the order of one clock."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest

from koordgen.operate import logs
from koordgen.operate.hosts import HostError
from koordgen.operate.logs import Follower, Line, clock_offset, merged, offset_of
from tests.operate.fakes import FakeSession, reached, unreachable


def test_the_quickest_request_says_how_far_a_clock_is_ahead() -> None:
    found = offset_of([(100.0, 107.0, 104.0), (110.0, 115.1, 110.2), (120.0, 127.0, 123.0)])
    assert found.ahead == pytest.approx(5.0) and found.error == pytest.approx(0.1)


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


class Talking(FakeSession):
    """A host whose robot writes a line for each question, until the link is cut at the fourth."""

    def answer_logs(self, robot: str, since: float | None = None, lines: int | None = None) -> dict[str, Any]:
        self.asked = getattr(self, "asked", 0) + 1
        if self.asked == 4:
            raise HostError(self.host, "link", "the link was cut during `logs`", "run the command again")
        at = time.time() + self.ahead - 0.001
        return {"lines": [[at, f"line {self.asked}"]], "next": at}


def test_lines_are_followed_until_no_host_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "EVERY", 0.001)
    alice, bert = Talking("alice"), Talking("bert")
    bert.ahead = 500.0
    shown: list[Line] = []
    lost: list[HostError] = []
    sessions = reached(alice, bert, failed=(unreachable("cleo"),))
    asyncio.run(logs.show_lines(sessions, 5, True, shown.append, lost.append))
    for robot in ("alice", "bert"):
        assert [line.text for line in shown if line.robot == robot] == ["line 1", "line 2", "line 3"]
    assert [line.time for line in shown] == sorted(line.time for line in shown)
    assert all(abs(line.time - time.time()) < 60 for line in shown)
    assert sorted(error.host.robots[0] for error in lost) == ["alice", "bert", "cleo"]


def test_without_follow_the_last_lines_are_all() -> None:
    shown: list[Line] = []
    asyncio.run(logs.show_lines(reached(Talking("alice")), 5, False, shown.append, lambda error: None))
    assert [line.text for line in shown] == ["line 1"]
