"""Immutable value classes for syntax trees and the IR.

What a frozen dataclass gives, at a tenth of its start-up cost: `@dataclass(frozen=True)` compiles six
functions a class at every import (0.45 ms each, 30 ms for the trees of this compiler, more than all else
that `koordgen check` does on a small program); here one `__init__` is compiled a class and the rest is shared.
"""

from __future__ import annotations

from typing import Any, TypeVar, dataclass_transform

N = TypeVar("N", bound="Node")
_APART = ("span", "capacity")


class _NodeMeta(type):
    """Turns a class body's annotations into slots and an `__init__`, in their order of writing."""

    def __new__(mcs, name: str, bases: tuple[type, ...], body: dict[str, Any]) -> _NodeMeta:
        fields = tuple(f for f in body.get("__annotations__", {}) if not f.startswith("_"))
        defaults = {f: body.pop(f) for f in fields if f in body}
        body["__slots__"] = body["__match_args__"] = fields
        cls = super().__new__(mcs, name, bases, body)
        if fields:
            setters = {f"_{f}": getattr(cls, f).__set__ for f in fields}
            values = {f"_default_{f}": value for f, value in defaults.items()}
            head = ", ".join(f"{f}=_default_{f}" if f in defaults else f for f in fields)
            lines = "".join(f"\n _{f}(self, {f})" for f in fields)
            scope: dict[str, Any] = {**setters, **values}
            exec(f"def __init__(self, {head}):{lines}", scope)  # names come from our own class bodies only
            cls.__init__ = scope["__init__"]  # type: ignore[misc]
        return cls


@dataclass_transform(frozen_default=True)
class Node(metaclass=_NodeMeta):
    """Base of every tree node. No node subclasses another; a field called `span` (where the node stands in
    the source) takes no part in equality and hash, so that trees compare by what they say; nor does `capacity`
    (how much a variable of a type may hold)."""

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{type(self).__name__} is immutable")

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"{type(self).__name__} is immutable")

    def _key(self) -> tuple[object, ...]:
        return tuple(getattr(self, f) for f in type(self).__match_args__ if f not in _APART)  # type: ignore[attr-defined]

    def __eq__(self, other: Any) -> bool:
        return type(self) is type(other) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash((type(self), self._key()))

    def __repr__(self) -> str:
        shown = ", ".join(f"{f}={getattr(self, f)!r}" for f in type(self).__match_args__ if f != "span")  # type: ignore[attr-defined]
        return f"{type(self).__name__}({shown})"


def replace(node: N, **changes: object) -> N:
    """A copy of `node` with some fields changed; TypeError for a name that is no field."""
    fields = {f: getattr(node, f) for f in type(node).__match_args__}  # type: ignore[attr-defined]
    return type(node)(**{**fields, **changes})
