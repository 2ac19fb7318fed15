"""IR expressions -> Python text, with no more parentheses than Python needs."""

from __future__ import annotations

from koordgen.build.emit import size
from koordgen.build.emit.alone import tells_of_itself
from koordgen.build.emit.floats import ANY, kind
from koordgen.build.emit.names import Names
from koordgen.build.emit.types import display
from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import (
    FLOAT,
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
from koordgen.lang.node import nodes

# Python's binding strengths, loosest first.
_CONDITIONAL, _OR, _AND, _NOT, _COMPARE, _SUM, _PRODUCT, _SIGN, _ATOM = range(9)
_STRENGTH = {"or": _OR, "and": _AND, "+": _SUM, "-": _SUM, "*": _PRODUCT, "/": _PRODUCT, "//": _PRODUCT, "%": _PRODUCT}
# Builtins that Python or the runtime's library calls something else. All others are functions of the same name.
_CALLED = {"GridMap": "area", "index": "index_of", "get": "map_get"}
# Builtins that compare their arguments, or parts of them; `clear` and `path_distance` look for NaN themselves.
_COMPARING = ("min", "max", "sorted", "index", "removed", "Rect", "Ball")
# Builtins that go through their arguments; so do those that compare them.
_SEARCHING = ("sum", "union", "intersection", "difference")


def text(node: ir.Expr, names: Names) -> str:
    """The Python expression for `node`, over a State called `s`."""
    return _text(node, names)[0]


def operand_of_and(node: ir.Expr, names: Names) -> str:
    """The Python expression for `node` as an operand of `and`."""
    return _within(node, names, _AND)


def domain(node: ir.Expr, names: Names) -> str:
    """What a loop over `node` runs over in Python: of a Map its keys."""
    match node:
        case ir.Range(ir.Const(0), stop, 1):
            return f"range({text(stop, names)})"
        case ir.Range(start, stop, step):
            last = "" if step == 1 else f", {step}"
            return f"range({text(start, names)}, {text(stop, names)}{last})"
        case ir.Ids():
            return "range(s.n_sys)"
        case _:
            shown = text(node, names)
            return f"keys({shown})" if isinstance(node.type, MapOf) else shown


def _text(node: ir.Expr, names: Names) -> tuple[str, int]:
    match node:
        case ir.Const(value):
            # A negative literal binds as a sign does: -1 ** 2 and (-1).x are other things.
            negative = isinstance(value, (int, float)) and value < 0
            return literal(value), _SIGN if negative else _ATOM
        case ir.Widen(ir.Const(value)):
            return repr(float(value)), _ATOM
        case ir.Widen(ir.Unary("-", ir.Const(value))) if value != 0:  # -0 is 0, and no -0.0
            return f"-{float(value)!r}", _SIGN
        case ir.Widen(operand):
            return f"float({text(operand, names)})", _ATOM
        case ir.Unary("not", ir.Contains(item, values)) if not isinstance(values.type, MapOf):
            return f"{_compared(item, names)} not in {_compared(values, names)}", _COMPARE
        case ir.Unary(op, operand):
            if op == "not":
                return f"not {_within(operand, names, _NOT)}", _NOT
            return f"-{_within(operand, names, _SIGN)}", _SIGN
        case ir.Binary("**", left, right):
            return f"power({text(left, names)}, {text(right, names)})", _ATOM
        case ir.Binary(op, left, right) if looks := size.checked(node):
            if looks == "made":
                return f"made({_within(left, names, _SUM)} {op} {_within(right, names, _PRODUCT)})", _ATOM
            return f"{looks}({text(left, names)}, {text(right, names)})", _ATOM
        case ir.Binary(op, left, right) | ir.Logic(op, left, right):
            own = _STRENGTH[op]
            return f"{_within(left, names, own)} {op} {_within(right, names, own + 1)}", own
        case ir.Compare(op, left, right) if left.type == STRING:  # as fast as a turn, however long they are
            return f"{_within(left, names, _SUM)} {op} {_within(right, names, _SUM)}", _COMPARE
        case ir.Compare(op, left, right):
            return f"{_compared(left, names)} {op} {_compared(right, names)}", _COMPARE
        case ir.Contains(item, values):
            if isinstance(values.type, MapOf):
                return f"has_key({text(values, names)}, {text(item, names)})", _ATOM
            return f"{_compared(item, names)} in {_compared(values, names)}", _COMPARE
        case ir.Conditional(condition, then, orelse):
            shown = f"{_within(then, names, _OR)} if {_within(condition, names, _OR)} else {text(orelse, names)}"
            return shown, _CONDITIONAL
        case ir.Quantified(kind, name, over, body):
            if names.formulas:
                return _quantified(node, names), _ATOM
            every = "all" if kind == "forall" else "any"
            return f"{every}({text(body, names)} for {names.temp(name)} in {_counted(over, names)})", _ATOM
        case _:
            return _atom(node, names), _ATOM


def _quantified(node: ir.Quantified, names: Names) -> str:
    """Of what is known of a fleet, which may leave the truth open, and tells what made it false."""
    every = "every" if node.kind == "forall" else "some"
    others = "" if isinstance(node.domain, ir.Ids) or _names_a_robot(node.name, node.body) else ", robots=False"
    body = f"lambda {names.temp(node.name)}: {text(node.body, names)}"
    if tells_of_itself(node):
        return f"s.own({literal(node.name)}, {body})"
    return f"s.{every}({literal(node.name)}, {_counted(node.domain, names)}, {body}{others})"


def _counted(over: ir.Expr, names: Names) -> str:
    """The domain of a quantifier: each of its values costs a turn, unless they are the robots."""
    return domain(over, names) if isinstance(over, ir.Ids) else f"turns({domain(over, names)})"


def _names_a_robot(name: str, body: ir.Expr) -> bool:
    """Whether a temp is the index of a robot somewhere in an expression."""
    for node in nodes(body):
        match node:
            case ir.LocalOf(_, ir.TempRead(at)) | ir.PortOf(_, _, ir.TempRead(at)) | ir.SlotRead(_, ir.TempRead(at)):
                if at == name:
                    return True
            case _:
                pass
    return False


def _compared(node: ir.Expr, names: Names, least: int = _SUM) -> str:
    """An operand of a comparison: a value that may have NaN in it goes through a function that raises for one. Of a
    region, the values that it is made of do. A large one takes turns."""
    if kind(node, names.floats) == ANY:
        return f"{'no_nan' if node.type == FLOAT else 'no_nan_in'}({_searched(node, names, _CONDITIONAL)})"
    return _searched(node, names, least)


def _searched(node: ir.Expr, names: Names, least: int) -> str:
    """A value that is gone through: one that may have many elements takes turns."""
    looks = size.looks(node, names.floats)
    return f"{looks}({text(node, names)})" if looks else _within(node, names, least)


def literal(value: int | float | bool | str) -> str:
    """A constant; strings in double quotes, as the rest of the program has them."""
    if not isinstance(value, str):
        return repr(value)
    inner = repr('"' + value)[2:-1]  # a double quote inside makes repr choose single ones around
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
            return names.params[name]
        case ir.LocalRead(name):
            return f"s.{names.locals[name]}.value"
        case ir.TempRead(name):
            return names.temp(name)
        case ir.SlotRead(name, index):
            return f"s.{names.shared[name]}[{text(index, names)}]"
        case ir.SlotsRead(name):
            return f"s.{names.shared[name]}.all"
        case ir.SharedRead(name):
            return f"s.{names.shared[name]}.value"
        case ir.PortRead(module, port, primed):
            read = f"s.{names.after if primed else names.before}{names.ports[module, port]}"
            return read if (module, port) in names.sensors else f"{read}.value"
        case ir.LocalOf(name, robot):
            return f"s.{names.locals[name]}[{text(robot, names)}]"
        case ir.PortOf(module, port, robot):
            return f"s.{names.ports[module, port]}[{text(robot, names)}]"
        case _:
            return _part(node, names)


def _part(node: ir.Expr, names: Names) -> str:
    match node:
        case ir.Make(items, type_):
            return _make(items, type_, names)
        case ir.Field(operand, name):
            owner = operand.type
            field = names.fields[owner.name][name] if isinstance(owner, RecordType) else name
            return f"{_within(operand, names, _ATOM)}.{field}"
        case ir.Item(operand, index):
            return f"{_within(operand, names, _ATOM)}[{index}]"
        case ir.At(operand, index, proved):
            if proved:
                return f"{_within(operand, names, _ATOM)}[{text(index, names)}]"
            return f"at({text(operand, names)}, {text(index, names)})"
        case ir.Slice(operand, start, stop, proved):
            a, b = (None if bound is None else text(bound, names) for bound in (start, stop))
            if proved:
                return f"made({_within(operand, names, _ATOM)}[{a or ''}:{b or ''}])"
            return f"{'part' if operand.type == STRING else 'slice_'}({text(operand, names)}, {a}, {b})"
        case ir.With(operand, name, value):
            return _with(operand, name, text(value, names), names)
        case _:
            return _call(node, names)


def _call(node: ir.Expr, names: Names) -> str:
    match node:
        case ir.Builtin(name, args):
            return _builtin(name, args, names)
        case ir.Call(name, args):
            return f"{names.functions[name]}({_args(args, names)})"
        case ir.ExternCall(name, args):
            return f"{names.externs[name]}({_args(args, names)})"
        case ir.PortCall(module, port, args):
            return f"s.{names.ports[module, port]}({_args(args, names)})"
        case _:  # a Range that nothing runs over
            raise InternalError(f"a {type(node).__name__} has no place in an event")


def _args(args: tuple[ir.Expr, ...], names: Names) -> str:
    return ", ".join([text(arg, names) for arg in args])


def _make(items: tuple[ir.Expr, ...], type_: Type, names: Names) -> str:
    parts = [text(item, names) for item in items]
    match type_:
        case RecordType(name):
            return f"{names.records[name]}({', '.join(parts)})"
        case ExternType():
            return "Opaque()"
        case Sized(name):
            return f"{name}()"
        case Sequence("Set") if parts:
            return f"set_of({display(parts)})"
        case MapOf() if parts:
            return f"map_of({display(parts)})"
        case _:
            return display(parts)


def _with(operand: ir.Expr, name: str, value: str, names: Names) -> str:
    match operand.type:
        case RecordType(record):
            return f"replace({text(operand, names)}, {names.fields[record][name]}={value})"
        case TupleOf(items):
            whole = _within(operand, names, _ATOM)
            return display([value if i == int(name) else f"{whole}[{i}]" for i in range(len(items))])
        case other:
            raise InternalError(f"a {other} with {name}")


def _argument(arg: ir.Expr, name: str, names: Names) -> str:
    if name in _COMPARING:
        return _compared(arg, names, _CONDITIONAL)
    return _searched(arg, names, _CONDITIONAL) if name in _SEARCHING else text(arg, names)


def _builtin(name: str, args: tuple[ir.Expr, ...], names: Names) -> str:
    given = ", ".join([_argument(arg, name, names) for arg in args])
    match name:
        case "cleared" if isinstance(args[0], (ir.LocalRead, ir.TempRead, ir.SharedRead, ir.PortRead)):
            return "()"
        case "cleared":  # `m[k].clear()`: there may be no such key
            return f"{_within(args[0], names, _ATOM)}[:0]"
        case "items":  # a map is its pairs
            return given
        case "sorted":
            return f"made(tuple(sorted({given})))"
        case "reversed":
            return f"made(tuple(reversed({given})))"
        case "count":
            xs, item = args
            return f"{_compared(xs, names, _ATOM)}.count({_compared(item, names, _CONDITIONAL)})"
        case "sum" if isinstance(args[0].type, Sequence) and args[0].type.element == FLOAT:
            return f"total({given})"
        case "sum":
            return f"checked(sum({given}))"
        case "str" if args[0].type == POINT:
            return f"shown({given})"
        case _:
            return f"{_CALLED.get(name, name)}({given})"


def _within(node: ir.Expr, names: Names, least: int) -> str:
    shown, strength = _text(node, names)
    return shown if strength >= least else f"({shown})"
