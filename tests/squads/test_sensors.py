"""States of the inner fleet that an outer robot reads: none that a view change may discard."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from koordgen.runtime.agent.squad import SensorValues, Squad
from koordgen.runtime.values import turns
from koordgen.runtime.values.points import Point
from tests.squads.levels import Levels
from tests.squads.test_hosts import LINE


def test_an_outer_robot_reads_the_newest_committed_state() -> None:
    levels = Levels(LINE, [3, 0, 0])
    levels.run_rounds(3)
    node = levels.host(0)
    assert node is not None and node.host is not None and node.agent.state is not None
    host, real = node.host, node.agent.state.shared

    def store(x: float) -> dict[str, Any]:
        return {**real, "triangle.corner": (Point(x), Point(x), Point(x))}

    def reads(applied: int, committed: int, shared: dict[str, Any]) -> tuple[Any, float]:
        state = SimpleNamespace(applied=applied, committed=committed, shared=shared)
        host._inner = SimpleNamespace(state=state, began=float)  # type: ignore[assignment]
        values, time = host.values()
        return values["Motion.position"], time

    one, two, three, again = (store(x) for x in (1.0, 2.0, 3.0, 4.0))
    assert reads(1001, 1001, one) == (Point(1), 1001.0)
    assert reads(1002, 1001, two) == (Point(1), 1001.0), "round 1002 is not committed"
    assert reads(1003, 1002, three) == (Point(2), 1002.0)
    assert reads(1003, 1002, again) == (Point(2), 1002.0), "a view change replaced the state after round 1003"
    assert reads(1003, 1003, again) == (Point(4), 1003.0)


def values_of(*sensors: Callable[[Any], Any]) -> list[Any]:
    """Return the values of sensors that are these functions of the inner state."""
    levels = Levels(LINE, [3, 0, 0])
    levels.run_rounds(1)
    node = levels.host(0)
    assert node is not None and node.host is not None and node.agent.state is not None
    named = {f"Motion.s{number}": sensor for number, sensor in enumerate(sensors)}
    values = SensorValues(Squad(0, named, {}, levels.outer_program), node.host.fleet)
    return list(values.of(node.agent.state.shared).values())


def test_an_expression_that_fails_has_no_value() -> None:
    def fails(state: Any) -> Any:
        return [][0]

    assert values_of(fails, lambda state: 1) == [None, 1]


def test_the_turns_of_an_expression_are_its_own() -> None:
    def loops(state: Any) -> Any:
        return len(list(turns.turns(range(most))))

    most = turns.MOST_TURNS * 2 // 3
    assert values_of(loops, loops) == [most, most]
