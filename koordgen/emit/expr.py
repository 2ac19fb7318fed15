"""IR expressions -> Python text, with no more parentheses than Python needs."""

from __future__ import annotations

from typing import assert_never

from koordgen.emit.names import Names
from koordgen.ir import expr as ir

# Python's binding strengths, loosest first.
_CONDITIONAL, _OR, _AND, _NOT, _COMPARE, _SUM, _PRODUCT, _SIGN, _ATOM = range(9)
_STRENGTH = {"or": _OR, "and": _AND, "+": _SUM, "-": _SUM, "*": _PRODUCT, "/": _PRODUCT, "//": _PRODUCT, "%": _PRODUCT}


def text(node: ir.Expr, names: Names) -> str:
    """The Python expression for `node`, over a State called `s`."""
    return _text(node, names)[0]


def _text(node: ir.Expr, names: Names) -> tuple[str, int]:
    match node:
        case ir.Const(value):
            # A negative literal binds as a sign does: -1 ** 2 and (-1).x are other things.
            return repr(value), _SIGN if not isinstance(value, bool) and value < 0 else _ATOM
        case ir.Pid():
            return "s.pid", _ATOM
        case ir.NSys():
            return "s.n_sys", _ATOM
        case ir.ParamRead(name):
            return names.params[name], _ATOM
        case ir.LocalRead(name):
            return f"s.{names.locals[name]}", _ATOM
        case ir.TempRead(name):
            return names.temp(name), _ATOM
        case ir.SlotRead(name, index):
            return f"s.{names.shared[name]}[{text(index, names)}]", _ATOM
        case ir.SharedRead(name):
            return f"s.{names.shared[name]}.value", _ATOM
        case ir.PortRead(module, port):
            read = f"s.{names.ports[module, port]}"
            return read if (module, port) in names.sensors else f"{read}.value", _ATOM
        case ir.Widen(operand):
            match operand:
                case ir.Const(value):
                    return repr(float(value)), _ATOM
                case ir.Unary("-", ir.Const(value)):
                    return f"-{float(value)!r}", _SIGN
            return f"float({text(operand, names)})", _ATOM
        case ir.Unary(op, operand):
            return (
                (f"not {_within(operand, names, _NOT)}", _NOT)
                if op == "not"
                else (f"-{_within(operand, names, _SIGN)}", _SIGN)
            )
        case ir.Binary(op, left, right) | ir.Logic(op, left, right):
            own = _STRENGTH[op]
            return f"{_within(left, names, own)} {op} {_within(right, names, own + 1)}", own
        case ir.Compare(op, left, right):
            return f"{_within(left, names, _SUM)} {op} {_within(right, names, _SUM)}", _COMPARE
        case ir.Conditional(condition, then, orelse):
            shown = f"{_within(then, names, _OR)} if {_within(condition, names, _OR)} else {text(orelse, names)}"
            return shown, _CONDITIONAL
        case ir.Coordinate(operand, axis):
            return f"{_within(operand, names, _ATOM)}.{axis}", _ATOM
        case ir.Builtin(name, args):
            return f"{name}({', '.join(text(a, names) for a in args)})", _ATOM
        case _:
            assert_never(node)


def _within(node: ir.Expr, names: Names, least: int) -> str:
    shown, strength = _text(node, names)
    return shown if strength >= least else f"({shown})"
