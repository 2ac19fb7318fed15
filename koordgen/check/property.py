"""Properties: what initially holds, what is to hold always, what is known of spec functions."""

from __future__ import annotations

from collections.abc import Iterable

from koordgen.check.base import condition
from koordgen.check.context import Context
from koordgen.check.names import unique
from koordgen.ir import decl
from koordgen.source import Span
from koordgen.syntax import decl as ast


def properties(sections: Iterable[ast.Property], c: Context) -> tuple[decl.Property, ...]:
    """The properties in the order of their writing."""
    found = []
    seen: dict[str, Span] = {}
    for node in sections:
        if node.name:
            unique(node.name, "properties", node.span, seen, c)
        c.enter("property")
        what = f"the {node.kind} {node.name}" if node.name else "what holds initially"
        formula = condition(node.formula, c, what)
        found.append(decl.Property(node.kind, node.name, formula, node.span))
    return tuple(found)
