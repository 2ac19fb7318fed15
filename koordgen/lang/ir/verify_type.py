"""Result types of literals, operators, indices and builtins.

Raises InternalError if they do not apply.
"""

from __future__ import annotations

from math import isfinite

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir.builtins import FUNCTIONS, METHODS, ORDERED, UPDATE_SIGNATURES, K, N, S, Signature, T, V
from koordgen.lang.ir.types import (
    BOOL,
    FLOAT,
    INT,
    POINT,
    STRING,
    MapOf,
    PerRobot,
    RecordType,
    Sequence,
    TupleOf,
    Type,
    is_key,
    list_of,
)
from koordgen.lang.source import Span

_NUMBERS = (INT, FLOAT)
ORDERED_TYPES = (INT, FLOAT, STRING)
_FLOATS = list_of(FLOAT)
_FIELDS: dict[str, dict[str, Type]] = {
    "Point": {"x": FLOAT, "y": FLOAT, "z": FLOAT},
    "Pose": {"position": POINT, "yaw": FLOAT},
    "Grid": {"x": INT, "y": INT, "size": FLOAT},
    "Scan": {"angles": _FLOATS, "ranges": _FLOATS, "max_range": FLOAT},
}


def require(holds: bool, message: str, span: Span) -> None:
    """Raise InternalError unless a condition holds."""
    if not holds:
        raise InternalError(f"IR at {span.line}:{span.column}: {message}")


def fail(message: str, span: Span) -> Type:
    """Raise InternalError."""
    raise InternalError(f"IR at {span.line}:{span.column}: {message}")


_LITERALS: dict[type, Type] = {int: INT, float: FLOAT, bool: BOOL, str: STRING}


def literal_type(value: object, span: Span) -> Type:
    type_ = _LITERALS.get(type(value))
    if type_ is None or (type_ is FLOAT and not isfinite(value)):  # type: ignore[arg-type]
        return fail("the value is not a literal, or not finite", span)
    return type_


def fields_of(type_: Type) -> dict[str, Type]:
    match type_:
        case RecordType(_, fields):
            return dict(fields)
        case TupleOf(items):
            return {str(index): item for index, item in enumerate(items)}
        case _:
            return _FIELDS.get(str(type_), {})


def at_type(type_: Type, span: Span) -> Type:
    match type_:
        case Sequence("List" | "Queue", element) | PerRobot(element):
            return element
        case _:
            require(type_ == STRING, f"a {type_} has no index", span)
            return STRING


def binary_type(op: str, left: Type, right: Type, span: Span) -> Type:
    if (left is right or left == right) and left in _NUMBERS and op in ("+", "-", "*", "/", "//", "%", "**"):
        return FLOAT if op == "/" else left
    if left == POINT and (right == POINT if op in ("+", "-") else right == FLOAT and op in ("*", "/")):
        return POINT
    if op == "*" and left == FLOAT and right == POINT:
        return POINT
    if op == "+" and left == right and (left == STRING or (isinstance(left, Sequence) and left.name == "List")):
        return left
    return fail(f"{op} does not apply to {left} and {right}", span)


def _word(type_: Type) -> str:
    match type_:
        case Sequence(name):
            return name
        case MapOf():
            return "Map"
        case PerRobot():
            return "List"
        case _:
            return ""


def fits(type_: Type, wanted: Type) -> bool:
    """Return whether an argument's type fits a parameter: an allread variable as a whole fits a list, too."""
    if isinstance(type_, PerRobot) and isinstance(wanted, Sequence):
        return wanted.name == "List" and fits(type_.element, wanted.element)
    return type_ == wanted


def builtin_type(name: str, types: list[Type], span: Span) -> Type:
    """Return the result type of a builtin, a method or an update for arguments of these types."""
    signatures = FUNCTIONS.get(name) or UPDATE_SIGNATURES.get(name)
    if signatures is None:
        method = METHODS.get((_word(types[0]), name)) if types else None
        signatures = () if method is None else (method,)
    for signature in signatures:
        result = _result(signature, types)
        if result is not None:
            return result
    return fail(f"no builtin {name} takes ({', '.join(map(str, types))})", span)


def _result(signature: Signature, types: list[Type]) -> Type | None:
    """Return a signature's result type for arguments of these types; None if they do not match."""
    bound: dict[Type, Type] = {S: types[0]} if types else {}
    if len(types) != len(signature.args):
        return None
    if all(_unified(wanted, type_, bound) for wanted, type_ in zip(signature.args, types, strict=True)):
        return _substituted(signature.result, bound)
    return None


def _unified(wanted: Type, type_: Type, bound: dict[Type, Type]) -> bool:
    """Return whether a type matches a pattern. Adds the types of the pattern's variables to `bound`."""
    match wanted, type_:
        case Sequence("List", element), PerRobot(found):
            return _unified(element, found, bound)
        case Sequence(name, element), Sequence(name_, found):
            return name == name_ and _unified(element, found, bound)
        case MapOf(key, value), MapOf(key_, value_):
            return _unified(key, key_, bound) and _unified(value, value_, bound)
        case _:
            pass
    if wanted not in (T, K, V, N, ORDERED):
        return wanted == type_
    if wanted in (N, ORDERED) and type_ not in (_NUMBERS if wanted == N else ORDERED_TYPES):
        return False
    return bound.setdefault(wanted, type_) == type_ and (wanted != K or is_key(type_))


def _substituted(type_: Type, bound: dict[Type, Type]) -> Type:
    match type_:
        case Sequence(name, element, capacity):
            return Sequence(name, _substituted(element, bound), capacity)
        case TupleOf(items):
            return TupleOf(tuple([_substituted(item, bound) for item in items]))
        case _:
            return bound.get(type_, type_)
