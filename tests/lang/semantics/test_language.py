"""The meaning of the whole language, case by case: values, loops, changes of parts, functions, ports."""

from __future__ import annotations

import pytest

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import decl, expr, stmt
from koordgen.lang.ir.types import INT, list_of
from koordgen.lang.node import replace
from koordgen.lang.semantics import exec
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.state import State, World, nobody
from koordgen.lang.semantics.step import initial, round_
from koordgen.lang.semantics.values import RecordValue, Value, default
from koordgen.lang.source import Span
from koordgen.runtime.values.points import Grid, Point
from tests.lang.semantics.programs import after, compiled, event, local

HEAD = """
def Task:
  Point target
  int id = 7
  List<int> marks
allread: List<int> found[N_SYS]
local:
  List<int> xs = [3, 1, 2]
  List<float> fs = [1.5, 2.5]
  List<List<int>> nested = [[1], [2, 3]]
  List<(string, int)> pairs = [("b", 1), ("a", 2)]
  Queue<int> jobs = [4, 5]
  Set<int> ids = {3, 1}
  Map<string, int> seen = {"b": 2, "a": 1}
  Map<string, List<int>> lists = {"a": [1]}
  (int, string) best = (1, "x")
  string text = "naïve"
  Task task
  List<Task> tasks = [Task(), Task(id=9)]
  Point place
  GridMap area = GridMap(Point(0, 0, 0), Point(1, 1, 0), 0.5)
  int n
  float f
  bool on
"""


def value(effect: str, name: str = "n") -> Value:
    return local(HEAD + event(effect), name)


def reason(effect: str, head: str = HEAD) -> str:
    """Why an effect is discarded."""
    state, steps = after(head + event(effect), 1)
    outcome = steps[0].outcome
    assert isinstance(outcome, Discarded), outcome
    assert state.robots[0].locals == initial(compiled(head + event("pass")), 1).robots[0].locals
    return outcome.reason


@pytest.mark.parametrize(
    ("effect", "name", "expected"),
    [
        ("xs.append(9)", "xs", (3, 1, 2, 9)),
        ("xs.extend([8, 9])", "xs", (3, 1, 2, 8, 9)),
        ("xs.insert(0, 9)\nxs.insert(4, 8)", "xs", (9, 3, 1, 2, 8)),
        ("xs.append(1)\nxs.remove(1)", "xs", (3, 2, 1)),
        ("n = xs.pop()", "xs", (3, 1)),
        ("n = xs.pop(0)", "xs", (1, 2)),
        ("n = xs.pop(0)", "n", 3),
        ("n = 0\nn = xs.pop(n)", "n", 3),
        ("n = 0\nn = xs.pop(n)", "xs", (1, 2)),
        ("int k = 1\nk = xs.pop(k + 1)\nn = k", "xs", (3, 1)),
        ("xs.clear()", "xs", ()),
        ("xs[1] = 9", "xs", (3, 9, 2)),
        ("xs[1] += 9", "xs", (3, 10, 2)),
        ("nested[1][0] = 9", "nested", ((1,), (9, 3))),
        ("nested[0].append(9)", "nested", ((1, 9), (2, 3))),
        ("nested.append(xs)\nnested[2][0] = 8", "xs", (3, 1, 2)),
        ("jobs.push(6)", "jobs", (4, 5, 6)),
        ("n = jobs.pop()", "n", 4),
        ("n = jobs.pop()", "jobs", (5,)),
        ("ids.add(2)\nids.add(1)", "ids", (1, 2, 3)),
        ("ids.remove(3)", "ids", (1,)),
        ('seen["c"] = 3\nseen["a"] = 9', "seen", (("a", 9), ("b", 2), ("c", 3))),
        ('seen.remove("a")', "seen", (("b", 2),)),
        ('lists["a"].append(2)', "lists", (("a", (1, 2)),)),
        ("task.id = 3", "task", RecordValue("Task", (Point(), 3, ()))),
        ("task.marks.append(3)", "task", RecordValue("Task", (Point(), 7, (3,)))),
        ("tasks[1].target = Point(1, 0, 0)\ntask = tasks[1]", "task", RecordValue("Task", (Point(1.0), 9, ()))),
        ("found[pid].append(4)\nxs = found[pid]", "xs", (4,)),
    ],
)  # fmt: skip
def test_changes_of_parts(effect: str, name: str, expected: Value) -> None:
    assert value(effect, name) == expected


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("xs[2]", 2), ("first(xs)", 3), ("last(xs)", 2), ("len(xs)", 3), ("sum(xs)", 6), ("xs.index(2)", 2),
        ("(xs + [1]).count(1)", 2), ("last(sorted(xs))", 3), ("first(reversed(xs))", 2), ("len(xs[1:9])", 2),
        ("xs[:2][1]", 1), ("len(xs[2:1])", 0), ("first(jobs)", 4), ("jobs[1]", 5), ("len(ids.union({9, 3}))", 3),
        ("len(ids.intersection({9, 3}))", 1), ("len(ids.difference({9, 3}))", 1), ('seen["b"]', 2),
        ('seen.get("z", 8)', 8), ("first(seen.values())", 1), ("first(seen.items())[1]", 1), ("best[0]", 1),
        ("len(text)", 5), ("task.id", 7), ("floor(-1.5)", -2), ("ceil(-1.5)", -1), ("round(2.5)", 2),
        ("round(-3.5)", -4),
        ("2 ** 3 ** 2", 512), ("-2 ** 2", -4), ("(-1) ** 1000000001", -1), ("len(seen.keys())", 2),
        ("cell(Point(-0.1, 1.2, 0), 0.5).x", -1), ("7 if 1 in xs else 8", 7),
    ],
)  # fmt: skip
def test_ints(expression: str, expected: int) -> None:
    found = value(f"n = {expression}")
    assert found == expected and type(found) is int


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("sum(fs)", 4.0), ("sum(fs[2:])", 0.0), ("2.0 ** 0.5", 2**0.5), ("2 ** 0.5", 2**0.5),
        ("atan2(1, 0)", 1.5707963267948966),
        ("pi", 3.141592653589793), ("max(1, 2.5)", 2.5), ("center(Grid(1, 2, 0.5)).y", 1.25), ("exp(0)", 1.0),
        ("path_distance([Point(0, 0, 0), Point(4, 0, 0)], [Point(2, 3, 0)])", 3.0),
        ("Pose(Point(1, 2, 3), 0.5).yaw", 0.5), ("Pose(Point(1, 2, 3), 0.5).position.z", 3.0),
    ],
)  # fmt: skip
def test_floats(expression: str, expected: float) -> None:
    found = value(f"f = {expression}", "f")
    assert found == expected and type(found) is float


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("3 in xs and 4 not in xs", True), ('"a" in seen', True), ('"aï" in text', True), ('"nv" in text', False),
        ("5 in jobs", True), ("Point(1, 1, 1) in Rect(Point(1, 2, 0), Point(0, 0, 2))", True),
        ("Point(1, 2.1, 1) in Rect(Point(1, 2, 0), Point(0, 0, 2))", False),
        ("Point(3, 0, 4) in Ball(Point(0, 0, 0), 5)", True), ('"a" < "b"', True), ("ids == {1, 3}", True),
        ("xs == [3, 1, 2] and nested != [[1]]", True), ("task == Task()", True), ('best == (1, "x")', True),
        ("is_known(area, Grid(0, 0, 0.5))", False),
        ("is_free(mark_free(area, Grid(1, 1, 0.5)), Grid(1, 1, 0.5))", True),
        ("is_occupied(merge(area, mark_occupied(area, Grid(1, 1, 0.5))), Grid(1, 1, 0.5))", True),
        ("clear([place], [[Point(1, 0, 0)], []], 0.5)", True), ("clear([place], [[Point(1, 0, 0)]], 1.0)", False),
        ("len(xs) > 5 and xs[5] == 0", False), ("len(xs) < 5 or xs[5] == 0", True),
    ],
)  # fmt: skip
def test_conditions(expression: str, expected: bool) -> None:
    assert value(f"on = {expression}", "on") is expected


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ('text + "!"', "naïve!"), ("text[2]", "ï"), ("text[1:3]", "aï"), ("str(3)", "3"), ("str(0.5)", "0.5"),
        ("str(1e300)", "1e+300"), ("str(True)", "True"), ("str(text)", "naïve"),
        ("str(Point(1, 0.5, -2))", "(1.0, 0.5, -2.0)"),
    ],
)  # fmt: skip
def test_strings(expression: str, expected: str) -> None:
    assert value(f"text = {expression}", "text") == expected


@pytest.mark.parametrize(
    ("effect", "why"),
    [
        ("xs.remove(9)", "not there"), ("ids.remove(9)", "not there"), ('seen.remove("z")', "not there"),
        ('n = seen["z"]', "no such key"), ("n = xs.index(9)", "not there"), ("n = xs[n + 7]", "index 7"),
        ("n = xs[n - 1]", "index -1"), ("xs.insert(n + 4, 0)", "no place"), ("xs = xs[n - 1:]", "slice"),
        ("xs.clear()\nn = first(xs)", "index 0"), ("xs.clear()\nn = xs.pop()", "index"), ("n = 2 ** (n - 1)", "power"),
        ("n = 2 ** 1025", "exponent"), ("f = (n - 1.0) ** 0.5", "domain"), ("f = 0.0 ** (n - 1.0)", "domain"),
        ("f = log(n)", "domain"), ("f = exp(n + 1000)", "range"), ("n = floor(1e308 * 10)", "infinity"),
        ("area = mark_free(area, Grid(9, 9, 0.5))", "outside"), ("area = mark_free(area, Grid(0, 0, 1))", "cell"),
        ("area = GridMap(Point(1, 1, 0), Point(0, 0, 0), 0.5)", "corner"),
        ("while True: n += 1", "not finished"), ("for i in range(9999999): n = i", "not finished"),
    ],
)  # fmt: skip
def test_what_has_no_value_discards(effect: str, why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exec, "MAX_TURNS", 1000)
    assert why in reason(f"on = True\n{effect}")


@pytest.mark.parametrize(
    ("effect", "expected"),
    [
        ("for x in xs:\n  xs.append(x)\n  n += x", 6),
        ("for x in xs:\n  x = 10\n  n += x", 30),
        ("for i in range(5): n += i", 10),
        ("for i in range(5, 0, -2): n = n * 10 + i", 531),
        ("for i in range(3, 3): n = 9", 0),
        ("for i in ID: n += 1", 1),
        ("for x in ids: n = n * 10 + x", 13),
        ("for x in jobs: n = n * 10 + x", 45),
        ("for k in seen: n = n * 10 + seen[k]", 12),
        ("for name, x in pairs:\n  if name == \"a\": n = x", 2),
        ("for k, v in seen.items(): n = n * 10 + v", 12),
        ("for ms in found: n += 1 + len(ms)", 1),
        ("for x in xs:\n  if x == 1: continue\n  n = n * 10 + x", 32),
        ("for x in xs:\n  if x == 1: break\n  n = n * 10 + x", 3),
        ("for x in xs:\n  for y in xs:\n    if y == x: break\n    n += 1", 3),
        ("while n < 7: n += 2", 8),
        ("while True:\n  n += 1\n  if n < 3: continue\n  break", 3),
        ("for x in xs:\n  n = x\n  if x == 1: stop\nn = 9", 1),
    ],
)  # fmt: skip
def test_loops(effect: str, expected: int) -> None:
    assert value(effect) == expected


def test_a_while_goes_on_while_its_condition_holds_and_forgets_its_blocks_variables() -> None:
    assert value("while n < 3:\n  int k = n\n  k += 1\n  n = k", "n") == 3


FUNCTIONS = """
param float near = 2.0
fun twice(int a) -> int:
  a = a * 2
  return a
fun closest(List<Point> ps, Point p) -> Point:
  Point best = p
  float least = near
  for q in ps:
    if distance(p, q) == 0: return q
    if distance(p, q) < least:
      best = q
      least = distance(p, q)
  return best
fun four(int a) -> int:
  return twice(twice(a))
fun total(int each[N_SYS]) -> int:
  int all = 0
  for i in range(len(each)): all += each[i]
  return all
fun loops(int a) -> int:
  while True:
    a += 1
    if a > 10: return a
allread: int x[N_SYS] = 2
local:
  int n = 3
  Point p
"""


@pytest.mark.parametrize(
    ("expression", "expected"),
    [("twice(n)", 6), ("four(n)", 12), ("total(x)", 2), ("loops(n)", 11), ("n + twice(n)", 9)],
)
def test_functions(expression: str, expected: int) -> None:
    assert local(FUNCTIONS + event(f"n = {expression}"), "n") == expected


def test_a_functions_first_return_ends_it_and_params_are_its_constants() -> None:
    call = "p = closest([Point(3, 0, 0), Point(1, 0, 0), Point(0, 1.5, 0)], p)"
    assert local(FUNCTIONS + event(call), "p") == Point(1.0, 0.0, 0.0)


EXTERN = """
extern type Ticket
extern fun rank(List<int> xs, Ticket t) -> int:
  requires: len(xs) > 0
  ensures: result >= 0
local:
  Ticket t
  int n = 2
  List<int> xs = [1]
"""


def ranked(found: Value, effect: str = "n = rank(xs, t)") -> Writes | Discarded | None:
    world = World({"rank": lambda xs, t: found}, nobody)
    return after(EXTERN + event(effect), 1, world=world)[1][0].outcome


def test_extern_functions_are_called_under_their_contracts() -> None:
    outcome = ranked(7)
    assert isinstance(outcome, Writes) and outcome.locals["n"] == 7
    for found, effect, why in (
        (-1, "n = rank(xs, t)", "ensures"),
        (7, "n = rank([], t)", "requires"),
        (7.0, "n = rank(xs, t)", "which is not of type int"),
        (True, "n = rank(xs, t)", "which is not of type int"),
    ):
        outcome = ranked(found, effect)
        assert isinstance(outcome, Discarded) and why in outcome.reason
    outcome = after(EXTERN + event("n = rank(xs, t)"), 1)[1][0].outcome  # there is none
    assert isinstance(outcome, Discarded) and "KeyError" in outcome.reason


PORTS = """
using Motion:
  sensors: Point position
  actuators: List<Point> path
  PathPlanner planner
using Log:
  stream stdout
local:
  int n
  List<Grid> walls = [Grid(1, 2, 0.5)]
"""


def planned(effect: str) -> tuple[State, Writes | Discarded | None]:
    def answer(pid: int, port: str, args: tuple[Value, ...]) -> Value:
        assert (pid, port) == (0, "Motion.planner")
        if len(args) == 2:
            return (args[0], Point(9.0, 0.0, 0.0)) if args[1] == (Grid(1, 2, 0.5),) else 3
        raise RuntimeError("no map")

    state, steps = after(PORTS + event(effect), 1, world=World({}, answer))
    return state, steps[0].outcome


def test_a_port_call_is_an_input() -> None:
    state, _ = planned("Motion.path = Motion.planner(Motion.position, walls)\nn = len(Motion.path)")
    assert state.robots[0].ports["Motion.path"] == (Point(), Point(9.0, 0.0, 0.0))
    assert state.robots[0].locals["n"] == 2
    for effect, why in (
        ("(Motion.position)", "no map"),
        ("(Motion.position, [Grid(0, 0, 1)])", "not of type List<Point>"),
    ):
        _, outcome = planned(f"Motion.path = Motion.planner{effect}")
        assert isinstance(outcome, Discarded) and why in outcome.reason


def test_streams_get_lines_in_order_when_the_event_counts() -> None:
    _, outcome = planned('Log.stdout << "n is " << n\nn += 1\nLog.stdout << n << ":" << Motion.position\nstop')
    assert isinstance(outcome, Writes) and outcome.stopped
    assert outcome.streams == (("Log.stdout", "n is 0"), ("Log.stdout", "1:(0.0, 0.0, 0.0)"))


KEPT = """
def Box:
  List<int> held max 2
using Motion:
  actuators: List<Point> path
allwrite:
  List<int> few max 2
  string word max 3
  List<float> fs
local:
  List<int> many
  List<string> words max 2, 3
  List<float> own
  Box box
  GridMap area max 4
  int n = 1
"""


@pytest.mark.parametrize(
    ("effect", "why"),
    [
        ("few = [1, 2, 3]", "3 elements where at most 2"), ('word = "naï"', "4 bytes"), ('words = ["abcd"]', "4 bytes"),
        ('words = ["a", "b", "c"]', "3 elements"), ("box.held = [1, 2, 3]", "3 elements"),
        ("area = GridMap(Point(0, 0, 0), Point(3, 2, 0), 1)", "6 cells"),
        ("fs = [1e308 * 10]", "inf"), ("fs = [1e308 * 10 - 1e308 * 10]", "nan"),
        ("own = [1e308 * 10]", "inf"), ("own = [1, 1e308 * 10 - 1e308 * 10]", "nan"),
        ("Motion.path = [Point(0, 1e308 * 10, 0)]", "inf"), ("many = [9223372036854775807 + n]", "64 bits"),
        ("for i in range(5000): many.append(i)", "5000 elements where at most 4096"),
    ],
)  # fmt: skip
def test_what_a_variable_may_not_keep_discards(effect: str, why: str) -> None:
    assert why in reason(effect, KEPT)


def test_a_variable_may_hold_more_while_the_event_runs() -> None:
    state, steps = after(KEPT + event("few = [1, 2, 3]\nmany = few\nfew = few[:2]\nown = [1e308 * 10]\nown = [1]"), 1)
    assert isinstance(steps[0].outcome, Writes), steps
    assert state.store.cells["few"] == (1, 2) and state.robots[0].locals["many"] == (1, 2, 3)
    assert state.robots[0].locals["own"] == (1.0,)


def test_defaults_of_types_and_records() -> None:
    program = compiled(HEAD + "using M:\n  sensors: Task order\n  actuators: (int, Task) both\n" + event("pass"))
    ports = initial(program, 1).robots[0].ports
    task = RecordValue("Task", (Point(), 7, ()))
    assert ports == {"M.order": task, "M.both": (0, task)}
    assert default(list_of(INT), {}) == ()


def test_a_comparison_that_meets_nan_at_any_depth_discards() -> None:
    head = "float nan = 1e308 * 10 - 1e308 * 10\nList<float> ns = [nan]\n"
    for test in ("nan == nan", "ns == ns", "nan in ns", "Point(nan, 0, 0) == Point(nan, 0, 0)", "max(nan, 1) > 0"):
        assert reason(f"{head}on = {test}") == "a comparison met NaN"


AT = Span(1, 1, 1, 2)


def test_what_is_proved_and_fails_is_a_mistake_of_the_compiler() -> None:
    program = compiled(HEAD + event("n = xs[n + 7]"))
    statement = program.events[0].effect[0]
    assert isinstance(statement, stmt.Assign)
    wrong = replace(program.events[0], effect=(replace(statement, value=_proved(statement.value)),))
    with pytest.raises(InternalError, match="proved"):
        round_(replace(program, events=(wrong,)), initial(program, 1))


def _proved(node: expr.Expr) -> expr.Expr:
    assert isinstance(node, expr.At) and not node.proved
    return replace(node, proved=True)


def test_an_extern_default_is_empty() -> None:
    program = compiled(EXTERN + event("pass"))
    assert isinstance(program.externs[0], decl.ExternFunction)
    assert repr(initial(program, 1).robots[0].locals["t"]) == "Opaque(data=b'')"


def violated(effect: str, head: str = HEAD) -> list[int]:
    """The lines of an effect in which loop invariants are false, from 1; it must not be discarded."""
    first = (head + event("")).count("\n")
    outcome = after(head + event(effect), 1)[1][0].outcome
    assert isinstance(outcome, Writes), outcome
    return [span.line - first + 1 for span in outcome.violated]


@pytest.mark.parametrize(
    ("loop", "lines"),
    [
        # before the first turn, before each further turn, and where the condition is false
        ("while n < 3:\n  invariant n <= 3\n  invariant n != 0\n  invariant n != 2\n  n += 1", [3, 4]),
        ("while n < 3:\n  invariant n != 3\n  n += 1", [2]),
        ("while n < 0:\n  invariant n > 0\n  n += 1", [2]),
        # not where it is left in another way
        ("while n < 3:\n  invariant n < 2\n  n += 1\n  if n == 2: break", []),
        ("while n < 3:\n  invariant n < 2\n  n += 1\n  if n == 2: stop", []),
        ("while n < 3:\n  invariant n != 2\n  n += 1\n  continue", [2]),
        # the variable of a loop that counts is the next value
        ("for i in range(2, 5):\n  invariant i != 2\n  invariant i != 4\n  n += 1", [2, 3]),
        ("for i in range(2, 5):\n  invariant i != 5\n  invariant i <= 5\n  n += 1", [2]),
        ("for i in range(5, 0, -2):\n  invariant i != -1\n  invariant i >= -1\n  n += 1", [2]),
        ("for i in range(7, 3):\n  invariant i != 7\n  invariant i == 7\n  n += 1", [2]),
        ("for i in ID:\n  invariant i != 1\n  invariant i <= N_SYS\n  n += 1", [2]),
        ("for i in range(3):\n  invariant i <= 3\n  i = 9\n  n += 1", []),
        ("for x in xs:\n  invariant n < 3\n  invariant n <= 3\n  n += 1", [2]),
        ("for x in xs:\n  invariant n < 3\n  n += 1\n  if n == 3: break", []),
        # once each, whatever it is that it lacks
        ("for x in xs:\n  invariant xs[n] > 0\n  n += 1", [2]),
        ("for x in xs:\n  invariant 1 // (n - 1) < 9\n  n += 1", [2]),
        # old values are those where the very loop begins
        ("n = 4\nwhile n < 6:\n  invariant n >= old(n)\n  invariant n == old(n)\n  n += 1", [4]),
        ("for i in range(2):\n  for j in range(2):\n    invariant n <= old(n) + 2\n    invariant n <= 2\n    n += 1",
         [4]),
        ("for x in xs:\n  invariant forall i in range(0, len(xs)): xs[i] <= 3\n  n += x", []),
        ("for x in xs:\n  invariant exists y in xs: y == 4\n  n += x", [2]),
    ],
)  # fmt: skip
def test_loop_invariants_are_evaluated_at_the_head_of_each_turn_and_at_the_end(loop: str, lines: list[int]) -> None:
    assert violated(loop) == lines


def test_loop_invariants_of_functions_count_for_the_event_that_calls_them() -> None:
    head = HEAD + "fun up(int m) -> int:\n  int k = 0\n  while k < m:\n    invariant k < 2\n    k += 1\n  return k\n"
    program = compiled(head + event("n = up(1)\nn = up(3)\nn = up(4)", "up(5) == 5"))
    _, steps = round_(program, initial(program, 1))
    outcome = steps[0].outcome
    assert isinstance(outcome, Writes)
    assert [span.line for span in outcome.violated] == [head.count("\n") - 2], "once, and none of the guard's"


def test_a_false_loop_invariant_changes_nothing_and_is_not_told_of_what_is_discarded() -> None:
    loop = "while n < 3:\n  invariant n < 0\n  n += 1"
    assert value(loop) == 3
    outcome = after(HEAD + event(f"{loop}\nn = xs[n + 7]"), 1)[1][0].outcome
    assert isinstance(outcome, Discarded)
