"""Signatures with type variables against the types of arguments."""

from __future__ import annotations

from koordgen.lang.check.base import same
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.builtins import ORDERED, VARIABLES, K, N, Signature
from koordgen.lang.ir.types import (
    FLOAT,
    INT,
    SHARED_ELEMENTS,
    STRING,
    MapOf,
    PerRobot,
    Scalar,
    Sequence,
    TupleOf,
    Type,
    is_key,
)

Bound = dict[str, Type]  # a variable's name -> the type that it stands for
_VARIABLES = {variable.name for variable in VARIABLES}
_SHOWN = {"T": "T", "V": "V", "K": "K", "N": "int or float", "O": "int, float or string"}


def bind(pattern: Type, value: ir.Expr, bound: Bound) -> ir.Expr | None:
    """The value as what a signature takes there, an int widened to a float where one is wanted; None where it does not
    fit. What the variables of the pattern stand for is added to `bound` where it does."""
    type_ = value.type
    if type_ is pattern:
        return value
    if type_ is INT:
        wanted = bound.get(pattern.name) if isinstance(pattern, Scalar) and pattern.name in _VARIABLES else pattern
        if wanted is FLOAT:
            return ir.Widen(value, FLOAT, value.span)
    if type_ is FLOAT and pattern is N and bound.get("N") is INT:
        bound["N"] = FLOAT
        return value
    return value if _agree(pattern, type_, bound) else None


def _agree(pattern: Type, type_: Type, bound: Bound) -> bool:
    match pattern:
        case Scalar(name) if name in _VARIABLES:
            if name in bound:
                return same(bound[name], type_)
            if not _admits(pattern, type_):
                return False
            bound[name] = type_
            return True
        case Sequence(word, element):
            if isinstance(type_, PerRobot):
                return word == "List" and _agree(element, type_.element, bound)
            return isinstance(type_, Sequence) and type_.name == word and _agree(element, type_.element, bound)
        case MapOf(key, value):
            return isinstance(type_, MapOf) and _agree(key, type_.key, bound) and _agree(value, type_.value, bound)
        case _:
            return same(pattern, type_)


def _admits(variable: Scalar, type_: Type) -> bool:
    if isinstance(type_, PerRobot):
        return False
    if variable is N:
        return type_ is INT or type_ is FLOAT
    if variable is ORDERED:
        return type_ is INT or type_ is FLOAT or type_ == STRING
    return variable is not K or is_key(type_)


def filled(pattern: Type, bound: Bound) -> Type | None:
    """The pattern with its variables replaced; None where one of them stands for nothing yet."""
    match pattern:
        case Scalar(name):
            return bound.get(name) if name in _VARIABLES else pattern
        case Sequence(word, element):
            part = filled(element, bound)
            return None if part is None else pattern if part is element else Sequence(word, part, SHARED_ELEMENTS)
        case MapOf(key, value):
            parts = filled(key, bound), filled(value, bound)
            return None if parts[0] is None or parts[1] is None else MapOf(parts[0], parts[1], SHARED_ELEMENTS)
        case TupleOf(items):
            found = [filled(item, bound) for item in items]
            return None if None in found else TupleOf(tuple([f for f in found if f is not None]))
        case _:
            return pattern


def shown(signature: Signature, skip: int = 0) -> str:
    """What a builtin takes, in words: "(Point, Point)"; `skip` leaves out the object of a method."""
    return f"({', '.join(_shown(arg) for arg in signature.args[skip:])})"


def _shown(pattern: Type) -> str:
    if isinstance(pattern, Scalar):
        return _SHOWN.get(pattern.name, pattern.name)
    return str(pattern)
