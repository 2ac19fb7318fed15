"""What is known at a point of an event: the conditions passed on the way and the values of its variables.

Immutable: a branch of the program takes its own Flow from its parent's.
"""

from __future__ import annotations

from koordgen.check import linear
from koordgen.check.linear import TRUE, UNKNOWN, Fact, Formula, Linear
from koordgen.ir import expr as ir
from koordgen.ir import stmt
from koordgen.ir.types import BOOL, FLOAT, INT
from koordgen.node import Node

# To forget is always right; what is kept is bounded so that a long event costs no more a line than a short one.
MOST_FACTS = 12
MOST_VALUES = 20

_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}


class Flow(Node):
    """`facts` hold here, the event's guard first; `values` are those of variables (by their `variable_of` name) that
    are a term or a condition over what does not change. A Flow is asked, never changed."""

    facts: tuple[Formula, ...] = ()
    values: dict[str, Linear | Formula] = {}  # noqa: RUF012 - never changed

    def knowing(self, condition: Formula) -> Flow:
        """This, and the condition holds."""
        if condition == TRUE:
            return self
        facts = self.facts if len(self.facts) < MOST_FACTS else (self.facts[0], *self.facts[2:])
        return Flow((*facts, condition), self.values)

    def assigned(self, name: str, value: Linear | Formula | None) -> Flow:
        """After an assignment: what was known of the variable is gone, and its new value may be known."""
        if not self.facts and not self.values and value is None:
            return self
        facts = tuple(f for f in self.facts if not _mentions(f, name))
        values = {n: v for n, v in self.values.items() if n != name and not _mentions(v, name)}
        if value is not None and not _mentions(value, name):
            if len(values) >= MOST_VALUES:
                del values[next(iter(values))]
            values[name] = value
        return Flow(facts, values)

    def joined(self, other: Flow) -> Flow:
        """Where two ways meet: what is known on both."""
        facts = tuple(f for f in self.facts if f in other.facts)
        values = {n: v for n, v in self.values.items() if other.values.get(n) == v}
        return Flow(facts, values)


def variable_of(node: ir.Expr | stmt.Place) -> str | None:
    """The name by which what is read or written is known here: "local count", "port Motion.position"."""
    match node:
        case ir.LocalRead(name) | stmt.LocalPlace(name):
            return f"local {name}"
        case ir.TempRead(name) | stmt.TempPlace(name):
            return f"temp {name}"
        case ir.SharedRead(name) | stmt.SharedPlace(name):
            return f"shared {name}"
        case ir.SlotRead(name) | stmt.OwnSlot(name):
            return f"slot {name}"
        case ir.PortRead(module, port) | stmt.PortPlace(module, port):
            return f"port {module}.{port}"
        case ir.ParamRead(name):
            return f"param {name}"
        case _:
            return None


def term(node: ir.Expr, flow: Flow) -> Linear | None:
    """An expression as a term over integers, if it is one; `Widen` of an int counts as the int."""
    match node:
        case ir.Const(value):
            whole = not isinstance(value, bool) and value == int(value)
            return linear.constant(int(value)) if whole else None
        case ir.Pid():
            return linear.variable(linear.PID)
        case ir.NSys():
            return linear.variable(linear.N_SYS)
        case ir.Widen(operand):
            return term(operand, flow)
    if node.type != INT:
        return None
    match node:
        case ir.Unary("-", operand):
            positive = term(operand, flow)
            return None if positive is None else linear.scale(positive, -1)
        case ir.Binary():
            return _arithmetic(node, flow)
        case ir.Conditional(condition, then, orelse):
            return _choice(formula(condition, flow), term(then, flow), term(orelse, flow))
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
        case ir.LocalRead() | ir.TempRead() | ir.SharedRead() | ir.PortRead() | ir.ParamRead():
            name = variable_of(node)
            assert name is not None
            known = flow.values.get(name)
            return known if isinstance(known, Linear) else linear.variable(name)
        case _:
            return None


def _choice(condition: Formula, then: Linear | None, orelse: Linear | None) -> Linear | None:
    return None if then is None or orelse is None else linear.variable(linear.Choice(condition, then, orelse))


def _arithmetic(node: ir.Binary, flow: Flow) -> Linear | None:
    left, right = term(node.left, flow), term(node.right, flow)
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
        case "%" if not right.terms and right.constant > 0:
            quotient = linear.variable(linear.Quotient(left, right.constant))
            return linear.combine(left, quotient, -right.constant)
        case "%" if right.terms:
            return linear.variable(linear.Remainder(left, right))
        case _:
            return None


def formula(node: ir.Expr, flow: Flow) -> Formula:
    """A bool expression as a formula; what is not understood is Unknown, which may be either."""
    match node:
        case ir.Const(bool(value)):
            return TRUE if value else linear.FALSE
        case ir.Unary("not", operand):
            return linear.negate(formula(operand, flow))
        case ir.Logic(op, left, right):
            parts = (formula(left, flow), formula(right, flow))
            return linear.And(parts) if op == "and" else linear.Or(parts)
        case ir.Conditional(condition, then, orelse):
            held = formula(condition, flow)
            yes = linear.And((held, formula(then, flow)))
            return linear.Or((yes, linear.And((linear.negate(held), formula(orelse, flow)))))
        case ir.Compare(op, left, right):
            return _comparison(op, left, right, flow)
        case ir.LocalRead() | ir.TempRead() | ir.SharedRead() | ir.PortRead() | ir.ParamRead():
            name = variable_of(node)
            assert name is not None
            known = flow.values.get(name)
            return Fact(name, True) if known is None or isinstance(known, Linear) else known
        case _:
            return UNKNOWN


def _comparison(op: str, left: ir.Expr, right: ir.Expr, flow: Flow) -> Formula:
    first, second = term(left, flow), term(right, flow)
    if first is not None and second is not None:
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
    if left.type == FLOAT:
        if isinstance(right, (ir.Const, ir.Widen)):
            return _nonzero_by(op, left, right, flow)
        if isinstance(left, (ir.Const, ir.Widen)):
            return _nonzero_by(_MIRRORED[op], right, left, flow)
    return UNKNOWN


def _nonzero_by(op: str, value: ir.Expr, bound: ir.Expr, flow: Flow) -> Formula:
    """What `value op bound` tells of a float: whether it can be zero."""
    number = bound.value if isinstance(bound, ir.Const) else None
    if number is None:
        known = term(bound, flow)
        number = known.constant if known is not None and not known.terms else None
    if number is None:
        return UNKNOWN
    if op == "==" and number == 0:
        return Fact(value, False)
    excludes_zero = {"!=": number == 0, ">": number >= 0, ">=": number > 0, "<": number <= 0, "<=": number < 0}
    # Either answer to the comparison is possible where the value is not zero, so only one direction tells anything.
    return linear.And((UNKNOWN, Fact(value, True))) if excludes_zero.get(op) else UNKNOWN


def nonzero(node: ir.Expr, flow: Flow) -> Formula:
    """That a divisor differs from zero."""
    value = term(node, flow)
    if value is not None:
        return linear.negate(linear.equal(value, linear.constant(0)))
    if isinstance(node, ir.Const):
        return TRUE if node.value else linear.FALSE
    return Fact(node, True)


def known_value(node: ir.Expr, flow: Flow) -> Linear | Formula | None:
    """What a variable is known to be after `node` was assigned to it; None when that is nothing."""
    if node.type == INT:
        return term(node, flow)
    if node.type == BOOL:
        return formula(node, flow)
    return None


def _mentions(item: Linear | Formula, name: str) -> bool:
    for found in linear.variables(item):
        if found == name or (not isinstance(found, str) and name in _reads(found)):
            return True
    return False


def _reads(node: object) -> set[str]:
    """The variables that a fact about an expression depends on."""
    found: set[str] = set()
    pending: list[object] = [node]
    while pending:
        item = pending.pop()
        if isinstance(item, tuple):
            pending.extend(item)
        elif isinstance(item, Node):
            name = variable_of(item)  # type: ignore[arg-type]
            if name is not None:
                found.add(name)
            pending.extend(getattr(item, f) for f in type(item).__match_args__ if f not in ("span", "type"))  # type: ignore[attr-defined]
    return found
