"""The build's budget and the robot's must give the same verdict."""

from __future__ import annotations

import pytest

from koordgen.bundle.budget import check_budget, overhead
from koordgen.check import check
from koordgen.emit.program import WIRE_FORMAT
from koordgen.ir.decl import Program
from koordgen.runtime import wire
from koordgen.runtime.layout import Layout, TooLarge
from koordgen.runtime.program import Variable
from koordgen.runtime.values import Point
from koordgen.source import Source
from koordgen.syntax.parse import parse

TYPES = {"bool": bool, "int": int, "float": float, "Point": Point}


def program(points: int, others: str = "") -> Program:
    text = "".join(f"allread: Point x{i}[N_SYS]\n" for i in range(points)) + others + "E:\n  pre: True\n  eff: pass\n"
    tree, found = parse(Source("a.koord", text))
    assert tree is not None, found
    checked, _ = check(tree, Source("a.koord", text))
    assert checked is not None
    return checked


def robots_verdict(checked: Program, n_sys: int) -> bool:
    try:
        Layout([Variable(v.name, v.kind, TYPES[v.type.name], lambda: None) for v in checked.shared], n_sys)
    except TooLarge:
        return False
    return True


def test_overhead_is_the_wires() -> None:
    assert [overhead(n) for n in range(1, wire.MAX_ROBOTS + 1)] == [
        wire.overhead(n) for n in range(1, wire.MAX_ROBOTS + 1)
    ]


def test_the_wire_format_is_the_hashed_one() -> None:
    assert WIRE_FORMAT == wire.WIRE_FORMAT


@pytest.mark.parametrize("n_sys", [1, 2, 5, 16, 60, 90, 128])
def test_both_give_the_same_verdict(n_sys: int) -> None:
    verdicts = set()
    for points in range(38):
        checked = program(points, "allwrite:\n  int a\n  bool b\n  float c\n")
        fits = not check_budget(checked, n_sys)
        assert fits == robots_verdict(checked, n_sys), points
        verdicts.add(fits)
    assert len(verdicts) == 2 or n_sys > 100, "both sides of the limit were met"


def test_the_message_has_the_arithmetic_and_the_place() -> None:
    (found,) = check_budget(program(40), 5)
    assert (found.code, found.span.line) == ("B004", 29)
    assert "up to 1305 bytes; with 5 robots a datagram of 1200 has room for 944" in found.message
