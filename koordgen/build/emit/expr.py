"""IR expressions -> Python text, with no more parentheses than Python needs.

`Names.use` records each name of the library or the program, and each operator that the head of the module explains.
"""

from __future__ import annotations

from koordgen.build.emit import size
from koordgen.build.emit.floats import ANY, is_nonzero_literal, kind
from koordgen.build.emit.layout import alternatives, brackets, chain, display, joined, longer
from koordgen.build.emit.names import Names
from koordgen.build.emit.own_instance import is_own_instance_enough
from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import (
    FLOAT,
    INT,
    POINT,
    STRING,
    ExternType,
    MapOf,
    RecordType,
    Sequence,
    Sized,
    TupleOf,
    Type,
)

# Precedence of Python's operators, lowest first.
_CONDITIONAL, _OR, _AND, _NOT, _COMPARE, _SUM, _PRODUCT, _SIGN, _ATOM = range(9)
_STRENGTH = {"or": _OR, "and": _AND, "+": _SUM, "-": _SUM, "*": _PRODUCT, "/": _PRODUCT, "//": _PRODUCT, "%": _PRODUCT}
# Builtins with another name in Python or in the runtime's library. All others are functions of the same name.
_CALLED = {"GridMap": "area", "index": "index_of", "get": "map_get"}
# Builtins that compare their arguments, so generated code checks the arguments for NaN. Not listed: `clear` and
# `path_distance`, which check for NaN themselves.
_COMPARING = ("min", "max", "sorted", "index", "removed", "Rect", "Ball")
# Builtins that iterate over their arguments and compare nothing.
_SEARCHING = ("sum", "union", "intersection", "difference")


def text(node: ir.Expr, names: Names) -> str:
    """Return the Python expression for `node`; the program's State is called `s` in it."""
    return _text(node, names)[0]


def and_also(node: ir.Expr, last: str, names: Names) -> str:
    """Return the Python expression `node and LAST`. `last`: the text of the second operand, which begins with `and`."""
    shown, strength = _text(node, names)
    if strength == _AND:
        return longer(shown, last)
    return chain(shown if strength > _AND else brackets("(", [shown], ")"), last)


def domain(node: ir.Expr, names: Names) -> str:
    """Return the Python text of the iterable of a loop over `node`. A loop over a Map visits the keys."""
    match node:
        case ir.Range(ir.Const(0), stop, 1):
            return _call_of("range", text(stop, names))
        case ir.Range(start, stop, step):
            last = () if step == 1 else (str(step),)
            return _call_of("range", text(start, names), text(stop, names), *last)
        case ir.Ids():
            return "range(s.n_sys)"
        case _:
            shown = text(node, names)
            return _call_of(names.use("keys"), shown) if isinstance(node.type, MapOf) else shown


def _call_of(function: str, *args: str) -> str:
    return brackets(f"{function}(", args, ")")


def _text(node: ir.Expr, names: Names) -> tuple[str, int]:
    match node:
        case ir.Const(value):
            # A negative literal binds as a sign does: -1 ** 2 is -(1 ** 2), and -1 .x is -(1 .x).
            negative = isinstance(value, (int, float)) and value < 0
            return literal(value), _SIGN if negative else _ATOM
        case ir.Widen(ir.Const(value)):
            return repr(float(value)), _ATOM
        case ir.Widen(ir.Unary("-", ir.Const(value))) if value != 0:  # not for 0: the int -0 is 0, not -0.0
            return f"-{float(value)!r}", _SIGN
        case ir.Widen(operand):
            return _call_of("float", text(operand, names)), _ATOM
        case ir.Unary("not", ir.Contains(item, values)) if not isinstance(values.type, MapOf):
            return _infix(_compared(item, names), "not in", _compared(values, names)), _COMPARE
        case ir.Unary(op, operand):
            if op == "not":
                return joined("not ", _within(operand, names, _NOT)), _NOT
            return joined("-", _within(operand, names, _SIGN)), _SIGN
        case ir.Binary("**", left, right):
            return _call_of(names.use("power"), text(left, names), text(right, names)), _ATOM
        case ir.Binary() if size.checked(node):
            return _checked(node, names), _ATOM
        case ir.Binary(op, left, right) | ir.Logic(op, left, right):
            own = _STRENGTH[op]
            _explain(node, names)
            shown, strength = _text(left, names)
            last = joined(f"{op} ", _within(right, names, own + 1))
            if strength == own:
                return longer(shown, last), own
            return chain(shown if strength > own else brackets("(", [shown], ")"), last), own
        case ir.Compare(op, left, right) if left.type == STRING:  # comparing strings costs no turn
            return _infix(_within(left, names, _SUM), op, _within(right, names, _SUM)), _COMPARE
        case ir.Compare(op, left, right):
            return _infix(_compared(left, names), op, _compared(right, names)), _COMPARE
        case ir.Contains(item, values):
            if isinstance(values.type, MapOf):
                return _call_of(names.use("has_key"), text(values, names), text(item, names)), _ATOM
            return _infix(_compared(item, names), "in", _compared(values, names)), _COMPARE
        case ir.Conditional(condition, then, orelse):
            parts = [_within(then, names, _OR), joined("if ", _within(condition, names, _OR))]
            return alternatives(parts, text(orelse, names), isinstance(orelse, ir.Conditional)), _CONDITIONAL
        case ir.Quantified(kind, name, over, body):
            if names.formulas:
                return _quantified(node, names), _ATOM
            each = joined(f"for {names.temp(name)} in ", _counted(over, names))
            return _call_of("all" if kind == "forall" else "any", chain(text(body, names), each)), _ATOM
        case _:
            return _atom(node, names), _ATOM


def _infix(left: str, op: str, right: str) -> str:
    return joined(left, f" {op} ", right)


def _checked(node: ir.Binary, names: Names) -> str:
    """Return the Python text of an operation that checks the size of its result at run time."""
    looks = names.use(size.checked(node))
    if looks == "made":
        last = joined(f"{node.op} ", _within(node.right, names, _PRODUCT))
        return _call_of(looks, chain(_within(node.left, names, _SUM), last))
    return _call_of(looks, text(node.left, names), text(node.right, names))


def change(node: ir.Expr, names: Names) -> str:
    """Return ` += value`, ` -= value` and so on if Python's operator needs no check; otherwise "".

    The emitted assignment gives its variable a new value; it never changes a value in place.
    """
    if not isinstance(node, ir.Binary) or node.op == "**" or size.checked(node):
        return ""
    _explain(node, names)
    return joined(f" {node.op}= ", text(node.right, names))


def _explain(node: ir.Binary | ir.Logic, names: Names) -> None:
    """Record the operator of `node`, if the head of the generated module must explain it."""
    if node.type == INT and node.op in ("+", "-", "*") and not size.is_small(node):
        names.use("+")
    if node.op in ("//", "%") or (node.op == "/" and not is_nonzero_literal(node.right)):
        names.use(node.op)


def _quantified(node: ir.Quantified, names: Names) -> str:
    """Return the Python text of a call that evaluates a quantifier of a property.

    A robot knows only a part of the fleet's state, so the truth value may be unknown. The called methods of `s` also
    record which robot or value made the formula false.
    """
    every = "every" if node.kind == "forall" else "some"
    others = () if isinstance(node.domain, ir.Ids) or _names_a_robot(node.name, node.body) else ("robots=False",)
    body = joined(f"lambda {names.temp(node.name)}: ", text(node.body, names))
    if is_own_instance_enough(node):
        return _call_of("s.own", literal(node.name), body)
    return _call_of(f"s.{every}", literal(node.name), _counted(node.domain, names), body, *others)


def _counted(over: ir.Expr, names: Names) -> str:
    """Return the Python text of a quantifier's domain. Each value of the domain costs a turn, except in `ID`."""
    return domain(over, names) if isinstance(over, ir.Ids) else _call_of(names.use("turns"), domain(over, names))


def _names_a_robot(name: str, body: ir.Expr) -> bool:
    """Return whether the temp `name` is used as the index of a robot in an expression."""
    for node in walk(body):
        match node:
            case ir.LocalOf(_, ir.TempRead(at)) | ir.PortOf(_, _, ir.TempRead(at)) | ir.SlotRead(_, ir.TempRead(at)):
                if at == name:
                    return True
            case _:
                pass
    return False


def _compared(node: ir.Expr, names: Names, least: int = _SUM) -> str:
    """Return the Python text of an operand of a comparison.

    If the operand may contain NaN, the text calls a function that raises for NaN. For a region, it does so for the
    values that construct the region. If the operand is large, the text also counts turns.
    """
    if kind(node, names.floats) == ANY:
        looks = names.use("no_nan" if node.type == FLOAT else "no_nan_in")
        return _call_of(looks, _searched(node, names, _CONDITIONAL))
    return _searched(node, names, least)


def _searched(node: ir.Expr, names: Names, least: int) -> str:
    """Return the Python text of a value over which the runtime iterates.

    If the value may have many elements, the text also counts the turns of the iteration.
    """
    looks = size.looks(node, names.floats)
    return _call_of(names.use(looks), text(node, names)) if looks else _within(node, names, least)


def literal(value: int | float | bool | str) -> str:
    """Return the Python text of a constant. Strings have double quotes, like all strings of the module."""
    if not isinstance(value, str):
        return repr(value)
    inner = repr('"' + value)[2:-1]  # repr encloses a string with a double quote in single quotes
    return '"' + inner.replace("\\'", "'").replace('"', '\\"') + '"'


def _atom(node: ir.Expr, names: Names) -> str:
    match node:
        case ir.Pid():
            return "s.pid"
        case ir.NSys():
            return "s.n_sys"
        case ir.Ids():
            return "tuple(range(s.n_sys))"
        case ir.ParamRead(name):
            return names.use(names.params[name])
        case ir.LocalRead(name):
            return f"s.{names.locals[name]}.value"
        case ir.TempRead(name):
            return names.temp(name)
        case ir.SlotRead(name, index):
            return brackets(f"s.{names.shared[name]}[", [text(index, names)], "]")
        case ir.SlotsRead(name):
            return f"s.{names.shared[name]}.all"
        case ir.SharedRead(name):
            return f"s.{names.shared[name]}.value"
        case ir.PortRead(module, port, primed):
            read = f"s.{names.after if primed else names.before}{names.ports[module, port]}"
            return read if (module, port) in names.sensors else f"{read}.value"
        case ir.LocalOf(name, robot):
            return brackets(f"s.{names.locals[name]}[", [text(robot, names)], "]")
        case ir.PortOf(module, port, robot):
            return brackets(f"s.{names.ports[module, port]}[", [text(robot, names)], "]")
        case _:
            return _part(node, names)


def _part(node: ir.Expr, names: Names) -> str:
    match node:
        case ir.Make(items, type_):
            return _make(items, type_, names)
        case ir.Field(operand, name):
            owner = operand.type
            field = names.fields[owner.name][name] if isinstance(owner, RecordType) else name
            return joined(_within(operand, names, _ATOM), f".{field}")
        case ir.Item(operand, index):
            return joined(_within(operand, names, _ATOM), f"[{index}]")
        case ir.At(operand, index, proved):
            if proved:
                names.use("[]")
                return joined(_within(operand, names, _ATOM), brackets("[", [text(index, names)], "]"))
            return _call_of(names.use("at"), text(operand, names), text(index, names))
        case ir.Slice(operand, start, stop, proved):
            a, b = (None if bound is None else text(bound, names) for bound in (start, stop))
            if proved:
                return _call_of(names.use("made"), joined(_within(operand, names, _ATOM), f"[{a or ''}:{b or ''}]"))
            part = names.use("part" if operand.type == STRING else "slice_")
            return _call_of(part, text(operand, names), a or "None", b or "None")
        case ir.With(operand, name, value):
            return _with(operand, name, text(value, names), names)
        case _:
            return _call(node, names)


def _call(node: ir.Expr, names: Names) -> str:
    match node:
        case ir.Builtin(name, args):
            return _builtin(name, args, names)
        case ir.Call(name, args):
            return _call_of(names.use(names.functions[name]), *_args(args, names))
        case ir.ExternCall(name, args):
            return _call_of(names.use(names.externs[name]), *_args(args, names))
        case ir.PortCall(module, port, args):
            return _call_of(f"s.{names.ports[module, port]}", *_args(args, names))
        case _:  # a Range outside of a loop or quantifier
            raise InternalError(f"a {type(node).__name__} cannot occur in an event")


def _args(args: tuple[ir.Expr, ...], names: Names) -> list[str]:
    return [text(arg, names) for arg in args]


def _make(items: tuple[ir.Expr, ...], type_: Type, names: Names) -> str:
    parts = [text(item, names) for item in items]
    match type_:
        case RecordType(name):
            return _call_of(names.use(names.records[name]), *parts)
        case ExternType():
            return f"{names.use('Opaque')}()"
        case Sized(name):
            return f"{names.use(name)}()"
        case Sequence("Set") if parts:
            return _call_of(names.use("set_of"), display(parts))
        case MapOf() if parts:
            return _call_of(names.use("map_of"), display(parts))
        case _:
            return display(parts)


def _with(operand: ir.Expr, name: str, value: str, names: Names) -> str:
    match operand.type:
        case RecordType(record):
            field = joined(f"{names.fields[record][name]}=", value)
            return _call_of(names.use("replace"), text(operand, names), field)
        case TupleOf(items):
            whole = _within(operand, names, _ATOM)
            return display([value if i == int(name) else joined(whole, f"[{i}]") for i in range(len(items))])
        case other:
            raise InternalError(f"a value of type {other} has no field {name} to replace")


def _argument(arg: ir.Expr, name: str, names: Names) -> str:
    if name in _COMPARING:
        return _compared(arg, names, _CONDITIONAL)
    return _searched(arg, names, _CONDITIONAL) if name in _SEARCHING else text(arg, names)


def _builtin(name: str, args: tuple[ir.Expr, ...], names: Names) -> str:
    if name == "cleared":
        if isinstance(args[0], (ir.LocalRead, ir.TempRead, ir.SharedRead, ir.PortRead)):
            return "()"
        return joined(_within(args[0], names, _ATOM), "[:0]")  # evaluates `m[k]`, whose key may be missing
    if name == "count":
        counted, item = _compared(args[0], names, _ATOM), _compared(args[1], names, _CONDITIONAL)
        return joined(counted, _call_of(".count", item))
    given = [_argument(arg, name, names) for arg in args]
    match name:
        case "items":  # generated code has a Map as a tuple of its pairs
            return given[0]
        case "sorted" | "reversed":
            return _call_of(names.use("made"), _call_of("tuple", _call_of(name, *given)))
        case "sum" if isinstance(args[0].type, Sequence) and args[0].type.element == FLOAT:
            return _call_of(names.use("total"), *given)
        case "sum":
            return _call_of(names.use("checked"), _call_of("sum", *given))
        case "str" if args[0].type == POINT:
            return _call_of(names.use("shown"), *given)
        case "str":
            names.use("str()")
            return _call_of(name, *given)
        case _:
            return _call_of(names.use(_CALLED.get(name, name)), *given)


def _within(node: ir.Expr, names: Names, least: int) -> str:
    shown, strength = _text(node, names)
    return shown if strength >= least else brackets("(", [shown], ")")
