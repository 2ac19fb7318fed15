"""Random well-typed IR programs over one fixed set of declarations, and random states for them."""

from __future__ import annotations

from functools import cache
from typing import Any

from hypothesis import strategies as st

from koordgen.ir import decl as d
from koordgen.ir import expr as e
from koordgen.ir import stmt as s
from koordgen.ir.types import BOOL, FLOAT, INT, POINT, Scalar
from koordgen.source import Span

N_SYS = 3
DIVISIONS = ("/", "//", "%")
AT = Span(1, 1, 1, 2)
VARIABLES = {"i": INT, "f": FLOAT, "b": BOOL, "p": POINT}
ZERO: dict[Scalar, e.Expr] = {
    INT: e.Const(2, INT, AT),
    FLOAT: e.Const(1.5, FLOAT, AT),
    BOOL: e.Const(False, BOOL, AT),
    POINT: e.Builtin("Point", (e.Const(1.0, FLOAT, AT), e.Const(2.0, FLOAT, AT), e.Const(0.5, FLOAT, AT)), POINT, AT),
}
PORTS = (
    d.Port("position", POINT, "sensor", AT),
    d.Port("reached", BOOL, "sensor", AT),
    d.Port("target", POINT, "actuator", AT),
)

ints = st.sampled_from([0, 1, 1, 2, 2, 3, 3, 4, 5, 6, 7, 8, 9, 2**62, 10**30])
floats = st.sampled_from([0.0, 0.5, 0.5, 1.0, 1.0, 2.5, 2.5, 3.25, 4.0, 1e-3, 1e9, 1e308])


def _leaves(type_: Scalar, temps: tuple[tuple[str, Scalar], ...]) -> st.SearchStrategy[e.Expr]:
    name = next(n for n, t in VARIABLES.items() if t == type_)
    found: list[st.SearchStrategy[e.Expr]] = [
        st.just(e.ParamRead(f"param_{name}", type_, AT)),
        st.just(e.LocalRead(f"local_{name}", type_, AT)),
        st.just(e.SharedRead(f"all_{name}", type_, AT)),
        *(st.just(e.TempRead(n, t, AT)) for n, t in temps if t == type_),
    ]
    match type_.name:
        case "int":
            found += [ints.map(lambda v: e.Const(v, INT, AT)), st.sampled_from([e.Pid(INT, AT), e.NSys(INT, AT)])]
        case "float":
            found += [floats.map(lambda v: e.Const(v, FLOAT, AT))]
        case "bool":
            found += [st.booleans().map(lambda v: e.Const(v, BOOL, AT)), st.just(_port("reached", BOOL))]
        case "Point":
            found += [st.just(_port("position", POINT)), st.just(_port("target", POINT))]
    return st.one_of(found)


def _port(name: str, type_: Scalar) -> e.Expr:
    return e.PortRead("Motion", name, type_, AT)


def _indices(any_int: st.SearchStrategy[e.Expr]) -> st.SearchStrategy[e.Expr]:
    """Indices that mostly name a robot: what is discarded shows little."""
    pid: e.Expr = e.Pid(INT, AT)
    constant = st.integers(0, N_SYS - 1).map(lambda v: e.Const(v, INT, AT))
    within = any_int.map(lambda i: e.Binary("%", i, e.NSys(INT, AT), False, INT, AT))
    return st.one_of(st.just(pid), constant, within, within, any_int)


@cache  # strategies are costly to build and the same few are asked for again and again
def expressions(type_: Scalar, depth: int = 3, temps: tuple[tuple[str, Scalar], ...] = ()) -> st.SearchStrategy[e.Expr]:
    """Expressions of a type, at most so deep."""
    leaves = _leaves(type_, temps)
    if depth == 0:
        return leaves

    def sub(of: Scalar) -> st.SearchStrategy[e.Expr]:
        return st.deferred(lambda: expressions(of, depth - 1, temps))

    def binary(ops: list[str], left: Scalar, right: Scalar) -> st.SearchStrategy[e.Expr]:
        return st.builds(
            lambda o, a, b: e.Binary(o, a, b, o not in DIVISIONS, type_, AT),
            st.sampled_from(ops),
            sub(left),
            sub(right),
        )

    def call(name: str, *args: Scalar) -> st.SearchStrategy[e.Expr]:
        return st.tuples(*(sub(a) for a in args)).map(lambda given: e.Builtin(name, given, type_, AT))

    name = next(n for n, t in VARIABLES.items() if t == type_)
    found: list[st.SearchStrategy[e.Expr]] = [
        leaves,
        st.builds(lambda c, a, b: e.Conditional(c, a, b, type_, AT), sub(BOOL), sub(type_), sub(type_)),
        _indices(sub(INT)).map(lambda i: e.SlotRead(f"each_{name}", i, False, type_, AT)),
    ]
    match type_.name:
        case "int":
            found += [binary(["+", "-", "*", "//", "%"], INT, INT), call("abs", INT), call("min", INT, INT)]
            found += [sub(INT).map(lambda a: e.Unary("-", a, INT, AT)), call("max", INT, INT)]
        case "float":
            found += [binary(["+", "-", "*", "/", "//", "%"], FLOAT, FLOAT), call("abs", FLOAT), call("sqrt", FLOAT)]
            found += [sub(FLOAT).map(lambda a: e.Unary("-", a, FLOAT, AT)), call("min", FLOAT, FLOAT)]
            found += [sub(INT).map(lambda a: e.Widen(a, FLOAT, AT)), call("distance", POINT, POINT)]
            found += [st.builds(lambda p, c: e.Coordinate(p, c, FLOAT, AT), sub(POINT), st.sampled_from("xyz"))]
        case "bool":
            found += [sub(BOOL).map(lambda a: e.Unary("not", a, BOOL, AT))]
            found += [
                st.builds(
                    lambda o, a, b: e.Logic(o, a, b, BOOL, AT), st.sampled_from(["and", "or"]), sub(BOOL), sub(BOOL)
                )
            ]
            for of, ops in ((INT, "== != < <= > >="), (FLOAT, "== != < <= > >="), (POINT, "== !="), (BOOL, "== !=")):
                found += [
                    st.builds(
                        lambda o, a, b: e.Compare(o, a, b, BOOL, AT), st.sampled_from(ops.split()), sub(of), sub(of)
                    )
                ]
        case "Point":
            found += [binary(["+", "-"], POINT, POINT), binary(["*", "/"], POINT, FLOAT), binary(["*"], FLOAT, POINT)]
            found += [sub(POINT).map(lambda a: e.Unary("-", a, POINT, AT)), call("Point", FLOAT, FLOAT, FLOAT)]
    return st.one_of(found)


def _place(name: str, type_: Scalar) -> st.SearchStrategy[s.Place]:
    found: list[s.Place] = [s.LocalPlace(f"local_{name}"), s.SharedPlace(f"all_{name}"), s.OwnSlot(f"each_{name}")]
    if type_ == POINT:
        found.append(s.PortPlace("Motion", "target"))
    return st.sampled_from(found)


@st.composite
def blocks(
    draw: st.DrawFn, depth: int = 2, temps: tuple[tuple[str, Scalar], ...] = (), prefix: str = "t"
) -> tuple[s.Stmt, ...]:
    """Blocks of one to three statements; temporaries have names that are unique within an event."""
    found: list[s.Stmt] = []
    for index in range(draw(st.integers(1, 3))):
        name, type_ = draw(st.sampled_from(sorted(VARIABLES.items())))
        value = expressions(type_, 2, temps)
        match draw(st.sampled_from(["assign", "assign", "assign", "let", "if", "temp", "stop"])):
            case "let":
                temp = f"{prefix}{index}"
                found.append(s.Let(temp, type_, draw(value), AT))
                temps = (*temps, (temp, type_))
            case "if" if depth:
                orelse = draw(st.just(()) | blocks(depth - 1, temps, f"{prefix}{index}e"))
                condition = draw(expressions(BOOL, 2, temps))
                found.append(s.If(condition, draw(blocks(depth - 1, temps, f"{prefix}{index}i")), orelse, AT))
            case "temp" if temps:
                temp, of = draw(st.sampled_from(temps))
                found.append(s.Assign(s.TempPlace(temp), draw(expressions(of, 2, temps)), AT))
            case "stop" if index:
                found.append(s.Stop(AT))
                break
            case _:
                found.append(s.Assign(draw(_place(name, type_)), draw(value), AT))
    return tuple(found)


@st.composite
def programs(draw: st.DrawFn) -> d.Program:
    """A program of one to three random events."""
    events = tuple(
        d.Event(
            f"Event{i}",
            draw(expressions(BOOL, 2)) if draw(st.integers(0, 2)) == 0 else e.Const(True, BOOL, AT),
            draw(blocks()),
            AT,
        )
        for i in range(draw(st.integers(1, 3)))
    )
    return d.Program(
        name="random",
        path="random.koord",
        params=tuple(d.Param(f"param_{n}", t, ZERO[t], AT) for n, t in VARIABLES.items()),
        modules=(d.Module("Motion", PORTS, AT),),
        shared=(
            *(d.Shared(f"each_{n}", "allread", t, ZERO[t], AT) for n, t in VARIABLES.items()),
            *(d.Shared(f"all_{n}", "allwrite", t, ZERO[t], AT) for n, t in VARIABLES.items()),
        ),
        locals=tuple(d.Local(f"local_{n}", t, ZERO[t], AT) for n, t in VARIABLES.items()),
        init=(),
        events=events,
    )


points = st.tuples(*[st.floats(-100, 100).map(lambda v: round(v, 3))] * 3)
VALUES: dict[Scalar, st.SearchStrategy[Any]] = {
    INT: st.integers(-5, 9) | st.sampled_from([1, 2, 3, 2**62, -(2**63)]),
    FLOAT: st.floats(-100, 100).map(lambda v: round(v, 3)) | st.sampled_from([1e300, -0.0]),
    BOOL: st.booleans(),
    POINT: points,
}
