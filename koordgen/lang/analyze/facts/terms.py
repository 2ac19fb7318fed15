"""Translation of expressions to facts: linear terms, conditions, lengths."""

from __future__ import annotations

from collections.abc import Iterator

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.flow import Flow, independent, names_of, variable_of
from koordgen.lang.analyze.facts.linear import FALSE, TRUE, UNKNOWN, BoolFact, Formula, Length, Linear, Value
from koordgen.lang.analyze.facts.number import number_of
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import BOOL, FLOAT, INT, MapOf, PerRobot, Sequence, Sized, Type

__all__ = [
    "Flow",
    "after_assignment",
    "formula",
    "known_value",
    "length",
    "names_of",
    "nonzero",
    "range_facts",
    "term",
    "variable_of",
]

_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}
_VARIABLES = frozenset((ir.LocalRead, ir.TempRead, ir.SharedRead, ir.PortRead, ir.ParamRead))
_PARTS = frozenset((ir.SlotRead, ir.Field, ir.Item, ir.At, ir.LocalOf, ir.PortOf))
_SIZE, _PID = linear.variable(linear.N_SYS), linear.variable(linear.PID)
# Change of the length by each updating builtin. A builtin without an entry may change the length in any way.
_STEPS = {"appended": 1, "inserted": 1, "removed": -1, "without": -1, "popped": -1, "updated": 0, "sorted": 0,
          "reversed": 0, "set_without": -1, "map_without": -1, "keys": 0, "values": 0, "items": 0}  # fmt: skip


def term(node: ir.Expr, flow: Flow) -> Linear | None:
    """Return an expression as a linear integer term, or None. For an int converted to a float, use the int."""
    kind = type(node)
    if kind is ir.Const:
        return _constant(node.value)  # type: ignore[union-attr]
    if kind is ir.Pid:
        return _PID
    if kind is ir.NSys:
        return _SIZE
    if kind is ir.Widen:
        return term(node.operand, flow)  # type: ignore[union-attr]
    if node.type is not INT:
        return None
    if kind in _VARIABLES:
        name = variable_of(node)
        assert name is not None
        known = flow.value(name)
        return known if isinstance(known, Linear) else linear.variable(name)
    match node:
        case ir.Binary():
            return _arithmetic(node, flow)
        case ir.Unary("-", operand):
            positive = term(operand, flow)
            return None if positive is None else linear.scale(positive, -1)
        case ir.Builtin("len", (operand,)):
            return length(operand, flow)
        case ir.Builtin("abs", (operand,)):
            inner = term(operand, flow)
            if inner is None:
                return None
            return _choice(linear.AtLeastZero(inner), inner, linear.scale(inner, -1))
        case ir.Builtin("min" | "max" as which, (first, second)):
            left, right = term(first, flow), term(second, flow)
            if left is None or right is None:
                return None
            return _choice(linear.at_least(*((right, left) if which == "min" else (left, right))), left, right)
        case ir.Conditional(condition, then, orelse):
            return _choice(formula(condition, flow), term(then, flow), term(orelse, flow))
        case ir.SlotRead(name, ir.Pid()):
            known = flow.value(f"slot {name}")
            return known if isinstance(known, Linear) else linear.variable(Value(node))
        case _:
            return linear.variable(Value(node)) if kind in _PARTS and pure(node) else None


def _constant(value: object) -> Linear | None:
    if type(value) is int:
        return linear.constant(value)
    return linear.constant(int(value)) if isinstance(value, float) and value.is_integer() else None


def _choice(condition: Formula, then: Linear | None, orelse: Linear | None) -> Linear | None:
    return None if then is None or orelse is None else linear.variable(linear.ConditionalTerm(condition, then, orelse))


def _arithmetic(node: ir.Binary, flow: Flow) -> Linear | None:
    left = term(node.left, flow)
    right = term(node.right, flow) if left is not None else None
    if left is None or right is None:
        return None
    match node.op:
        case "+":
            return linear.combine(left, right)
        case "-":
            return linear.combine(left, right, -1)
        case "*" if not left.terms:
            return linear.scale(right, left.constant)
        case "*" if not right.terms:
            return linear.scale(left, right.constant)
        case "//" if not right.terms and right.constant > 0:
            return linear.variable(linear.Quotient(left, right.constant))
        case "%" if right.terms or right.constant > 0:
            return linear.variable(linear.Remainder(left, right))
        case _:
            return None


def pure(node: ir.Expr) -> bool:
    """Return whether an expression's value depends on its variables only: the expression calls no port."""
    return not any(isinstance(part, ir.PortCall) for part in walk(node))


def has_length(type_: Type) -> bool:
    return isinstance(type_, (Sequence, MapOf)) or (isinstance(type_, Sized) and type_.name == "string")


def length(node: ir.Expr, flow: Flow) -> Linear | None:
    """Return the length of a list, queue, set, map or string as a term, or None.

    For an allread variable as a whole, which has one value for each robot, the length is N_SYS.
    """
    kind = type(node)
    if isinstance(node.type, PerRobot) or kind is ir.Ids:
        return _SIZE
    if kind in _VARIABLES:
        name = variable_of(node)
        assert name is not None
        known = flow.value(f"len {name}")
        return known if isinstance(known, Linear) else linear.variable(Length(name))
    match node:
        case ir.Make(items, Sequence("List" | "Queue")):
            return linear.constant(len(items))
        case ir.Make(()):
            return linear.constant(0)
        case ir.Const(str(text)):
            return linear.constant(len(text))
        case ir.Binary("+", left, right):
            first, second = length(left, flow), length(right, flow)
            return None if first is None or second is None else linear.combine(first, second)
        case ir.Builtin("cleared"):
            return linear.constant(0)
        case ir.Builtin("extended", (first_, second_)):
            first, second = length(first_, flow), length(second_, flow)
            return None if first is None or second is None else linear.combine(first, second)
        case ir.Builtin(name, (operand, *_)) if name in _STEPS:
            before = length(operand, flow)
            return None if before is None else linear.combine(before, linear.constant(_STEPS[name]))
        case ir.Conditional(condition, then, orelse):
            return _choice(formula(condition, flow), length(then, flow), length(orelse, flow))
        case ir.SlotRead(name, ir.Pid()):
            known = flow.value(f"len slot {name}")
            return known if isinstance(known, Linear) else linear.variable(Length(node))
        case _:
            return linear.variable(Length(node)) if kind in _PARTS and pure(node) else None


def formula(node: ir.Expr, flow: Flow) -> Formula:
    """Return a bool expression as a formula. Parts that cannot be translated become UNKNOWN."""
    kind = type(node)
    if kind is ir.Compare:
        return _comparison(node.op, node.left, node.right, flow)  # type: ignore[union-attr]
    if kind in _VARIABLES:
        name = variable_of(node)
        assert name is not None
        known = flow.value(name)
        return BoolFact(name, True) if known is None or isinstance(known, Linear) else known
    match node:
        case ir.Logic(op, left, right):
            parts = (formula(left, flow), formula(right, flow))
            if parts == (UNKNOWN, UNKNOWN):
                return UNKNOWN
            return linear.And(parts) if op == "and" else linear.Or(parts)
        case ir.Unary("not", operand):
            return linear.negate(formula(operand, flow))
        case ir.Const(bool(value)):
            return TRUE if value else FALSE
        case ir.Conditional(condition, then, orelse):
            held = formula(condition, flow)
            yes = linear.And((held, formula(then, flow)))
            return linear.Or((yes, linear.And((linear.negate(held), formula(orelse, flow)))))
        case ir.SlotRead(name, ir.Pid()):
            known = flow.value(f"slot {name}")
            return BoolFact(node, True) if known is None or isinstance(known, Linear) else known
        case _:
            return BoolFact(node, True) if kind in _PARTS and pure(node) else UNKNOWN


def _comparison(op: str, left: ir.Expr, right: ir.Expr, flow: Flow) -> Formula:
    if left.type is INT or left.type is FLOAT:
        first = term(left, flow)
        second = term(right, flow) if first is not None else None
        if first is not None and second is not None:
            return _compared(op, first, second)
        if left.type is FLOAT:
            if type(right) is ir.ParamRead or number_of(right) is not None:
                return _nonzero_by(op, left, right)
            if type(left) is ir.ParamRead or number_of(left) is not None:
                return _nonzero_by(_MIRRORED[op], right, left)
        return UNKNOWN
    if op in ("==", "!="):
        for side, other in ((left, right), (right, left)):
            if isinstance(other, ir.Make) and not other.items and has_length(other.type):
                many = length(side, flow)
                return UNKNOWN if many is None else _compared(op, many, linear.constant(0))
    return UNKNOWN


def _compared(op: str, first: Linear, second: Linear) -> Formula:
    match op:
        case "==":
            return linear.equal(first, second)
        case "!=":
            return linear.negate(linear.equal(first, second))
        case "<":
            return linear.less(first, second)
        case "<=":
            return linear.at_least(second, first)
        case ">":
            return linear.less(second, first)
        case _:
            return linear.at_least(first, second)


def _nonzero_by(op: str, value: ir.Expr, bound: ir.Expr) -> Formula:
    """Return what a comparison of the float `value` with `bound` implies: `value` is zero, or is not zero."""
    if not pure(value):
        return UNKNOWN
    number = number_of(bound)
    if number is None:
        # If the bound is a param, the conclusion depends on the param's value.
        implied = (
            linear.Or((BoolFact(value, True), BoolFact((op, bound), False))) if type(bound) is ir.ParamRead else UNKNOWN
        )
        return linear.And((UNKNOWN, implied))
    if op == "==" and number == 0:
        return BoolFact(value, False)
    # The comparison implies that the value is not zero, but the converse is false. UNKNOWN keeps the negation unknown.
    return linear.And((UNKNOWN, BoolFact(value, True))) if excludes_zero(op, number) else UNKNOWN


def excludes_zero(op: str, number: float) -> bool:
    """Return whether each float x with `x op number` differs from zero."""
    return {"!=": number == 0, ">": number >= 0, ">=": number > 0, "<": number <= 0, "<=": number < 0}.get(op, False)


def nonzero(node: ir.Expr, flow: Flow) -> Formula:
    """Return the condition that a divisor differs from zero."""
    value = term(node, flow)
    if value is not None:
        return linear.negate(linear.equal(value, linear.constant(0)))
    number = number_of(node)
    if number is not None:
        return TRUE if number else FALSE
    return BoolFact(node, True) if pure(node) else UNKNOWN


def known_value(node: ir.Expr, flow: Flow) -> Linear | Formula | None:
    """Return the known value of a variable after the assignment of `node`; None if the value is unknown."""
    if node.type is INT:
        return term(node, flow)
    if node.type is BOOL:
        known = formula(node, flow)
        return None if known is UNKNOWN else known
    return None


def after_assignment(flow: Flow, place: stmt.Place, node: ir.Expr) -> Flow:
    """Return the facts after the assignment `place = node`."""
    name = variable_of(place)
    assert name is not None
    if has_length(node.type):
        return flow.assigned(name, length(node, flow), True)
    return flow.assigned(name, known_value(node, flow))


def range_facts(
    unique: str,
    values: ir.Expr,
    before: Flow,
    after: Flow,
    changed: frozenset[str] = frozenset(),
    sized: frozenset[str] = frozenset(),
) -> Iterator[Formula]:
    """Yield facts about the temp `unique` that iterates over `values`, and about `values`.

    `before` has the facts before the loop, `after` those at the start of each iteration. The loop may change the
    variables in `changed`, but not the lengths of the variables in `sized`.
    """

    def bound(node: ir.Expr) -> Linear | None:
        for flow in (before, after):
            found = term(node, flow)
            if found is not None and independent(found, changed, sized):
                return found
        return None

    index = linear.variable(f"temp {unique}")
    match values:
        case ir.Range(start, stop, step):
            first, last = bound(start), bound(stop)
            if first is not None:
                yield linear.at_least(index, first) if step > 0 else linear.at_least(first, index)
            if last is not None:
                yield linear.less(index, last) if step > 0 else linear.less(last, index)
        case ir.Ids():
            yield linear.at_least(index, linear.constant(0))
            yield linear.less(index, _SIZE)
        case _:
            many = length(values, before) if has_length(values.type) else None
            if many is not None and many.terms and independent(many, changed, sized):
                yield linear.at_least(many, linear.constant(1))
