"""Limits of one event are equal in the semantics and in generated code.

With low limits random programs, which are small, reach them often.
"""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from functools import partial

import pytest

from koordgen.build.emit import size
from koordgen.build.emit.program import program_text
from koordgen.lang.semantics import eval, exec, numbers, values
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.step import initial
from koordgen.runtime.program import metered
from koordgen.runtime.values import containers, turns
from tests.agree.both import Generated, Meant, agree
from tests.agree.programs import N_SYS
from tests.build.emit.generated import in_one_line
from tests.lang.semantics.programs import compiled

TURNS, ELEMENTS, A_TURN, BITS, SMALL, CELLS, PAIRS = 12, 5, 2, 12, 3, 2, 2
LIMITS = [
    (turns, "MOST_TURNS", TURNS), (turns, "MOST_ELEMENTS", ELEMENTS), (turns, "ELEMENTS_A_TURN", A_TURN),
    (turns, "MOST_BITS", BITS), (turns, "SMALL_BITS", SMALL), (containers, "MOST_BITS", BITS),
    (size, "ELEMENTS_A_TURN", A_TURN), (size, "MOST_BITS", BITS), (size, "SMALL_BITS", SMALL),
    (exec, "MAX_TURNS", TURNS), (eval, "MAX_ELEMENTS", ELEMENTS), (eval, "ELEMENTS_A_TURN", A_TURN),
    (numbers, "MAX_BITS", BITS), (numbers, "SMALL_BITS", SMALL),
    (turns, "CELLS_AN_ELEMENT", CELLS), (size, "CELLS_AN_ELEMENT", CELLS), (values, "CELLS_AN_ELEMENT", CELLS),
    (metered, "PAIRS_A_TURN", PAIRS), (eval, "PAIRS_A_TURN", PAIRS),
]  # fmt: skip


@pytest.fixture
def low(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, name, value in LIMITS:
        monkeypatch.setattr(module, name, value)


def test_the_limits_of_the_semantics_are_those_of_robots() -> None:
    assert exec.MAX_TURNS == turns.MOST_TURNS
    assert eval.MAX_ELEMENTS == turns.MOST_ELEMENTS
    assert eval.ELEMENTS_A_TURN == turns.ELEMENTS_A_TURN
    assert numbers.MAX_BITS == turns.MOST_BITS
    assert numbers.SMALL_BITS == turns.SMALL_BITS
    assert size.ELEMENTS_A_TURN == turns.ELEMENTS_A_TURN
    assert (size.MOST_BITS, size.SMALL_BITS) == (turns.MOST_BITS, turns.SMALL_BITS)
    assert size.CELLS_AN_ELEMENT == values.CELLS_AN_ELEMENT == turns.CELLS_AN_ELEMENT
    assert eval.PAIRS_A_TURN == metered.PAIRS_A_TURN
    assert eval.MOST_COUNTED == turns.MOST_TURNS * turns.ELEMENTS_A_TURN


def compare(seed: int, seen: Counter[str]) -> None:
    """Run one random program both ways, if its initial values are within the limits."""
    with suppress(Discarded, turns.TooMuch):
        agree(seed, seen)


def test_random_programs_agree_at_the_limits(low: None) -> None:
    seen: Counter[str] = Counter()
    for seed in range(40):
        compare(seed, seen)
    assert seen["discarded"] >= seen.total() / 4, "the limits must be met"
    assert seen["ran"] >= seen.total() / 10, "and not by all"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("MOST_TURNS", TURNS + 1), ("MOST_ELEMENTS", ELEMENTS + 1), ("ELEMENTS_A_TURN", A_TURN + 1),
        ("MOST_BITS", BITS + 1),
    ],
)  # fmt: skip
def test_a_limit_that_is_off_by_one_is_found(name: str, value: int, low: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(turns, name, value)
    with pytest.raises(AssertionError):  # a Difference is one
        both("k = a + b", f"  int a = {2**SMALL}\n  int b = {2**BITS - 1}")  # what random programs hardly add
        for seed in range(400):
            compare(seed, Counter())


def both(effect: str, declared: str = "", functions: str = "") -> object:
    """Return the result of one event, which is equal on both sides: its locals, or "discarded"."""
    lines = "\n".join(["    " + line for line in effect.split("\n")])
    program = compiled(f"{functions}local:\n  int k = 3\n{declared}\nE:\n  pre: True\n  eff:\n{lines}\n")
    state = initial(program, N_SYS)
    event, _, outcome = Generated(program, program_text(program)).event(state, 0)
    assert (event, None, outcome) == Meant(program).event(state, 0)
    return outcome if isinstance(outcome, str) else {name: value[1] for name, value in outcome["locals"].items()}


LONGEST = "int n = 2 ** 1023\nn = n * n * n * n * 8\nn = n + (n - 1)"  # 4,096 bits
SLOW = "fun f(int a) -> int:\n  return a + 1\n"


@pytest.mark.parametrize(
    ("effect", "outcome"),
    [
        ("for i in range(1000): pass", {"k": "3"}),
        ("for i in range(1001): pass", "discarded"),
        ("for i in range(1000000000):\n  if i == 3: break", {"k": "3"}),
        ("while k < 1003: k += 1", {"k": "1003"}),
        ("while k < 1004: k += 1", "discarded"),
        ("while True:\n  k += 1\n  if k == 1003: break", {"k": "1003"}),
        ("while True:\n  k += 1\n  if k == 1004: break", "discarded"),
        ("for i in range(500): k = f(k)", {"k": "503"}),
        ("for i in range(500): k = f(k)\nk = f(k)", "discarded"),
        ("for i in range(40):\n  for j in range(24): k += 1", {"k": "963"}),
        ("for i in range(41):\n  for j in range(24): k += 1", "discarded"),
        ("int n = 2 ** 1023\nn = n * n * n * n\nn = n * 8\nk = n % 7", {"k": "1"}),
        ("int n = 2 ** 1023\nn = n * n * n * n\nn = n * 16\nk = n % 7", "discarded"),
        ("int n = 2 ** 1023\nn = n * n * n * n * 8\nn = n + (n - 1)\nk = n % 7", {"k": "1"}),
        ("int n = 2 ** 1023\nn = n * n * n * n * 8\nn = n + n\nk = n % 7", "discarded"),
        ("int n = -(2 ** 1023)\nn = n * n * n * n * 8\nn = -n - n\nk = n % 7", "discarded"),
        ("int n = 2 ** 1023\nn = n * n * n * n * 8\nn = n + (n - 1) + 1\nk = n % 7", {"k": "2"}),
        (f"{LONGEST}\nint m = 2 ** 63\nk = (n + m) % 7", {"k": "2"}),
        (f"{LONGEST}\nint m = 2 ** 64\nk = (n + m) % 7", "discarded"),
        ("int n = 16 ** 1023\nk = n % 7", {"k": "1"}),
        ("int n = 16 ** 1024\nk = n % 7", "discarded"),
    ],
)
def test_the_last_that_is_within_a_limit_and_the_first_that_is_not(
    effect: str, outcome: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(turns, "MOST_TURNS", 1000)
    monkeypatch.setattr(exec, "MAX_TURNS", 1000)
    assert both(effect, functions=SLOW if "f(" in effect else "") == outcome


@pytest.mark.parametrize(
    ("grow", "start"),
    [
        ("s = s + s", 'string s = "ab"'),
        ("xs.extend(xs)", "List<int> xs = [1, 2]"),
        ("xs = xs + xs", "List<int> xs = [1, 2]"),
        ("k = k * k", "int n = 0"),
        ("k = k + k", "int n = 0"),
        ("k = sum([k, k])", "int n = 0"),
    ],
)
def test_what_doubles_for_ever_ends(grow: str, start: str) -> None:
    assert both(f"{start}\nwhile k != 0: {grow}") == "discarded"


# By operation: what each turn of a loop takes beside its own turn, of a list, set, text or path of 2,000 elements.
MANY = """List<int> xs
for i in range(2000): xs.append(i)
Set<int> few = {1, 2}
Set<int> many
List<Point> path
List<List<int>> nested = [[1, 2], xs]
List<(int, bool)> pairs
string s = "abcdefghij"
Map<int, int> m
bool b
for i in range(2000):
  many.add(i)
  path.append(Point(i, 0, 0))
  pairs.append((i, True))
  m[i] = i
for i in range(11): s = s + s
GridMap g = GridMap(Point(0, 0, 0), Point(200, 100, 0), 1)
k = 0
"""

alike = partial(pytest.param, marks=pytest.mark.slow)  # like another one, which is tried every day


@pytest.mark.parametrize(
    ("operation", "cost"),
    [
        ("n = sum(xs)", 20), ("n = xs.count(3)", 20), alike("n = xs.index(3)", 20), ("b = 3 in xs", 20),
        ("b = 3 in many", 20),
        ("b = xs == xs", 40), alike("b = xs != [1]", 20), alike("b = many == few", 20), ("ys = sorted(xs)", 40),
        alike("us = many.intersection(few)", 20), alike("us = many.difference(many)", 40),
        alike("us = few.union(many)", 40),
        ("b = xs in nested", 40), alike("b = nested == nested", 40), ("b = (3, True) in pairs", 60),
        ("b = m == m", 120),
        ('b = "x" in s', 204), ("b = s == s", 0), alike("b = s < s", 0), ("b = 3 in m", 0), alike("n = m[3]", 0),
        alike("n = m.get(-3, 4)", 0), ("b = is_free(g, Grid(1, 1, 1))", 0), ("n = first(xs) + len(xs)", 0),
        ("h = mark_free(g, Grid(1, 1, 1))", 2), alike("h = mark_occupied(g, Grid(1, 1, 1))", 2),
        ("h = merge(g, g)", 200),
        ("h = GridMap(Point(0, 0, 0), Point(200, 100, 0), 1)", 2), alike("b = g == g", 4),
        alike("f = path_distance(path, [])", 200), ("f = path_distance([Point(0, 0, 0)], path)", 400),
        ("b = clear([Point(0, 1, 0)], [path, [Point(0, 0, 0)]], 0.5)", 400), ("for j, _ in m.items(): break", 1),
        ("for j in m: break", 21),
    ],
)  # fmt: skip
def test_going_through_many_elements_takes_turns(operation: str, cost: int, monkeypatch: pytest.MonkeyPatch) -> None:
    declared = "int n = 0\nfloat f = 0.0\nList<int> ys\nSet<int> us\nGridMap h\n"
    made = 2000 + 2011 + sum(n // 100 for n in range(2001)) * 5 + sum((10 << n) // 100 for n in range(1, 12)) + 2
    effect = MANY + declared + f"for i in range(10):\n  k += 1\n  {operation}\nxs = []"
    for limit, outcome in ((made + 10 * (1 + cost), {"k": "10"}), (made + 10 * (1 + cost) - 1, "discarded")):
        monkeypatch.setattr(turns, "MOST_TURNS", limit)
        monkeypatch.setattr(exec, "MAX_TURNS", limit)
        assert both(effect) == outcome


def test_what_is_surely_small_is_not_looked_at() -> None:
    text = """allread: int x[N_SYS]
local: List<int> few max 99
  List<int> many max 100
  List<int> grown max 3
  Map<int, bool> m max 33
  Map<int, bool> n max 34
  string mode
  bool b
  int k
E:
  pre: few == [1, 2] and 3 in few and mode == "idle" and pid in ID
  eff:
    grown.extend(grown)
    k = sum(few) + sum(x)
    b = m == {1: True}
    b = n == {1: True}
    k = k + sum(many)
    k = k + grown.count(3)
"""
    shown = in_one_line(program_text(compiled(text)))
    assert "few.value == (1, 2) and 3 in s.local_few.value" in shown
    assert "sum(s.local_few.value)" in shown
    assert "sum(s.shared_x.all)" in shown
    assert "sum(looked(s.local_many.value))" in shown
    assert "looked(s.local_grown.value).count(3)" in shown
    assert shown.count("looked_in(") == 1


def test_making_many_elements_takes_turns() -> None:
    effect = "List<int> xs\nfor i in range(14000): xs.append(i)\nk = len(xs)"
    assert both(effect) == {"k": "14000"}
    assert both(effect.replace("14000", "15000")) == "discarded"  # 15,000 ** 2 / 2 elements are more than 100 million
