"""Walks over trees of the IR."""

from __future__ import annotations

from collections.abc import Iterator

from koordgen.node import Node
from koordgen.source import Span


def nodes(node: object) -> Iterator[Node]:
    """All nodes of a tree."""
    if isinstance(node, tuple):
        for part in node:
            yield from nodes(part)
    elif isinstance(node, Node) and not isinstance(node, Span):
        yield node
        for field in type(node).__match_args__:  # type: ignore[attr-defined]
            if field not in ("type", "span"):
                yield from nodes(getattr(node, field))
