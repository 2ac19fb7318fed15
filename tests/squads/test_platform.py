"""Platform of an outer robot: commands become writes, and sensors that they clear stay false until the commit."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import count
from typing import Any

from koordgen.runtime.agent.squad_platform import SquadPlatform
from koordgen.runtime.values.points import Point
from tests.squads.levels import loaded, squad_of
from tests.squads.test_hosts import GO

HERE, THERE = Point(1, 2, 3), Point(4, 5, 6)


class Inner:
    """Inner fleet that stands at HERE."""

    def __init__(self) -> None:
        self.sensed: dict[str, Any] = {"Motion.position": HERE, "Motion.reached": True}
        self.lag, self.told, self.stopped = "", list[str](), False

    def values(self) -> tuple[Mapping[str, Any], float]:
        return self.sensed, 7.0

    def trouble(self) -> str:
        return self.lag

    def stop(self, why: str) -> None:
        self.told.append(why)


def platform() -> tuple[SquadPlatform, Inner]:
    inner, versions = Inner(), count(1)
    return SquadPlatform(squad_of(loaded("outer_go", GO).PROGRAM), inner, lambda: next(versions)), inner


def test_a_command_is_written_until_it_is_committed() -> None:
    made, _ = platform()
    assert made.writes() == {} and made.sense(0.0).values["Motion.reached"] is True
    made.command({"Motion.target": THERE}, 0.0)
    assert made.writes() == {"goal": THERE} and made.sense(0.0).values["Motion.reached"] is False
    made.committed(0)
    assert made.writes() == {"goal": THERE} and made.sense(0.0).values["Motion.reached"] is False
    made.committed(1)
    assert made.writes() == {} and made.sense(0.0).values["Motion.reached"] is True
    made.command({"Motion.target": THERE}, 0.0)
    assert made.writes() == {}, "the inner fleet has this value"


def test_a_later_command_replaces_one_that_is_not_committed() -> None:
    made, _ = platform()
    made.command({"Motion.target": THERE}, 0.0)
    made.command({"Motion.target": HERE}, 0.0)
    made.committed(1)
    assert made.writes() == {"goal": HERE}, "the first one is committed, the second one is not"
    made.committed(2)
    assert made.writes() == {}


def test_a_robot_that_holds_stays_where_it_is_and_then_resumes_its_command() -> None:
    made, inner = platform()
    made.command({"Motion.target": THERE}, 0.0)
    made.committed(1)
    inner.sensed["Motion.position"] = Point(2, 2, 2)
    made.hold(True, 0.0)
    made.hold(True, 0.0)
    assert made.writes() == {"goal": Point(2, 2, 2)}
    made.command({"Motion.target": HERE}, 0.0)
    assert made.writes() == {"goal": Point(2, 2, 2)}, "a command does not end the hold"
    made.hold(False, 0.0)
    assert made.writes() == {"goal": HERE}


def test_it_is_ready_when_all_sensors_have_values_and_the_inner_fleet_is_current() -> None:
    made, inner = platform()
    found = [(made.ready, made.progress)]
    inner.sensed["Motion.reached"] = None
    found.append((made.ready, made.progress))
    assert found == [(True, ""), (False, "Motion.reached has no value yet")] and made.sense(0.0).time == 7.0
    inner.lag = "the inner fleet is 5 rounds behind: not current"
    assert made.progress == inner.lag


def test_its_safe_stop_stops_the_inner_robots_once() -> None:
    made, inner = platform()
    made.stop(0.0)
    made.stop(0.1)
    before, inner.stopped = made.stopped, True
    assert inner.told == ["the outer robot stops safely"] and (before, made.stopped) == (False, True)
