"""The nodes of what recover.py has put in the place of what cannot be read. See build.py.

The token BROKEN is longer than others: `("BROKEN", name, line, column, names, span)`, where `name` is the one that a
declaration was to declare, as far as one can tell, and `names` are all that stand there.
"""

from __future__ import annotations

from koordgen.syntax import decl, expr, types
from koordgen.syntax.build_base import Children


def broken(c: Children) -> expr.Broken:
    return expr.Broken(c[0][4], c[0][5])


def broken_variable(c: Children) -> decl.Variable:
    _, name, _, _, _, span = c[0]
    return decl.Variable(types.BrokenType(span), name, None, (), broken(c), span)


def broken_port(c: Children) -> decl.Port:
    _, name, _, _, _, span = c[0]
    return decl.Port(types.BrokenType(span), name, span)


def broken_bare_port(c: Children) -> decl.Ports:
    port = broken_port(c)
    return decl.Ports("", (port,), port.span)
