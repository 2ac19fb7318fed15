"""The verifier finds what a faulty pass would leave behind."""

from __future__ import annotations

import pytest

from koordgen.lang.analyze.program import check
from koordgen.lang.check.sections.program import resolve
from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import decl, expr, stmt
from koordgen.lang.ir.types import (
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
from koordgen.lang.ir.verify import verify
from koordgen.lang.node import replace
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax.parse import parse
from tests.lang.check.sound import SOUND

AT = Span(3, 1, 3, 2)
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
IN_LIST = expr.Contains(expr.TempRead("a", INT, AT), LIST, BOOL, AT)
PLANNED = expr.Contains(HERE, expr.PortCall("Motion", "planner", (HERE,), list_of(POINT), AT), BOOL, AT)
EVERY = expr.Quantified("forall", "i", LIST, YES, BOOL, AT)


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
    "loop invariant's type": stmt.While(YES, (), AT, (stmt.LoopInvariant(ONE, AT),)),
    "element in a loop invariant": stmt.For(("a",), (INT,), LIST, (), AT, (stmt.LoopInvariant(IN_LIST, AT),)),
    "planner in a loop invariant": stmt.While(YES, (), AT, (stmt.LoopInvariant(PLANNED, AT),)),
    "quantifier in a loop's block": stmt.While(
        YES,
        (stmt.If(EVERY, (), (), AT),),
        AT,
        (stmt.LoopInvariant(YES, AT),),
    ),
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


PID_READ = expr.Pid(INT, AT)
LATER = expr.Call(SOUND.functions[1].name, (ONE,), INT, AT)
MOTION, LOG = SOUND.modules
GO, TAKE = SOUND.events[:2]
NEAR = SOUND.properties[1]


def faulty_declarations() -> dict[str, decl.Program]:
    param, extern = SOUND.params[0], SOUND.externs[0]
    return {
        "params": replace(SOUND, params=(param, param)),
        "a function and a param of one name": replace(SOUND, params=(replace(param, name="once"),)),
        "initial value": replace(SOUND, locals=(replace(SOUND.locals[0], initial=PID_READ),)),
        "initial value's type": replace(SOUND, locals=(replace(SOUND.locals[0], initial=HALF),)),
        "initial value that calls": replace(SOUND, locals=(replace(SOUND.locals[0], initial=LATER),)),
        "param of a param": replace(SOUND, params=(replace(param, default=expr.ParamRead("k", INT, AT)),)),
        "record's defaults": replace(SOUND, records=(replace(SOUND.records[0], defaults=(HERE,)),)),
        "contract": replace(SOUND, externs=(replace(extern, requires=(ONE,)),)),
        "result before the call": replace(SOUND, externs=(replace(extern, requires=extern.ensures),)),
        "stream as a sensor": replace(
            SOUND, modules=(MOTION, replace(LOG, ports=(replace(LOG.ports[0], direction="sensor"),)))
        ),
    }


def faulty_events() -> dict[str, decl.Program]:
    planned = expr.Contains(HERE, expr.PortCall("Motion", "planner", (HERE,), list_of(POINT), AT), BOOL, AT)
    return {
        "events": replace(SOUND, events=(GO, GO)),
        "guard": replace(SOUND, events=(replace(GO, guard=ONE),)),
        "call of a planner in a guard": replace(SOUND, events=(replace(GO, guard=planned),)),
        "lock": replace(SOUND, events=(GO, replace(TAKE, lock=3))),
        "variable beyond the lock": replace(SOUND, events=(replace(GO, lock=0), TAKE)),
        "empty lock": replace(SOUND, locks=(*SOUND.locks, ())),
        "variable of two locks": replace(SOUND, locks=(*SOUND.locks, *SOUND.locks)),
    }


def faulty_functions() -> dict[str, decl.Program]:
    function, *others = SOUND.functions

    def body(*block: stmt.Stmt) -> decl.Program:
        return replace(SOUND, functions=(replace(function, block=block), *others))

    return {
        "function that goes on": body(stmt.Let("a", INT, ONE, AT)),
        "function that may go on": body(stmt.If(YES, (stmt.Return(ONE, AT),), (), AT)),
        "function that leaves its loop": body(stmt.While(YES, (stmt.If(YES, (stmt.Break(AT),), (), AT),), AT)),
        "function's result": body(stmt.Return(HALF, AT)),
        "function that reads a variable": body(stmt.Return(expr.LocalRead("count", INT, AT), AT)),
        "function that reads pid": body(stmt.Return(PID_READ, AT)),
        "function that writes": body(stmt.Assign(stmt.LocalPlace("count"), ONE, AT), stmt.Return(ONE, AT)),
        "function that stops": body(stmt.Stop(AT), stmt.Return(ONE, AT)),
        "function that calls itself": body(stmt.Return(expr.Call(function.name, (ONE,), INT, AT), AT)),
        "function that calls a later one": body(stmt.Return(LATER, AT)),
    }


def faulty_properties() -> dict[str, decl.Program]:
    bare = expr.LocalRead("on", BOOL, AT)
    elsewhere = expr.Compare("==", expr.PortRead("Log", "stdout", False, POINT, AT), HERE, BOOL, AT)

    def assumed(formula: expr.Expr) -> decl.Program:
        return replace(SOUND, modules=(replace(MOTION, assumptions=(decl.Assumption(formula, AT),)),))

    return {
        "property": replace(SOUND, properties=(replace(NEAR, formula=ONE),)),
        "properties": replace(SOUND, properties=(NEAR, NEAR)),
        "property with a bare variable": replace(SOUND, properties=(replace(NEAR, formula=bare),)),
        "assumption on a variable": assumed(bare),
        "assumption of another module": assumed(elsewhere),
    }


FAULTY = faulty_declarations() | faulty_events() | faulty_functions() | faulty_properties()


@pytest.mark.parametrize("program", FAULTY.values(), ids=FAULTY.keys())
def test_a_faulty_program_is_an_internal_error(program: decl.Program) -> None:
    with pytest.raises(InternalError):
        verify(program)


@pytest.mark.parametrize("blocks", [(1, 1), (0, 2), (0, None, 0), (0, 1, 0), (-1,)])
def test_priority_blocks_that_do_not_stand_together_are_found(blocks: tuple[int | None, ...]) -> None:
    with pytest.raises(InternalError, match="priority block"):
        verify(in_blocks(*blocks))


def test_priority_blocks_in_text_order_are_right() -> None:
    verify(in_blocks(None, 0, 0, None, 1, 2, 2))


def in_blocks(*blocks: int | None) -> decl.Program:
    """The sound program with one event for each of these, in the block of that number."""
    first = SOUND.events[0]
    events = [replace(first, name=f"E{number}", priority=block) for number, block in enumerate(blocks)]
    return replace(SOUND, events=tuple(events))


@pytest.mark.parametrize("effect", ["atomic:\n      n += 1", "for i in ID:\n      if i == pid: x[i] = 3"])
def test_a_program_of_drafts_is_refused(effect: str) -> None:
    text = f"allread: int x[N_SYS]\nallwrite: int n\nGo:\n  pre: n > 2\n  eff:\n    {effect}\n"
    source = Source("draft.koord", text)
    tree, _ = parse(source)
    with pytest.raises(AssertionError):
        verify(resolve(tree, source).program)
    program, _ = check(tree, source)
    assert program is not None
    verify(program)
