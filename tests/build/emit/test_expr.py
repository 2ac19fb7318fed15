"""Parentheses in generated expressions: Python parses the text into the tree that was printed."""

from __future__ import annotations

import ast
from itertools import product

import pytest

from koordgen.build.emit.expr import text
from koordgen.build.emit.names import Names
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.types import FLOAT, INT
from koordgen.lang.source import Span

AT = Span(1, 1, 1, 2)
NAMES = Names(Program("p", "p.koord", *[()] * 13))
A, B, C = (ir.Const(v, INT, AT) for v in (5, 7, 9))
OPERATORS = ("+", "-", "*", "/", "//", "%", "and", "or", "==", "<")


def node(op: str, left: ir.Expr, right: ir.Expr) -> ir.Expr:
    match op:
        case "and" | "or":
            return ir.Logic(op, left, right, INT, AT)
        case "==" | "<":
            return ir.Compare(op, left, right, INT, AT)
        case _:
            return ir.Binary(op, left, right, True, INT, AT)


def same(printed: str, spelled: str) -> bool:
    return ast.dump(ast.parse(printed, mode="eval")) == ast.dump(ast.parse(spelled, mode="eval"))


@pytest.mark.parametrize(("outer", "inner"), list(product(OPERATORS, OPERATORS)))
def test_nested_on_either_side(outer: str, inner: str) -> None:
    right = text(node(outer, A, node(inner, B, C)), NAMES)
    left = text(node(outer, node(inner, A, B), C), NAMES)
    spelled_left = f"(5 {inner} 7) {outer} 9"
    assert same(right, f"5 {outer} (7 {inner} 9)"), right
    # `a and b and c` is one node to Python, however it is nested; it means the same.
    assert same(left, spelled_left) or (outer == inner and outer in ("and", "or")), left


@pytest.mark.parametrize("op", OPERATORS)
def test_under_a_sign_a_not_and_a_condition(op: str) -> None:
    inner = node(op, A, B)
    assert same(text(ir.Unary("-", inner, INT, AT), NAMES), f"-(5 {op} 7)")
    assert same(text(ir.Unary("not", inner, INT, AT), NAMES), f"not (5 {op} 7)")
    chosen = ir.Conditional(inner, A, B, INT, AT)
    assert same(text(node(op, chosen, C), NAMES), f"(5 if 5 {op} 7 else 7) {op} 9")
    assert same(text(ir.Field(inner, "x", INT, AT), NAMES), f"(5 {op} 7).x")


def test_a_widened_minus_zero_has_no_sign() -> None:
    """-0 is an int before it is widened; -0.0 and 0.0 are two floats."""
    minus = ir.Unary("-", ir.Const(0, INT, AT), INT, AT)
    assert repr(eval(text(ir.Widen(minus, FLOAT, AT), NAMES))) == "0.0"
    assert text(ir.Widen(ir.Unary("-", A, INT, AT), FLOAT, AT), NAMES) == "-5.0"
