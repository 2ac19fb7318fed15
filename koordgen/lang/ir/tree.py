"""Walks over trees of the IR: `children`, `walk`, `statements`, `map_children`, `transform`.

A child is a node of the program in a field of another one: an expression, a statement, a target, a declaration. Types,
meanings of ports and spans are not children and have none.

The order is that of the fields. It is the order of the text except for a Conditional, whose condition comes before
`then`, and for loops, whose invariants come after the block.

Annotations determine which fields of a class have children; they are read once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter
from typing import Any, TypeVar, assert_never

from koordgen.lang.ir import draft, stmt
from koordgen.lang.node import Node, replace

Part = Node | tuple["Part", ...]  # a node, or a tuple of parts: a block, formulas, a guard and its effect
N = TypeVar("N", bound=Node)
_Children = Callable[[Any], tuple[Node, ...]]

_IR = "koordgen.lang.ir."
_NO_CHILDREN = frozenset(("Span", "Type", "RecordType", "Meaning", "Literal", "None"))  # words in annotations


def children(node: Node) -> tuple[Node, ...]:
    """Return the children of a node, in the order of the fields.

    Raises TypeError for a node outside of the IR.
    """
    return _CHILDREN[type(node)](node)


def walk(part: Part) -> Iterator[Node]:
    """Yield a node, or all nodes of a tuple, and all nodes below: depth first, each before its children."""
    pending: list[Part] = [part]
    while pending:
        part = pending.pop()
        if type(part) is tuple:
            pending += part[::-1]
        else:
            yield part  # type: ignore[misc]
            below = _CHILDREN[type(part)](part)  # type: ignore[index]
            if below:
                pending += below[::-1]


def statements(block: Sequence[draft.Draft]) -> Iterator[stmt.Stmt]:
    """Yield the statements of a block and of its inner blocks, in the order of the text.

    Expressions are not walked. Drafts are left out.
    """
    pending = list(block[::-1])
    while pending:
        statement = pending.pop()
        if isinstance(statement, (draft.Atomic, draft.UnparsedStmt, draft.WrongStmt)):
            continue
        yield statement
        match statement:
            case stmt.If(_, then, orelse):
                pending += orelse[::-1]
                pending += then[::-1]
            case stmt.For() | stmt.While():
                pending += statement.block[::-1]
            case (
                stmt.Assign() | stmt.Let() | stmt.Emit() | stmt.Break() | stmt.Continue() | stmt.Return() | stmt.Stop()
            ):
                pass
            case _:
                assert_never(statement)


def map_children(node: N, function: Callable[[Any], Node]) -> N:
    """Return a node with `function` applied to each of its children, in their order.

    All other fields are kept, the span included. If no child changes, the same node is returned.
    """
    changes: dict[str, object] = {}
    for field in child_fields(type(node)):
        old = getattr(node, field)
        if type(old) is tuple:
            new: Any = tuple([function(child) for child in old])
            changed = any(a is not b for a, b in zip(old, new, strict=True))
        else:
            new = None if old is None else function(old)
            changed = new is not old
        if changed:
            changes[field] = new
    return replace(node, **changes) if changes else node


def transform(node: Node, function: Callable[[Any], Node]) -> Node:
    """Return a tree with `function` applied to every node, from the leaves up.

    `function` gets each node with its children already replaced. Subtrees without changes are not copied.
    """
    return function(map_children(node, lambda child: transform(child, function)))


def child_fields(kind: type[Node]) -> tuple[str, ...]:
    """Return the names of a class's fields that hold children: one child, a tuple of children, or None.

    Raises TypeError for a class outside of the IR.
    """
    found = _FIELDS.get(kind)
    if found is None:
        if not kind.__module__.startswith(_IR):
            raise TypeError(f"{kind.__name__} is not a node of the IR")
        annotations = kind.__annotations__
        found = _FIELDS[kind] = tuple([field for field in annotations if _has_children(annotations[field])])
    return found


def _has_children(annotation: str) -> bool:
    words = annotation.replace("[", " ").replace("]", " ").replace(",", " ").split()
    return any(word[0].isupper() and word not in _NO_CHILDREN for word in words)


def _getter(kind: type[Node]) -> _Children:
    """Return a function that returns the children of nodes of a class.

    It is a plain `attrgetter` where possible.
    """
    fields = child_fields(kind)
    if not fields:
        return lambda node: ()
    get: Callable[[Any], Any] = attrgetter(*fields)
    several = [kind.__annotations__[field].startswith(("tuple", "Block")) for field in fields]
    if len(fields) == 1:
        return get if several[0] else lambda node: (get(node),)
    if any(several) or any("None" in kind.__annotations__[field] for field in fields):
        return lambda node: _flat(get(node))
    return get


def _flat(parts: tuple[Node | tuple[Node, ...] | None, ...]) -> tuple[Node, ...]:
    found: list[Node] = []
    for part in parts:
        if type(part) is tuple:
            found += part
        elif part is not None:
            found.append(part)  # type: ignore[arg-type]
    return tuple(found)


class _Getters(dict[type[Node], _Children]):
    """Cache: class of nodes -> function that returns their children, made on demand."""

    def __missing__(self, kind: type[Node]) -> _Children:
        found = self[kind] = _getter(kind)
        return found


_FIELDS: dict[type[Node], tuple[str, ...]] = {}
_CHILDREN = _Getters()
