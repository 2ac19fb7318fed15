"""The nodes that the grammar's rules make: each function gets a rule's children, tokens included.

The names are those of koord.lark; parse.py looks them up here. No function refuses anything but a number
that no machine holds, which it reports.
"""

from __future__ import annotations

from typing import Any

from koordgen.diagnostics import Diagnostic
from koordgen.node import replace
from koordgen.source import Span
from koordgen.syntax import decl, expr, stmt

Children = list[Any]  # of tokens (tuples of four), nodes, and blocks (tuples of statements)

MOST_ELIFS = 100  # each becomes an `if` inside the `else` before it


class Refused(Exception):
    """A rule whose children cannot be accepted."""

    def __init__(self, diagnostic: Diagnostic) -> None:
        super().__init__(diagnostic.message)
        self.diagnostic = diagnostic


def token_span(token: tuple[str, str, int, int]) -> Span:
    """Where a token stands."""
    _, text, line, column = token
    return Span(line, column, line, column + len(text))


def _span(first: Any, last: Any) -> Span:
    if type(first) is tuple:
        line, column = first[2], first[3]
    else:
        line, column = first.span.line, first.span.column
    if type(last) is tuple:
        return Span(line, column, last[2], last[3] + len(last[1]))
    return Span(line, column, last.span.end_line, last.span.end_column)


def _nodes(children: Children) -> tuple[Any, ...]:
    return tuple(c for c in children if type(c) is not tuple)


# Declarations


def using_(c: Children) -> decl.Using:
    return decl.Using(c[1][1], _nodes(c), _span(c[0], c[1]))


def ports(c: Children) -> decl.Ports:
    return decl.Ports("sensor" if c[0][1] == "sensors" else "actuator", _nodes(c), token_span(c[0]))


def port(c: Children) -> decl.Port:
    return decl.Port(c[0][1], token_span(c[0]), c[1][1], token_span(c[1]))


def param_(c: Children) -> decl.Param:
    return decl.Param(c[1][1], token_span(c[1]), c[2][1], c[4], token_span(c[2]))


def variables(c: Children) -> decl.Variables:
    return decl.Variables(c[0][1], _nodes(c), token_span(c[0]))


def variable(c: Children) -> decl.Variable:
    initial = c[3] if len(c) == 5 else None
    return decl.Variable(c[0][1], token_span(c[0]), c[1][1], None, initial, token_span(c[1]))


def array(c: Children) -> decl.Variable:
    initial = c[6] if len(c) == 8 else None
    return decl.Variable(c[0][1], token_span(c[0]), c[1][1], c[3], initial, token_span(c[1]))


def init_(c: Children) -> decl.Init:
    return decl.Init(c[2], token_span(c[0]))


def event(c: Children) -> decl.Event:
    return decl.Event(c[0][1], _nodes(c[2:]), token_span(c[0]))


def guard(c: Children) -> decl.Guard:
    return decl.Guard(c[2], token_span(c[0]))


def deep_guard(c: Children) -> decl.Guard:
    return decl.Guard(c[4], token_span(c[0]))


def effect(c: Children) -> decl.Effect:
    return decl.Effect(c[2], token_span(c[0]))


# Statements


def block(c: Children) -> stmt.Block:
    return _nodes(c)


def if_(c: Children) -> stmt.If:
    first = stmt.Branch(c[1], c[3], _span(c[0], c[1]))
    orelse: stmt.Block = c[-1] if len(c) > 4 and type(c[-1]) is tuple else ()
    elifs = tuple(b for b in c[4:] if type(b) is stmt.Branch)
    if len(elifs) > MOST_ELIFS:
        message = f"more than {MOST_ELIFS} 'elif' follow one 'if'"
        raise Refused(Diagnostic("K007", "error", message, elifs[MOST_ELIFS].span, help="split the chain"))
    return stmt.If((first, *elifs), orelse, first.span)


def elif_(c: Children) -> stmt.Branch:
    return stmt.Branch(c[1], c[3], _span(c[0], c[1]))


def else_(c: Children) -> stmt.Block:
    block: stmt.Block = c[2]
    return block


def assign(c: Children) -> stmt.Assign:
    return stmt.Assign(c[0], c[1][1][:-1], c[2], _span(c[0], c[2]))


def declare(c: Children) -> stmt.Declare:
    value = c[3] if len(c) == 4 else None
    return stmt.Declare(c[0][1], token_span(c[0]), c[1][1], token_span(c[1]), value, _span(c[0], c[-1]))


def evaluate(c: Children) -> stmt.Evaluate:
    return stmt.Evaluate(c[0], c[0].span)


def pass_(c: Children) -> stmt.Pass:
    return stmt.Pass(token_span(c[0]))


def stop_(c: Children) -> stmt.Stop:
    return stmt.Stop(token_span(c[0]))


# Expressions


def conditional(c: Children) -> expr.Conditional:
    return expr.Conditional(c[2], c[0], c[4], _span(c[0], c[4]))


def logic(c: Children) -> expr.Logic:
    return expr.Logic(c[1][1], c[0], c[2], _span(c[0], c[2]))


def unary(c: Children) -> expr.Unary:
    return expr.Unary(c[0][1], c[1], _span(c[0], c[1]))


def compare(c: Children) -> expr.Compare:
    rest = tuple((c[i][1], c[i + 1]) for i in range(1, len(c), 2))
    return expr.Compare(c[0], rest, _span(c[0], c[-1]))


def binary(c: Children) -> expr.Binary:
    return expr.Binary(c[1][1], c[0], c[2], _span(c[0], c[2]))


def attribute(c: Children) -> expr.Attribute:
    return expr.Attribute(c[0], c[2][1], token_span(c[2]), _span(c[0], c[2]))


def index(c: Children) -> expr.Index:
    return expr.Index(c[0], c[2], _span(c[0], c[3]))


def call(c: Children) -> expr.Call:
    return expr.Call(c[0], _nodes(c[1:]), _span(c[0], c[-1]))


def name(c: Children) -> expr.Name:
    return expr.Name(c[0][1], token_span(c[0]))


def integer(c: Children) -> expr.Literal:
    text = c[0][1].lstrip("0") or "0"
    value = int(text) if len(text) < 20 else 2**63
    if value >= 2**63:
        help = f"an int has 64 bits: at most {2**63 - 1}"
        raise Refused(
            Diagnostic("K009", "error", f"{_shown(text)} is too large for an int", token_span(c[0]), help=help)
        )
    return expr.Literal(value, token_span(c[0]))


def real(c: Children) -> expr.Literal:
    value = float(c[0][1])
    if value == float("inf"):
        help = "a float is at most about 1.8e308"
        text = _shown(c[0][1])
        raise Refused(Diagnostic("K009", "error", f"{text} is too large for a float", token_span(c[0]), help=help))
    return expr.Literal(value, token_span(c[0]))


def boolean(c: Children) -> expr.Literal:
    return expr.Literal(c[0][1] == "True", token_span(c[0]))


def group(c: Children) -> expr.Expr:
    """Parentheses leave no node; what they enclose now spans them."""
    node: expr.Expr = replace(c[1], span=_span(c[0], c[2]))
    return node


def _shown(text: str) -> str:
    return text if len(text) <= 30 else f"{text[:12]}... ({len(text)} digits)"
