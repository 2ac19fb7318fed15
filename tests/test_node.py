"""Nodes: only slots, equality without places, copies."""

from __future__ import annotations

import pytest

from koordgen.lang.node import Node, replace
from koordgen.lang.source import Span


class Leaf(Node):
    name: str
    span: Span | None = None


class Twin(Node):
    name: str
    span: Span | None = None


def test_nodes_hold_their_fields_and_no_others() -> None:
    leaf = Leaf("a")
    assert (leaf.name, leaf.span) == ("a", None) and Leaf.__match_args__ == ("name", "span")
    with pytest.raises(AttributeError):
        leaf.other = 1  # type: ignore[attr-defined]
    with pytest.raises(TypeError):
        Leaf()  # type: ignore[call-arg]


def test_places_and_classes_in_comparisons() -> None:
    placed = Leaf("a", Span(1, 2, 3, 4))
    assert placed == Leaf("a") and hash(placed) == hash(Leaf("a"))
    assert placed != Leaf("b") and placed != Twin("a")
    assert replace(placed, name="b") == Leaf("b") and replace(placed, name="b").span is placed.span
