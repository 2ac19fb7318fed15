"""Builders of syntax tree nodes: one function for each grammar rule, called with the rule's children.

The functions are named like the rules of koord.lark; lr.py looks them up here. They reject errors that the grammar
cannot express: invalid numbers and escapes, a tuple with one item, a chain that is too long, an expression in place of
a type.
"""

from __future__ import annotations

import re
from itertools import pairwise
from typing import Any

from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.node import replace
from koordgen.lang.source import Span
from koordgen.lang.syntax import decl, expr, stmt, types

Children = list[Any]  # tokens (tuples of four), nodes, and blocks (tuples of statements)


class BuilderError(Exception):
    """A builder rejected the children of its rule."""

    def __init__(self, diagnostic: Diagnostic) -> None:
        super().__init__(diagnostic.message)
        self.diagnostic = diagnostic


def builder_error(code: str, message: str, span: Span, help: str = "") -> BuilderError:
    """Make an exception to raise, with an error at `span`."""
    return BuilderError(Diagnostic(code, "error", message, span, help=help))


def token_span(token: tuple[str, str, int, int]) -> Span:
    """Return the span of a token."""
    _, text, line, column = token
    return Span(line, column, line, column + len(text))


def span_across(first: Any, last: Any) -> Span:
    """Return the span from the beginning of one token or node to the end of another."""
    if first.__class__ is tuple:
        line, column = first[2], first[3]
    else:
        start = first.span
        line, column = start.line, start.column
    if last.__class__ is tuple:
        return Span(line, column, last[2], last[3] + len(last[1]))
    end = last.span
    return Span(line, column, end.end_line, end.end_column)


def span_of_nodes(first: Any, last: Any) -> Span:
    """Return the span from the beginning of one node to the end of another."""
    start, end = first.span, last.span
    return Span(start.line, start.column, end.end_line, end.end_column)


def nodes(children: Children) -> tuple[Any, ...]:
    """Return the children that are neither tokens nor blocks."""
    return tuple([c for c in children if c.__class__ is not tuple])


def using_(c: Children) -> decl.Using:
    return decl.Using(c[1][1], nodes(c), span_across(c[0], c[1]))


def ports(c: Children) -> decl.Ports:
    return decl.Ports("sensor" if c[0][1] == "sensors" else "actuator", nodes(c), token_span(c[0]))


def port(c: Children) -> decl.Port:
    return decl.Port(c[0], c[1][1], nodes(c[2:]), token_span(c[1]))


def position_mark(c: Children) -> decl.Mark:
    return decl.Mark("as", c[1][1], token_span(c[1]))


def held_mark(c: Children) -> decl.Mark:
    return decl.Mark("at", c[1][1], token_span(c[1]))


def clears_mark(c: Children) -> decl.Mark:
    return decl.Mark("clears", c[1][1], token_span(c[1]))


def bare_port(c: Children) -> decl.Ports:
    alone = port(c)
    return decl.Ports("", (alone,), alone.span)


def assume_(c: Children) -> decl.Assume:
    return decl.Assume(c[1], token_span(c[0]))


def param_(c: Children) -> decl.Param:
    capacities, default = _optional(c[3:])
    return decl.Param(c[1], c[2][1], capacities, default, token_span(c[2]))


def variables(c: Children) -> decl.Variables:
    return decl.Variables(c[0][1], nodes(c), token_span(c[0]))


def variable(c: Children) -> decl.Variable:
    capacities, initial = _optional(c[2:])
    return decl.Variable(c[0], c[1][1], None, capacities, initial, token_span(c[1]))


def array(c: Children) -> decl.Variable:
    capacities, initial = _optional(c[5:])
    return decl.Variable(c[0], c[1][1], c[3], capacities, initial, token_span(c[1]))


def _optional(c: Children) -> tuple[tuple[Any, ...], Any]:
    """Return the capacities and the initial value from the children after a variable's name and size."""
    found = nodes(c)
    if any(type(child) is tuple and child[0] == "=" for child in c):
        return found[:-1], found[-1]
    return found, None


def export_(c: Children) -> decl.Export:
    return decl.Export(nodes(c), token_span(c[0]))


def exported(c: Children) -> decl.Exported:
    is_written, c = _is_written(c)
    return decl.Exported(c[0], c[1][1], None, is_written, _guarantees(c), token_span(c[1]))


def exported_array(c: Children) -> decl.Exported:
    return decl.Exported(c[0], c[1][1], c[3], False, _guarantees(c), token_span(c[1]))


def _guarantees(c: Children) -> tuple[decl.Guarantee, ...]:
    return tuple([child for child in c if type(child) is decl.Guarantee])


def guarantee_(c: Children) -> decl.Guarantee:
    return decl.Guarantee(c[1][1], nodes(c)[0], token_span(c[1]))


def import_(c: Children) -> decl.Import:
    return decl.Import(c[1][1], nodes(c), token_span(c[1]))


def imported(c: Children) -> decl.Imported:
    is_written, c = _is_written(c)
    return decl.Imported(c[0], c[1][1], None, nodes(c[2:]), is_written, token_span(c[1]))


def imported_array(c: Children) -> decl.Imported:
    return decl.Imported(c[0], c[1][1], c[3], nodes(c[5:]), False, token_span(c[1]))


def provides_(c: Children) -> decl.Provides:
    return decl.Provides(c[1][1], nodes(c), span_across(c[0], c[1]))


def provided_ports(c: Children) -> decl.ProvidedPorts:
    return decl.ProvidedPorts("sensor" if c[0][1] == "sensors" else "actuator", nodes(c), token_span(c[0]))


def provided(c: Children) -> decl.Provided:
    *marks, value = nodes(c[2:])
    return decl.Provided(c[0], c[1][1], tuple(marks), value, token_span(c[1]))


def _is_written(c: Children) -> tuple[bool, Children]:
    """Return whether the children of an exported or imported variable begin with `write`, and the others."""
    is_written = type(c[0]) is tuple
    return is_written, c[1:] if is_written else c


def record(c: Children) -> decl.RecordDef:
    return decl.RecordDef(c[1][1], nodes(c), token_span(c[1]))


def function(c: Children) -> decl.Function:
    return decl.Function(c[1][1], _parameters(c), c[-3], c[-1], None, token_span(c[1]))


def old_function(c: Children) -> decl.Function:
    return decl.Function(c[2][1], _parameters(c), _result(c), c[-1], token_span(c[0]), token_span(c[2]))


def extern_function(c: Children) -> decl.ExternFunction:
    contracts = tuple(child for child in c if type(child) is decl.Contract)
    return decl.ExternFunction(c[2][1], _parameters(c), _result(c), contracts, token_span(c[2]))


def extern_type(c: Children) -> decl.ExternType:
    return decl.ExternType(c[2][1], token_span(c[2]))


def spec_function(c: Children) -> decl.SpecFunction:
    return decl.SpecFunction(c[2][1], _parameters(c), _result(c), token_span(c[2]))


def contract(c: Children) -> decl.Contract:
    return decl.Contract(c[0][1], nodes(c)[0], token_span(c[0]))


def parameter(c: Children) -> decl.Parameter:
    return decl.Parameter(c[0], c[1][1], c[3] if len(c) == 5 else None, token_span(c[1]))


def _parameters(c: Children) -> tuple[decl.Parameter, ...]:
    return tuple(child for child in c if type(child) is decl.Parameter)


def _result(c: Children) -> Any:
    """Return the type after `->`, or None."""
    for mark, node in pairwise(c):
        if type(mark) is tuple and mark and mark[0] == "->":
            return node
    return None


def property_(c: Children) -> decl.Property:
    head = c[0] if c[1][0] == ":" else c[1]
    return decl.Property(c[0][1], "" if head is c[0] else head[1], nodes(c)[0], token_span(head))


def init_(c: Children) -> decl.Init:
    return decl.Init(c[2], token_span(c[0]))


def event(c: Children) -> decl.Event:
    return decl.Event(c[0][1], nodes(c[2:]), token_span(c[0]))


def priority_(c: Children) -> decl.Priority:
    return decl.Priority(nodes(c), token_span(c[0]))


def guard(c: Children) -> decl.Guard:
    return decl.Guard(nodes(c)[0], token_span(c[0]))


def effect(c: Children) -> decl.Effect:
    return decl.Effect(c[2], token_span(c[0]))


_FOREIGN = frozenset(("let", "var", "const", "auto", "import", "from"))  # `let x = 3` parses as a declaration


def named_type(c: Children) -> types.NamedType:
    return _named(c[0][1], token_span(c[0]))


def _named(name: str, span: Span) -> types.NamedType:
    if name in _FOREIGN:
        from koordgen.lang.syntax.habits import FOREIGN

        raise builder_error("K001", f"Koord has no '{name}'", span, FOREIGN[name])
    return types.NamedType(name, span)


def generic(c: Children) -> types.GenericType:
    return types.GenericType(c[0][1], nodes(c), span_across(c[0], c[-1]))


def tuple_type(c: Children) -> types.TupleType:
    items = tuple(map(as_type, nodes(c)))
    if len(items) < 2:
        raise builder_error("K001", "a tuple type has at least two items", span_across(c[0], c[-1]))
    return types.TupleType(items, span_across(c[0], c[-1]))


def list_type(c: Children) -> types.GenericType:
    return types.GenericType("[]", (as_type(c[0]),), span_across(c[0], c[-1]))


def as_type(node: types.TypeExpr | expr.Expr) -> types.TypeExpr:
    """Convert a node to a type. It was parsed as an expression if its beginning fits both."""
    match node:
        case types.NamedType() | types.GenericType() | types.TupleType() | types.BrokenType():
            return node
        case expr.Name():
            return _named(node.name, node.span)
        case expr.Tuple():
            return types.TupleType(tuple(map(as_type, node.items)), node.span)
        case expr.Broken():
            return types.BrokenType(node.span)
        case _:
            help = "a declaration is a type and a name: int count = 0"
            raise builder_error("K001", "this is not a type", node.span, help)


_ESCAPES = {'\\"': '"', "\\'": "'", "\\\\": "\\", "\\n": "\n", "\\t": "\t"}
_ESCAPE = re.compile(r"\\.")


def conditional(c: Children) -> expr.Conditional:
    return expr.Conditional(c[2], c[0], c[4], span_across(c[0], c[4]))


def logic(c: Children) -> expr.Logic:
    return expr.Logic(c[1][1], token_span(c[1]), c[0], c[2], span_of_nodes(c[0], c[2]))


def quantified(c: Children) -> expr.Quantified:
    domain, body = c[-3], c[-1]
    return expr.Quantified(c[0][1], names(c[1:-4]), domain, body, span_across(c[0], body))


def names(tokens: Children) -> tuple[expr.Name, ...]:
    """Return the names of a list with commas between them."""
    return tuple(expr.Name(token[1], token_span(token)) for token in tokens[::2])


def unary(c: Children) -> expr.Unary:
    return expr.Unary(c[0][1], c[1], span_across(c[0], c[1]))


def compare(c: Children) -> expr.Compare:
    rest: list[tuple[str, expr.Expr]] = []
    op = ""
    for child in c[1:]:
        if child.__class__ is tuple:
            op = f"{op} {child[1]}" if op else child[1]
        else:
            rest.append((op, child))
            op = ""
    return expr.Compare(c[0], tuple(rest), span_of_nodes(c[0], c[-1]))


def binary(c: Children) -> expr.Binary:
    left, op, right = c
    return expr.Binary(op[1], left, right, span_of_nodes(left, right))


def attribute(c: Children) -> expr.Attribute:
    value = c[0]
    _, text, line, column = c[2]
    end = column + len(text)
    span = value.span
    return expr.Attribute(value, text, Span(line, column, line, end), Span(span.line, span.column, line, end))


def primed(c: Children) -> expr.Primed:
    return expr.Primed(c[0], span_across(c[0], c[1]))


def index(c: Children) -> expr.Index:
    return expr.Index(c[0], c[2], span_across(c[0], c[3]))


def slice_(c: Children) -> expr.Slice:
    start = c[2] if type(c[2]) is not tuple else None
    stop = c[-2] if type(c[-2]) is not tuple else None
    return expr.Slice(c[0], start, stop, span_across(c[0], c[-1]))


def call(c: Children) -> expr.Call:
    return expr.Call(c[0], nodes(c[1:]), span_across(c[0], c[-1]))


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
        raise builder_error("K009", f"{_shown(digits)} is too large for an int", token_span(c[0]), help)
    if len(text) > 1 and text[0] == "0":
        raise builder_error(
            "K001", f"a number does not begin with 0: {_shown(text)}", token_span(c[0]), f"write {value}"
        )
    return expr.Literal(value, token_span(c[0]))


def real(c: Children) -> expr.Literal:
    value = float(c[0][1])
    if value == float("inf"):
        help = "a float is at most about 1.8e308"
        raise builder_error("K009", f"{_shown(c[0][1])} is too large for a float", token_span(c[0]), help)
    return expr.Literal(value, token_span(c[0]))


def string(c: Children) -> expr.Literal:
    _, text, line, column = c[0]
    for escape in _ESCAPE.finditer(text, 1, len(text) - 1):
        if escape[0] not in _ESCAPES:
            start = column + escape.start()
            help = "the escapes are \\\" \\' \\\\ \\n \\t"
            raise builder_error(
                "K001", f"'{escape[0]}' is not an escape sequence", Span(line, start, line, start + 2), help
            )
    return expr.Literal(_ESCAPE.sub(lambda escape: _ESCAPES[escape[0]], text[1:-1]), token_span(c[0]))


def boolean(c: Children) -> expr.Literal:
    return expr.Literal(c[0][1] == "True", token_span(c[0]))


def group(c: Children) -> expr.Expr:
    """Return the expression in parentheses, with a span that includes them.

    They have no node of their own.
    """
    node: expr.Expr = replace(c[1], span=span_across(c[0], c[2]))
    return node


def tuple_(c: Children) -> expr.Tuple:
    items = nodes(c)
    if len(items) < 2:
        help = "parentheses need no comma inside"
        raise builder_error("K001", "a tuple has at least two items", span_across(c[0], c[-1]), help)
    return expr.Tuple(items, span_across(c[0], c[-1]))


def list_(c: Children) -> expr.ListDisplay:
    return expr.ListDisplay(nodes(c), span_across(c[0], c[-1]))


def set_(c: Children) -> expr.SetDisplay:
    return expr.SetDisplay(nodes(c), span_across(c[0], c[-1]))


def map_(c: Children) -> expr.MapDisplay:
    items = nodes(c)
    return expr.MapDisplay(tuple(zip(items[::2], items[1::2], strict=True)), span_across(c[0], c[-1]))


def _shown(text: str) -> str:
    return text if len(text) <= 30 else f"{text[:12]}... ({len(text)} digits)"


MOST_ELIFS = 100  # each becomes a nested `if` in the `else` of the one before


def block(c: Children) -> stmt.Block:
    return nodes(c)


def if_(c: Children) -> stmt.If:
    first = stmt.Branch(c[1], c[3], span_across(c[0], c[1]))
    orelse: stmt.Block = c[-1] if len(c) > 4 and type(c[-1]) is tuple else ()
    elifs = tuple(b for b in c[4:] if type(b) is stmt.Branch)
    if len(elifs) > MOST_ELIFS:
        message = f"more than {MOST_ELIFS} 'elif' follow one 'if'"
        raise builder_error("K007", message, elifs[MOST_ELIFS].span, "split the chain")
    return stmt.If((first, *elifs), orelse, first.span)


def elif_(c: Children) -> stmt.Branch:
    return stmt.Branch(c[1], c[3], span_across(c[0], c[1]))


def else_(c: Children) -> stmt.Block:
    block: stmt.Block = c[2]
    return block


def atomic_(c: Children) -> stmt.Atomic:
    return stmt.Atomic(c[2], token_span(c[0]))


def for_(c: Children) -> stmt.For:
    return stmt.For(names(c[1:-4]), c[-3], c[-1], span_across(c[0], c[-3]))


def counted_for(c: Children) -> stmt.CountedFor:
    return stmt.CountedFor(expr.Name(c[1][1], token_span(c[1])), c[3], c[5], c[7], span_across(c[0], c[5]))


def while_(c: Children) -> stmt.While:
    return stmt.While(c[1], c[3], span_across(c[0], c[1]))


def assign(c: Children) -> stmt.Assign:
    target, mark, value = c
    return stmt.Assign(target, mark[1][:-1], value, span_of_nodes(target, value))


def declare(c: Children) -> stmt.Declare:
    value = c[3] if len(c) == 4 else None
    return stmt.Declare(as_type(c[0]), c[1][1], token_span(c[1]), value, span_across(c[0], c[-1]))


def evaluate(c: Children) -> stmt.Evaluate | stmt.BrokenStmt:
    if type(c[0]) is expr.Broken:
        return stmt.BrokenStmt(c[0].names, c[0].span)
    return stmt.Evaluate(c[0], c[0].span)


def return_(c: Children) -> stmt.Return:
    return stmt.Return(c[1], span_across(c[0], c[1]))


def break_(c: Children) -> stmt.Break:
    return stmt.Break(token_span(c[0]))


def continue_(c: Children) -> stmt.Continue:
    return stmt.Continue(token_span(c[0]))


def pass_(c: Children) -> stmt.Pass:
    return stmt.Pass(token_span(c[0]))


def stop_(c: Children) -> stmt.Stop:
    return stmt.Stop(token_span(c[0]))


def loop_invariant(c: Children) -> stmt.Invariant:
    return stmt.Invariant(c[1], span_across(c[0], c[1]))


def broken(c: Children) -> expr.Broken:
    return expr.Broken(c[0][4], c[0][5])


def broken_variable(c: Children) -> decl.Variable:
    _, name, _, _, _, span = c[0]
    return decl.Variable(types.BrokenType(span), name, None, (), broken(c), span)


def broken_exported(c: Children) -> decl.Exported:
    _, name, _, _, _, span = c[0]
    return decl.Exported(types.BrokenType(span), name, broken(c), False, (), span)


def broken_imported(c: Children) -> decl.Imported:
    _, name, _, _, _, span = c[0]
    return decl.Imported(types.BrokenType(span), name, broken(c), (), False, span)


def broken_provided(c: Children) -> decl.Provided:
    _, name, _, _, _, span = c[0]
    return decl.Provided(types.BrokenType(span), name, (), broken(c), span)


def broken_port(c: Children) -> decl.Port:
    _, name, _, _, _, span = c[0]
    return decl.Port(types.BrokenType(span), name, (), span)


def broken_bare_port(c: Children) -> decl.Ports:
    port = broken_port(c)
    return decl.Ports("", (port,), port.span)
