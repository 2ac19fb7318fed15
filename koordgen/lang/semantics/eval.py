"""Semantics of expressions: evaluation without side effects over the state that one robot sees.

Numbers behave as in Python: inside an event an int may exceed 64 bits (`numbers.py` limits its size), a float has 64
bits, `/` gives a true quotient (of two ints as well), `//` rounds down, and the result of `%` has the divisor's sign.
An operation without a value (a division by zero, an index out of range, a missing key, an int too large for a float)
discards the event. NaN and infinity may arise within an event; a comparison with NaN discards the event, and so does
NaN or infinity in a value that is stored or sent. If an operation fails although the analysis has proved that it
cannot, the compiler has a bug, and the evaluator raises InternalError.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from collections.abc import Sized as HasLength
from itertools import count
from typing import Any, NamedTuple, TypeVar

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import FLOAT, STRING, MapOf, PerRobot, RecordType, Scalar, Sized, TupleOf
from koordgen.lang.ir.types import ExternType as Extern
from koordgen.lang.ir.types import Sequence as SequenceType
from koordgen.lang.node import Node
from koordgen.lang.semantics import builtins
from koordgen.lang.semantics.exact import is_exact
from koordgen.lang.semantics.numbers import arithmetic, as_real, compared
from koordgen.lang.semantics.state import Robot
from koordgen.lang.semantics.values import RecordValue, Value, as_, conforms, default, elements_in, items, number_flaw
from koordgen.lang.source import Span
from koordgen.runtime.values.points import Opaque, Point

T = TypeVar("T", bound=HasLength)


class Discarded(Exception):
    """Signal that an event is discarded: none of its writes takes effect. The expression at `span` failed."""

    def __init__(self, reason: str, span: Span) -> None:
        super().__init__(f"line {span.line}: {reason}")
        self.reason = reason
        self.span = span


Call = Callable[[str, tuple[Value, ...]], Value]
Spend = Callable[[int, Span], None]
MAX_ELEMENTS = 100_000  # elements of a list, set, map or queue, or characters of a string, that an event may make
ELEMENTS_A_TURN = 100  # elements that an event may read or make for one turn of its budget
PAIRS_A_TURN = 10  # pairs of points of two paths whose comparison costs one turn of the event's budget
MOST_COUNTED = 100_000_000  # limit on a count of elements, whose read would use up an event's whole budget


class StateView(NamedTuple):
    """State that one robot sees while an expression is evaluated.

    `slots` maps the name of each allread variable to its values by pid, `cells` the name of each allwrite variable to
    its value, and `ports` "Module.port" to the value of a sensor or actuator. `call` calls a function, and `ask` calls
    a callable port. In a port assumption `after` holds the values of primed ports (`position'`), at a later time. In a
    property `robots` holds the state of each robot of the fleet. `spend` charges loop turns to the event's budget.
    """

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
    spend: Spend


def view_of(n_sys: int, params: Mapping[str, Value], call: Call, ask: Call, spend: Spend) -> StateView:
    """Return a View without a robot's state: it gives access to params, the fleet's size and functions only."""
    return StateView(-1, n_sys, params, {}, {}, {}, {}, {}, call, ask, {}, (), spend)


def charged_for_making(value: T, view: StateView, span: Span) -> T:
    """Charge the size of a new list, set, map, queue or string to the event's budget, and return the value.

    Raises Discarded if the value is too large or the budget is used up.
    """
    size = len(value)
    if size > MAX_ELEMENTS:
        raise Discarded(f"{size} elements or characters, where an event makes at most {MAX_ELEMENTS}", span)
    if size >= ELEMENTS_A_TURN:
        view.spend(size // ELEMENTS_A_TURN, span)
    return value


def charged_for_reading(node: ir.Expr, value: Value, view: StateView) -> Value:
    """Charge the reading of all elements of a value to the event's budget, and return the value.

    Raises Discarded if the budget is used up.
    """
    one = node.type.element if isinstance(node.type, PerRobot) else node.type
    if isinstance(one, (Scalar, Extern)) or isinstance(node, ir.Ids):
        return value  # a read of a scalar, or of one scalar for each robot, costs no turn of the event's budget
    turns = elements_in(value, MOST_COUNTED) // ELEMENTS_A_TURN
    if turns:
        view.spend(turns, node.span)
    return value


def operand(node: ir.Expr, view: StateView) -> Value:
    """Evaluate an operand of a comparison or a search, and charge its reading to the event's budget.

    Raises Discarded if the operand has no value or contains NaN, or if the budget is used up.
    """
    value = charged_for_reading(node, evaluate(node, view), view)
    try:
        builtins.comparable(value)
    except ArithmeticError as error:
        raise _fault(node, str(error), False) from None
    return value


def evaluate(node: ir.Expr, view: StateView) -> Value:
    """Return the value of a checked expression.

    Raises Discarded if the expression has no value, but InternalError if the analysis has proved that the failing
    node cannot fail.
    """
    return MEANINGS[type(node)](node, view)


def holds(node: ir.Expr, view: StateView) -> bool:
    """Return the value of a condition. Raises Discarded if the condition has no value."""
    return as_(bool, evaluate(node, view))


def elements(node: ir.Expr, view: StateView) -> Iterator[Value]:
    """Return the elements over which a loop or quantifier iterates, evaluated once, before the first iteration."""
    if isinstance(node, ir.Range):
        return _steps(_number(node.start, view), _number(node.stop, view), node.step)
    values = items(evaluate(node, view))
    if isinstance(node.type, MapOf):
        values = charged_for_making(tuple([pair[0] for pair in values]), view, node.span)
    return iter(values)


def counting(node: ir.Expr, view: StateView) -> tuple[Iterator[Value], Iterator[int]] | None:
    """Return the values of a loop over a range or `ID`, and the same sequence continued without end.

    Returns None for a loop over other values.
    """
    match node:
        case ir.Range(start, stop, step):
            first = _number(start, view)
            return _steps(first, _number(stop, view), step), count(first, step)
        case ir.Ids():
            return elements(node, view), count()
        case _:
            return None


def _steps(start: int, stop: int, step: int) -> Iterator[int]:
    while start < stop if step > 0 else start > stop:
        yield start
        start += step


def _slot(node: ir.SlotRead, view: StateView) -> Value:
    place = _number(node.index, view)
    if not 0 <= place < view.n_sys:
        raise _fault(node, f"index {place} names no robot (0 to {view.n_sys - 1})", node.proved)
    return view.slots[node.name][place]


def _port(node: ir.PortRead, view: StateView) -> Value:
    return (view.after if node.primed else view.ports)[f"{node.module}.{node.port}"]


def _unary(node: ir.Unary, view: StateView) -> Value:
    if node.op == "not":
        return not holds(node.operand, view)
    positive = evaluate(node.operand, view)
    return Point(-positive.x, -positive.y, -positive.z) if isinstance(positive, Point) else -as_real(positive)


def _binary(node: ir.Binary, view: StateView) -> Value:
    first, second = evaluate(node.left, view), evaluate(node.right, view)
    try:
        value = arithmetic(node.op, first, second)
        return charged_for_making(value, view, node.span) if isinstance(value, (str, tuple)) else value
    except (ArithmeticError, ValueError) as error:
        checked = node.op != "**" and isinstance(error, ZeroDivisionError)
        reason = "division by zero" if checked and is_exact(first, second) else str(error)
        raise _fault(node, reason, node.proved and checked) from None


def _contains(node: ir.Contains, view: StateView) -> Value:
    if isinstance(node.values.type, MapOf):
        held = evaluate(node.values, view)
        return builtins.has_key(held, evaluate(node.item, view))
    member, held = operand(node.item, view), operand(node.values, view)
    return _guarded(node, lambda: builtins.contains(held, member))


def _compare(node: ir.Compare, view: StateView) -> Value:
    value = evaluate if node.left.type == STRING else operand  # comparing strings costs no turn
    left, right = value(node.left, view), value(node.right, view)
    return _guarded(node, lambda: compared(node.op, left, right))


def _logic(node: ir.Logic, view: StateView) -> Value:
    left = holds(node.left, view)
    return holds(node.right, view) if left == (node.op == "and") else left


def _quantified(node: ir.Quantified, view: StateView) -> Value:
    temps = dict(view.temps)
    within = view._replace(temps=temps)

    def truths() -> Iterator[bool]:
        for value in elements(node.domain, view):
            if not isinstance(node.domain, ir.Ids):
                view.spend(1, node.span)
            temps[node.name] = value
            yield holds(node.body, within)

    return all(truths()) if node.kind == "forall" else any(truths())


def _range(node: ir.Range, view: StateView) -> Value:
    raise InternalError("a range is not a value")


def _field(node: ir.Field, view: StateView) -> Value:
    whole = evaluate(node.operand, view)
    if isinstance(whole, RecordValue):
        return whole.fields[_place(node.operand, node.name)]
    return getattr(whole, node.name)  # type: ignore[no-any-return]


def _at(node: ir.At, view: StateView) -> Value:
    xs, i = evaluate(node.operand, view), _number(node.index, view)
    return _guarded(node, lambda: builtins.element(xs, i), node.proved)


def _slice(node: ir.Slice, view: StateView) -> Value:
    xs = evaluate(node.operand, view)
    low, high = (None if bound is None else _number(bound, view) for bound in (node.start, node.stop))
    part = _guarded(node, lambda: builtins.part(xs, low, high), node.proved)
    return charged_for_making(part, view, node.span)  # type: ignore[type-var]


def _with(node: ir.With, view: StateView) -> Value:
    whole, new = evaluate(node.operand, view), evaluate(node.value, view)
    place = _place(node.operand, node.name)
    if isinstance(whole, RecordValue):
        return RecordValue(whole.name, _put(whole.fields, place, new))
    return _put(items(whole), place, new)


def _builtin(node: ir.Builtin, view: StateView) -> Value:
    values = [_argument(node.name, arg, view) for arg in node.args]
    zero = 0.0 if node.type == FLOAT else 0
    if node.name in ("path_distance", "clear"):
        view.spend(_pairs(node.name, values) // PAIRS_A_TURN, node.span)
    value = _guarded(node, lambda: builtins.applied(node.name, values, zero))
    if node.name == "merge":
        view.spend(elements_in(value, MOST_COUNTED), node.span)
    if node.name in builtins.MAPPING:
        charged_for_reading(node, value, view)
    return charged_for_making(value, view, node.span) if node.name in builtins.MAKING else value  # type: ignore[type-var]


def _argument(name: str, arg: ir.Expr, view: StateView) -> Value:
    if name in builtins.COMPARING:
        return operand(arg, view)
    value = evaluate(arg, view)
    return charged_for_reading(arg, value, view) if name in builtins.SEARCHING else value


def _pairs(name: str, values: Sequence[Value]) -> int:
    """Return the number of pairs of points to compare.

    Each path counts as one point longer than it is, so that a comparison with an empty path has a cost, too."""
    others = [values[1]] if name == "path_distance" else items(values[1])
    return (len(items(values[0])) + 1) * sum([len(items(other)) + 1 for other in others])


def _call(node: ir.Call | ir.ExternCall, view: StateView) -> Value:
    values = tuple([evaluate(arg, view) for arg in node.args])
    return _guarded(node, lambda: view.call(node.name, values))


def _asked(node: ir.PortCall, view: StateView) -> Value:
    port, args = f"{node.module}.{node.port}", tuple([evaluate(arg, view) for arg in node.args])
    try:
        answer = view.ask(port, args)
    except Exception as error:
        raise Discarded(f"{port} failed: {error}", node.span) from None
    if not conforms(answer, node.type) or number_flaw(answer):
        raise Discarded(f"{port} answered {answer!r}, which is not of type {node.type}", node.span)
    return answer


def _guarded(node: ir.Expr, compute: Callable[[], Value], proved: bool = False) -> Value:
    """Return the result of `compute`, which evaluates `node`.

    If `compute` fails, raises Discarded at the node's span; raises InternalError instead if `proved`: the analysis has
    proved that the node cannot fail.
    """
    try:
        return compute()
    except (ArithmeticError, ValueError) as error:
        raise _fault(node, str(error), proved) from None


def _fault(node: ir.Expr, reason: str, proved: bool) -> Exception:
    if proved:
        return InternalError(f"line {node.span.line}: proved to have a value, but: {reason}")
    return Discarded(reason, node.span)


def _number(node: ir.Expr, view: StateView) -> int:
    return as_(int, evaluate(node, view))


def _robot(node: ir.Expr, view: StateView) -> Robot:
    pid = _number(node, view)
    if not 0 <= pid < view.n_sys:
        raise Discarded(f"index {pid} names no robot (0 to {view.n_sys - 1})", node.span)
    return view.robots[pid]


def _place(operand: ir.Expr, name: str) -> int:
    """Return the index of the field `name` of a record. For a tuple, `name` is the item's index as text."""
    type_ = operand.type
    if isinstance(type_, TupleOf):
        return int(name)
    if not isinstance(type_, RecordType):
        raise InternalError(f"a {type_} has no parts")
    return [field for field, _ in type_.fields].index(name)


def _put(parts: tuple[Value, ...], place: int, value: Value) -> tuple[Value, ...]:
    return tuple([value if i == place else part for i, part in enumerate(parts)])


def _made(node: ir.Make, view: StateView) -> Value:
    parts = tuple([evaluate(part, view) for part in node.items])
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


# Evaluator of each class of node. The table finds it in one look-up, while a `match` would test one class after the
# other. Speed matters, because replaying a mission evaluates millions of nodes.
MEANINGS: Mapping[type[Node], Callable[[Any, StateView], Value]] = {
    ir.Const: lambda node, view: node.value,
    ir.Pid: lambda node, view: view.pid,
    ir.NSys: lambda node, view: view.n_sys,
    ir.Ids: lambda node, view: tuple(range(view.n_sys)),
    ir.ParamRead: lambda node, view: view.params[node.name],
    ir.LocalRead: lambda node, view: view.locals[node.name],
    ir.TempRead: lambda node, view: view.temps[node.name],
    ir.SharedRead: lambda node, view: view.cells[node.name],
    ir.SlotRead: _slot,
    ir.SlotsRead: lambda node, view: tuple(view.slots[node.name]),
    ir.PortRead: _port,
    ir.LocalOf: lambda node, view: _robot(node.robot, view).locals[node.name],
    ir.PortOf: lambda node, view: _robot(node.robot, view).ports[f"{node.module}.{node.port}"],
    ir.Widen: lambda node, view: _guarded(node, lambda: float(_number(node.operand, view))),
    ir.Unary: _unary,
    ir.Binary: _binary,
    ir.Compare: _compare,
    ir.Contains: _contains,
    ir.Logic: _logic,
    ir.Conditional: lambda node, view: evaluate(node.then if holds(node.condition, view) else node.orelse, view),
    ir.Quantified: _quantified,
    ir.Range: _range,
    ir.Make: _made,
    ir.Field: _field,
    ir.Item: lambda node, view: items(evaluate(node.operand, view))[node.index],
    ir.At: _at,
    ir.Slice: _slice,
    ir.With: _with,
    ir.Builtin: _builtin,
    ir.Call: _call,
    ir.ExternCall: _call,
    ir.PortCall: _asked,
}
