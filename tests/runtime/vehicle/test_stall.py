"""Stalls: reported when they begin, at slow intervals, when their reason changes, and when they end."""

from __future__ import annotations

from benchmarks.fixtures.fleet import Fleet
from koordgen.runtime.vehicle.stall import AGAIN, CLEAR, GRACE, Stalls

STEP = 0.05


def told(*parts: tuple[float, str]) -> list[tuple[float, str, str]]:
    """When what was reported of reasons that lasted for so many seconds each."""
    found: list[tuple[float, str, str]] = []
    now = 0.0
    stalls = Stalls(lambda state, why, lasted: found.append((round(now, 2), state, why)))
    for seconds, why in parts:
        for _ in range(round(seconds / STEP)):
            now += STEP
            stalls.see(why, now)
    return found


def test_a_stall_is_reported_when_it_begins_at_slow_intervals_and_when_it_ends() -> None:
    found = told((1.0, ""), (2.5 * AGAIN, "lost"), (5.0, ""))
    assert [state for _, state, _ in found] == ["begins", "goes on", "goes on", "ends"]
    begin, again, _, end = (at for at, _, _ in found)
    assert abs(begin - (1.05 + GRACE)) < 0.06 and abs(again - begin - AGAIN) < 0.06
    assert abs(end - (1.0 + 2.5 * AGAIN + CLEAR)) < 0.06


def test_a_short_one_is_none_and_a_moment_with_a_way_does_not_end_a_long_one() -> None:
    assert told((GRACE - 0.5, "lost"), (30.0, "")) == []
    assert [s for _, s, _ in told((5.0, "lost"), (CLEAR / 2, ""), (4.0, "lost"))] == ["begins"]


def test_another_reason_is_reported_and_other_numbers_are_none() -> None:
    found = told((5.0, "lost"), (5.0, "blocked 1.5 m ahead"), (1.0, "blocked 1.4 m ahead"))
    assert [(state, why) for _, state, why in found] == [("begins", "lost"), ("goes on", "blocked 1.5 m ahead")]


def test_an_agent_says_it_in_its_log_and_its_trace() -> None:
    fleet = Fleet(n=1).boot_all()
    fleet.run_rounds(3)
    robot = fleet.robots[0]
    robot.platform.stall = "target (3.00, 0.00) lies inside obstacle 3"
    fleet.run(GRACE + 0.2)
    robot.platform.stall = ""
    fleet.run(CLEAR + 0.2)
    first, last = robot.trace("stall")
    assert (first["state"], first["why"]) == ("begins", "target (3.00, 0.00) lies inside obstacle 3")
    assert last["state"] == "ends" and last["lasted"] > first["lasted"] >= GRACE
    lines = [line.partition("warning: ")[2] for line in robot.lines if "warning: " in line]
    assert lines == [
        "no way for 2 s: target (3.00, 0.00) lies inside obstacle 3",
        "the stall is over after 3 s: target (3.00, 0.00) lies inside obstacle 3",
    ]
    assert [t["message"] for t in robot.trace("log")] == lines
