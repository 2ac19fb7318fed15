"""Walks over trees of the IR."""

from __future__ import annotations

from collections.abc import Iterator

from koordgen.lang.node import Node
from koordgen.lang.source import Span

_FIELDS: dict[type, tuple[str, ...]] = {}  # of a class of nodes, last first


def nodes(node: object) -> Iterator[Node]:
    """All nodes of a tree, each before those within it."""
    pending = [node]
    while pending:
        node = pending.pop()
        if type(node) is tuple:
            pending += node[::-1]
        elif isinstance(node, Node) and type(node) is not Span:
            yield node
            pending += [getattr(node, field) for field in _FIELDS.get(type(node)) or _fields(type(node))]


def _fields(kind: type) -> tuple[str, ...]:
    names = kind.__match_args__[::-1]  # type: ignore[attr-defined]
    return _FIELDS.setdefault(kind, tuple([name for name in names if name not in ("type", "span")]))
