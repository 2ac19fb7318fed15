"""What is known is worked out late, and conditions of which nothing is known are not judged: neither may show."""

from __future__ import annotations

from random import Random

import pytest

from koordgen.lang.analyze.facts.decide import unsat
from koordgen.lang.analyze.facts.linear import negate
from koordgen.lang.analyze.facts.path import Condition, Path, is_open, joined
from koordgen.lang.analyze.facts.terms import Flow, formula
from koordgen.lang.analyze.program import check
from koordgen.lang.ir import expr as e
from koordgen.lang.ir import stmt as s
from koordgen.lang.ir.types import BOOL, FLOAT, INT
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax.parse import parse

AT = Span(1, 1, 1, 1)
OPERATORS = ("==", "!=", "<", "<=", ">", ">=")


def condition(rng: Random, depth: int = 2) -> e.Expr:
    which = rng.randrange(8)
    if which < 2 and depth:
        op = rng.choice(("and", "or"))
        return e.Logic(op, condition(rng, depth - 1), condition(rng, depth - 1), BOOL, AT)
    if which == 2 and depth:
        return e.Unary("not", condition(rng, depth - 1), BOOL, AT)
    if which == 3:
        return e.LocalRead(rng.choice("pq"), BOOL, AT)
    op, number = rng.choice(OPERATORS), e.Const(rng.randrange(-1, 3), INT, AT)
    if which == 4:
        value = rng.choice((e.Const(rng.choice((0.0, 1.5)), FLOAT, AT), e.Widen(number, FLOAT, AT)))
        return e.Compare(op, e.LocalRead(rng.choice("fg"), FLOAT, AT), value, BOOL, AT)
    read = e.Pid(INT, AT) if which == 5 else e.LocalRead(rng.choice("abc"), INT, AT)
    other = e.LocalRead(rng.choice("abc"), INT, AT) if which == 6 else number
    return e.Compare(op, read, other, BOOL, AT)


def test_what_is_open_is_possible_and_so_is_its_opposite() -> None:
    rng, found = Random(1), 0
    for _ in range(20_000):
        node = condition(rng)
        if is_open(node, set()):
            found += 1
            known = formula(node, Flow())
            assert not unsat((known,)) and not unsat((negate(known),)), node
    assert found > 5_000


def test_what_was_mentioned_before_is_not_open() -> None:
    node = e.Compare(">", e.LocalRead("a", INT, AT), e.Const(3, INT, AT), BOOL, AT)
    assert is_open(node, {"b", "pid"})
    assert not is_open(node, {"b", "a"})


def test_where_a_condition_fails_its_opposite_is_known_and_where_it_holds_itself() -> None:
    path = Path()
    asked = Condition(e.Compare(">", e.LocalRead("a", INT, AT), e.Const(3, INT, AT), BOOL, AT), path)
    assert path.passing(asked).flow.facts == (asked.formula,)
    assert path.failing(asked).flow.facts == (negate(asked.formula),)
    assert unsat((*path.passing(asked).flow.facts, *path.failing(asked).flow.facts))


def codes(effect: str, guard: str = "on") -> list[str]:
    text = (
        "allread: int x[N_SYS]\nallwrite: int total\nlocal:\n  int a\n  int b\n  bool on\n"
        f"Go:\n  pre: {guard}\n  eff:\n{effect}"
    )
    tree, unread = parse(Source("p.koord", text))
    assert not unread
    return [d.code for d in check(tree, Source("p.koord", text))[1]]


@pytest.mark.parametrize(
    "guard, effect, expected",
    [
        ("on", "    if a > 3: pass\n", []),
        ("a < 2", "    if a > 3: pass\n", ["K043"]),
        ("a < 2", "    if b > 3: pass\n", []),
        ("on", "    a = 2\n    if a > 3: pass\n", ["K043"]),
        ("on", "    a = b\n    if b > 3:\n      if a < 2: pass\n", ["K043"]),
        ("on", "    if not on: pass\n", ["K043"]),
        ("on", "    if a > 3: stop\n    if a > 4: pass\n", ["K043"]),
        ("on", "    if a > 3: stop\n    if a > 2: pass\n", []),
        ("on", "    if a > 3: b = 1\n    elif a > 4: pass\n", ["K043"]),
        ("pid == 1", "    if pid == 0: pass\n", ["K043"]),
        ("total == 1", "    if total == 0: pass\n", ["K043"]),
        ("on", "    if pid < 0: pass\n", ["K043"]),
        ("pid < 0", "    a = 1\n", ["K041"]),
        ("pid > 2 and pid < 3", "    a = 1\n", ["K041"]),
        ("a > 2 and a < 3", "    a = 1\n", ["K041"]),
        ("pid >= 0", "    a = 1\nNext:\n  pre: on\n  eff: a = 2\n", ["K042"]),
        ("pid >= 1", "    a = 1\nNext:\n  pre: on\n  eff: a = 2\n", []),
    ],
)
def test_conditions_are_judged_where_something_is_known(guard: str, effect: str, expected: list[str]) -> None:
    assert codes(effect, guard) == expected


def test_an_index_at_the_end_of_a_long_event_knows_all_of_the_way() -> None:
    steps = "".join(f"    if on: b = {i}\n" for i in range(3_000))
    assert codes(steps + "    a = x[pid - 1]\n", "pid > 0") == []
    assert codes(steps + "    a = x[pid - 1]\n", "on") == ["K031"]


def test_a_way_of_any_length_is_worked_out_and_forgotten() -> None:
    value = e.LocalRead("b", INT, AT)
    for asked in (True, False):
        path: Path | None = Path()
        for _ in range(20_000):
            assert path is not None
            path = path.assigning(s.LocalPlace("a"), value)
            passed = Condition(e.LocalRead("on", BOOL, AT), path)
            path = joined([path.passing(passed), None, path.failing(passed)])
        assert path is not None
        assert not asked or path.flow.value("local a") is not None
