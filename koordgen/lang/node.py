"""Immutable value classes for syntax trees and the IR.

They replace frozen dataclasses at a tenth of the start-up cost. `@dataclass(frozen=True)` compiles six functions for
each class at every import: 0.45 ms a class, 30 ms for the trees of this compiler, more than all other work of
`koordgen check` on a small program. Here one `__init__` is compiled for each number of fields, each class has a copy
with its own names, and all other code is shared.

mypy enforces immutability, not the run time: a `__setattr__` that raises would double the time to build a node.
"""

from __future__ import annotations

from operator import attrgetter
from types import CodeType, FunctionType
from typing import Any, TypeVar, dataclass_transform

N = TypeVar("N", bound="Node")
_APART = ("span", "capacity")
_INITS: dict[int, CodeType] = {}  # number of fields -> code of `__init__(self, _0, _1)`


def _init(fields: tuple[str, ...], defaults: tuple[object, ...]) -> FunctionType:
    code = _INITS.get(len(fields))
    if code is None:
        head = "".join(f", _{i}" for i in range(len(fields)))
        lines = "".join(f"\n self._{i} = _{i}" for i in range(len(fields)))
        scope: dict[str, Any] = {}
        exec(f"def __init__(self{head}):{lines}", scope)
        code = _INITS[len(fields)] = scope["__init__"].__code__
    return FunctionType(code.replace(co_varnames=("self", *fields), co_names=fields), {}, "__init__", defaults)


class _NodeMeta(type):
    """Metaclass that turns the annotations of a class body into slots and an `__init__`, in their order."""

    def __new__(mcs, name: str, bases: tuple[type, ...], body: dict[str, Any]) -> _NodeMeta:
        fields = tuple(f for f in body.get("__annotations__", {}) if not f.startswith("_"))
        given = [f in body for f in fields]
        assert given == sorted(given), f"{name}: fields with defaults come last"
        defaults = tuple(body.pop(f) for f in fields if f in body)
        body["__slots__"] = body["__match_args__"] = fields
        cls = super().__new__(mcs, name, bases, body)
        compared = [f for f in fields if f not in _APART]
        cls._compared = attrgetter(*compared) if compared else type  # type: ignore[attr-defined]
        if fields:
            cls.__init__ = _init(fields, defaults)  # type: ignore[misc]
        return cls


@dataclass_transform(frozen_default=True)
class Node(metaclass=_NodeMeta):
    """Base class of all tree nodes. No node class inherits from another one.

    The fields `span` (position in the source) and `capacity` (size limit of a type) do not count in equality and hash,
    so trees compare by their contents.
    """

    _compared: Any  # node -> the fields that count in comparisons

    def __eq__(self, other: Any) -> bool:
        return self is other or (type(self) is type(other) and self._compared(self) == self._compared(other))

    def __hash__(self) -> int:
        return hash((type(self), self._compared(self)))

    def __repr__(self) -> str:
        shown = ", ".join(f"{f}={getattr(self, f)!r}" for f in type(self).__match_args__ if f != "span")  # type: ignore[attr-defined]
        return f"{type(self).__name__}({shown})"


def replace(node: N, **changes: object) -> N:
    """Return a copy of a node with some fields changed. Raises TypeError for a name that is not a field."""
    fields = {f: getattr(node, f) for f in type(node).__match_args__}  # type: ignore[attr-defined]
    return type(node)(**{**fields, **changes})
