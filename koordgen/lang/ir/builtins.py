"""Table of builtin functions and methods, for checker, verifier, semantics and emitter.

Type variables of signatures: "T", "V" any type, "K" a key type, "N" int or float, "O" int, float or string. The first
item of `Builtin.args` of a method is its object.
"""

from __future__ import annotations

from koordgen.lang.ir.types import (
    BALL,
    BOOL,
    FLOAT,
    GRID,
    GRIDMAP,
    INT,
    POINT,
    POSE,
    RECT,
    SHARED_ELEMENTS,
    STRING,
    MapOf,
    Scalar,
    Sequence,
    TupleOf,
    Type,
    list_of,
)  # fmt: skip
from koordgen.lang.node import Node

T, K, V, N = Scalar("T"), Scalar("K"), Scalar("V"), Scalar("N")
ORDERED = Scalar("O")
VARIABLES = (T, K, V, N, ORDERED)


class Signature(Node):
    """Types of a builtin's arguments and of its result."""

    args: tuple[Type, ...]
    result: Type


def _queue(element: Type) -> Sequence:
    return Sequence("Queue", element, SHARED_ELEMENTS)


def _set(element: Type) -> Sequence:
    return Sequence("Set", element, SHARED_ELEMENTS)


def _s(*types: Type) -> Signature:
    return Signature(types[:-1], types[-1])


_MAP = MapOf(K, V, SHARED_ELEMENTS)
_PATH = list_of(POINT)

# Functions that a program calls by name. Several signatures are tried in order.
FUNCTIONS: dict[str, tuple[Signature, ...]] = {
    "Point": (_s(FLOAT, FLOAT, FLOAT, POINT),),
    "Pose": (_s(POINT, FLOAT, POSE),),
    "Grid": (_s(INT, INT, FLOAT, GRID),),
    "GridMap": (_s(POINT, POINT, FLOAT, GRIDMAP),),
    "Rect": (_s(POINT, POINT, RECT),),
    "Ball": (_s(POINT, FLOAT, BALL),),
    "distance": (_s(POINT, POINT, FLOAT),),
    "path_distance": (_s(_PATH, _PATH, FLOAT),),
    "clear": (_s(_PATH, list_of(_PATH), FLOAT, BOOL),),
    "abs": (_s(N, N),),
    "min": (_s(N, N, N),),
    "max": (_s(N, N, N),),
    **{name: (_s(FLOAT, FLOAT),) for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "log")},
    "atan2": (_s(FLOAT, FLOAT, FLOAT),),
    **{name: (_s(FLOAT, INT),) for name in ("floor", "ceil", "round")},
    "len": (_s(list_of(T), INT), _s(_queue(T), INT), _s(_set(K), INT), _s(_MAP, INT), _s(STRING, INT)),
    "sum": (_s(list_of(N), N),),
    "first": (_s(list_of(T), T), _s(_queue(T), T)),
    "last": (_s(list_of(T), T), _s(_queue(T), T)),
    "sorted": (_s(list_of(ORDERED), list_of(ORDERED)),),
    "reversed": (_s(list_of(T), list_of(T)),),
    "str": (_s(INT, STRING), _s(FLOAT, STRING), _s(BOOL, STRING), _s(STRING, STRING), _s(POINT, STRING)),
    "center": (_s(GRID, POINT),),
    "cell": (_s(POINT, FLOAT, GRID),),
    "merge": (_s(GRIDMAP, GRIDMAP, GRIDMAP),),
    **{name: (_s(GRIDMAP, GRID, BOOL),) for name in ("is_free", "is_occupied", "is_known")},
    **{name: (_s(GRIDMAP, GRID, GRIDMAP),) for name in ("mark_free", "mark_occupied")},
}

# Methods that return a value: (name of the type, name of the method) -> signature.
METHODS: dict[tuple[str, str], Signature] = {
    ("List", "index"): _s(list_of(T), T, INT),
    ("List", "count"): _s(list_of(T), T, INT),
    ("Map", "get"): _s(_MAP, K, V, V),
    ("Map", "keys"): _s(_MAP, list_of(K)),
    ("Map", "values"): _s(_MAP, list_of(V)),
    ("Map", "items"): _s(_MAP, list_of(TupleOf((K, V)))),
    ("Set", "union"): _s(_set(K), _set(K), _set(K)),
    ("Set", "intersection"): _s(_set(K), _set(K), _set(K)),
    ("Set", "difference"): _s(_set(K), _set(K), _set(K)),
}

# Methods that change their object: (name of the type, name of the method) -> the update that returns the changed value.
UPDATES: dict[tuple[str, str], str] = {
    ("List", "append"): "appended",
    ("List", "extend"): "extended",
    ("List", "insert"): "inserted",
    ("List", "remove"): "removed",
    ("List", "clear"): "cleared",
    ("Queue", "push"): "appended",
    ("Queue", "clear"): "cleared",
    ("Set", "add"): "set_with",
    ("Set", "remove"): "set_without",
    ("Set", "clear"): "cleared",
    ("Map", "remove"): "map_without",
    ("Map", "clear"): "cleared",
}
# `xs.pop()`, `xs.pop(i)`, `q.pop()`: the expression of the removed value, and that of the remaining object.
#   List pop():  At(xs, len(xs) - 1), popped(xs)     List pop(i): At(xs, i), without(xs, i)
#   Queue pop(): first(q), without(q, 0)

# Signatures of the builtins of the IR to which updating methods, such as `xs.append(x)`, are translated. Programs
# cannot call these builtins by name. S stands for the type of the object that is updated.
S = Scalar("S")
UPDATE_SIGNATURES: dict[str, tuple[Signature, ...]] = {
    "updated": (_s(list_of(T), INT, T, S),),
    "appended": (_s(list_of(T), T, S), _s(_queue(T), T, S)),
    "extended": (_s(list_of(T), list_of(T), S),),
    "inserted": (_s(list_of(T), INT, T, S),),
    "removed": (_s(list_of(T), T, S),),
    "without": (_s(list_of(T), INT, S), _s(_queue(T), INT, S)),
    "popped": (_s(list_of(T), S),),
    "cleared": (_s(list_of(T), S), _s(_queue(T), S), _s(_set(K), S), _s(_MAP, S)),
    "set_with": (_s(_set(K), K, S),),
    "set_without": (_s(_set(K), K, S),),
    "map_at": (_s(_MAP, K, V),),  # `m[k]` read
    "map_with": (_s(_MAP, K, V, S),),  # `m[k] = v`
    "map_without": (_s(_MAP, K, S),),
}

CONSTANTS: dict[str, float] = {"pi": 3.141592653589793}
