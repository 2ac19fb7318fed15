"""The verifier finds what a faulty pass would leave behind, and the printer shows the tree as it is."""

from __future__ import annotations

import pytest

from koordgen.check import check, params
from koordgen.diagnostics import InternalError
from koordgen.ir import decl, expr, stmt
from koordgen.ir.printer import show
from koordgen.ir.types import (
    BOOL,
    FLOAT,
    GRIDMAP,
    INT,
    POINT,
    POISON,
    RECT,
    STRING,
    MapOf,
    PerRobot,
    RecordType,
    Sequence,
    TupleOf,
    list_of,
)
from koordgen.ir.verify import verify
from koordgen.node import replace
from koordgen.source import Source, Span
from koordgen.syntax.parse import parse

AT = Span(3, 1, 3, 2)
TEXT = """using Motion:
  sensors: Point position
  actuators: Point target
    List<Point> path
  PathPlanner planner
  assume position' in Rect(position, target)
using Log:
  stream stdout
def Task:
  Point target
  int id = 3
extern type Ticket
extern fun fee(Ticket ticket, List<int> all[N_SYS]) -> int:
  requires: len(all) > 0
  ensures: result >= 0
spec fun fair(int a) -> bool
fun twice(int n) -> int:
  return once(n) * 2
fun once(int n) -> int:
  while True:
    if n > 3:
      return n
    n += 1
param int k = 2
allread: Point x[N_SYS]
  List<int> seen[N_SYS] max 8
allwrite: float level = k
  List<Task> tasks
local: int count
  bool on
  Ticket ticket
  Map<int, string> names max 4, 16
  Task mine
init: x[pid] = Motion.position
Go:
  pre: on and 0 <= count < k
  eff:
    Point goal = x[count] / level if level != 0 else Motion.position
    if count > 3:
      Motion.target = goal * 2
      stop
    elif pid == 0: count = max(count, 1) % 7
    else: on = not on
Take:
  pre: len(tasks) > 0
  eff: atomic:
    for task in tasks:
      if task.id == pid:
        mine = task
        tasks.remove(task)
        break
Pay:
  pre: True
  eff:
    count = twice(fee(ticket, seen))
    mine.id = count
    names[3] = "three"
    Log.stdout << "paid" << count
    Motion.path = Motion.planner(mine.target)
initially: forall i in ID: count[i] == 0
invariant Near: forall i, j in ID: distance(Motion.position[i], x[j]) > k
axiom All: fair(3)
"""


def program() -> decl.Program:
    source = Source("dir/app.koord", TEXT)
    tree, found = parse(source)
    assert not found, found
    checked, found = check(tree, source)
    assert checked is not None, found
    return checked


SOUND = program()


def test_the_checkers_program_is_well_formed_and_reads_as_text() -> None:
    verify(SOUND)
    assert (
        show(SOUND)
        == """program app (app.koord)
extern type Ticket
record Task
  target: Point = Point(0.0, 0.0, 0.0)
  id: int = 3
param k: int = 2
fun once(n: int) -> int
  while True
    if (n > 3)
      return n
    n := (n + 1: int)
fun twice(n: int) -> int
  return (once(n) * 2: int)
extern fun fee(ticket: Ticket, all: List<int>[N_SYS]) -> int
  requires (len(all) > 0)
  ensures (result >= 0)
spec fun fair(a: int) -> bool
module Motion
  sensor position: Point
  actuator target: Point
  actuator path: List<Point> max 4096
  callable planner: PathPlanner
  assume (Motion.position' in Rect(Motion.position, Motion.target))
module Log
  stream stdout: stream
allread x: Point[N_SYS] = Point(0.0, 0.0, 0.0)
allread seen: List<int>[N_SYS] max 8 = List<int>{}
allwrite level: float = (int -> float k)
allwrite tasks: List<Task> max 64 = List<Task>{}
local count: int = 0
local on: bool = False
local ticket: Ticket = Ticket{}
local names: Map<int, string> max 4, 16 = Map<int, string>{}
local mine: Task = Task{Point(0.0, 0.0, 0.0), 3}
lock 0: tasks
init
  x[pid] := Motion.position
event Go
  when (on and ((0 <= count) and (count < k)))
  let goal: Point = ((x[count]? / level: Point) if (level != (int -> float 0)) else Motion.position: Point)
  if (count > 3)
    Motion.target := (goal * (int -> float 2): Point)
    stop
  elif (pid == 0)
    count := ((max(count, 1): int) % 7: int)
  else
    on := (not on)
event Take under lock 0
  when (len(tasks) > 0)
  for task: Task in tasks
    if (task.id == pid)
      mine := task
      tasks := removed(tasks, task)
      break
event Pay
  when True
  count := twice(fee(ticket, seen))
  mine := (mine with id = count)
  names := map_with(names, 3, 'three')
  Log.stdout << 'paid', str(count)
  Motion.path := Motion.planner(mine.target)
initially: (forall i in ID: (count[i] == 0))
invariant Near: (forall i in ID: (forall j in ID: (distance(Motion.position[i], x[j]) > (int -> float k))))
axiom All: fair(3)
"""
    )


ONE = expr.Const(1, INT, AT)
HALF = expr.Const(0.5, FLOAT, AT)
YES = expr.Const(True, BOOL, AT)
WORD = expr.Const("a", STRING, AT)
MIXED = expr.Binary("+", ONE, HALF, True, FLOAT, AT)
HERE = expr.PortRead("Motion", "position", False, POINT, AT)
NUMBERS = list_of(INT)
LIST = expr.Make((ONE,), NUMBERS, AT)
TASK = RecordType("Task", (("target", POINT), ("id", INT)))
OTHER = RecordType("Other", (("id", INT),))
MINE = expr.LocalRead("mine", TASK, AT)
PAIR = expr.Make((ONE, HALF), TupleOf((INT, FLOAT)), AT)
KEYED = Sequence("Set", FLOAT, 8)


def let(value: expr.Expr) -> stmt.Stmt:
    return stmt.Let("a", value.type, value, AT)


WRONG: dict[str, stmt.Stmt] = {
    "type of an assignment": stmt.Assign(stmt.LocalPlace("count"), YES, AT),
    "type that a node claims": stmt.Assign(stmt.LocalPlace("count"), expr.Binary("/", ONE, ONE, True, INT, AT), AT),
    "operands of two types": let(MIXED),
    "operator": let(expr.Binary("<<", ONE, ONE, True, INT, AT)),
    "sum of bools": let(expr.Binary("+", YES, YES, True, BOOL, AT)),
    "comparison of a type without order": let(expr.Compare("<", YES, YES, BOOL, AT)),
    "unproved sum": let(expr.Binary("+", ONE, ONE, False, INT, AT)),
    "write to a sensor": stmt.Assign(stmt.PortPlace("Motion", "position"), HERE, AT),
    "unknown port": stmt.Assign(stmt.PortPlace("Motion", "speed"), HERE, AT),
    "read of a planner": let(expr.PortRead("Motion", "planner", False, POINT, AT)),
    "unknown name": stmt.Assign(stmt.LocalPlace("nobody"), ONE, AT),
    "temp out of scope": stmt.If(YES, (stmt.Let("a", INT, ONE, AT),), (stmt.Assign(stmt.TempPlace("a"), ONE, AT),), AT),
    "temp declared twice": stmt.If(YES, (stmt.Let("a", INT, ONE, AT),), (stmt.Let("a", INT, ONE, AT),), AT),
    "loop variable out of scope": stmt.If(
        YES, (stmt.For(("a",), (INT,), LIST, (), AT), stmt.Assign(stmt.TempPlace("a"), ONE, AT)), (), AT
    ),
    "loop variable's type": stmt.For(("a",), (BOOL,), LIST, (), AT),
    "loop over no pairs": stmt.For(("a", "b"), (INT, INT), LIST, (), AT),
    "loop over a number": stmt.For(("a",), (INT,), ONE, (), AT),
    "break outside a loop": stmt.Break(AT),
    "continue outside a loop": stmt.Continue(AT),
    "break behind a loop": stmt.If(YES, (stmt.While(YES, (stmt.Continue(AT),), AT), stmt.Break(AT)), (), AT),
    "return in an event": stmt.Return(ONE, AT),
    "output of a number": stmt.Emit("Log", "stdout", (ONE,), AT),
    "output to an actuator": stmt.Emit("Motion", "target", (WORD,), AT),
    "condition": stmt.If(ONE, (), (), AT),
    "condition of a loop": stmt.While(ONE, (), AT),
    "index": let(expr.SlotRead("x", YES, True, POINT, AT)),
    "slot of an allwrite variable": stmt.Assign(stmt.OwnSlot("level"), HALF, AT),
    "literal": let(expr.Const(float("nan"), FLOAT, AT)),
    "field": let(expr.Field(HERE, "w", FLOAT, AT)),
    "field of a record": let(expr.Field(MINE, "goal", POINT, AT)),
    "item of a tuple": let(expr.Item(PAIR, 2, INT, AT)),
    "element of a map": let(expr.At(expr.LocalRead("names", MapOf(INT, STRING, 4), AT), ONE, True, STRING, AT)),
    "slice of a number": let(expr.Slice(ONE, None, None, True, INT, AT)),
    "bound of a slice": let(expr.Slice(LIST, HALF, None, True, NUMBERS, AT)),
    "change of a field that is none": let(expr.With(MINE, "goal", HERE, TASK, AT)),
    "change of a field's type": let(expr.With(MINE, "id", HALF, TASK, AT)),
    "change of a list": let(expr.With(LIST, "0", ONE, NUMBERS, AT)),
    "arity of a tuple": let(expr.Make((ONE,), TupleOf((INT, FLOAT)), AT)),
    "arity of a record": let(expr.Make((HERE,), TASK, AT)),
    "element's type": let(expr.Make((ONE, HALF), NUMBERS, AT)),
    "record that is none": let(expr.Make((ONE,), OTHER, AT)),
    "map that is made with parts": let(expr.Make((ONE,), GRIDMAP, AT)),
    "set of floats": let(expr.Make((), KEYED, AT)),
    "variable of a region": let(expr.Builtin("Rect", (HERE, HERE), RECT, AT)),
    "variable of a whole array": let(expr.SlotsRead("x", PerRobot(POINT), AT)),
    "poison": let(expr.Const(0, POISON, AT)),
    "containment of another type": let(expr.Contains(HALF, LIST, BOOL, AT)),
    "containment in a number": let(expr.Contains(ONE, ONE, BOOL, AT)),
    "range as a value": let(expr.Range(ONE, ONE, 1, NUMBERS, AT)),
    "builtin": let(expr.Builtin("sine", (HALF,), FLOAT, AT)),
    "arguments": let(expr.Builtin("max", (ONE,), INT, AT)),
    "argument's type": let(expr.Builtin("sin", (ONE,), FLOAT, AT)),
    "number that is none": let(expr.Builtin("max", (YES, YES), BOOL, AT)),
    "two numbers": let(expr.Builtin("max", (ONE, HALF), FLOAT, AT)),
    "element appended": let(expr.Builtin("appended", (LIST, HALF), NUMBERS, AT)),
    "method of another type": let(expr.Builtin("keys", (LIST,), NUMBERS, AT)),
    "function": let(expr.Call("thrice", (ONE,), INT, AT)),
    "argument of a function": let(expr.Call("twice", (HALF,), INT, AT)),
    "spec function in an event": let(expr.Call("fair", (ONE,), BOOL, AT)),
    "arguments of an extern function": let(expr.ExternCall("fee", (ONE,), INT, AT)),
    "call of a sensor": let(expr.PortCall("Motion", "position", (HERE,), list_of(POINT), AT)),
    "goal of a planner": let(expr.PortCall("Motion", "planner", (ONE,), list_of(POINT), AT)),
    "widened float": let(expr.Widen(HALF, FLOAT, AT)),
    "quantifier in an event": let(expr.Quantified("forall", "i", expr.Ids(NUMBERS, AT), YES, BOOL, AT)),
    "another robot's local": let(expr.LocalOf("count", ONE, INT, AT)),
    "another robot's port": let(expr.PortOf("Motion", "position", ONE, POINT, AT)),
    "prime in an event": let(expr.PortRead("Motion", "position", True, POINT, AT)),
}


@pytest.mark.parametrize("statement", WRONG.values(), ids=WRONG.keys())
def test_a_faulty_statement_is_an_internal_error(statement: stmt.Stmt) -> None:
    event = replace(SOUND.events[0], effect=(statement,))
    with pytest.raises(InternalError, match="3:1"):
        verify(replace(SOUND, events=(event,)))


def faulty_programs() -> dict[str, decl.Program]:
    pid = expr.Pid(INT, AT)
    param, function, extern = SOUND.params[0], SOUND.functions[0], SOUND.externs[0]
    go, take = SOUND.events[:2]
    near = SOUND.properties[1]
    motion = SOUND.modules[0]
    call = expr.Call(SOUND.functions[1].name, (ONE,), INT, AT)

    def body(*block: stmt.Stmt) -> decl.Program:
        return replace(SOUND, functions=(replace(function, block=block), *SOUND.functions[1:]))

    def assumed(formula: expr.Expr) -> decl.Program:
        return replace(SOUND, modules=(replace(motion, assumptions=(decl.Assumption(formula, AT),)),))

    return {
        "params": replace(SOUND, params=(param, param)),
        "a function and a param of one name": replace(SOUND, params=(replace(param, name="once"),)),
        "initial value": replace(SOUND, locals=(replace(SOUND.locals[0], initial=pid),)),
        "initial value's type": replace(SOUND, locals=(replace(SOUND.locals[0], initial=HALF),)),
        "initial value that calls": replace(SOUND, locals=(replace(SOUND.locals[0], initial=call),)),
        "param of a param": replace(SOUND, params=(replace(param, default=expr.ParamRead("k", INT, AT)),)),
        "record's defaults": replace(SOUND, records=(replace(SOUND.records[0], defaults=(HERE,)),)),
        "events": replace(SOUND, events=(go, go)),
        "guard": replace(SOUND, events=(replace(go, guard=ONE),)),
        "call of a planner in a guard": replace(
            SOUND,
            events=(
                replace(
                    go,
                    guard=expr.Contains(
                        HERE, expr.PortCall("Motion", "planner", (HERE,), list_of(POINT), AT), BOOL, AT
                    ),
                ),
            ),
        ),
        "lock": replace(SOUND, events=(go, replace(take, lock=3))),
        "variable beyond the lock": replace(SOUND, events=(replace(go, lock=0), take)),
        "empty lock": replace(SOUND, locks=(*SOUND.locks, ())),
        "variable of two locks": replace(SOUND, locks=(*SOUND.locks, *SOUND.locks)),
        "stream as a sensor": replace(
            SOUND,
            modules=(
                motion,
                replace(SOUND.modules[1], ports=(replace(SOUND.modules[1].ports[0], direction="sensor"),)),
            ),
        ),
        "function that goes on": body(stmt.Let("a", INT, ONE, AT)),
        "function that may go on": body(stmt.If(YES, (stmt.Return(ONE, AT),), (), AT)),
        "function that leaves its loop": body(stmt.While(YES, (stmt.If(YES, (stmt.Break(AT),), (), AT),), AT)),
        "function's result": body(stmt.Return(HALF, AT)),
        "function that reads a variable": body(stmt.Return(expr.LocalRead("count", INT, AT), AT)),
        "function that reads pid": body(stmt.Return(pid, AT)),
        "function that writes": body(stmt.Assign(stmt.LocalPlace("count"), ONE, AT), stmt.Return(ONE, AT)),
        "function that stops": body(stmt.Stop(AT), stmt.Return(ONE, AT)),
        "function that calls itself": body(stmt.Return(expr.Call(function.name, (ONE,), INT, AT), AT)),
        "function that calls a later one": body(stmt.Return(call, AT)),
        "contract": replace(SOUND, externs=(replace(extern, requires=(ONE,)),)),
        "result before the call": replace(SOUND, externs=(replace(extern, requires=extern.ensures),)),
        "property": replace(SOUND, properties=(replace(near, formula=ONE),)),
        "properties": replace(SOUND, properties=(near, near)),
        "property with a bare variable": replace(
            SOUND, properties=(replace(near, formula=expr.LocalRead("on", BOOL, AT)),)
        ),
        "assumption on a variable": assumed(expr.LocalRead("on", BOOL, AT)),
        "assumption of another module": assumed(
            expr.Compare("==", expr.PortRead("Log", "stdout", False, POINT, AT), HERE, BOOL, AT)
        ),
    }


@pytest.mark.parametrize("name", faulty_programs())
def test_a_faulty_program_is_an_internal_error(name: str) -> None:
    with pytest.raises(InternalError):
        verify(faulty_programs()[name])


# Params that a build sets are a pass over the IR, too.

PARAMS = """def Task:
  Point target
  int id = 3
  List<string> tags max 2, 4
param int laps = 1
param float margin = 0.5
param bool fast = False
param string name = "none"
param Pose start = Pose(Point(0, 0, 0), 0)
param Grid cell_ = Grid(1, 2, 0.5)
param List<Task> tasks max 2 = []
param Map<string, int> table = {}
param Map<(int, bool), int> odd = {}
param Set<int> some = {1}
param List<Point, int> pairs = []
Go:
  pre: True
  eff: pass
"""


def with_values(values: dict[str, params.Value]) -> decl.Program:
    source = Source("app.koord", PARAMS)
    checked, found = check(parse(source)[0], source)
    assert checked is not None, found
    return params.with_params(checked, values)


def test_a_build_sets_params_of_every_type() -> None:
    given: dict[str, params.Value] = {
        "laps": -4,
        "margin": 2,
        "fast": True,
        "name": "blue",
        "start": [[1, 2, 3], -0.5],
        "cell_": [1, -2, 0.25],
        "tasks": [{"target": [1, 2, 3], "tags": ["a", "b"]}, {"target": [0, 0, 0], "id": 4}],
        "table": {"a": 1, "b": -2},
        "odd": [[[1, True], 3]],
        "some": [3, 2],
        "pairs": [[[1, 2, 3], 4]],
    }
    program = with_values(given)
    verify(program)
    shown = [line.partition(" = ")[2] for line in show(program).splitlines() if line.startswith("param ")]
    no_tags = "List<string>{}"
    assert shown == [
        "(-4)",
        "2.0",
        "True",
        "'blue'",
        "Pose(Point(1.0, 2.0, 3.0), (-0.5))",
        "Grid(1, (-2), 0.25)",
        "List<Task>{Task{Point(1.0, 2.0, 3.0), 3, List<string>{'a', 'b'}}, "
        f"Task{{Point(0.0, 0.0, 0.0), 4, {no_tags}}}}}",
        "Map<string, int>{(string, int){'a', 1}, (string, int){'b', (-2)}}",
        "Map<(int, bool), int>{((int, bool), int){(int, bool){1, True}, 3}}",
        "Set<int>{3, 2}",
        "List<(Point, int)>{(Point, int){Point(1.0, 2.0, 3.0), 4}}",
    ]


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("lap", 3, "no param 'lap'"),
        ("laps", 0.5, "param laps is of type int; 0.5"),
        ("laps", True, "param laps"),
        ("laps", 2**63, "param laps"),
        ("margin", float("nan"), "not a finite number"),
        ("margin", float("inf"), "param margin"),
        ("fast", 1, "param fast"),
        ("name", 3, "written \"...\""),
        ("start", [1, 2, 3], "[[x, y, z], yaw]"),
        ("cell_", [1.5, 2, 0.5], "param cell_[0] is of type int"),
        ("tasks", {"target": [1, 2, 3]}, "param tasks is of type List<Task>"),
        ("tasks", [{"goal": [1, 2, 3]}], "param tasks[0]: a Task has no field 'goal' (it has: target, id, tags)"),
        ("tasks", [{"target": [1, 2]}], "param tasks[0].target is of type Point, written [x, y, z]"),
        ("tasks", [{}, {}, {}], "param tasks has 3 elements, and at most 2 fit"),
        ("tasks", [{"tags": ["a", "b", "c"]}], "param tasks has 3 elements, and at most 2 fit"),
        ("tasks", [{"tags": ["\N{SNOWMAN}\N{SNOWMAN}"]}], "param tasks has 6 bytes, and at most 4 fit"),
        ("table", {1: 1}, "param table[0][0] is of type string"),
        ("odd", [[[1, True], 3], [[1, True], 4]], "param odd has one of its elements twice"),
        ("some", [1, 1], "param some has one of its elements twice"),
        ("pairs", [[[1, 2, 3]]], "param pairs[0] is of type (Point, int), written [Point, int]"),
    ],
)  # fmt: skip
def test_a_value_that_does_not_fit_its_param(name: str, value: params.Value, told: str) -> None:
    with pytest.raises(params.BadParam) as caught:
        with_values({name: value})
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("3", 3),
        ("-0.5", -0.5),
        ("True", True),
        ("1,2,-3", [1, 2, -3]),
        ("blue", "blue"),
        ('"3"', "3"),
        ('[{"id": 3}]', [{"id": 3}]),
        ("", ""),
    ],
)
def test_a_value_on_the_command_line(text: str, value: params.Value) -> None:
    assert params.parse_value(text) == value


def test_broken_json_on_the_command_line() -> None:
    with pytest.raises(params.BadParam, match="no JSON"):
        params.parse_value("[1, 2")
