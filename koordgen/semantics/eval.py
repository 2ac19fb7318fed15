"""What an expression means: pure, over what one robot sees at one moment.

Numbers are Python's: ints without bound inside an event, floats of 64 bits, `/` a true quotient (of two ints as well),
`//` and `%` floored with the divisor's sign. What has no value (a division by zero, an index out of range, a key that
is not there, an int too large for a float) discards the event; NaN and infinity may arise and only must not leave the
robot. Where the checker has proved that a node cannot fail and it does, that is a mistake of the compiler.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple, assert_never

from koordgen.diagnostics import InternalError
from koordgen.ir import expr as ir
from koordgen.ir.types import FLOAT, MapOf, RecordType, Sized, TupleOf
from koordgen.ir.types import ExternType as Extern
from koordgen.ir.types import Sequence as SequenceType
from koordgen.runtime.values import Opaque, Point
from koordgen.semantics import builtins
from koordgen.semantics.exact import is_exact, power
from koordgen.semantics.state import Robot
from koordgen.semantics.values import RecordValue, Value, as_, conforms, default, items, same
from koordgen.source import Span

MAX_EXPONENT = 1024


class Discarded(Exception):
    """Why an event is discarded whole, and where."""

    def __init__(self, reason: str, span: Span) -> None:
        super().__init__(f"line {span.line}: {reason}")
        self.reason = reason
        self.span = span


Call = Callable[[str, tuple[Value, ...]], Value]


class View(NamedTuple):
    """What one robot sees: `slots` by allread name and pid, `cells` by allwrite name, `ports` by "Module.port". `call`
    applies functions, `ask` callable ports. `after` are a robot's primed ports in an assumption; `robots` is the whole
    fleet in a property."""

    pid: int
    n_sys: int
    params: Mapping[str, Value]
    locals: Mapping[str, Value]
    temps: Mapping[str, Value]
    slots: Mapping[str, Sequence[Value]]
    cells: Mapping[str, Value]
    ports: Mapping[str, Value]
    call: Call
    ask: Call
    after: Mapping[str, Value]
    robots: Sequence[Robot]


def view_of(n_sys: int, params: Mapping[str, Value], call: Call, ask: Call) -> View:
    """What stands open everywhere: params, the fleet's size, functions."""
    return View(-1, n_sys, params, {}, {}, {}, {}, {}, call, ask, {}, ())


def evaluate(node: ir.Expr, view: View) -> Value:
    """The value of a checked expression. Raises Discarded; InternalError where what was proved does not hold."""
    match node:
        case ir.Const(value):
            return value
        case ir.Pid():
            return view.pid
        case ir.NSys():
            return view.n_sys
        case ir.Ids():
            return tuple(range(view.n_sys))
        case ir.ParamRead(name):
            return view.params[name]
        case ir.LocalRead(name):
            return view.locals[name]
        case ir.TempRead(name):
            return view.temps[name]
        case ir.SharedRead(name):
            return view.cells[name]
        case ir.SlotRead(name, index, proved):
            place = _number(index, view)
            if not 0 <= place < view.n_sys:
                raise _fault(node, f"index {place} names no robot (0 to {view.n_sys - 1})", proved)
            return view.slots[name][place]
        case ir.SlotsRead(name):
            return tuple(view.slots[name])
        case ir.PortRead(module, port, primed):
            return (view.after if primed else view.ports)[f"{module}.{port}"]
        case ir.LocalOf(name, robot):
            return _robot(robot, view).locals[name]
        case ir.PortOf(module, port, robot):
            return _robot(robot, view).ports[f"{module}.{port}"]
        case _:
            return _operation(node, view)


def holds(node: ir.Expr, view: View) -> bool:
    """The value of a condition. Raises Discarded."""
    return as_(bool, evaluate(node, view))


def elements(node: ir.Expr, view: View) -> Iterator[Value]:
    """What a loop or a quantifier runs over: the value as it is at the start."""
    if isinstance(node, ir.Range):
        return _steps(_number(node.start, view), _number(node.stop, view), node.step)
    values = items(evaluate(node, view))
    return iter([pair[0] for pair in values] if isinstance(node.type, MapOf) else values)


def _steps(start: int, stop: int, step: int) -> Iterator[int]:
    while start < stop if step > 0 else start > stop:
        yield start
        start += step


_Operation = (
    ir.Widen | ir.Unary | ir.Binary | ir.Compare | ir.Contains | ir.Logic | ir.Conditional | ir.Quantified | ir.Range
    | ir.Make | ir.Field | ir.Item | ir.At | ir.Slice | ir.With | ir.Builtin | ir.Call | ir.ExternCall | ir.PortCall
)  # fmt: skip


def _operation(node: _Operation, view: View) -> Value:
    match node:
        case ir.Widen(operand):
            return _guarded(node, lambda: float(_number(operand, view)))
        case ir.Unary("not", operand):
            return not holds(operand, view)
        case ir.Unary(_, operand):
            positive = evaluate(operand, view)
            return Point(-positive.x, -positive.y, -positive.z) if isinstance(positive, Point) else -as_real(positive)
        case ir.Binary(op, left, right, proved):
            first, second = evaluate(left, view), evaluate(right, view)
            try:
                return arithmetic(op, first, second)
            except (ArithmeticError, ValueError) as error:
                checked = op != "**" and isinstance(error, ZeroDivisionError)
                reason = "division by zero" if checked and is_exact(first, second) else str(error)
                raise _fault(node, reason, proved and checked) from None
        case ir.Compare(op, left, right):
            return _compared(op, evaluate(left, view), evaluate(right, view))
        case ir.Contains(item, values):
            member = evaluate(item, view)
            held = evaluate(values, view)
            return builtins.contains([pair[0] for pair in items(held)] if _is_map(values) else held, member)
        case ir.Logic(op, left, right):
            return holds(left, view) and holds(right, view) if op == "and" else holds(left, view) or holds(right, view)
        case ir.Conditional(condition, then, orelse):
            return evaluate(then if holds(condition, view) else orelse, view)
        case ir.Quantified(kind, name, domain, body):
            truths = (holds(body, _binding(view, name, value)) for value in elements(domain, view))
            return all(truths) if kind == "forall" else any(truths)
        case ir.Range():
            raise InternalError("a range is no value")
        case _:
            return _part(node, view)


_Part = (
    ir.Make | ir.Field | ir.Item | ir.At | ir.Slice | ir.With | ir.Builtin | ir.Call | ir.ExternCall | ir.PortCall
)  # fmt: skip


def _part(node: _Part, view: View) -> Value:
    match node:
        case ir.Make(parts):
            return _made(node, tuple([evaluate(part, view) for part in parts]))
        case ir.Field(operand, name):
            whole = evaluate(operand, view)
            if isinstance(whole, RecordValue):
                return whole.fields[_place(operand, name)]
            return getattr(whole, name)  # type: ignore[no-any-return]
        case ir.Item(operand, place):
            return items(evaluate(operand, view))[place]  # type: ignore[no-any-return]
        case ir.At(operand, index, proved):
            xs, i = evaluate(operand, view), _number(index, view)
            return _guarded(node, lambda: builtins.element(xs, i), proved)
        case ir.Slice(operand, start, stop, proved):
            xs = evaluate(operand, view)
            low, high = (None if bound is None else _number(bound, view) for bound in (start, stop))
            return _guarded(node, lambda: builtins.part(xs, low, high), proved)
        case ir.With(operand, name, value):
            whole, new, place = evaluate(operand, view), evaluate(value, view), _place(operand, name)
            if isinstance(whole, RecordValue):
                return RecordValue(whole.name, _put(whole.fields, place, new))
            return _put(items(whole), place, new)
        case ir.Builtin(name, args):
            values = [evaluate(arg, view) for arg in args]
            zero = 0.0 if node.type == FLOAT else 0
            return _guarded(node, lambda: builtins.applied(name, values, zero))
        case ir.Call(name, args) | ir.ExternCall(name, args):
            values = [evaluate(arg, view) for arg in args]
            return _guarded(node, lambda: view.call(name, tuple(values)))
        case ir.PortCall(module, port, args):
            return _asked(node, f"{module}.{port}", tuple([evaluate(arg, view) for arg in args]), view)
        case _:
            assert_never(node)


def _guarded(node: ir.Expr, compute: Callable[[], Value], proved: bool = False) -> Value:
    """A value that need not exist: Discarded at this node then."""
    try:
        return compute()
    except (ArithmeticError, ValueError) as error:
        raise _fault(node, str(error), proved) from None


def _fault(node: ir.Expr, reason: str, proved: bool) -> Exception:
    if proved:
        return InternalError(f"line {node.span.line}: proved to have a value, but: {reason}")
    return Discarded(reason, node.span)


def _asked(node: ir.PortCall, port: str, args: tuple[Value, ...], view: View) -> Value:
    try:
        answer = view.ask(port, args)
    except Exception as error:
        raise Discarded(f"{port} failed: {error}", node.span) from None
    if not conforms(answer, node.type):
        raise Discarded(f"{port} answered {answer!r}, which is no {node.type}", node.span)
    return answer


def _number(node: ir.Expr, view: View) -> int:
    return as_(int, evaluate(node, view))


def as_real(value: Value) -> int | float:
    """An int, a float, or what stands for a float where nothing is rounded."""
    if not isinstance(value, (int, float)) and not is_exact(value):
        raise InternalError(f"{value!r} is no number")
    return value  # type: ignore[return-value]


def _robot(node: ir.Expr, view: View) -> Robot:
    pid = _number(node, view)
    if not 0 <= pid < view.n_sys:
        raise Discarded(f"index {pid} names no robot (0 to {view.n_sys - 1})", node.span)
    return view.robots[pid]


def _binding(view: View, name: str, value: Value) -> View:
    return view._replace(temps={**view.temps, name: value})


def _is_map(node: ir.Expr) -> bool:
    return isinstance(node.type, MapOf)


def _place(operand: ir.Expr, name: str) -> int:
    """Where a field of a record stands, or an item of a tuple, which is named by its index."""
    type_ = operand.type
    if isinstance(type_, TupleOf):
        return int(name)
    if not isinstance(type_, RecordType):
        raise InternalError(f"a {type_} has no parts")
    return [field for field, _ in type_.fields].index(name)


def _put(parts: tuple[Value, ...], place: int, value: Value) -> tuple[Value, ...]:
    return tuple([value if i == place else part for i, part in enumerate(parts)])


def _made(node: ir.Make, parts: tuple[Value, ...]) -> Value:
    match node.type:
        case SequenceType("Set"):
            return builtins.set_of(parts)
        case SequenceType() | TupleOf():
            return parts
        case MapOf():
            return builtins.map_of(parts)
        case RecordType(name):
            return RecordValue(name, parts)
        case Extern():
            return Opaque()
        case Sized() as type_:
            return default(type_, {})
        case _:
            raise InternalError(f"a {node.type} is not made of parts")


def arithmetic(op: str, left: Value, right: Value) -> Value:
    """One operator on two values of agreeing types; raises ArithmeticError or ValueError where there is no value."""
    match left, right:
        case Point(), Point():
            if op == "+":
                return Point(left.x + right.x, left.y + right.y, left.z + right.z)
            return Point(left.x - right.x, left.y - right.y, left.z - right.z)
        case Point(), _:
            by = as_real(right)
            if op == "*":
                return Point(left.x * by, left.y * by, left.z * by)
            return Point(left.x / by, left.y / by, left.z / by)
        case _, Point():
            return arithmetic(op, right, left)
        case (str(), str()) | (tuple(), tuple()):
            return left + right  # type: ignore[operator]
        case _:
            return _of_numbers(op, as_real(left), as_real(right))


def _of_numbers(op: str, left: int | float, right: int | float) -> int | float:
    match op:
        case "+":
            return left + right
        case "-":
            return left - right
        case "*":
            return left * right
        case "/":
            return left / right
        case "//":
            return left // right
        case "%":
            return left % right
        case "**":
            return _power(left, right)
        case _:
            raise InternalError(f"no operator {op}")


def _power(base: int | float, exponent: int | float) -> int | float:
    if isinstance(base, float) or isinstance(exponent, float):
        return math.pow(base, exponent)
    if is_exact(base, exponent):
        return power(base, exponent)  # type: ignore[return-value]
    if exponent < 0:
        raise ValueError("an int to the power of a negative one")
    if exponent > MAX_EXPONENT and abs(base) > 1:
        raise ValueError(f"an exponent above {MAX_EXPONENT}")
    return as_(int, base**exponent)


def _compared(op: str, left: Value, right: Value) -> bool:
    match op:
        case "==":
            return same(left, right)
        case "!=":
            return not same(left, right)
        case _ if isinstance(left, str):
            return _ordered(op, left, as_(str, right))
        case _:
            return _ordered(op, as_real(left), as_real(right))


def _ordered(op: str, first: int | float | str, second: int | float | str) -> bool:
    match op:
        case "<":
            return first < second  # type: ignore[operator]
        case "<=":
            return first <= second  # type: ignore[operator]
        case ">":
            return first > second  # type: ignore[operator]
        case ">=":
            return first >= second  # type: ignore[operator]
        case _:
            raise InternalError(f"no comparison {op}")
