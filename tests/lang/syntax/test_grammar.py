"""The grammar, construct by construct: what each text is as a tree, and that no rule is in another's way."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from typing import Any

import pytest

from koordgen.lang.node import Node
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax.generate import GRAMMAR
from koordgen.lang.syntax.parse import parse
from koordgen.lang.syntax.printer import show


def outline(node: Any) -> str:
    """A tree in one line, without its places."""
    if isinstance(node, tuple):
        return f"[{', '.join(map(outline, node))}]"
    if not isinstance(node, Node):
        return repr(node) if isinstance(node, str) and not node.isidentifier() else str(node)
    fields = [getattr(node, f) for f in fields_of(node) if not f.endswith("span")]
    name = type(node).__name__
    if name in ("Name", "NamedType", "Literal"):
        return repr(fields[0]) if name == "Literal" else str(fields[0])
    return f"{name}({', '.join(outline(f) for f in fields if f is not None)})"


def fields_of(node: Node) -> tuple[str, ...]:
    names: tuple[str, ...] = type(node).__match_args__  # type: ignore[attr-defined]
    return names


def section(text: str) -> Any:
    tree, found = parse(Source("t", text))
    assert not found, [(d.span.line, d.message) for d in found]
    assert show(tree)
    (only,) = tree.sections
    return only


def statement(text: str) -> str:
    (only,) = section(f"init:\n  {text}\n").block
    return outline(only)


def expression(text: str) -> str:
    return outline(section(f"invariant P: {text}\n").formula)


def types_written(text: str) -> set[str]:
    """The type as it is read in each place where one may stand."""
    places = [
        section(f"local: {text} x\n").variables[0].type,
        section(f"fun f({text} x) -> int: return 1\n").parameters[0].type,
        section(f"fun f() -> {text}: return 1\n").result,
        section(f"def R: {text} x\n").fields[0].type,
        section(f"using M: {text} x\n").items[0].ports[0].type,
        section(f"param {text} x = 1\n").type,
        section(f"init: {text} x\n").block[0].type,
        section(f"init: {text} x = 1\n").block[0].type,
    ]
    return {outline(t) for t in places}


@pytest.mark.parametrize(
    ("text", "tree"),
    [
        ("int", "int"),
        ("Task", "Task"),
        ("List<Point>", "GenericType(List, [Point])"),
        ("List<Point, Scan>", "GenericType(List, [Point, Scan])"),
        ("Map<string, List<int>>", "GenericType(Map, [string, GenericType(List, [int])])"),
        ("Set<(int, bool)>", "GenericType(Set, [TupleType([int, bool])])"),
        ("(int, Task)", "TupleType([int, Task])"),
        ("(int, List<int>, bool)", "TupleType([int, GenericType(List, [int]), bool])"),
        ("(Queue<int>, int)", "TupleType([GenericType(Queue, [int]), int])"),
        ("((int, int), int)", "TupleType([TupleType([int, int]), int])"),
        ("int[]", "GenericType('[]', [int])"),
        ("pos[][]", "GenericType('[]', [GenericType('[]', [pos])])"),
        ("List<int>[]", "GenericType('[]', [GenericType(List, [int])])"),
        ("(int[], int)", "TupleType([GenericType('[]', [int]), int])"),
    ],
)
def test_a_type_reads_the_same_wherever_it_stands(text: str, tree: str) -> None:
    assert types_written(text) == {tree}


@pytest.mark.parametrize(
    ("text", "tree"),
    [
        ("using Motion:\n  sensors: Point position\n    bool reached\n  PathPlanner planner\n"
         "  actuators:\n    Point target\n  assume position' in Rect(position, target)\n",
         "Using(Motion, [Ports(sensor, [Port(Point, position, []), Port(bool, reached, [])]), "
         "Ports('', [Port(PathPlanner, planner, [])]), Ports(actuator, [Port(Point, target, [])]), "
         "Assume(Compare(Primed(position), [[in, Call(Rect, [position, target])]]))])"),
        ("using Log: stream stdout", "Using(Log, [Ports('', [Port(stream, stdout, [])])])"),
        ("param float margin = 0.5", "Param(float, margin, [], 0.5)"),
        ("param List<Task> tasks max 8 = []", "Param(GenericType(List, [Task]), tasks, [8], ListDisplay([]))"),
        ("allread: Point x[N_SYS]\n  List<Point> path[N_SYS] max 16 = []\n  int[] c",
         "Variables(allread, [Variable(Point, x, N_SYS, []), "
         "Variable(GenericType(List, [Point]), path, N_SYS, [16], ListDisplay([])), "
         "Variable(GenericType('[]', [int]), c, [])])"),
        ("allwrite: Map<int, List<int>> m max 16, 2 * k = {1: [2]}",
         "Variables(allwrite, [Variable(GenericType(Map, [int, GenericType(List, [int])]), m, "
         "[16, Binary('*', 2, k)], MapDisplay([[1, ListDisplay([2])]]))])"),
        ("local:\n  float max = max(1, 2)",
         "Variables(local, [Variable(float, max, [], Call(max, [1, 2]))])"),
        ("def Task:\n  Point target\n  int id = 0\n  string name max 8",
         "RecordDef(Task, [Variable(Point, target, []), Variable(int, id, [], 0), Variable(string, name, [8])])"),
        ("fun f() -> int: return 1", "Function(f, [], int, [Return(1)])"),
        ("fun f(List<Point> ps, Point p[N_SYS]) -> (int, Point):\n  return (1, p[0])\n",
         "Function(f, [Parameter(GenericType(List, [Point]), ps), Parameter(Point, p, N_SYS)], "
         "TupleType([int, Point]), [Return(Tuple([1, Index(p, 0)]))])"),
        ("def fun f(pos a): return a", "Function(f, [Parameter(pos, a)], [Return(a)])"),
        ("def fun f() -> int:\n  return 1\n", "Function(f, [], int, [Return(1)])"),
        ("extern fun f(int a) -> List<int>",
         "ExternFunction(f, [Parameter(int, a)], GenericType(List, [int]), [])"),
        ("extern fun f(int requires) -> int:\n  requires: 0 < requires\n  ensures:\n    result > 0\n",
         "ExternFunction(f, [Parameter(int, requires)], int, [Contract(requires, Compare(0, [['<', requires]])), "
         "Contract(ensures, Compare(result, [['>', 0]]))])"),
        ("extern type Ticket", "ExternType(Ticket)"),
        ("spec fun clear(int type) -> bool", "SpecFunction(clear, [Parameter(int, type)], bool)"),
        ("initially: a", "Property(initially, '', a)"),
        ("invariant A:\n  a\n", "Property(invariant, A, a)"),
        ("axiom A: forall x, y in xs: f(x, y)",
         "Property(axiom, A, Quantified(forall, [x, y], xs, Call(f, [x, y])))"),
        ("init: pass", "Init([Pass()])"),
        ("Go:\n  pre: a\n  eff: stop\n", "Event(Go, [Guard(a), Effect([Stop()])])"),
        ("Go:\n  eff:\n    stop\n  pre:\n    a\n", "Event(Go, [Effect([Stop()]), Guard(a)])"),
        ("Go: pre: a\n  eff: stop", "Event(Go, [Guard(a), Effect([Stop()])])"),
        ("priority:\n  Go:\n    pre: a\n    eff: stop\n  Wait: pre: priority\n    eff: priority = b\n",
         "Priority([Event(Go, [Guard(a), Effect([Stop()])]), "
         "Event(Wait, [Guard(priority), Effect([Assign(priority, '', b)])])])"),
    ],
)  # fmt: skip
def test_sections(text: str, tree: str) -> None:
    assert outline(section(text)) == tree


@pytest.mark.parametrize(
    ("text", "tree"),
    [
        ("a = 1", "Assign(a, '', 1)"),
        ("a[i].f = 1", "Assign(Attribute(Index(a, i), f), '', 1)"),
        ("a **= 2", "Assign(a, '**', 2)"),
        ("a //= 2", "Assign(a, '//', 2)"),
        ("Task t = Task(target=p, id=1)",
         "Declare(Task, t, Call(Task, [Keyword(target, p), Keyword(id, 1)]))"),
        ("q.push(1)", "Evaluate(Call(Attribute(q, push), [1]))"),
        ("Log.stdout << a << 'b'", "Evaluate(Binary('<<', Binary('<<', Attribute(Log, stdout), a), 'b'))"),
        ("for x in xs: pass", "For([x], xs, [Pass()])"),
        ("for a, b in xs if c else ys:\n    continue", "For([a, b], Conditional(c, xs, ys), [Continue()])"),
        ("for i = a, b + 1:\n    break", "CountedFor(i, a, Binary('+', b, 1), [Break()])"),
        ("while a: b = 1", "While(a, [Assign(b, '', 1)])"),
        ("while a:\n    invariant b\n    c = 1", "While(a, [Invariant(b), Assign(c, '', 1)])"),
        ("for i in ID: invariant a\n    invariant b", "For([i], ID, [Invariant(a), Invariant(b)])"),
        ("atomic:\n    a = 1\n    stop", "Atomic([Assign(a, '', 1), Stop()])"),
        ("if a: b = 1\n  elif c: atomic: d = 1\n  else: atomic:\n      e = 1\n      f = 1",
         "If([Branch(a, [Assign(b, '', 1)]), Branch(c, [Atomic([Assign(d, '', 1)])])], "
         "[Atomic([Assign(e, '', 1), Assign(f, '', 1)])])"),
        ("if a: b = 1\n    c = 1", "If([Branch(a, [Assign(b, '', 1), Assign(c, '', 1)])], [])"),
        ("for i in xs: while a: b = 1\n      c = 1",
         "For([i], xs, [While(a, [Assign(b, '', 1), Assign(c, '', 1)])])"),
        ("return -a", "Return(Unary('-', a))"),
    ],
)  # fmt: skip
def test_statements(text: str, tree: str) -> None:
    assert statement(text) == tree


@pytest.mark.parametrize(
    ("text", "tree"),
    [
        ("2 ** -3 ** 2", "Binary('**', 2, Unary('-', Binary('**', 3, 2)))"),
        ("-2 ** 2", "Unary('-', Binary('**', 2, 2))"),
        ("a << b + c < d", "Compare(Binary('<<', a, Binary('+', b, c)), [['<', d]])"),
        ("a not in b == c in d", "Compare(a, [['not in', b], ['==', c], [in, d]])"),
        ("not a in b", "Unary(not, Compare(a, [[in, b]]))"),
        ("!a && b || c", "Logic('||', Logic('&&', Unary('!', a), b), c)"),
        ("xs[a:b][:b][a:][:]", "Slice(Slice(Slice(Slice(xs, a, b), b), a))"),
        ("(a, b,)", "Tuple([a, b])"),
        ("(a, (b, c))", "Tuple([a, Tuple([b, c])])"),
        ("[a, [b],]", "ListDisplay([a, ListDisplay([b])])"),
        ("[]", "ListDisplay([])"),
        ("{a, b}", "SetDisplay([a, b])"),
        ("{}", "MapDisplay([])"),
        ("{a: b, c: {d: e},}", "MapDisplay([[a, b], [c, MapDisplay([[d, e]])]])"),
        ("f(a, b,)", "Call(f, [a, b])"),
        ("x[i]' + x'", "Binary('+', Primed(Index(x, i)), Primed(x))"),
        ("f(x)'", "Primed(Call(f, [x]))"),
        ("x''", "Primed(Primed(x))"),
        ("'a' + \"b\"", "Binary('+', 'a', 'b')"),
        (r"'a\'b\"\\\n\t' + '#'", r"""Binary('+', 'a\'b"\\\n\t', '#')"""),
        ("['', 'a', x']", "ListDisplay(['', 'a', Primed(x)])"),
        ("forall i, j in range(0, 3): a or exists k in xs: b and c",
         "Quantified(forall, [i, j], Call(range, [0, 3]), "
         "Logic(or, a, Quantified(exists, [k], xs, Logic(and, b, c))))"),
        ("(forall i in ID: a) and b", "Logic(and, Quantified(forall, [i], ID, a), b)"),
        ("not forall i in ID: a if b else c",
         "Unary(not, Quantified(forall, [i], ID, Conditional(b, a, c)))"),
        (".5 + 1e3 + 1.5E-3", "Binary('+', Binary('+', 0.5, 1000.0), 0.0015)"),
    ],
)  # fmt: skip
def test_expressions(text: str, tree: str) -> None:
    assert expression(text) == tree


@pytest.mark.parametrize(
    "text",
    [
        "  a\n  and b\n  or c\n",
        "  a\n    and b\n      or c\n",
        "  a and \\\n b or c\n",
        "  (a\nand b\n or c)\n",
        "  a  # one\n\n  # two\n  and b\n  or c",
        " a and b or c",
    ],
)
def test_a_formula_goes_on(text: str) -> None:
    start = "" if text.startswith(" a") else "\n"
    assert outline(section(f"invariant P:{start}{text}")) == outline(section("invariant P: a and b or c"))


def test_a_guard_and_its_event_go_on_behind_it() -> None:
    text = "Go:\n  pre: a\n    and b\n  eff: c = a\n     or b\n    d = 1\n"
    assert outline(section(text)) == outline(section("Go:\n  pre: a and b\n  eff:\n    c = a or b\n    d = 1\n"))


PRINTED = """\
using MotionWithScan
  sensors:
    Point position
    List<Point, Scan> pscan
    bool reached
    PathPlanner planner
  actuators:
    List<Point> path
allwrite:
  GridMap map
local:
  GridMap localMap
  Point target
  bool onPath = True
  List<Grid> obstacles
GUpdate:
  pre MotionWithScan.reached
  eff: atomic:
    map = merge(map, localMap)
    onPath = False
NewTarget:
  pre onPath
  eff:
    target = pickFrontierPos(map, \\
                             MotionWithScan.position)
    obstacles = findObs(map)
    MotionWithScan.path = \\
      MotionWithScan.planner(target, obstacles)
    if MotionWithScan.path == []:
      onPath = True
    else:
      onPath = False
    localMap = map
LUpdate:
  pre onPath and MotionWithScan.reached
  eff:
    for p, s in MotionWithScan.pscan:
      localMap = merge(localMap, \\
                       scanToMap(p, s))
"""
TASK = """\
using Motion:
  actuators:
    List<Point> path
  sensors:
    Point position
    bool reached
  PathPlanner planner
local:
  bool on_task = s
  List<Point> curr_path
  Task cur_task
allread:
  List<Point> shared_paths[N_SYS]
allwrite:
  List<Task> all_tasks
Complete:
  pre: on_task and Motion.reached
  eff: on_task= False
    shared_paths[pid]=[Motion.position]
Assign:
  pre: on_task
  eff:
    if len(all_tasks) == 0:
      stop
    else: atomic:
      for t in all_tasks:
        curr_path= Motion.planner(t.target)
        if pathIsClear(shared_paths, \\
                       curr_path, pid):
          on_task= True
          cur_task= t
          break
      if on_task:
        all_tasks.remove(cur_task)
        shared_paths[pid]= curr_path
        Motion.path= curr_path
      else:
        shared_paths[pid]=[Motion.position]
"""


def test_the_published_mapping_program_as_printed() -> None:
    tree, found = parse(Source("t", PRINTED))
    assert [(d.span.line, d.code, d.message) for d in found] == [
        (1, "K001", "expected ':' after 'using MotionWithScan'"),
        (17, "K001", "expected ':' after 'pre'"),
        (22, "K001", "expected ':' after 'pre'"),
        (35, "K001", "expected ':' after 'pre'"),
    ]
    corrected = PRINTED.replace("Scan\n  sensors", "Scan:\n  sensors").replace("pre ", "pre: ")
    right, found = parse(Source("t", corrected))
    assert not found
    assert outline(tree) == outline(right)  # a lost colon loses nothing else


def test_the_published_task_program_as_printed() -> None:
    tree, found = parse(Source("t", TASK))
    assert not found  # what is wrong in it is not its form
    assign = outline(tree.sections[-1])
    assert "[Stop()])], [Atomic([For([t], all_tasks, " in assign
    assert assign.endswith(
        "[Assign(Index(shared_paths, pid), '', ListDisplay([Attribute(Motion, position)]))])])])])])"
    )
    complete = outline(tree.sections[4])
    assert "Effect([Assign(on_task, '', False), Assign(Index(shared_paths, pid), ''" in complete


def nodes(tree: Any) -> Iterator[Any]:
    if isinstance(tree, tuple):
        for child in tree:
            yield from nodes(child)
    elif isinstance(tree, Node) and not isinstance(tree, Span):
        yield tree
        for field in fields_of(tree):
            yield from nodes(getattr(tree, field))


def test_places_hold_what_they_say() -> None:
    """The text at a span begins and ends as its node does."""
    text = "init:\n  (int, List<int>) xs = [f(a)[1:], {b: -c}, (d, 'e')] + (g if h.i else not j << k ** 2)\n"
    seen = {}
    for node in nodes(parse(Source("t", text))[0]):
        if hasattr(node, "span"):
            line = text.split("\n")[node.span.line - 1]
            seen[type(node).__name__, line[node.span.column - 1 : node.span.end_column - 1]] = node
    names = {name for name, _ in seen}
    assert {
        ("TupleType", "(int, List<int>)"), ("GenericType", "List<int>"), ("Slice", "f(a)[1:]"), ("Call", "f(a)"),
        ("MapDisplay", "{b: -c}"), ("Tuple", "(d, 'e')"), ("Literal", "'e'"),
        ("ListDisplay", "[f(a)[1:], {b: -c}, (d, 'e')]"),
        ("Conditional", "(g if h.i else not j << k ** 2)"), ("Unary", "not j << k ** 2"), ("Binary", "j << k ** 2"),
        ("Binary", "k ** 2"), ("Attribute", "h.i"), ("Init", "init"),
    } <= set(seen), names  # fmt: skip


def test_conflicts_are_those_that_the_grammar_tells_of() -> None:
    """Shift/reduce: deeper lines belong to the innermost block, a quantifier's body reaches far; reduce/reduce
    conflicts lark refuses."""
    from lark import Lark, logger

    told: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: told.append(record.getMessage())  # type: ignore[method-assign]
    level, handlers = logger.level, logger.handlers
    logger.setLevel(logging.DEBUG)
    logger.handlers = [handler]
    try:
        Lark(GRAMMAR.read_text(encoding="utf-8"), parser="lalr", lexer="basic", debug=True)
    finally:
        logger.setLevel(level)
        logger.handlers = handlers
    conflicts = set(zip(told[::2], told[1::2], strict=True))
    pairs = {(re.findall(r"terminal (\w+):", a)[0], re.sub(r"\s+", " ", b).strip(" *<>")) for a, b in conflicts}
    innermost = {(mark, rule) for mark, rule in pairs if mark == "INDENT"}
    assert {rule.split(" :")[0] for _, rule in innermost} <= {"block", "_suite{port}", "_suite{provided}"}, innermost
    assert {rule.split(" :")[0] for _, rule in pairs - innermost} <= {"expr", "disjunction"}, pairs
    assert {mark for mark, _ in pairs - innermost if not mark.startswith("__ANON")} == {"AND", "OR", "IF"}
