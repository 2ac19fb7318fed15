"""All nodes of a tree by reflection: what the API of the IR is compared with."""

from __future__ import annotations

from collections.abc import Iterator

from koordgen.lang.node import Node


def nodes(part: object) -> Iterator[Node]:
    """Yield every node of a tree, or of a tuple of trees, each before those within it: types and spans, too."""
    if isinstance(part, Node):
        yield part
        part = tuple([getattr(part, field) for field in type(part).__match_args__])  # type: ignore[attr-defined]
    if type(part) is tuple:
        for inner in part:
            yield from nodes(inner)
