"""Analysis of expressions: tracks the facts at each part of an expression and applies the rules there.

`analyze_expression` sets `proved` on each index, slice and division that a rule has proved safe.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from koordgen.lang.analyze.facts.number import FUNCTIONS
from koordgen.lang.analyze.facts.path import Condition
from koordgen.lang.analyze.facts.terms import range_facts
from koordgen.lang.analyze.rules.analysis import Analysis
from koordgen.lang.analyze.rules.divisor import divisor_proved
from koordgen.lang.analyze.rules.element_index import element_proved, end_proved, has_element
from koordgen.lang.analyze.rules.known_value import check_function, check_power
from koordgen.lang.analyze.rules.robot_index import index_proved
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import map_children
from koordgen.lang.ir.types import BOOL, POISON, Sequence


def analyze_expression(node: ir.Expr, a: Analysis) -> ir.Expr:
    """Analyse an expression at the current point. Returns the same object if nothing changed."""
    rule = _RULES.get(type(node))
    return node if rule is None else rule(node, a)


def _parts(node: Any, a: Analysis) -> Any:
    return map_children(node, lambda child: analyze_expression(child, a))


def _pid(node: ir.Pid, a: Analysis) -> ir.Expr:
    a.mentioned.add("pid")
    return node


def _local(node: ir.LocalRead, a: Analysis) -> ir.Expr:
    a.mentioned.add(node.name)
    return node


def _shared(node: ir.SharedRead, a: Analysis) -> ir.Expr:
    a.mentioned.add(node.name)
    a.read_shared.add(node.name)
    return node


def _slot(node: ir.SlotRead, a: Analysis) -> ir.Expr:
    index = analyze_expression(node.index, a)
    proved = node.proved or index_proved(index, node.span, a)
    if index is node.index and proved is node.proved:
        return node
    return ir.SlotRead(node.name, index, proved, node.type, node.span)


def _of_robot(node: ir.LocalOf | ir.PortOf, a: Analysis) -> ir.Expr:
    found: ir.LocalOf | ir.PortOf = _parts(node, a)
    index_proved(found.robot, node.span, a)
    return found


def _binary(node: ir.Binary, a: Analysis) -> ir.Expr:
    left, right = analyze_expression(node.left, a), analyze_expression(node.right, a)
    proved = node.proved or divisor_proved(right, node.span, a)
    if left is not node.left or right is not node.right or proved is not node.proved:
        node = ir.Binary(node.op, left, right, proved, node.type, node.span)
    if node.op == "**":
        check_power(node, a)
    return node


def _compare(node: ir.Compare, a: Analysis) -> ir.Expr:
    left, right = analyze_expression(node.left, a), analyze_expression(node.right, a)
    if left is node.left and right is node.right:
        return node
    return ir.Compare(node.op, left, right, node.type, node.span)


def _logic(node: ir.Logic, a: Analysis) -> ir.Expr:
    """Analyse `and` or `or`. The right side is evaluated only if the left side does not decide the result."""
    left = analyze_expression(node.left, a)
    path, poisoned = a.path, a.poisoned
    if path is not None and left.type is BOOL:
        held = Condition(left, path)
        a.path = path.passing(held) if node.op == "and" else path.failing(held)
    a.poisoned = poisoned or left.type is POISON
    right = analyze_expression(node.right, a)
    a.path, a.poisoned = path, poisoned
    if left is node.left and right is node.right:
        return node
    return ir.Logic(node.op, left, right, node.type, node.span)


def _conditional(node: ir.Conditional, a: Analysis) -> ir.Expr:
    """Analyse `then if condition else orelse`. Only one of the two sides is evaluated."""
    condition = analyze_expression(node.condition, a)
    path, poisoned = a.path, a.poisoned
    yes = no = path
    if path is not None and condition.type is BOOL:
        known = Condition(condition, path)
        yes, no = path.passing(known), path.failing(known)
    a.poisoned = poisoned or condition.type is POISON
    a.path = yes
    then = analyze_expression(node.then, a)
    a.path = no
    orelse = analyze_expression(node.orelse, a)
    a.path, a.poisoned = path, poisoned
    if condition is node.condition and then is node.then and orelse is node.orelse:
        return node
    return ir.Conditional(condition, then, orelse, node.type, node.span)


def _quantified(node: ir.Quantified, a: Analysis) -> ir.Expr:
    domain = analyze_expression(node.domain, a)
    path = a.path
    if a.flow is not None:
        for fact in range_facts(node.name, domain, a.flow, a.flow):
            a.flow = a.flow.assuming(fact)
    body = analyze_expression(node.body, a)
    a.path = path
    if domain is node.domain and body is node.body:
        return node
    return ir.Quantified(node.kind, node.name, domain, body, node.type, node.span)


def _at(node: ir.At, a: Analysis) -> ir.Expr:
    operand, index = analyze_expression(node.operand, a), analyze_expression(node.index, a)
    if _is_last(operand, index) and index.span is node.span:  # `pop()` has an index only in the IR: nothing to report
        proved = node.proved or has_element(operand, a)
    else:
        proved = node.proved or element_proved(operand, index, node.span, a)
    if operand is node.operand and index is node.index and proved is node.proved:
        return node
    return ir.At(operand, index, proved, node.type, node.span)


def _is_last(operand: ir.Expr, index: ir.Expr) -> bool:
    match index:
        case ir.Binary("-", ir.Builtin("len", (counted,)), ir.Const(1)):
            return counted == operand
        case _:
            return False


def _slice(node: ir.Slice, a: Analysis) -> ir.Expr:
    found: ir.Slice = _parts(node, a)
    if found.proved:
        return found
    # `all` takes a list here, not a generator, so that both ends of the slice are checked and reported.
    ends = [end_proved(end, node.span, a) for end in (found.start, found.stop) if end is not None]
    proved = all(ends)
    return ir.Slice(found.operand, found.start, found.stop, proved, node.type, node.span) if proved else found


def _builtin(node: ir.Builtin, a: Analysis) -> ir.Expr:
    args = tuple([analyze_expression(arg, a) for arg in node.args])
    if any(new is not old for new, old in zip(args, node.args, strict=True)):
        node = ir.Builtin(node.name, args, node.type, node.span)
    name = node.name
    if name in FUNCTIONS:
        check_function(node, a)
    elif name == "inserted":
        end_proved(args[1], args[1].span, a)
    elif name == "updated" or (name == "without" and isinstance(node.type, Sequence) and node.type.name == "List"):
        element_proved(args[0], args[1], node.span, a)
    return node


_Rule = Callable[[Any, Analysis], ir.Expr]
# Class of node -> function that analyses the node. A class that is missing in this table has no parts and no rule.
_RULES: dict[type, _Rule] = {
    ir.Pid: _pid,
    ir.LocalRead: _local,
    ir.SharedRead: _shared,
    ir.SlotRead: _slot,
    ir.LocalOf: _of_robot,
    ir.PortOf: _of_robot,
    ir.Binary: _binary,
    ir.Compare: _compare,
    ir.Logic: _logic,
    ir.Conditional: _conditional,
    ir.Quantified: _quantified,
    ir.At: _at,
    ir.Slice: _slice,
    ir.Builtin: _builtin,
    **dict.fromkeys((ir.Widen, ir.Unary, ir.Contains, ir.Range, ir.Make, ir.Field, ir.Item, ir.With), _parts),
    **dict.fromkeys((ir.Call, ir.ExternCall, ir.PortCall), _parts),
}
