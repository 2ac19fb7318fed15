"""Spellings of the 2020 dialect in expressions and statements.

Each old spelling is reported with the edits that modernise it, and has the meaning of its modern form. A name that the
program itself declares does not count as an old spelling.
"""

from __future__ import annotations

from koordgen.lang.check.context import Context
from koordgen.lang.diagnostics import Edit
from koordgen.lang.source import Span
from koordgen.lang.syntax import expr as ast
from koordgen.lang.syntax import stmt as tree

VALUES = {"true": "True", "false": "False", "numAgents": "N_SYS", "numBots": "N_SYS"}
FUNCTIONS = {"pos3d": "Point", "midpoint": "(p + q) / 2"}


def old_name(node: ast.Name, c: Context) -> ast.Expr:
    """Return the modern form of a value's name in the 2020 dialect, such as `true` or `numAgents`."""
    new = VALUES[node.name]
    c.report_old_spelling(node.name, new, node.span)
    return ast.Name(new, node.span) if new == "N_SYS" else ast.Literal(new == "True", node.span)


def modern_not(node: ast.Unary, c: Context) -> None:
    span = node.span
    mark = Span(span.line, span.column, span.line, span.column + 1)
    spaced = c.source.line(span.line)[span.column : span.column + 1] == " "
    c.report_old_spelling("!", "not", mark, (Edit(mark, "not" if spaced else "not "),))


def modern_logic(node: ast.Logic, c: Context) -> str:
    """Return the modern form of an operator: `and` for `&&`, `or` for `||`."""
    if node.op == "and" or node.op == "or":
        return node.op
    new = "and" if node.op == "&&" else "or"
    line, span = c.source.line(node.op_span.line), node.op_span
    before = "" if line[span.column - 2 : span.column - 1] == " " else " "
    after = "" if line[span.end_column - 1 : span.end_column] in ("", " ") else " "
    c.report_old_spelling(node.op, new, span, (Edit(span, f"{before}{new}{after}"),))
    return new


def old_call(node: ast.Call, name: ast.Name, c: Context) -> ast.Expr | None:
    """Return the modern form of a call of `pos3d` or `midpoint`, functions of the 2020 dialect.

    Returns None if the function does not take the arguments of the call.
    """
    if any(isinstance(arg, ast.Keyword) for arg in node.args):
        return None
    if name.name == "pos3d":
        c.report_old_spelling("pos3d", "Point", name.span)
        return ast.Call(ast.Name("Point", name.span), node.args, node.span)
    if len(node.args) != 2:
        return None
    first, second = node.args
    assert not isinstance(first, ast.Keyword) and not isinstance(second, ast.Keyword)
    edits = (
        Edit(Span(*_start(name.span), *_start(first.span)), f"(({_open(first)}"),
        Edit(_between(first.span, second.span), f"{_close(first)} + {_open(second)}"),
        Edit(_between(second.span, _end(node.span)), f"{_close(second)}) / 2)"),
    )
    c.report_old_spelling("midpoint(p, q)", "(p + q) / 2", name.span, edits)
    total = ast.Binary("+", first, second, node.span)
    return ast.Binary("/", total, ast.Literal(2, node.span), node.span)


def old_for(node: tree.CountedFor, c: Context) -> tree.For:
    """Return the modern form of `for i = a, b:`, which is `for i in range(a, b + 1):`."""
    edits = [Edit(_between(node.name.span, node.first.span), " in range(")]
    if _binds_loosely(node.last):
        edits.append(Edit(Span(*_start(node.last.span), *_start(node.last.span)), "("))
    edits.append(Edit(_end(node.last.span), f"{_close(node.last)} + 1)"))
    span = node.span
    c.report_old_spelling("for i = a, b", "for i in range(a, b + 1)", span, tuple(edits))
    last = node.last
    stop = ast.Binary("+", last, ast.Literal(1, last.span), last.span)
    values = ast.Call(ast.Name("range", node.first.span), (node.first, stop), node.first.span)
    return tree.For((node.name,), values, node.block, span)


def _start(span: Span) -> tuple[int, int]:
    return span.line, span.column


def _end(span: Span) -> Span:
    """Return the empty span at the end of a span, where an edit can insert text."""
    return Span(span.end_line, span.end_column, span.end_line, span.end_column)


def _between(first: Span, second: Span) -> Span:
    return Span(first.end_line, first.end_column, *_start(second))


def _binds_loosely(node: ast.Expr) -> bool:
    """Return whether an expression binds less tightly than `+`, so that it needs parentheses as operand of `+`."""
    return isinstance(node, (ast.Conditional, ast.Logic, ast.Compare, ast.Quantified)) or (
        isinstance(node, (ast.Unary, ast.Binary)) and node.op in ("not", "!", "<<")
    )


def _open(node: ast.Expr) -> str:
    return "(" if _binds_loosely(node) else ""


def _close(node: ast.Expr) -> str:
    return ")" if _binds_loosely(node) else ""
