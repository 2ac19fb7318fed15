"""Printer of syntax trees, one node a line, for `koordgen dump --after parse`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from koordgen.lang.node import Node

_PLACES = ("span", "name_span", "op_span", "def_span")


def show(tree: Node) -> str:
    """Return a tree as text: each node with its line and column, its children below it, two spaces deeper."""
    lines: list[str] = []
    pending: list[tuple[Any, int, str]] = [(tree, 0, "")]
    while pending:
        node, depth, role = pending.pop()
        fields = [(f, getattr(node, f)) for f in type(node).__match_args__ if f not in _PLACES]
        children = [(child, depth + 1, role) for f, value in fields for child, role in _children(value, f)]
        plain = [f"{f}={value!r}" for f, value in fields if value not in (None, ()) and not any(_children(value, f))]
        span = getattr(node, "span", None)
        place = f"  @{span.line}:{span.column}" if span is not None else ""
        lines.append(f"{'  ' * depth}{role}{type(node).__name__}({', '.join(plain)}){place}")
        pending.extend(reversed(children))
    return "\n".join(lines) + "\n"


def _children(value: Any, field: str) -> Iterator[tuple[Node, str]]:
    """Yield the nodes in a field, each with its role.

    Fields without nodes are shown on their parent's line.
    """
    if isinstance(value, Node):
        yield value, f"{field}: "
    elif isinstance(value, tuple):
        for item in value:
            match item:
                case Node():
                    yield item, f"{field}: "
                case (Node() as key, Node() as entry):
                    yield key, f"{field}, key: "
                    yield entry, f"{field}, value: "
                case (str() as op, Node() as operand):
                    yield operand, f"{field} {op} "
