"""Holds a program to the IR's invariants after every pass: a breach is a mistake of the compiler."""

from __future__ import annotations

from collections.abc import Iterable
from math import isfinite
from typing import assert_never

from koordgen.diagnostics import InternalError
from koordgen.ir import decl, expr, stmt
from koordgen.ir.types import BOOL, FLOAT, INT, POINT, Scalar
from koordgen.source import Span

_NUMBERS = (INT, FLOAT)
_SIGNATURES: dict[str, tuple[tuple[Scalar, ...], Scalar]] = {
    "Point": ((FLOAT, FLOAT, FLOAT), POINT),
    "distance": ((POINT, POINT), FLOAT),
    "sqrt": ((FLOAT,), FLOAT),
}


def verify(program: decl.Program) -> None:
    """Raises InternalError when types disagree, a name is not resolved, a temp is out of scope or an operator is
    none of the IR's."""
    _distinct("variable", [*program.params, *program.modules, *program.shared, *program.locals])
    _distinct("event", program.events)
    walk = _Walk(program)
    for param in program.params:
        walk.constant(param.default, param.type, params=False)
    variables: list[decl.Shared | decl.Local] = [*program.shared, *program.locals]
    for variable in variables:
        walk.constant(variable.initial, variable.type, params=True)
    walk.block(program.init, {})
    for event in program.events:
        walk.lets = set()
        walk.typed(event.guard, BOOL, {})
        walk.block(event.effect, {})


def _distinct(what: str, named: Iterable[decl.Param | decl.Module | decl.Shared | decl.Local | decl.Event]) -> None:
    seen: set[str] = set()
    for item in named:
        _must(item.name not in seen, f"two {what}s are called {item.name}", item.span)
        seen.add(item.name)


def _must(holds: bool, message: str, span: Span) -> None:
    if not holds:
        raise InternalError(f"IR at {span.line}:{span.column}: {message}")


Temps = dict[str, Scalar]


class _Walk:
    def __init__(self, program: decl.Program) -> None:
        self.params = {p.name: p.type for p in program.params}
        self.locals = {v.name: v.type for v in program.locals}
        self.slots = {v.name: v.type for v in program.shared if v.kind == "allread"}
        self.cells = {v.name: v.type for v in program.shared if v.kind == "allwrite"}
        self.ports = {(m.name, p.name): p for m in program.modules for p in m.ports}
        self.lets: set[str] = set()  # every Let of the event so far
        self.only_params: bool | None = None  # in a constant: whether params may be read

    def constant(self, node: expr.Expr, type_: Scalar, params: bool) -> None:
        self.only_params = params
        self.typed(node, type_, {})
        self.only_params = None

    def block(self, block: stmt.Block, outer: Temps) -> None:
        temps = dict(outer)
        for statement in block:
            match statement:
                case stmt.Assign(place, value, span):
                    self.typed(value, self.place(place, temps, span), temps)
                case stmt.Let(name, type_, value, span):
                    self.typed(value, type_, temps)
                    _must(name not in self.lets, f"{name} is declared twice in one event", span)
                    self.lets.add(name)
                    temps[name] = type_
                case stmt.If(condition, then, orelse):
                    self.typed(condition, BOOL, temps)
                    self.block(then, temps)
                    self.block(orelse, temps)
                case stmt.Stop():
                    pass
                case _:
                    assert_never(statement)

    def place(self, place: stmt.Place, temps: Temps, span: Span) -> Scalar:
        match place:
            case stmt.LocalPlace(name):
                return _known(self.locals, name, span)
            case stmt.OwnSlot(name):
                return _known(self.slots, name, span)
            case stmt.SharedPlace(name):
                return _known(self.cells, name, span)
            case stmt.TempPlace(name):
                return _known(temps, name, span)
            case stmt.PortPlace(module, port):
                found = self.ports.get((module, port))
                _must(found is not None and found.direction == "actuator", f"{module}.{port} is no actuator", span)
                assert found is not None
                return found.type
            case _:
                assert_never(place)

    def typed(self, node: expr.Expr, type_: Scalar, temps: Temps) -> None:
        found = self.type_of(node, temps)
        _must(node.type == found, f"a node of type {node.type} yields {found}", node.span)
        _must(found == type_, f"a {type_} is wanted, not a {found}", node.span)

    def type_of(self, node: expr.Expr, temps: Temps) -> Scalar:
        """The type that a node must carry, from its parts."""
        span = node.span
        if self.only_params is not None and isinstance(node, _VARIABLE):
            _must(False, "a constant reads a variable", span)
        match node:
            case expr.Const(value):
                _must(not isinstance(value, float) or isfinite(value), "a literal is not finite", span)
                return BOOL if isinstance(value, bool) else INT if isinstance(value, int) else FLOAT
            case expr.Pid() | expr.NSys():
                return INT
            case expr.ParamRead(name):
                _must(self.only_params is not False, "a param's default reads a param", span)
                return _known(self.params, name, span)
            case expr.LocalRead(name):
                return _known(self.locals, name, span)
            case expr.TempRead(name):
                return _known(temps, name, span)
            case expr.SharedRead(name):
                return _known(self.cells, name, span)
            case expr.SlotRead(name, index):
                self.typed(index, INT, temps)
                return _known(self.slots, name, span)
            case expr.PortRead(module, port):
                _must((module, port) in self.ports, f"no port {module}.{port}", span)
                return self.ports[module, port].type
            case _:
                return self.operation(node, temps)

    def operation(self, node: expr.Expr, temps: Temps) -> Scalar:
        span = node.span
        match node:
            case expr.Widen(operand):
                self.typed(operand, INT, temps)
                return FLOAT
            case expr.Unary(op, operand):
                self.typed(operand, operand.type, temps)
                _must(
                    operand.type in ((BOOL,) if op == "not" else (INT, FLOAT, POINT)), f"{op} on {operand.type}", span
                )
                _must(op in ("-", "not"), f"no operator {op}", span)
                return operand.type
            case expr.Binary(op, left, right, proved):
                self.typed(left, left.type, temps)
                self.typed(right, right.type, temps)
                _must(op in ("/", "//", "%") or proved, f"{op} needs no proof", span)
                return _binary(op, left.type, right.type, span)
            case expr.Compare(op, left, right):
                self.typed(left, right.type, temps)
                self.typed(right, left.type, temps)
                ordered = op in ("<", "<=", ">", ">=") and left.type in _NUMBERS
                _must(ordered or op in ("==", "!="), f"{op} on {left.type}", span)
                return BOOL
            case expr.Logic(op, left, right):
                _must(op in ("and", "or"), f"no operator {op}", span)
                self.typed(left, BOOL, temps)
                self.typed(right, BOOL, temps)
                return BOOL
            case expr.Conditional(condition, then, orelse):
                self.typed(condition, BOOL, temps)
                self.typed(then, orelse.type, temps)
                self.typed(orelse, then.type, temps)
                return then.type
            case expr.Coordinate(operand, axis):
                self.typed(operand, POINT, temps)
                _must(axis in ("x", "y", "z"), f"no axis {axis}", span)
                return FLOAT
            case expr.Builtin(name, args):
                return self.builtin(name, args, span, temps)
            case _:
                raise InternalError(f"IR at {span.line}:{span.column}: {type(node).__name__} is no operation")

    def builtin(self, name: str, args: tuple[expr.Expr, ...], span: Span, temps: Temps) -> Scalar:
        if name in _SIGNATURES:
            wanted, result = _SIGNATURES[name]
        else:
            _must(name in ("abs", "min", "max") and len(args) > 0, f"no builtin {name}", span)
            result = args[0].type
            _must(result in _NUMBERS, f"{name} of {result}", span)
            wanted = (result,) if name == "abs" else (result, result)
        _must(len(args) == len(wanted), f"{name} of {len(args)} arguments", span)
        for arg, type_ in zip(args, wanted, strict=True):
            self.typed(arg, type_, temps)
        return result


_VARIABLE = (
    expr.Pid, expr.NSys, expr.LocalRead, expr.TempRead, expr.SlotRead, expr.SharedRead, expr.PortRead
)  # fmt: skip


def _binary(op: str, left: Scalar, right: Scalar, span: Span) -> Scalar:
    if left == right and left in _NUMBERS and op in ("+", "-", "*", "/", "//", "%"):
        return FLOAT if op == "/" else left
    if op in ("+", "-") and left == right == POINT:
        return POINT
    if (op in ("*", "/") and (left, right) == (POINT, FLOAT)) or (op == "*" and (left, right) == (FLOAT, POINT)):
        return POINT
    raise InternalError(f"IR at {span.line}:{span.column}: {left} {op} {right}")


def _known(declared: dict[str, Scalar], name: str, span: Span) -> Scalar:
    _must(name in declared, f"{name} is not declared", span)
    return declared[name]
