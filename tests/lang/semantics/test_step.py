"""The meaning of programs, case by case: what an event sees, what counts of what it writes, and what a round is."""

from __future__ import annotations

import pytest

from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.step import Step, initial, round_, run_init, sense
from koordgen.lang.semantics.values import Value
from koordgen.runtime.values.points import Point
from tests.lang.semantics.programs import compiled, event

HEAD = """
using Motion:
  sensors: Point position
  actuators: Point target
param float half = 0.5
allread: int x[N_SYS] = 7
allwrite: int total = 1
local: int count
  float level
  bool on = True
"""


def after(events: str, robots: int = 3, rounds: int = 1, skipping: tuple[int, ...] = ()) -> tuple[State, list[Step]]:
    program = compiled(HEAD + events)
    state, steps = run_init(program, initial(program, robots))
    for _ in range(rounds):
        state, steps = round_(program, state, skipping)
    return state, steps


def value(expression: str, name: str = "level") -> Value:
    """What `name = expression` leaves in a local of robot 1 of 3."""
    state, steps = after(event(f"{name} = {expression}"))
    assert isinstance(steps[1].outcome, Writes), steps[1].outcome
    return state.robots[1].locals[name]


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("7 // 2", 3), ("-7 // 2", -4), ("-7 % 2", 1), ("7 % -2", -1), ("pid", 1), ("N_SYS", 3), ("min(2, 1)", 1),
        ("max(2, 3) - abs(-4)", -1), ("1 if pid == 1 else 2", 1), ("x[pid] + x[0]", 14),
    ],
)  # fmt: skip
def test_ints_are_pythons(expression: str, expected: int) -> None:
    found = value(expression, "count")
    assert found == expected and type(found) is int


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("7 / 2", 3.5), ("4 / 2", 2.0), ("-7.5 // 2", -4.0), ("-7.5 % 2", 0.5), ("half", 0.5), ("3", 3.0),
        ("9007199254740993 / 9007199254740993", 1.0), ("9223372036854775807 / 3", 9223372036854775807 / 3),
        ("sqrt(2)", 2**0.5), ("distance(Point(0, 3, 0), Point(4, 0, 0))", 5.0), ("(Point(1, 2, 3) * 2).y", 4.0),
        ("(2 * Point(1, 2, 3) - Point(1, 1, 1) / 4).z", 5.75), ("(-Point(1, 2, 3)).x", -1.0),
    ],
)  # fmt: skip
def test_floats_are_pythons(expression: str, expected: float) -> None:
    found = value(expression)
    assert found == expected and type(found) is float


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("0 <= pid < N_SYS", True), ("0 < pid < 1", False), ("pid == 1.0", True),
        ("Point(1, 2, 3) == Point(1, 2, 3)", True),
        ("on or x[count - 1] == 0", True), ("not on and x[count - 1] == 0", False),
    ],
)  # fmt: skip
def test_conditions_decide_as_far_as_they_must(expression: str, expected: bool) -> None:
    assert value(expression, "on") is expected


@pytest.mark.parametrize(
    ("effect", "reason"),
    [
        ("count = x[count - 1]", "index -1 names no robot (0 to 2)"),
        ("count = x[count + 3]", "index 3 names no robot"),
        ("level = 1 / level", "division by zero"),
        ("count = 1 % count", "modulo"),
        ("level = sqrt(level - 1)", "domain"),
        ("count = 9223372036854775807 * 9223372036854775807\ncount = count * count * count * count * count * count\n"
         "count = count * count * count\nlevel = count", "too large"),
        ("x[pid] = 9223372036854775807 + 1", "no robot may use"),
        ("total = -9223372036854775807 - 2", "no robot may use"),
        ("Motion.target = Point(1e308 * 10, 0, 0)", "no robot may use"),
        ("Motion.target = Point(0, 1e308 * 10 - 1e308 * 10, 0)", "no robot may use"),
    ],
)  # fmt: skip
def test_what_fails_discards_the_event_whole(effect: str, reason: str) -> None:
    state, steps = after(event(f"on = False\ntotal = 5\n{effect}"))
    start, _ = after(event("on = False", "False"))
    assert state == start._replace(round=2)
    outcome = steps[0].outcome
    assert isinstance(outcome, Discarded) and reason in outcome.reason
    assert outcome.span.line > 10


def test_ints_are_unbounded_inside_an_event_and_at_the_limit_outside() -> None:
    state, _ = after(event("count = 9223372036854775807 + 1\ntotal = count - 1\nx[pid] = -count\ncount = 0"))
    assert state.store.cells["total"] == 2**63 - 1
    assert state.store.slots["x"] == (-(2**63),) * 3


@pytest.mark.parametrize("variable", ["count", "total", "x[pid]"])
def test_an_int_beyond_64_bits_is_no_last_value(variable: str) -> None:
    state, steps = after(event(f"count = 9223372036854775807\n{variable} = count * count"))
    assert all(isinstance(s.outcome, Discarded) for s in steps)
    assert state.robots[0].locals["count"] == 0


def test_a_very_long_int_is_told_without_its_digits() -> None:
    squared = "\n".join(["count = count * count"] * 6)
    _, steps = after(event(f"count = 1000000000000\n{squared}\ntotal = count"))
    assert isinstance(steps[0].outcome, Discarded)
    assert "an int beyond 64 bits" in steps[0].outcome.reason


def test_an_infinite_value_that_is_overwritten_does_no_harm() -> None:
    state, _ = after(
        event("Motion.target = Point(1e308 * 10, 0, 0)\nlevel = 1e308 * 10\nMotion.target = Point(1, 0, 0)\nlevel = 2")
    )
    assert state.robots[0].ports["Motion.target"] == Point(1.0, 0.0, 0.0)
    assert state.robots[0].locals["level"] == 2.0


def test_a_guard_that_fails_discards_and_no_later_event_runs() -> None:
    state, steps = after("A:\n  pre: x[count - 1] > 0\n  eff: pass\nB:\n  pre: True\n  eff: on = False\n")
    assert [(s.event, type(s.outcome)) for s in steps] == [("A", Discarded)] * 3
    assert all(r.locals["on"] for r in state.robots)


def test_an_event_reads_its_own_writes_and_others_see_them_next_round() -> None:
    effect = "x[pid] = pid * 10\ncount = x[pid] + x[0]\ntotal = total + 1\nlevel = total"
    state, _ = after(event(effect))
    assert [r.locals["count"] for r in state.robots] == [0, 17, 27]  # x[0] is still 7 for robots 1 and 2
    assert [r.locals["level"] for r in state.robots] == [2.0, 2.0, 2.0]
    assert state.store.slots["x"] == (0, 10, 20) and state.store.cells["total"] == 2
    state, _ = after(event(effect), rounds=2)
    assert [r.locals["count"] for r in state.robots] == [0, 10, 20]


def test_of_many_writers_the_highest_pid_wins_and_who_skips_writes_nothing() -> None:
    assert after(event("total = pid"))[0].store.cells["total"] == 2
    assert after(event("total = pid"), skipping=(2,))[0].store.cells["total"] == 1


def test_the_first_enabled_event_in_text_order_runs() -> None:
    text = "A:\n  pre: pid == 1\n  eff: count = 1\nB:\n  pre: pid > 0\n  eff: count = 2\n"
    state, steps = after(text)
    assert [r.locals["count"] for r in state.robots] == [0, 1, 2]
    assert [s.event for s in steps] == [None, "A", "B"] and steps[0].outcome is None


def test_stop_ends_the_event_keeps_its_writes_and_is_for_good() -> None:
    state, steps = after(event("count = count + 1\nif pid == 1:\n  stop\ncount = count + 10"), rounds=2)
    assert [r.locals["count"] for r in state.robots] == [22, 1, 22]
    assert [r.stopped for r in state.robots] == [False, True, False]
    assert [s.pid for s in steps] == [0, 2]


def test_init_runs_before_round_one_and_sees_ports_and_params() -> None:
    program = compiled(f"{HEAD}init:\n  x[pid] = pid + 1\n  Motion.target = Motion.position * half\n{event('pass')}")
    places: list[dict[str, Value]] = [{"Motion.position": Point(2.0 * i, 0.0, 0.0)} for i in range(3)]
    before = initial(program, 3, places)
    assert (before.round, before.store.slots["x"]) == (0, (7, 7, 7))
    state, _ = run_init(program, before)
    assert (state.round, state.store.slots["x"]) == (1, (1, 2, 3))
    assert state.robots[2].ports["Motion.target"] == Point(2.0, 0.0, 0.0)
    assert before.store.slots["x"] == (7, 7, 7)  # no state is ever changed


MOVING = "using Motion:\n  sensors:\n    Point position\n    bool reached\n  actuators: Point target\n"


def test_an_unset_target_is_where_the_robot_is() -> None:
    here: dict[str, Value] = {"Motion.position": Point(2.0, 1.0, 0.0)}
    program = compiled(f"{MOVING}{event('pass')}")
    assert initial(program, 1, [here]).robots[0].ports["Motion.target"] == Point(2.0, 1.0, 0.0)
    given = {**here, "Motion.target": Point(5.0, 0.0, 0.0)}
    assert initial(program, 1, [given]).robots[0].ports["Motion.target"] == Point(5.0, 0.0, 0.0)


def test_who_is_given_a_new_goal_has_not_reached_it() -> None:
    reached: list[dict[str, Value]] = [{"Motion.reached": True}] * 2
    program = compiled(MOVING + event("if pid == 0:\n  Motion.target = Point(1, 1, 1)"))
    state, _ = run_init(program, initial(program, 2, reached))
    state, _ = round_(program, state)
    assert [r.ports["Motion.reached"] for r in state.robots] == [False, True]


def test_the_environment_moves_sensors_only() -> None:
    state, _ = after(event("Motion.target = Point(1, 1, 1)"), robots=1)
    moved = sense(state, [{"Motion.position": Point(1.0, 1.0, 1.0)}])
    assert moved.robots[0].ports == {
        "Motion.position": Point(1.0, 1.0, 1.0), "Motion.target": Point(1.0, 1.0, 1.0)
    }  # fmt: skip
    assert moved.store == state.store


def test_temporaries_of_two_branches_do_not_meet() -> None:
    state, _ = after(
        event("if pid == 0:\n  int a = 1\n  count = a\nelse:\n  float a = 2.5\n  level = a\nint a = 9\ntotal = a")
    )
    assert [r.locals["count"] for r in state.robots] == [1, 0, 0]
    assert [r.locals["level"] for r in state.robots] == [0.0, 2.5, 2.5]
    assert state.store.cells["total"] == 9


def test_lineform_lines_up() -> None:
    """Robots that reach their target within a round converge to even spacing on the line between the outer ones."""
    from pathlib import Path

    text = (Path(__file__).parents[3] / "examples/lineform/lineform.koord").read_text(encoding="utf-8")
    program = compiled(text)
    places = [Point(0.0, 0.0, 1.0), Point(5.0, 3.0, 1.0), Point(-2.0, 9.0, 1.0), Point(9.0, 0.0, 1.0)]
    state, _ = run_init(program, initial(program, 4, [{"Motion.position": p, "Motion.target": p} for p in places]))
    for _ in range(200):
        state, _ = round_(program, state)
        state = sense(state, [{"Motion.position": r.ports["Motion.target"]} for r in state.robots])
    for pid, robot in enumerate(state.robots):
        place = robot.ports["Motion.position"]
        assert isinstance(place, Point)
        assert (place.x, place.y, place.z) == pytest.approx((3.0 * pid, 0.0, 1.0), abs=1e-6)
