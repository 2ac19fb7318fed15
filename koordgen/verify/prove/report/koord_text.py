"""Formulas as text in Koord, for messages and suggestions to users."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import assert_never

from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import MapOf, RecordType, Sequence, Type

_BINDING = {"or": 1, "and": 2, "+": 5, "-": 5, "*": 6, "/": 6, "//": 6, "%": 6, "**": 8}
_ORDER = {"<", "<="}
_LOOSE, _NOT, _COMPARE, _UNARY, _ATOM = 0, 3, 4, 7, 9
MOST_DIGITS = 9


def to_koord(node: ir.Expr) -> str:
    """Return an expression as text in Koord, without superfluous brackets."""
    return _text(node)[0]


def _in(node: ir.Expr, least: int) -> str:
    text, binding = _text(node)
    return text if binding >= least else f"({text})"


def _text(node: ir.Expr) -> tuple[str, int]:
    """Return the text of an expression, and the precedence of its outermost operator."""
    match node:
        case ir.Widen(operand):
            return _text(operand)
        case ir.Unary("not", operand):
            return f"not {_in(operand, _NOT)}", _NOT
        case ir.Unary(op, operand):
            return f"{op}{_in(operand, _UNARY)}", _UNARY
        case ir.Logic("and"):
            parts = _chained(list(_conjuncts(node)))
            return " and ".join(parts), _BINDING["and"] if len(parts) > 1 else _COMPARE
        case ir.Binary(op, left, right) | ir.Logic(op, left, right):
            level = _BINDING[op]
            sides = (level + 1, level) if op == "**" else (level, level + (0 if op in ("and", "or") else 1))
            return f"{_in(left, sides[0])} {op} {_in(right, sides[1])}", level
        case ir.Compare(op, left, right):
            return f"{_in(left, _COMPARE + 1)} {op} {_in(right, _COMPARE + 1)}", _COMPARE
        case ir.Contains(item, values):
            return f"{_in(item, _COMPARE + 1)} in {_in(values, _COMPARE + 1)}", _COMPARE
        case ir.Conditional(condition, then, orelse):
            return f"{_in(then, 1)} if {_in(condition, 1)} else {_in(orelse, _LOOSE)}", _LOOSE
        case ir.Quantified(kind, name, domain, body):
            return f"{kind} {name} in {_in(domain, 1)}: {_in(body, _LOOSE)}", _LOOSE
        case _:
            return _atom(node), _ATOM


def _conjuncts(node: ir.Expr) -> Iterator[ir.Expr]:
    if isinstance(node, ir.Logic) and node.op == "and":
        yield from _conjuncts(node.left)
        yield from _conjuncts(node.right)
    else:
        yield node


def _chained(parts: list[ir.Expr]) -> list[str]:
    """Return the texts of conjuncts. `a <= b and b <= c` becomes `a <= b <= c`."""
    found: list[str] = []
    last: ir.Expr | None = None
    for part in parts:
        chain = isinstance(last, ir.Compare) and isinstance(part, ir.Compare) and last.right == part.left
        if chain and isinstance(part, ir.Compare) and isinstance(last, ir.Compare) and {last.op, part.op} <= _ORDER:
            found[-1] += f" {part.op} {_in(part.right, _COMPARE + 1)}"
        else:
            found.append(_in(part, _BINDING["and"]))
        last = part
    return found


def _atom(
    node: ir.Const | ir.Pid | ir.NSys | ir.Ids | ir.ParamRead | ir.LocalRead | ir.TempRead | ir.SlotRead | ir.SlotsRead
    | ir.SharedRead | ir.PortRead | ir.LocalOf | ir.PortOf | ir.Range | ir.Make | ir.Field | ir.Item | ir.At | ir.Slice
    | ir.With | ir.Builtin | ir.Call | ir.ExternCall | ir.PortCall,
) -> str:  # fmt: skip
    match node:
        case ir.Const(value):
            return number(Fraction(value)) if isinstance(value, (float, Fraction)) else repr(value)
        case ir.Pid():
            return "pid"
        case ir.NSys():
            return "N_SYS"
        case ir.Ids():
            return "ID"
        case (
            ir.TempRead(name) | ir.ParamRead(name) | ir.LocalRead(name) | ir.SharedRead(name) | ir.SlotsRead(name)
        ):  # fmt: skip
            return name
        case ir.SlotRead(name, index) | ir.LocalOf(name, index):
            return f"{name}[{to_koord(index)}]"
        case ir.PortRead(module, port, primed):
            return f"{module}.{port}{_prime(primed)}"
        case ir.PortOf(module, port, robot):
            return f"{module}.{port}[{to_koord(robot)}]"
        case ir.Range(start, stop, step):
            return f"range({', '.join([to_koord(start), to_koord(stop), *([str(step)] if step != 1 else [])])})"
        case ir.Make(items, type_):
            return _made(items, type_)
        case ir.Field(operand, name):
            return f"{_in(operand, _ATOM)}.{name}"
        case ir.Item(operand, index):
            return f"{_in(operand, _ATOM)}[{index}]"
        case ir.At(operand, index):
            return f"{_in(operand, _ATOM)}[{to_koord(index)}]"
        case ir.Slice(operand, start, stop):
            bounds = ":".join("" if bound is None else to_koord(bound) for bound in (start, stop))
            return f"{_in(operand, _ATOM)}[{bounds}]"
        case ir.With(operand, name, value):
            return f"{_in(operand, _ATOM)} with {name} = {to_koord(value)}"
        case ir.Builtin(name, args) | ir.Call(name, args) | ir.ExternCall(name, args):
            return f"{name}({_list(args)})"
        case ir.PortCall(module, port, args):
            return f"{module}.{port}({_list(args)})"
        case _:
            assert_never(node)


def _made(items: tuple[ir.Expr, ...], type_: Type) -> str:
    match type_:
        case RecordType(name):
            return f"{name}({_list(items)})"
        case Sequence("List"):
            return f"[{_list(items)}]"
        case Sequence() | MapOf():
            return f"{type_}({_list(items)})"
        case _:
            return f"({_list(items)})"


def _list(items: Iterable[ir.Expr]) -> str:
    return ", ".join([to_koord(item) for item in items])


def _prime(primed: bool) -> str:
    return "'" if primed else ""


def number(value: Fraction | int) -> str:
    """Return a number as text, exactly if the exact text is readable.

    Finite decimals and small fractions are readable. Every other number is rounded and marked with `~`."""
    exact = Fraction(value)
    if exact.denominator == 1 and abs(exact) < 10**15:
        return str(exact.numerator)
    near = float(exact) if abs(exact) < 10**300 else float("inf")
    for text in (repr(near), str(exact)):
        if len(text) <= MOST_DIGITS and text != "inf" and (near == exact or Fraction(text) == exact):
            return text
    return f"~{near:.6g}"
