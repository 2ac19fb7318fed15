"""Expressions: resolves names, gives every node its type, has its indices and divisors judged."""

from __future__ import annotations

from typing import assert_never

from koordgen.check import bounds, linear
from koordgen.check.context import BUILTINS, Context
from koordgen.check.facts import formula
from koordgen.ir import expr as ir
from koordgen.ir.decl import Local, Module, Param, Shared
from koordgen.ir.types import BOOL, FLOAT, INT, NAMED, POINT, POISON, Scalar
from koordgen.source import Span
from koordgen.syntax import expr as ast

_NUMBERS = (INT, FLOAT)
_FUNCTIONS = f"the functions are {', '.join(BUILTINS)}"
_NO_FUNCTIONS = {
    "int": "a float never becomes an int; '//' of two ints gives an int",
    "float": "an int becomes a float by itself",
    "len": "N_SYS is the number of robots",
    "print": _FUNCTIONS,  # no Point was meant
}
_OTHER_WORDS = {"true": "True", "false": "False", "numAgents": "N_SYS", "numBots": "N_SYS", "self": "pid", "null": "0"}


def check_expr(node: ast.Expr, c: Context) -> ir.Expr:
    """The typed form; POISON where it is wrong, which has been reported then."""
    match node:
        case ast.Literal(value):
            return ir.Const(
                value, BOOL if isinstance(value, bool) else INT if isinstance(value, int) else FLOAT, node.span
            )
        case ast.Name():
            return _name(node, c)
        case ast.Attribute():
            return _attribute(node, c)
        case ast.Index():
            return _index(node, c)
        case ast.Call():
            return _call(node, c)
        case ast.Unary():
            return _unary(node, c)
        case ast.Binary(op, left, right):
            return arithmetic(op, check_expr(left, c), check_expr(right, c), node.span, c)
        case ast.Compare():
            return _compare(node, c)
        case ast.Logic():
            return _logic(node, c)
        case ast.Conditional():
            return _conditional(node, c)
        case _:
            assert_never(node)


def condition(node: ast.Expr, c: Context, what: str) -> ir.Expr:
    """An expression that must be a bool."""
    checked = check_expr(node, c)
    if checked.type not in (BOOL, POISON):
        help = "compare it: '!= 0'" if checked.type in _NUMBERS else ""
        return c.error("K013", f"{what} must be a bool, not {_a(checked.type)}", node.span, help)
    return checked


def widened(value: ir.Expr, type_: Scalar) -> ir.Expr:
    """An int as a float where a float is wanted; anything else as it is."""
    return ir.Widen(value, FLOAT, value.span) if type_ == FLOAT and value.type == INT else value


def fitting(value: ir.Expr, type_: Scalar, what: str, c: Context) -> ir.Expr:
    """A value that must be of a type."""
    value = widened(value, type_)
    if value.type == type_ or POISON in (value.type, type_):
        return value
    help = ""
    if (type_, value.type) == (INT, FLOAT):
        divides = isinstance(value, ir.Binary) and value.op == "/"
        help = "'/' gives a float; '//' of two ints gives an int" if divides else "a float never becomes an int"
    return c.error("K012", f"{what} is {_a(type_)}, not {_a(value.type)}", value.span, help)


def _a(type_: Scalar) -> str:
    return f"an {type_}" if type_ == INT else f"a {type_}"


def _name(node: ast.Name, c: Context) -> ir.Expr:
    name, span = node.name, node.span
    temp = c.temp(name)
    if temp is not None:
        return ir.TempRead(temp.unique, temp.type, span)
    if name in ("pid", "N_SYS"):
        if c.place == "constant":
            return c.error("K025", f"an initial value cannot depend on {name}", span, "set it in init")
        return ir.Pid(INT, span) if name == "pid" else ir.NSys(INT, span)
    if name == "ID":
        return c.error("K003", "'ID' is not supported by this version yet", span)
    if name in BUILTINS:
        return c.error("K017", f"{name} is a function and must be called", span, f"write {name}(...)")
    if name in NAMED:
        return c.error("K017", f"{name} is a type, not a value", span)
    if name not in c.entities:
        return c.error("K010", f"{name} is not defined", span, c.nearest(name, c.visible(), _OTHER_WORDS))
    match entity := c.entities[name]:
        case None:
            return ir.Const(0, POISON, span)
        case Param():
            return ir.ParamRead(name, entity.type, span)
        case Module():
            return c.error("K017", f"{name} is a module, not a value", span, f"name one of its ports: {name}.port")
    if c.place == "constant":
        return c.error("K025", f"an initial value cannot depend on the variable {name}", span, "set it in init")
    match entity:
        case Local():
            return ir.LocalRead(name, entity.type, span)
        case Shared(kind="allread"):
            help = f"{name}[pid] is this robot's"
            return c.error("K017", f"{name} has a value for each robot and needs an index", span, help)
        case Shared():
            if c.place == "init":
                return _shared_in_init(name, span, c)
            c.read_shared.add(name)
            return ir.SharedRead(name, entity.type, span)
        case _:
            assert_never(entity)


def _shared_in_init(name: str, span: Span, c: Context) -> ir.Expr:
    help = "other robots may not have run init yet: use a local variable, or do this in an event"
    return c.error("K023", f"init cannot read {name}: it is shared", span, help)


def _attribute(node: ast.Attribute, c: Context) -> ir.Expr:
    if isinstance(node.value, ast.Name) and c.temp(node.value.name) is None:
        name = node.value.name
        entity = c.entities.get(name)
        if isinstance(entity, Module):
            return _port(entity, node, c)
        if name in c.entities and entity is None:
            return ir.Const(0, POISON, node.span)
    operand = check_expr(node.value, c)
    if operand.type == POISON:
        return operand
    if operand.type != POINT or node.name not in ("x", "y", "z"):
        help = "a Point has .x, .y and .z" if operand.type == POINT else ""
        return c.error("K015", f"{_a(operand.type)} has no field {node.name}", node.name_span, help)
    return ir.Coordinate(operand, node.name, FLOAT, node.span)


def _port(module: Module, node: ast.Attribute, c: Context) -> ir.Expr:
    if c.place == "constant":
        help = "set it in init"
        return c.error("K025", f"an initial value cannot depend on the port {module.name}.{node.name}", node.span, help)
    for port in module.ports:
        if port.name == node.name:
            return ir.PortRead(module.name, port.name, port.type, node.span)
    help = c.nearest(node.name, [p.name for p in module.ports]) or f"declare it under 'using {module.name}:'"
    return c.error("K018", f"the port {module.name}.{node.name} is not declared", node.name_span, help)


def _index(node: ast.Index, c: Context) -> ir.Expr:
    index = check_expr(node.index, c)
    if not isinstance(node.value, ast.Name) or c.temp(node.value.name) is not None:
        value = check_expr(node.value, c)
        return value if value.type == POISON else c.error("K017", f"{_a(value.type)} has no index", node.span)
    name = node.value.name
    entity = c.entities.get(name)
    if not isinstance(entity, Shared) or entity.kind != "allread":
        value = _name(node.value, c)
        return value if value.type == POISON else c.error("K017", f"{name} is one value and takes no index", node.span)
    index = fitting(index, INT, "an index", c)
    if index.type == POISON or entity.type == POISON:
        return ir.Const(0, POISON, node.span)
    if c.place == "constant":
        return c.error("K025", f"an initial value cannot depend on the variable {name}", node.span, "set it in init")
    if c.place == "init" and not isinstance(index, ir.Pid):
        return _shared_in_init(c.text(node.span), node.span, c)
    proved = bounds.index_proved(index, node.span, c)
    return ir.SlotRead(name, index, proved, entity.type, node.span)


def _call(node: ast.Call, c: Context) -> ir.Expr:
    args = [check_expr(arg, c) for arg in node.args]
    if not isinstance(node.function, ast.Name):
        help = "ports that are called, and methods, come later"
        if isinstance(node.function, ast.Attribute) and node.function.name in BUILTINS:
            help = f"write {node.function.name}(...)"
        return c.error("K003", "this call is not supported by this version yet", node.span, help)
    name = node.function.name
    if name not in BUILTINS:
        if name in c.entities or c.temp(name) is not None:
            return c.error("K017", f"{name} is not a function", node.function.span)
        help = _NO_FUNCTIONS.get(name) or c.nearest(name, list(BUILTINS)) or _FUNCTIONS
        return c.error("K010", f"{name} is not defined", node.function.span, help)
    wanted = {"Point": 3, "distance": 2, "abs": 1, "sqrt": 1, "min": 2, "max": 2}[name]
    if len(args) != wanted:
        plural = "" if wanted == 1 else "s"
        return c.error("K014", f"{name} takes {wanted} argument{plural}, not {len(args)}", node.span)
    if any(a.type == POISON for a in args):
        return ir.Const(0, POISON, node.span)
    if name == "Point" or name == "sqrt":
        type_: Scalar = FLOAT
    elif name == "distance":
        type_ = POINT
    else:  # abs, min, max keep ints as ints
        type_ = INT if all(a.type == INT for a in args) else FLOAT
    args = [fitting(a, type_, f"an argument of {name}", c) for a in args]
    if any(a.type == POISON for a in args):
        return ir.Const(0, POISON, node.span)
    result = POINT if name == "Point" else FLOAT if name in ("distance", "sqrt") else type_
    return ir.Builtin(name, tuple(args), result, node.span)


def _unary(node: ast.Unary, c: Context) -> ir.Expr:
    operand = check_expr(node.operand, c)
    allowed = (BOOL,) if node.op == "not" else (INT, FLOAT, POINT)
    if operand.type == POISON:
        return operand
    if operand.type not in allowed:
        help = "compare it: '== 0'" if node.op == "not" and operand.type in _NUMBERS else ""
        return c.error("K012", f"'{node.op}' does not apply to {_a(operand.type)}", node.span, help)
    return ir.Unary(node.op, operand, operand.type, node.span)


def arithmetic(op: str, left: ir.Expr, right: ir.Expr, span: Span, c: Context) -> ir.Expr:
    """`left op right`, typed; a divisor is shown not to be zero, or reported."""
    if POISON in (left.type, right.type):
        return ir.Const(0, POISON, span)
    numbers = left.type in _NUMBERS and right.type in _NUMBERS
    result: Scalar | None = None
    if numbers:
        if left.type != right.type:
            left, right = widened(left, FLOAT), widened(right, FLOAT)
        result = FLOAT if op == "/" else left.type
    elif op in ("+", "-") and left.type == right.type == POINT:
        result = POINT
    elif op in ("*", "/") and left.type == POINT and right.type in _NUMBERS:
        right, result = widened(right, FLOAT), POINT
    elif op == "*" and left.type in _NUMBERS and right.type == POINT:
        left, result = widened(left, FLOAT), POINT
    if result is None:
        return c.error("K012", f"'{op}' does not apply to {_a(left.type)} and {_a(right.type)}", span)
    proved = op not in ("/", "//", "%") or bounds.divisor_proved(right, span, c)
    return ir.Binary(op, left, right, proved, result, span)


def _compare(node: ast.Compare, c: Context) -> ir.Expr:
    """A chain is the `and` of its pairs: no expression has effects, so to evaluate one twice is to evaluate it once."""
    left = check_expr(node.first, c)
    result: ir.Expr | None = None
    for op, right_node in node.rest:
        right = check_expr(right_node, c)
        pair = _pair(op, left, right, node.span, c)
        result = pair if result is None else ir.Logic("and", result, pair, BOOL, node.span)
        if pair.type == POISON:
            return pair
        left = right
    assert result is not None
    return result


def _pair(op: str, left: ir.Expr, right: ir.Expr, span: Span, c: Context) -> ir.Expr:
    if POISON in (left.type, right.type):
        return ir.Const(0, POISON, span)
    if left.type in _NUMBERS and right.type in _NUMBERS:
        if left.type != right.type:
            left, right = widened(left, FLOAT), widened(right, FLOAT)
    elif left.type != right.type:
        return c.error("K012", f"{_a(left.type)} and {_a(right.type)} cannot be compared", span)
    elif op not in ("==", "!="):
        return c.error("K012", f"'{op}' does not apply to {_a(left.type)} and {_a(right.type)}", span)
    return ir.Compare(op, left, right, BOOL, span)


def _logic(node: ast.Logic, c: Context) -> ir.Expr:
    left = check_expr(node.left, c)
    saved, poisoned = c.flow, c.poisoned
    if saved is not None and left.type == BOOL:
        held = formula(left, saved)
        c.flow = saved.knowing(held if node.op == "and" else linear.negate(held))
    c.poisoned = poisoned or left.type == POISON
    right = check_expr(node.right, c)
    c.flow, c.poisoned = saved, poisoned
    if POISON in (left.type, right.type):
        return ir.Const(0, POISON, node.span)
    for side in (left, right):
        if side.type != BOOL:
            return c.error("K013", f"'{node.op}' joins bools, not {_a(side.type)}", side.span)
    return ir.Logic(node.op, left, right, BOOL, node.span)


def _conditional(node: ast.Conditional, c: Context) -> ir.Expr:
    held = condition(node.condition, c, "the condition of 'if'")
    saved, poisoned = c.flow, c.poisoned
    known = formula(held, saved) if saved is not None and held.type == BOOL else linear.UNKNOWN
    c.poisoned = poisoned or held.type == POISON
    if saved is not None:
        c.flow = saved.knowing(known)
    then = check_expr(node.then, c)
    if saved is not None:
        c.flow = saved.knowing(linear.negate(known))
    orelse = check_expr(node.orelse, c)
    c.flow, c.poisoned = saved, poisoned
    if POISON in (held.type, then.type, orelse.type):
        return ir.Const(0, POISON, node.span)
    if then.type in _NUMBERS and orelse.type in _NUMBERS and then.type != orelse.type:
        then, orelse = widened(then, FLOAT), widened(orelse, FLOAT)
    if then.type != orelse.type:
        return c.error("K012", f"this is {_a(then.type)} or {_a(orelse.type)}; both must be of one type", node.span)
    return ir.Conditional(held, then, orelse, then.type, node.span)
