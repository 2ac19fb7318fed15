"""Rounds of transactions, all choices that the language allows, and what properties say of states."""

from __future__ import annotations

import pytest

from koordgen.lang.ir import decl, expr
from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.types import BOOL, POINT, list_of
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import NoMeaning, Writes
from koordgen.lang.semantics.property import Asked, holds_assumption, holds_property
from koordgen.lang.semantics.relations import choices, end, post, reach, rounds
from koordgen.lang.semantics.state import State, World, nobody
from koordgen.lang.semantics.step import applied, initial, round_, run_init
from koordgen.lang.semantics.values import Value
from koordgen.lang.source import Span
from koordgen.runtime.values.points import Point
from tests.lang.semantics.programs import compiled

ATOMIC = """
allwrite: int sum
  int other
local: bool done
Add:
  pre: not done and pid != 3
  eff: atomic:
    sum += pid + 1
    done = True
Plain:
  pre: True
  eff: other = pid + 10 * sum
"""


def started(text: str, robots: int) -> tuple[Program, State]:
    program = compiled(text)
    return program, run_init(program, initial(program, robots))[0]


def test_of_one_lock_one_transaction_commits_a_round_and_who_lacks_the_right_skips() -> None:
    program, state = started(ATOMIC, 4)
    sums, others = [], []
    for _ in range(4):
        state, steps = round_(program, state)
        sums.append(state.store.cells["sum"])
        others.append([(s.pid, s.event) for s in steps])
    assert sums == [1, 3, 6, 6]
    assert others[0] == [(0, "Add"), (1, None), (2, None), (3, "Plain")]  # a later event is no way out
    assert others[2] == [(2, "Add"), (0, "Plain"), (1, "Plain"), (3, "Plain")]  # commits come first
    assert state.store.cells["other"] == 3 + 10 * 6


def test_rights_may_be_given() -> None:
    program, state = started(ATOMIC, 3)
    state, steps = round_(program, state, grants={0: 2})
    assert state.store.cells["sum"] == 3 and [r.locals["done"] for r in state.robots] == [False, False, True]
    state, steps = round_(program, state, grants={})
    assert state.store.cells["sum"] == 3 and [s.event for s in steps] == [None, None, "Plain"]


def test_plain_writes_come_after_commits_and_both_see_the_rounds_start() -> None:
    text = ATOMIC.replace("other = pid + 10 * sum", "sum = sum + 100")
    program, state = started(text, 4)
    state, _ = round_(program, state)
    assert state.store.cells["sum"] == 100  # robot 3's; robot 0's commit is lost


def test_two_locks_are_had_in_one_round() -> None:
    text = (
        "allwrite: int a\n  int b\nA:\n  pre: pid % 2 == 0\n  eff: atomic: a = a + 1\n"
        "B:\n  pre: True\n  eff: atomic: b = b + 1\n"
    )
    program, state = started(text, 4)
    assert len(program.locks) == 2
    state, steps = round_(program, state)
    assert state.store.cells == {"a": 1, "b": 1}
    assert [s.event for s in steps] == ["A", "B", None, None]


def test_a_discarded_transaction_changes_nothing_and_its_right_is_spent() -> None:
    text = "allwrite: int a\nlocal: int n\nA:\n  pre: True\n  eff: atomic:\n    a = 5\n    a = a // (pid + n)\n"
    program, state = started(text, 2)
    state, steps = round_(program, state)
    assert state.store.cells["a"] == 0 and isinstance(steps[0].outcome, Discarded)
    assert [s.pid for s in steps] == [0, 1] and steps[1].event is None


CHOICES = """
allwrite: int a
local: int n
First:
  pre: n == 0
  eff: n = a + 1
    a = pid + 1
Second:
  pre: True
  eff: n = 9
Faulty:
  pre: 1 // n == 0
  eff: pass
Bad:
  pre: True
  eff: n = 1 // n
"""


def test_a_robot_may_run_any_enabled_event_or_none() -> None:
    program, state = started(CHOICES, 2)
    assert [c.event for c in choices(program, state, 1)] == [None, "First", "Second"]
    stopped = state._replace(robots=tuple([r._replace(stopped=True) for r in state.robots]))
    assert [c.event for c in choices(program, stopped, 1)] == [None]


def test_plain_events_see_the_rounds_start_and_transactions_the_state_as_it_is() -> None:
    for word, expected in (("a = a + 1", 1), ("atomic: a = a + 1", 2)):
        program, state = started(f"allwrite: int a\nE:\n  pre: a < 2\n  eff: {word}\n", 2)
        both = [s for s in post(program, state, (0, 1)) if s.store.cells["a"]]
        assert max(s.store.cells["a"] for s in both) == expected  # type: ignore[type-var]


def test_no_robot_no_change() -> None:
    program, state = started(CHOICES, 2)
    assert post(program, state, ()) == [state]
    assert reach(program, [state], lambda s: [s], 0) == [state]


def test_what_agents_do_is_one_of_the_choices() -> None:
    for text in (ATOMIC, CHOICES):
        program, state = started(text, 3)
        for _ in range(2):
            after, _ = round_(program, state)
            assert after in rounds(program, state)
            state = after


def test_every_order_and_every_skip_is_in_a_round() -> None:
    program, state = started("allwrite: int a\nE:\n  pre: True\n  eff: a = pid + 1\n", 3)
    assert sorted(s.store.cells["a"] for s in rounds(program, state)) == [0, 1, 2, 3]  # type: ignore[type-var]


def test_the_environment_moves_all_after_every_round() -> None:
    text = "using M:\n  sensors: int s\nlocal: int n\nE:\n  pre: n < 2\n  eff: n = n + M.s\n"
    program, state = started(text, 1)

    def environment(state: State) -> list[State]:
        return [
            state._replace(robots=tuple([r._replace(ports={"M.s": value}) for r in state.robots])) for value in (1, 2)
        ]

    assert len(end([state], environment)) == 2
    found = reach(program, [state], environment, 2)
    assert {s.robots[0].locals["n"] for s in found} == {0, 1, 2}
    assert all(s.round == 3 for s in found)


PROPERTIES = """
param Point lo = Point(-5, -5, 0)
param Point hi = Point(5, 5, 3)
param float eps = 0.5
spec fun calm(Point a) -> bool
fun near(Point a, Point b) -> bool:
  return distance(a, b) <= eps
using Motion:
  sensors: Point position
  actuators: Point target
  PathPlanner planner
  assume position' in Rect(position, target)
  assume pid < 1 or N_SYS == 2
allread: Point x[N_SYS]
allwrite: int sum
  List<int> few
local: int n
Go:
  pre: True
  eff: x[pid] = Motion.position
    n = pid
    sum = 3
initially: forall i in ID: Motion.position[i] in Rect(lo, hi)
invariant Separation:
  forall i, j in ID: i == j or not near(Motion.position[i], Motion.position[j])
invariant Counts: exists i in ID: n[i] == N_SYS - 1 and sum == 3
invariant Steps: forall i in range(1, N_SYS): n[i] == n[i - 1] + 1 and x[i].x > x[i - 1].x
invariant Few: forall k in few: k > 0
invariant Whole: len(x) == N_SYS
invariant Beyond: x[N_SYS - 1 + sum] == lo
invariant Calm: forall i in ID: calm(x[i])
"""


def _planned() -> decl.Assumption:
    """`assume planner(target) == [] or first(planner(target)) == position`"""
    position, target = (expr.PortRead("Motion", name, False, POINT, AT) for name in ("position", "target"))
    way = expr.PortCall("Motion", "planner", (target,), list_of(POINT), AT)
    none = expr.Compare("==", way, expr.Make((), list_of(POINT), AT), BOOL, AT)
    from_here = expr.Compare("==", expr.Builtin("first", (way,), POINT, AT), position, BOOL, AT)
    return decl.Assumption(expr.Logic("or", none, from_here, BOOL, AT), AT)


AT = Span(1, 1, 1, 2)
PLANS = _planned()


def _spread(distance: float) -> tuple[Program, State]:
    program = compiled(PROPERTIES)
    places: list[dict[str, Value]] = [{"Motion.position": Point(distance * i, 0.0, 0.0)} for i in range(3)]
    state, _ = run_init(program, initial(program, 3, places))
    return program, round_(program, state)[0]


def _truths(program: Program, state: State) -> dict[str, bool]:
    kept = [p for p in program.properties if p.name not in ("Beyond", "Calm")]
    return {p.name: holds_property(p, program, state) for p in kept}


def test_properties_are_of_the_store_and_of_every_robot() -> None:
    program, state = _spread(1.0)
    assert set(_truths(program, state).values()) == {True}
    program, state = _spread(0.4)
    assert [name for name, holds in _truths(program, state).items() if not holds] == ["Separation"]
    program, state = _spread(4.0)
    assert [name for name, holds in _truths(program, state).items() if not holds] == [""]
    cells: dict[str, Value] = {"sum": 2, "few": (1, 0)}
    state = state._replace(store=state.store._replace(cells=cells))
    assert [name for name, holds in _truths(program, state).items() if not holds] == ["", "Counts", "Few"]


def test_a_property_may_have_no_value_or_no_meaning() -> None:
    program, state = _spread(1.0)
    beyond, calm = program.properties[-2:]
    with pytest.raises(Discarded, match="names no robot"):
        holds_property(beyond, program, state)
    with pytest.raises(NoMeaning, match="calm"):
        holds_property(calm, program, state)
    assert holds_property(calm, program, state, World({"calm": lambda p: p.x >= 0}, nobody))


def test_assumptions_are_of_one_robots_ports_before_and_after() -> None:
    program, _ = _spread(1.0)
    box, which = program.modules[0].assumptions
    before: dict[str, Value] = {"Motion.position": Point(0.0, 0.0, 0.0), "Motion.target": Point(2.0, 2.0, 0.0)}

    def holds(x: float) -> bool:
        after: dict[str, Value] = {**before, "Motion.position": Point(x, 1.0, 0.0)}
        return holds_assumption(box, program, before, after, 0, 3, {})

    assert holds(1.0) and holds(2.0) and not holds(2.1)
    for way, expected in (((), True), ((Point(),), True), ((Point(1.0, 0.0, 0.0),), False)):
        world = World({}, lambda pid, port, args, way=way: way)  # type: ignore[misc]
        assert holds_assumption(PLANS, program, before, before, 0, 3, {}, world) is expected
    assert holds_assumption(which, program, {}, {}, 0, 3, {}) and holds_assumption(which, program, {}, {}, 1, 2, {})
    assert not holds_assumption(which, program, {}, {}, 1, 3, {})


GOALS = """\
using Motion:
  sensors: Point position
  PathPlanner planner
  assume planner(goal) == [] or last(planner(goal)) == goal
  assume planner(goal) == [] or planner(goal, walls) == [] or len(walls) > 0
Go:
  pre: True
  eff: pass
"""


def test_what_is_assumed_for_all_goals_is_held_to_the_calls_that_were_made() -> None:
    program = compiled(GOALS)
    ends, both = program.modules[0].assumptions
    here, there = Point(), Point(1.0, 0.0, 0.0)

    def holds(assumption: decl.Assumption, *asked: Asked) -> bool:
        ports: dict[str, Value] = {"Motion.position": here}
        return holds_assumption(assumption, program, ports, ports, 0, 3, {}, asked=asked)

    right, none = Asked("Motion.planner", (there,), (here, there)), Asked("Motion.planner", (here,), ())
    assert holds(ends) and holds(ends, right, none)
    assert not holds(ends, right, Asked("Motion.planner", (here,), (here, there)))
    around = Asked("Motion.planner", (there, ()), (there,))
    assert holds(both, right) and holds(both, around) and holds(both, none, around)
    assert not holds(both, right, around)
    assert holds(both, right, Asked("Motion.planner", (here, ()), (here,)))  # of another goal
    points = Asked("Motion.planner", (there, (here,)), (there,))
    assert holds(both, right, points)  # obstacles of another type


def test_a_step_is_applied_whole() -> None:
    program, state = started(CHOICES, 2)
    for step in choices(program, state, 1):
        after = applied(program, state, step)
        assert (after == state) is (step.outcome is None)
        if isinstance(step.outcome, Writes):
            assert after.robots[1].locals == step.outcome.locals and after.robots[0] == state.robots[0]
