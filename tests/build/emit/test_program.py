"""Generated programs have the meaning of the Koord program: values, functions, ports, streams, functions file."""

from __future__ import annotations

from typing import Any

import pytest

from koordgen.build.emit.program import program_text
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.state import Store, World, nobody
from koordgen.lang.semantics.step import execute, initial
from koordgen.runtime.program.program import Effects, Fault, Frame, Program
from koordgen.runtime.values.gridmap import GridMap
from koordgen.runtime.values.points import Grid, Opaque, Point
from tests.build.emit.generated import MOTION, checked, frame, load, locals_after, step


def event(body: str) -> str:
    lines = "".join(f"    {line}\n" for line in body.strip("\n").split("\n"))
    return f"E:\n  pre: True\n  eff:\n{lines}"


@pytest.mark.parametrize(
    ("declared", "body", "value"),
    [
        ("List<int> v = [1, 2, 3]", "v = v[1:] + [v[0]]", (2, 3, 1)),
        (
            "List<int> v = [1, 2]",
            "v.append(7)\nv.insert(1, 5)\nv.extend([9])\nv.remove(1)\nint i = v.pop(0)\nv[0] = i",
            (5, 7, 9),
        ),
        ("Queue<int> v", "v.push(3)\nv.push(4)\nint i = v.pop()\nv.push(i)", (4, 3)),
        ("Set<string> v", 'v.add("b")\nv.add("a")\nv.add("b")', ("a", "b")),
        ("Map<int, int> v = {3: 1}", "v[1] = 5\nv[3] += 2\nv[2] = v.get(9, 8)", ((1, 5), (2, 8), (3, 3))),
        ("(int, string) v", 'v = (v[0] - 1, "x")', (-1, "x")),
        ("List<int> v", "for i in range(9, 0, -3):\n  v.append(i)", (9, 6, 3)),
        ("List<int> v = [1]", "for i in v:\n  v.append(i + 1)", (1, 2)),
        ("List<int> v", "for i in ID:\n  if i == 1: continue\n  v.append(i)", (0, 2)),
        ("List<int> v", "Map<int, int> m = {2: 0, 1: 0}\nfor k in m:\n  v.append(k)", (1, 2)),
        ("int v", "while True:\n  v += 1\n  if v > 4: break", 5),
        ("string v", 'v = str(1) + str(2.5) + str(True) + "abc"[1:2] + "\\"\\n"', '12.5Trueb"\n'),
        ("int v", "v = 7 // 2 ** 2 - -7 % 4", 0),
        ("float v", "v = sum([1, 2.5]) + 2.0 ** 0.5 * 0", 3.5),
        ("bool v", 'v = "a" in ["b", "a"] and 2 not in {1, 3} and 1 in {1: 2} and "b" in "abc"', True),
        (
            "bool v",
            "v = Point(1, 1, 1) in Rect(Point(2, 0, 1), Point(0, 2, 1))\n"
            "v = v and Point(3, 0, 0) not in Ball(Point(0, 0, 0), 2.9)",
            True,
        ),
        ("Point v", "v = center(cell(Point(0.7, -0.1, 5), 0.5)) * 2", Point(1.5, -0.5, 0.0)),
        (
            "bool v",
            "GridMap m = GridMap(Point(0, 0, 0), Point(2, 2, 0), 1)\n"
            "m = mark_free(m, Grid(1, 1, 1))\nv = is_free(m, Grid(1, 1, 1))",
            True,
        ),
        (
            "List<(int, int)> v = [(1, 2), (3, 4)]",
            "v[1] = (v[0][1], 9)\nfor a, b in v:\n  v.append((b, a))",
            ((1, 2), (2, 9), (2, 1), (9, 2)),
        ),
    ],
)
def test_statements(declared: str, body: str, value: object) -> None:
    assert locals_after(f"local:\n  {declared}\n" + event(body))["v"] == value


def test_nested_updates_of_records() -> None:
    text = """def Leg:
  Point to
  List<int> marks
def Route:
  List<Leg> legs = [Leg(Point(1, 2, 3), [1])]
  int class = 4
local:
  Route r
  int n
"""
    after = locals_after(text + event("r.legs[0].marks.append(7)\nr.class += 1\nn = r.legs[0].marks[1] + r.class"))
    assert after["n"] == 12
    assert (after["r"].class_, after["r"].legs[0].to, after["r"].legs[0].marks) == (5, Point(1, 2, 3), (1, 7))


def test_names_of_python_and_of_the_runtime_are_harmless() -> None:
    """A program may use names of Python and of the runtime."""
    names = ["lambda_", "Cell", "State", "self", "print", "PROGRAM", "LINES", "frame", "msgspec", "keys", "at", "union"]
    text = "".join(f"def R{i}:\n  int {name} = {i}\n  Point p\n" for i, name in enumerate(names))
    text += "def Struct:\n  int Any = 1\ndef Variable:\n  Struct Program\n"
    text += "fun State(int lambda_, int s) -> int: return lambda_ + s\n"
    text += "local:\n  int n_sys = 1\n  int None_ = 2\n  int value\n  Variable frame\n  R1 slots\n"
    after = locals_after(text + event("value = State(n_sys, None_)\nframe.Program.Any += value\nslots.Cell = 9"))
    assert after["value"] == 3
    assert (after["frame"].Program.Any_ if hasattr(after["frame"], "Program") else after["frame"].Program_.Any_) == 4


def test_a_line_of_a_stream_is_put_out_with_the_event() -> None:
    text = (
        MOTION
        + "local: int i = 3\n"
        + event('Log.stdout << "at " << Point(1, 2.5, 0) << " " << i\nLog.stdout << True\ni = 4')
    )
    done = step(load(text))
    assert isinstance(done, Effects)
    assert done.streams == (("Log.stdout", "at (1.0, 2.5, 0.0) 3"), ("Log.stdout", "True"))


def test_a_callable_port_is_asked_by_its_name() -> None:
    asked: list[Any] = []

    def call(port: str, args: tuple[Any, ...]) -> Any:
        asked.append((port, args))
        return (Point(9, 9, 9),)

    program = load(MOTION + event("Motion.path = Motion.planner(Motion.position, [Grid(1, 2, 0.5)])"))
    done = step(program, frame(program, call=call))
    assert isinstance(done, Effects)
    assert asked == [("Motion.planner", (Point(1, 2, 3), (Grid(1, 2, 0.5),)))]
    assert done.actuators == {"Motion.path": (Point(9, 9, 9),)}


FUNCTIONS = """
from dataclasses import dataclass

@dataclass
class Ticket:
    number: int = 3
    seen: list[int] | None = None

class Other: pass

def stamp(t, goods): return Ticket(t.number + len(goods), [1])
def several(ts): return [ts[0], Ticket(9)]
def number(t): return t.number
def goods(n): return {"b": n, "a": 1}
def ids(s): return {3, 1, *s}
def tasks(t): return [t, (Point(1, 2, 3), "x"), {"at": [1, 2, 3], "name": "y"}]
def where(m): return m
def half(f): return 1
from koordgen.runtime.values.points import Point
"""
EXTERNS = """extern type Ticket
def Task:
  Point at
  string name
extern fun stamp(Ticket t, Map<string, int> wares) -> Ticket
extern fun several(List<Ticket> ts) -> List<Ticket>
extern fun number(Ticket t) -> int
extern fun goods(int n) -> Map<string, int>
extern fun ids(Set<int> s) -> Set<int>
extern fun tasks(Task t) -> List<Task>
extern fun where(GridMap m) -> GridMap
extern fun half(float f) -> float
local:
  Ticket t
  List<Ticket> ts
  int n
  Map<string, int> m
  Set<int> s = {2}
  List<Task> k
  GridMap g
  float f
"""


def test_values_go_to_python_and_come_back() -> None:
    body = (
        't = stamp(stamp(t, {}), {"a": 1})\nts = several([t, t])\nn = number(ts[1]) * 100 + number(t)\nm = goods(2)\n'
        's = ids(s)\nk = tasks(Task(name="z"))\ng = where(g)\nf = half(f)'
    )
    after = locals_after(EXTERNS + event(body), FUNCTIONS)
    assert isinstance(after["t"], Opaque) and after["t"].data
    assert (after["n"], after["m"], after["s"]) == (904, (("a", 1), ("b", 2)), (1, 2, 3))
    assert [(t.at, t.name) for t in after["k"]] == [(Point(), "z"), (Point(1, 2, 3), "x"), (Point(1, 2, 3), "y")]
    assert after["g"] == GridMap() and repr(after["f"]) == "1.0"


@pytest.mark.parametrize(
    ("name", "call", "returned", "wanted"),
    [
        ("stamp", "t = stamp(t, {})", "Other()", "a Ticket"),
        ("several", "ts = several([t])", "[Other()]", "a List<Ticket>"),
        ("goods", "m = goods(1)", "{1: 2}", "a Map<string, int>"),
        ("goods", "m = goods(1)", "{'\\ud800': 2}", "a Map<string, int>"),
        ("ids", "s = ids(s)", "{1, 'a'}", "a Set<int>"),
        ("ids", "s = ids(s)", "[1.0]", "a Set<int>"),
        ("tasks", "k = tasks(Task())", "[Point(1, 2, 3)]", "a List<Task>"),
        ("tasks", "k = tasks(Task())", "[(Point(1, 2, 'a'), 'b')]", "a List<Task>"),
        ("tasks", "k = tasks(Task())", "[{'at': (1, 2, 3), 'nam': 'b'}]", "a List<Task>"),
        ("where", "g = where(g)", "GridMap(1.0, 0, 0, 2, 2, b'')", "a GridMap"),
        ("half", "f = half(f)", "'1.0'", "a float"),
    ],
)
def test_what_is_none_of_the_type_is_told(name: str, call: str, returned: str, wanted: str) -> None:
    functions = (
        FUNCTIONS + f"from koordgen.runtime.values.gridmap import GridMap\ndef {name}(*args): return {returned}\n"
    )
    done = step(load(EXTERNS + event(call), functions))
    assert isinstance(done, Fault)
    assert done.reason.startswith(f"{name} returned ") and done.reason.endswith(f", not {wanted}"), done.reason


def test_what_the_user_does_to_an_extern_value_changes_no_other() -> None:
    functions = FUNCTIONS + "def number(t): t.number += 1; return t.number\n"
    assert locals_after(EXTERNS + event("n = number(t) * 10 + number(t)"), functions)["n"] == 44


QUANTIFIED = """
extern fun far(List<Point> places, List<float> spots[N_SYS]) -> int:
  requires: forall p in places: p.z >= 0
  ensures: exists p in places: result == 1 or (forall s in spots: forall k in range(len(s)): s[k] > p.x)
allread: List<float> spots[N_SYS]
local: List<Point> places
local: int n
E:
  pre: True
  eff: n = far(places, spots)
"""


@pytest.mark.parametrize(
    ("z", "spot", "returned", "told"),
    [
        (0.0, 2.0, 5, ""),
        (0.0, 1.0, 1, ""),
        (-1.0, 2.0, 1, "far was called although its precondition (line 3) does not hold"),
        (0.0, 1.0, 5, "far returned 5, which breaks its postcondition (line 4)"),
    ],
)
def test_quantifiers_in_contracts_are_checked_at_run_time(z: float, spot: float, returned: int, told: str) -> None:
    program = load(QUANTIFIED, f"def far(places, spots): return {returned}")
    given = frame(program, places=(Point(1, 0, 0), Point(1, 0, z)), spots=((spot,), (), (2.0, 2.0)))
    done = step(program, given)
    assert (str(done) if isinstance(done, Fault) else "") == (f"a.koord:10: {told}" if told else "")
    meant = checked(QUANTIFIED)
    state = initial(meant, 3)
    robots = tuple([r._replace(locals=dict(given.locals)) for r in state.robots])
    state = state._replace(robots=robots, store=Store({"spots": given.shared["spots"]}, {}))
    world = World({"far": lambda places, spots: returned}, nobody)
    outcome = execute(meant, meant.events[0].effect, state, 0, world)
    assert isinstance(outcome, Discarded) == bool(told), outcome


LOOPS = """
local:
  List<int> xs = [3, 1]
  int n
fun up(int m) -> int:
  int k = 0
  while True:
    invariant k < 2
    if k == m: return k
    k += 1
  return k
"""


def test_loop_invariants_that_are_false_are_told_by_their_lines() -> None:
    effect = (
        "for i in range(len(xs)):\n  invariant i < 2\n  n += 1\n"
        "while n < 3 or n < 4:\n  invariant n <= 4\n  invariant 1 // (n - 3) > 0\n  n += 1\n"
        "for x in xs:\n  invariant old(n) == n\nn = up(n)"
    )
    first = (LOOPS + event("")).count("\n")
    done = step(load(LOOPS + event(effect)))
    assert isinstance(done, Effects)
    assert done.locals["n"] == 4
    assert done.violated == (first + 1, first + 5, 8)


def test_an_event_tells_nothing_of_an_earlier_one() -> None:
    loop = "while n < 2:\n  invariant n < {}\n  n += 1"
    for bound, count in (("1", 1), ("3", 0)):
        done = step(load(LOOPS + event(loop.format(bound))))
        assert isinstance(done, Effects) and len(done.violated) == count


def test_a_program_without_loop_invariants_has_no_code_for_them() -> None:
    text = program_text(checked(LOOPS.replace("    invariant k < 2\n", "") + event("for x in xs: n += x")))
    assert "claim" not in text and "behind" not in text and "turns_" not in text


PROVIDES = """provides Motion:
  sensors:
    Point position = corner[0]
    bool reached = forall i in ID: corner[i] == goal
  actuators: Point target = goal
allwrite: Point goal
allread: Point corner[N_SYS]
E:
  pre: goal == Point(1, 0, 0)
  eff: corner[pid] = goal
"""


def test_each_provided_sensor_is_a_function_of_the_state() -> None:
    scope: dict[str, Any] = {"__file__": "generated.py"}
    exec(compile(program_text(checked(PROVIDES)), "generated.py", "exec"), scope)
    program: Program = scope["PROGRAM"]
    corners = (Point(1, 2, 3), Point(0, 0, 0), Point(1, 2, 3))
    shared = {"corner": corners, "goal": Point(1, 2, 3)}
    state = program.begin(Frame(0, 3, {}, shared, {}, {}))
    assert scope["provided_motion_position"](state) == Point(1, 2, 3)
    assert scope["provided_motion_reached"](state) is False
    assert "provided_motion_target" not in scope, "an actuator is a variable"
    assert program.lines[scope["provided_motion_reached"].__code__.co_firstlineno + 2] == 4
