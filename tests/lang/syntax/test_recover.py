"""Recovery: every independent mistake of a section is told once, and what is right around it is read."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest

from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.source import Source
from koordgen.lang.syntax import decl, expr, stmt
from koordgen.lang.syntax.layout import sections
from koordgen.lang.syntax.lr import DEEPEST_TREE
from koordgen.lang.syntax.parse import parse
from koordgen.lang.syntax.recover import MOST_FAULTS
from koordgen.lang.syntax.walk import broken_names
from tests.lang.syntax.test_fuzz import is_broken, lies_in

ROOT = Path(__file__).parents[3]

# Every construct of the language.
SAMPLE = r"""
using Motion:
  sensors:
    Point position
    bool reached
  actuators: List<Point> path
  PathPlanner planner
  assume position' in Ball(position, 1.0)
param List<(int, Point)> stops max 4 = [(1, Point(0, 0, 0)), (2, Point(1, 0, 0))]
def Task:
  Point target
  string label max 16 = 'a\'b'
allread: List<Point> paths[N_SYS] max 8
allwrite:
  Map<int, Set<string>> groups max 8, 4 = {}
  int total
local: Queue<Task> todo
extern type Ticket
extern fun price(Ticket t, List<int> xs[N_SYS]) -> float:
  requires: len(xs) > 0
  ensures:
    result >= 0
spec fun near(Point a, Point b) -> bool
axiom Symmetric: forall i, j in ID: near(paths[i][0], paths[j][0])
fun best(List<(int, float)> bids, int limit) -> int:
  int found = -1
  for who, what in bids:
    if what > 2 ** -1 and not who in [1, 2,]:
      found = who
    elif found == -1:
      continue
    else: break
  while found > limit and len(bids) > 1:
    found -= 1
  return found if found > 0 else limit
init: total = 0
Go:
  pre: not reached
    and (total < 3 or
         total > 5)
  eff: atomic:
    Task t = todo.pop()
    paths[pid] = Motion.planner(t.target)[0:2]
    groups[1] = {"x", t.label}
    Motion.path = paths[pid]
    (int, Point) first = stops[0]
    total += first[0] % 7
    Log.out << "at " << str(total)
    stop
Old:
  pre: a && !b || true
  eff:
    for i = 0, numAgents - 1:
      int[] xs = [i]
      total = total + xs[0]
initially: total == 0
invariant Apart:
  forall i, j in ID: i == j or exists k in range(0, 3): distance(paths[i][k], paths[j][k]) > 0.5
""".lstrip()


def read(text: str) -> tuple[decl.Program, list[Diagnostic]]:
    source = Source("t.koord", text)
    tree, found = parse(source)
    assert all(lies_in(d, source) for d in found)
    assert found or not is_broken(tree)
    return tree, found


def lines(text: str) -> list[int]:
    """The lines at which something is told."""
    return [d.span.line for d in read(text)[1]]


def effect(text: str) -> tuple[stmt.Block, list[int]]:
    """An effect's statements, and the lines of it at which something is told."""
    tree, found = read("E:\n  pre: ok\n  eff:\n" + "".join(f"    {line}\n" for line in text.split("\n")))
    (event,) = tree.sections
    assert isinstance(event, decl.Event), found
    clause = event.clauses[-1]
    assert isinstance(clause, decl.Effect)
    return clause.block, [d.span.line - 3 for d in found]


def test_the_sample_is_right() -> None:
    tree, found = read(SAMPLE)
    assert not found and not is_broken(tree)


def test_independent_mistakes_in_one_event_are_all_told() -> None:
    text = """\
E:
  pre: a + + b
  eff:
    x = 3 4
    y = 1
    if x >
      y = 2
      z = (1, 2
      w = 1
    for i range(3):
      y = i
    return return
    y = ]
    z = 1
"""
    tree, found = read(text)
    assert [d.span.line for d in found] == [2, 4, 6, 8, 10, 12, 13][: len(found)] or True
    assert [d.span.line for d in found] == [2, 4, 6, 8, 10, 12, 13]
    (event,) = tree.sections
    assert isinstance(event, decl.Event)
    guard, eff = event.clauses
    assert isinstance(guard, decl.Guard) and isinstance(guard.condition, expr.Broken)
    assert isinstance(eff, decl.Effect)
    assert [type(s).__name__ for s in eff.block] == [
        "BrokenStmt", "Assign", "If", "While", "BrokenStmt", "BrokenStmt", "Assign",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "kinds"),
    [
        ("x = = 1\ny = 2", "BrokenStmt Assign"),
        ("if a b:\n  x = 1\nelif c:\n  x = 2\nelse:\n  x = 3", "If"),
        ("if a:\n  x = 1\nelif c d:\n  x = 2\nelse:\n  x = 3", "If"),
        ("if a:\n  x = 1\nelse if c:\n  x = 2\nelse:\n  x = 3", "If"),
        ("if a\n  x = 1", "If"),
        ("if a: x = = 1", "If"),
        ("else:\n  x = 1\ny = 2", "If Assign"),
        ("while a b:\n  break", "While"),
        ("for x xs:\n  continue", "While"),
        ("fi a:\n  x = 1\nelse:\n  x = 2\ny = 2", "If Assign"),
        ("atomic\n  x = 1", "Atomic"),
        ("else: atomic:\n  x = 1", "If"),
        ("x = 1\n  y = 2\nz = 3", "Assign Assign Assign"),
        ("if a:\nx = 1\ny = 2", "If Assign Assign"),
        ("if a:\n    x = 1\n  y = 2\nz = 3", "If Assign"),
        ("if a:\n    x = 1\n  else:\n    y = 2\nz = 3", "If Assign"),
        ("x = (1, 2\npass", "BrokenStmt Pass"),
        ("x = 1)\npass", "BrokenStmt Pass"),
        ("x = (1]\npass", "BrokenStmt Pass"),
        ("x = 'a\npass", "BrokenStmt Pass"),
        ("x = 99999999999999999999\npass", "BrokenStmt Pass"),
        (f"x = {'-' * 200}1\npass", "BrokenStmt Pass"),
        ("x = $\npass", "BrokenStmt Pass"),
        ("x.y z = 3\npass", "BrokenStmt Pass"),
    ],
)
def test_one_mistake_is_told_once_and_the_rest_is_read(text: str, kinds: str) -> None:
    block, told = effect(text)
    assert len(told) == 1
    assert " ".join(type(s).__name__ for s in block) == kinds


def test_what_stands_in_a_header_beside_its_condition_is_kept() -> None:
    block, told = effect("if a b:\n  x = = 1\n  y = 2\nelse:\n  z = 3")
    assert told == [1, 2]
    (chain,) = block
    assert isinstance(chain, stmt.If)
    (branch,) = chain.branches
    assert isinstance(branch.condition, expr.Broken) and branch.condition.names == ("a", "b")
    assert [type(s) for s in branch.block] == [stmt.BrokenStmt, stmt.Assign]
    assert [type(s) for s in chain.orelse] == [stmt.Assign]


def test_a_forgotten_colon_costs_nothing() -> None:
    tree, found = read("E\n  pre a\n  eff\n    if a\n      x = 1\n    else\n      x = 2\n")
    assert [d.span.line for d in found] == [1, 2, 3, 4, 6]
    assert not is_broken(tree)


def test_lines_of_declarations_are_read_one_by_one() -> None:
    tree, found = read("local:\n  int a\n  int 3\n  b = 1\n  Point x y\n  float z = 2.0\n")
    assert [d.span.line for d in found] == [3, 4, 5]
    (section,) = tree.sections
    assert isinstance(section, decl.Variables)
    assert [v.name for v in section.variables] == ["a", "int", "b", "x", "z"]


def test_exports_and_imports_are_read_one_by_one() -> None:
    text = "export:\n  write int n m\n  int k\n    guarantee A: k <\n  int x[\n"
    tree, found = read(text + "import Mapping:\n  int\n  write int b of\n  int c\n")
    assert [d.span.line for d in found] == [2, 4, 5, 7, 8]
    first, second = tree.sections
    assert isinstance(first, decl.Export) and isinstance(second, decl.Import)
    assert [(v.name, len(v.guarantees)) for v in first.variables] == [("n", 0), ("k", 1), ("x", 0)]
    assert [item.name for item in second.items] == ["int", "b", "c"]
    assert broken_names(tree) >= {"n", "x", "b"}, "uses of these names are not reported as undefined"


def test_ports_are_read_one_by_one() -> None:
    tree, found = read("using M:\n  sensors:\n    Point\n    bool reached\n  planner\n  actuators: Point target\n")
    assert [d.span.line for d in found] == [3, 5]
    (section,) = tree.sections
    assert isinstance(section, decl.Using)
    assert [[p.name for p in item.ports] for item in section.items if isinstance(item, decl.Ports)] == [
        ["Point", "reached"], ["planner"], ["target"],
    ]  # fmt: skip


def test_a_clause_that_is_none_is_the_one_that_lacks() -> None:
    tree, found = read("E:\n  per: a\n  eff:\n    x = 1 1\n")
    assert [d.span.line for d in found] == [2, 4]
    (event,) = tree.sections
    assert isinstance(event, decl.Event)
    assert [type(c) for c in event.clauses] == [decl.Guard, decl.Effect]


def test_a_clause_without_the_name_of_its_event_costs_no_other_event() -> None:
    event = "  {}:\n    pre: a\n    eff: x = 1\n"
    tree, found = read(f"priority:\n{event.format('A')}  pre: b\n  eff: x = 2\n{event.format('B')}")
    assert [d.span.line for d in found] == [5]
    (block,) = tree.sections
    assert isinstance(block, decl.Priority) and [event.name for event in block.events] == ["A", "B"]


def test_a_header_of_which_nothing_can_be_made_breaks_its_section_only() -> None:
    tree, found = read("fun f(int a, -> int:\n  return a b\nfun g(int a) -> int:\n  return a\n")
    assert [d.span.line for d in found] == [1]
    broken, function = tree.sections
    assert isinstance(broken, decl.BrokenSection) and broken.names == ("f", "int", "a", "b")
    assert isinstance(function, decl.Function)


def test_what_has_no_header_of_its_own_is_one_mistake() -> None:
    assert lines("Motion:\n  sensors: Point position\n  actuators: Point target\n") == [2]
    assert lines("f(int a) -> int:\n  for i in a:\n    x = 1\n  return a\n") == [1]


def test_tabs_are_told_once_a_section_and_hide_nothing_else() -> None:
    tree, found = read("E:\n\tpre: a\n\teff:\n\t\tx = 1\n\t\ty = 2\nF:\n  pre: 1 1\n  eff: pass\n")
    assert [(d.code, d.span.line) for d in found] == [("K004", 2), ("K001", 7)]
    assert isinstance(tree.sections[0], decl.Event)


def test_blocks_too_deep_are_one_mistake() -> None:
    deep = "".join(f"{' ' * (i + 4)}if b:\n" for i in range(40)) + " " * 44 + "x = 1\n"
    assert lines(f"E:\n  pre: b\n  eff:\n{deep}F:\n  pre: 1 1\n  eff: pass\n") == [33, 46]


def test_blocks_on_one_line_and_types_nest_to_a_limit() -> None:
    for line in ("while a: " * 60 + "pass", "atomic: " * 60 + "pass", "List<" * 101 + "int" + ">" * 101 + " x",
                 "int" + "[]" * 101 + " x"):  # fmt: skip
        _, found = read(f"E:\n  pre: b\n  eff:\n    {line}\n    x = 1 1\n")
        assert [(d.code, d.span.line) for d in found] == [("K007", 4), ("K001", 5)]
    assert DEEPEST_TREE == 100


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x = f(a\ny = 2 2", [1, 2]),
        ("x = [1,\ny = 2 2", [1, 2]),
        ("x = (\nMotion.target = 1 1", [1, 2]),
        ("x = f(\na[i].f += 1 1", [1, 2]),
        ("x = {1:\nint y = 2 2", [1, 2]),
        ("x = f(a,\n  y = 2,\n  z = 3)\nw = 1 1", [4]),  # arguments
        ("x = f(a,\n  y == 2 or\n z <= 3)\nw = 1 1", [4]),
    ],
)
def test_an_open_bracket_ends_where_an_assignment_begins(text: str, told: list[int]) -> None:
    assert effect(text)[1] == told


@pytest.mark.parametrize("piece", ["-", "forall i in ID: ", "if x: ", "a' ", "]", "a if b else ", "for i in a: "])
def test_a_repetition_is_one_mistake(piece: str) -> None:
    assert effect(f"x = {piece * 3000}\nx = 1 1")[1] == [1, 2]


def test_a_header_is_told_once_though_its_block_shows_it_again() -> None:
    text = "func(int n) -> int:\n  return n\n :\n  pre: a\n"
    assert lines(text) == [1, 3]


def test_of_many_mistakes_the_first_are_told() -> None:
    text = "E:\n  pre: b\n  eff:\n" + "    x = 1 1\n" * 100
    assert lines(text) == list(range(4, 4 + MOST_FAULTS))
    assert len(lines(text + "F: x\n")) == MOST_FAULTS


def programs() -> list[str]:
    paths = [*ROOT.glob("examples/*/*.koord"), *ROOT.glob("tests/golden/*/*.koord")]
    return [SAMPLE, *(path.read_text(encoding="utf-8") for path in sorted(paths))]


def one_token_changed(text: str) -> Iterator[str]:
    """The text with each of its tokens left out, and with each doubled."""
    starts = [match.start() for match in re.finditer("^", text, re.MULTILINE)]
    for chunk in sections(Source("t", text)):
        for _, token, line, column in chunk.tokens:
            if token:
                at = starts[line - 1] + column - 1
                rest = text[at + len(token) :]
                yield text[:at] + rest.lstrip(" ")
                yield f"{text[:at]}{token} {token}{rest}"


@pytest.mark.parametrize("every", [7, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("text", programs(), ids=lambda text: text[:20].strip("# \n"))
def test_one_token_more_or_less_is_nearly_always_one_mistake(text: str, every: int) -> None:
    assert not read(text)[1]
    told = [len(read(changed)[1]) for changed in islice(one_token_changed(text), 0, None, every)]
    assert sum(count > 1 for count in told) <= 0.03 * len(told) + (every > 1)
    assert max(told) <= 4
