"""Syntax tree -> text, one node a line, for `koordgen dump --after parse`."""

from __future__ import annotations

from typing import Any

from koordgen.node import Node

_PLACES = ("span", "name_span", "op_span", "def_span")


def show(tree: Node) -> str:
    """Every node with its line and column; children stand below it, two spaces deeper."""
    lines: list[str] = []
    pending: list[tuple[Any, int, str]] = [(tree, 0, "")]
    while pending:
        node, depth, role = pending.pop()
        fields = [(f, getattr(node, f)) for f in type(node).__match_args__ if f not in _PLACES]
        plain = [f"{f}={value!r}" for f, value in fields if not isinstance(value, (Node, tuple)) and value is not None]
        span = getattr(node, "span", None)
        place = f"  @{span.line}:{span.column}" if span is not None else ""
        lines.append(f"{'  ' * depth}{role}{type(node).__name__}({', '.join(plain)}){place}")
        children: list[tuple[Any, int, str]] = []
        for field, value in fields:
            if isinstance(value, Node):
                children.append((value, depth + 1, f"{field}: "))
            elif isinstance(value, tuple):
                children.extend(_elements(value, depth + 1, field))
        pending.extend(reversed(children))
    return "\n".join(lines) + "\n"


def _elements(values: tuple[Any, ...], depth: int, field: str) -> list[tuple[Any, int, str]]:
    return [
        (value, depth, f"{field}: ") if isinstance(value, Node) else (value[1], depth, f"{field} {value[0]} ")
        for value in values
    ]
