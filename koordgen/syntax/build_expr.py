"""The nodes of expressions. See build.py."""

from __future__ import annotations

import re

from koordgen.node import replace
from koordgen.source import Span
from koordgen.syntax import expr
from koordgen.syntax.build_base import Children, across, nodes, reach, refused, token_span

_ESCAPES = {'\\"': '"', "\\'": "'", "\\\\": "\\", "\\n": "\n", "\\t": "\t"}
_ESCAPE = re.compile(r"\\.")


def conditional(c: Children) -> expr.Conditional:
    return expr.Conditional(c[2], c[0], c[4], reach(c[0], c[4]))


def logic(c: Children) -> expr.Logic:
    return expr.Logic(c[1][1], token_span(c[1]), c[0], c[2], across(c[0], c[2]))


def quantified(c: Children) -> expr.Quantified:
    domain, body = c[-3], c[-1]
    return expr.Quantified(c[0][1], names(c[1:-4]), domain, body, reach(c[0], body))


def names(tokens: Children) -> tuple[expr.Name, ...]:
    """The names of a list with commas."""
    return tuple(expr.Name(token[1], token_span(token)) for token in tokens[::2])


def unary(c: Children) -> expr.Unary:
    return expr.Unary(c[0][1], c[1], reach(c[0], c[1]))


def compare(c: Children) -> expr.Compare:
    rest: list[tuple[str, expr.Expr]] = []
    op = ""
    for child in c[1:]:
        if child.__class__ is tuple:
            op = f"{op} {child[1]}" if op else child[1]
        else:
            rest.append((op, child))
            op = ""
    return expr.Compare(c[0], tuple(rest), across(c[0], c[-1]))


def binary(c: Children) -> expr.Binary:
    left, op, right = c
    return expr.Binary(op[1], left, right, across(left, right))


def attribute(c: Children) -> expr.Attribute:
    value = c[0]
    _, text, line, column = c[2]
    end = column + len(text)
    span = value.span
    return expr.Attribute(value, text, Span(line, column, line, end), Span(span.line, span.column, line, end))


def primed(c: Children) -> expr.Primed:
    return expr.Primed(c[0], reach(c[0], c[1]))


def index(c: Children) -> expr.Index:
    return expr.Index(c[0], c[2], reach(c[0], c[3]))


def slice_(c: Children) -> expr.Slice:
    start = c[2] if type(c[2]) is not tuple else None
    stop = c[-2] if type(c[-2]) is not tuple else None
    return expr.Slice(c[0], start, stop, reach(c[0], c[-1]))


def call(c: Children) -> expr.Call:
    return expr.Call(c[0], nodes(c[1:]), reach(c[0], c[-1]))


def keyword(c: Children) -> expr.Keyword:
    return expr.Keyword(c[0][1], c[2], token_span(c[0]))


def name(c: Children) -> expr.Name:
    _, text, line, column = c[0]
    return expr.Name(text, Span(line, column, line, column + len(text)))


def integer(c: Children) -> expr.Literal:
    _, text, line, column = c[0]
    if len(text) < 19 and (text[0] != "0" or text == "0"):
        return expr.Literal(int(text), Span(line, column, line, column + len(text)))
    digits = text.lstrip("0") or "0"
    value = int(digits) if len(digits) < 20 else 2**63
    if value >= 2**63:
        help = f"an int has 64 bits: at most {2**63 - 1}"
        raise refused("K009", f"{_shown(digits)} is too large for an int", token_span(c[0]), help)
    if len(text) > 1 and text[0] == "0":
        raise refused("K001", f"a number does not begin with 0: {_shown(text)}", token_span(c[0]), f"write {value}")
    return expr.Literal(value, token_span(c[0]))


def real(c: Children) -> expr.Literal:
    value = float(c[0][1])
    if value == float("inf"):
        help = "a float is at most about 1.8e308"
        raise refused("K009", f"{_shown(c[0][1])} is too large for a float", token_span(c[0]), help)
    return expr.Literal(value, token_span(c[0]))


def string(c: Children) -> expr.Literal:
    _, text, line, column = c[0]
    for escape in _ESCAPE.finditer(text, 1, len(text) - 1):
        if escape[0] not in _ESCAPES:
            start = column + escape.start()
            help = "the escapes are \\\" \\' \\\\ \\n \\t"
            raise refused("K001", f"'{escape[0]}' is no escape", Span(line, start, line, start + 2), help)
    return expr.Literal(_ESCAPE.sub(lambda escape: _ESCAPES[escape[0]], text[1:-1]), token_span(c[0]))


def boolean(c: Children) -> expr.Literal:
    return expr.Literal(c[0][1] == "True", token_span(c[0]))


def group(c: Children) -> expr.Expr:
    """Parentheses leave no node; what they enclose now spans them."""
    node: expr.Expr = replace(c[1], span=reach(c[0], c[2]))
    return node


def tuple_(c: Children) -> expr.Tuple:
    items = nodes(c)
    if len(items) < 2:
        help = "parentheses need no comma inside"
        raise refused("K001", "a tuple has two items at least", reach(c[0], c[-1]), help)
    return expr.Tuple(items, reach(c[0], c[-1]))


def list_(c: Children) -> expr.ListDisplay:
    return expr.ListDisplay(nodes(c), reach(c[0], c[-1]))


def set_(c: Children) -> expr.SetDisplay:
    return expr.SetDisplay(nodes(c), reach(c[0], c[-1]))


def map_(c: Children) -> expr.MapDisplay:
    items = nodes(c)
    return expr.MapDisplay(tuple(zip(items[::2], items[1::2], strict=True)), reach(c[0], c[-1]))


def _shown(text: str) -> str:
    return text if len(text) <= 30 else f"{text[:12]}... ({len(text)} digits)"
