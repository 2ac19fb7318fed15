"""The one way through trees of the IR: `children`, `walk`, `statements`, `map_children`, `transform`.

A child is a node of the program in a field of another one: an expression, a statement, a place that is written, a
declaration. Types, meanings of ports and spans are no children, and have none: they are read where they stand.

The order is that of the fields. It is the order of the text but for a Conditional, whose condition comes before `then`,
and for loops, whose invariants come behind the block.

Which fields of a class have children is read from their annotations, once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter
from typing import Any, TypeVar, assert_never

from koordgen.lang.ir import draft, stmt
from koordgen.lang.node import Node, replace

Part = Node | tuple["Part", ...]  # a node, or a tuple of such: a block, formulas, a guard and its effect
N = TypeVar("N", bound=Node)
_Children = Callable[[Any], tuple[Node, ...]]

_IR = "koordgen.lang.ir."
_NO_CHILDREN = frozenset(("Span", "Type", "RecordType", "Meaning", "Literal", "None"))  # words of annotations


def children(node: Node) -> tuple[Node, ...]:
    """Return the nodes directly below a node, in the order of the fields. TypeError for a node that is not the IR's."""
    return _CHILDREN[type(node)](node)


def walk(part: Part) -> Iterator[Node]:
    """Yield a node, or each of a tuple in turn, and all nodes below it: depth first, each before its children."""
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
    """Yield the statements of a block, each before those of its own blocks, in the order of the text. No expression is
    gone into. Drafts are left out."""
    pending = list(block[::-1])
    while pending:
        statement = pending.pop()
        if isinstance(statement, (draft.Atomic, draft.Unread, draft.Wrong)):
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
    """Return a node with each of its children replaced by `function` of it, called in their order. All other fields
    stay, the span among them. A node none of whose children changes is returned itself."""
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
    """Return a tree with every node replaced by `function` of it, from the leaves up: `function` is given each node
    with the children that it has by then. Parts in which nothing changes are returned themselves."""
    return function(map_children(node, lambda child: transform(child, function)))


def child_fields(kind: type[Node]) -> tuple[str, ...]:
    """Return the names of the fields in which nodes of a class have children, in order: one child, a tuple of children,
    or None. TypeError for a class that is not the IR's."""
    found = _FIELDS.get(kind)
    if found is None:
        if not kind.__module__.startswith(_IR):
            raise TypeError(f"{kind.__name__} is no node of the IR")
        annotations = kind.__annotations__
        found = _FIELDS[kind] = tuple([field for field in annotations if _has_children(annotations[field])])
    return found


def _has_children(annotation: str) -> bool:
    words = annotation.replace("[", " ").replace("]", " ").replace(",", " ").split()
    return any(word[0].isupper() and word not in _NO_CHILDREN for word in words)


def _getter(kind: type[Node]) -> _Children:
    """A function that returns the children of nodes of a class: a mere `attrgetter` where the fields are as it yields
    them."""
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
    """Functions that return the children of a node, by its class, each made when it is first asked for."""

    def __missing__(self, kind: type[Node]) -> _Children:
        found = self[kind] = _getter(kind)
        return found


_FIELDS: dict[type[Node], tuple[str, ...]] = {}
_CHILDREN = _Getters()
