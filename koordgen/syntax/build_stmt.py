"""The nodes of statements. See build.py."""

from __future__ import annotations

from koordgen.syntax import expr, stmt
from koordgen.syntax.build_base import Children, across, nodes, reach, refused, token_span
from koordgen.syntax.build_expr import names
from koordgen.syntax.build_type import as_type

MOST_ELIFS = 100  # each becomes an `if` inside the `else` before it


def block(c: Children) -> stmt.Block:
    return nodes(c)


def if_(c: Children) -> stmt.If:
    first = stmt.Branch(c[1], c[3], reach(c[0], c[1]))
    orelse: stmt.Block = c[-1] if len(c) > 4 and type(c[-1]) is tuple else ()
    elifs = tuple(b for b in c[4:] if type(b) is stmt.Branch)
    if len(elifs) > MOST_ELIFS:
        message = f"more than {MOST_ELIFS} 'elif' follow one 'if'"
        raise refused("K007", message, elifs[MOST_ELIFS].span, "split the chain")
    return stmt.If((first, *elifs), orelse, first.span)


def elif_(c: Children) -> stmt.Branch:
    return stmt.Branch(c[1], c[3], reach(c[0], c[1]))


def else_(c: Children) -> stmt.Block:
    block: stmt.Block = c[2]
    return block


def atomic_(c: Children) -> stmt.Atomic:
    return stmt.Atomic(c[2], token_span(c[0]))


def for_(c: Children) -> stmt.For:
    return stmt.For(names(c[1:-4]), c[-3], c[-1], reach(c[0], c[-3]))


def counted_for(c: Children) -> stmt.CountedFor:
    return stmt.CountedFor(expr.Name(c[1][1], token_span(c[1])), c[3], c[5], c[7], reach(c[0], c[5]))


def while_(c: Children) -> stmt.While:
    return stmt.While(c[1], c[3], reach(c[0], c[1]))


def assign(c: Children) -> stmt.Assign:
    target, mark, value = c
    return stmt.Assign(target, mark[1][:-1], value, across(target, value))


def declare(c: Children) -> stmt.Declare:
    value = c[3] if len(c) == 4 else None
    return stmt.Declare(as_type(c[0]), c[1][1], token_span(c[1]), value, reach(c[0], c[-1]))


def evaluate(c: Children) -> stmt.Evaluate | stmt.BrokenStmt:
    if type(c[0]) is expr.Broken:
        return stmt.BrokenStmt(c[0].names, c[0].span)
    return stmt.Evaluate(c[0], c[0].span)


def return_(c: Children) -> stmt.Return:
    return stmt.Return(c[1], reach(c[0], c[1]))


def break_(c: Children) -> stmt.Break:
    return stmt.Break(token_span(c[0]))


def continue_(c: Children) -> stmt.Continue:
    return stmt.Continue(token_span(c[0]))


def pass_(c: Children) -> stmt.Pass:
    return stmt.Pass(token_span(c[0]))


def stop_(c: Children) -> stmt.Stop:
    return stmt.Stop(token_span(c[0]))


def loop_invariant(c: Children) -> stmt.Invariant:
    return stmt.Invariant(c[1], reach(c[0], c[1]))
