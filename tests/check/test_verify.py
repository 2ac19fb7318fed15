"""The verifier finds what a faulty pass would leave behind, and the printer shows the tree as it is."""

from __future__ import annotations

import pytest

from koordgen.check import check
from koordgen.diagnostics import InternalError
from koordgen.ir import decl, expr, stmt
from koordgen.ir.printer import show
from koordgen.ir.types import BOOL, FLOAT, INT, POINT
from koordgen.ir.verify import verify
from koordgen.node import replace
from koordgen.source import Source, Span
from koordgen.syntax.parse import parse

AT = Span(3, 1, 3, 2)
TEXT = """using Motion:
  sensors: Point position
  actuators: Point target
param int k = 2
allread: Point x[N_SYS]
allwrite: float level = k
local: int count
  bool on
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
"""


def program() -> decl.Program:
    source = Source("dir/app.koord", TEXT)
    tree, found = parse(source)
    assert tree is not None, found
    checked, found = check(tree, source)
    assert checked is not None, found
    return checked


def test_the_checkers_program_is_well_formed_and_reads_as_text() -> None:
    verify(program())
    assert (
        show(program())
        == """program app (app.koord)
param k: int = 2
module Motion
  sensor position: Point
  actuator target: Point
allread x: Point[N_SYS] = Point(0.0, 0.0, 0.0)
allwrite level: float = (int -> float k)
local count: int = 0
local on: bool = False
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
"""
    )


ONE = expr.Const(1, INT, AT)
MIXED = expr.Binary("+", ONE, expr.Const(1.0, FLOAT, AT), True, FLOAT, AT)
YES = expr.Const(True, BOOL, AT)
ORIGIN = expr.PortRead("Motion", "position", POINT, AT)
WRONG: dict[str, stmt.Stmt] = {
    "type of an assignment": stmt.Assign(stmt.LocalPlace("count"), YES, AT),
    "type that a node claims": stmt.Assign(stmt.LocalPlace("count"), expr.Binary("/", ONE, ONE, True, INT, AT), AT),
    "operands of two types": stmt.Let("a", FLOAT, MIXED, AT),
    "operator": stmt.Let("a", INT, expr.Binary("**", ONE, ONE, True, INT, AT), AT),
    "comparison of a type without order": stmt.Let("a", BOOL, expr.Compare("<", YES, YES, BOOL, AT), AT),
    "unproved sum": stmt.Let("a", INT, expr.Binary("+", ONE, ONE, False, INT, AT), AT),
    "write to a sensor": stmt.Assign(stmt.PortPlace("Motion", "position"), ORIGIN, AT),
    "unknown port": stmt.Assign(stmt.PortPlace("Motion", "path"), ORIGIN, AT),
    "unknown name": stmt.Assign(stmt.LocalPlace("nobody"), ONE, AT),
    "temp out of scope": stmt.If(
        YES, (stmt.Let("a", INT, ONE, AT),), (stmt.Assign(stmt.TempPlace("a"), ONE, AT),), AT
    ),
    "temp declared twice": stmt.If(YES, (stmt.Let("a", INT, ONE, AT),), (stmt.Let("a", INT, ONE, AT),), AT),
    "condition": stmt.If(ONE, (), (), AT),
    "index": stmt.Let("a", POINT, expr.SlotRead("x", YES, True, POINT, AT), AT),
    "slot of an allwrite variable": stmt.Assign(stmt.OwnSlot("level"), expr.Const(1.0, FLOAT, AT), AT),
    "literal": stmt.Let("a", FLOAT, expr.Const(float("nan"), FLOAT, AT), AT),
    "axis": stmt.Let("a", FLOAT, expr.Coordinate(ORIGIN, "w", FLOAT, AT), AT),
    "builtin": stmt.Let("a", FLOAT, expr.Builtin("sin", (ONE,), FLOAT, AT), AT),
    "arguments": stmt.Let("a", INT, expr.Builtin("max", (ONE,), INT, AT), AT),
    "widened float": stmt.Let("a", FLOAT, expr.Widen(expr.Const(1.0, FLOAT, AT), FLOAT, AT), AT),
}  # fmt: skip


@pytest.mark.parametrize("statement", WRONG.values(), ids=WRONG.keys())
def test_a_faulty_statement_is_an_internal_error(statement: stmt.Stmt) -> None:
    sound = program()
    event = replace(sound.events[0], effect=(statement,))
    with pytest.raises(InternalError, match="3:1"):
        verify(replace(sound, events=(event,)))


def test_faulty_declarations_are_internal_errors() -> None:
    sound = program()
    pid = expr.Pid(INT, AT)
    for faulty in (
        replace(sound, params=(*sound.params, *sound.params)),
        replace(sound, locals=(replace(sound.locals[0], initial=pid),)),
        replace(sound, params=(replace(sound.params[0], default=expr.ParamRead("k", INT, AT)),)),
        replace(sound, events=(*sound.events, *sound.events)),
        replace(sound, events=(replace(sound.events[0], guard=ONE),)),
    ):
        with pytest.raises(InternalError):
            verify(faulty)
