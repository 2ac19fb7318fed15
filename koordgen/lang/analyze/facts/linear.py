"""Linear integer terms, and conditions over them.

A variable of a term is a plain variable, named by a str, or a derived variable: the length of a list, an int that is a
part of a value, or a quotient, remainder or conditional choice of other terms.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import assert_never

from koordgen.lang.node import Node


class Linear(Node):
    """Term: constant + sum of factor * variable. The variables are distinct; the factors are not zero."""

    terms: tuple[tuple[Var, int], ...]
    constant: int


class Quotient(Node):
    """Term: operand // divisor, with divisor > 0."""

    operand: Linear
    divisor: int


class Remainder(Node):
    """Term: operand % divisor, in [0, divisor) if the divisor is positive."""

    operand: Linear
    divisor: Linear


class ConditionalTerm(Node):
    """Term: `then if condition else orelse`."""

    condition: Formula
    then: Linear
    orelse: Linear


class Length(Node):
    """Length (>= 0) of a list, queue, set, map or string.

    `of` is the name of the variable. For a part of a value, `of` is the expression that reads the part.
    """

    of: object


class Value(Node):
    """Int that is a part of a value. `of` is the expression that reads this int."""

    of: object


# A plain variable is a str: "pid", "N_SYS", or a kind and a name, as in "param k" and "local count".
Var = str | Quotient | Remainder | ConditionalTerm | Length | Value


class AtLeastZero(Node):
    """Condition: linear >= 0."""

    linear: Linear


class BoolFact(Node):
    """Condition that is not arithmetic, identified by any hashable key."""

    key: object
    holds: bool


class And(Node):
    """Conjunction; true if it has no parts."""

    parts: tuple[Formula, ...]


class Or(Node):
    """Disjunction; false if it has no parts."""

    parts: tuple[Formula, ...]


class UnknownCondition(Node):
    """Condition whose truth is unknown. Its negation is unknown, too."""


Formula = AtLeastZero | BoolFact | And | Or | UnknownCondition

TRUE, FALSE, UNKNOWN = And(()), Or(()), UnknownCondition()
PID, N_SYS = "pid", "N_SYS"


def constant(value: int) -> Linear:
    return Linear((), value)


def variable(var: Var) -> Linear:
    return Linear(((var, 1),), 0)


def combine(left: Linear, right: Linear, factor: int = 1) -> Linear:
    """Return left + factor * right."""
    total = left.constant + factor * right.constant
    if not right.terms:
        return Linear(left.terms, total)
    if not left.terms:
        return Linear(tuple([(var, factor * times) for var, times in right.terms]) if factor else (), total)
    terms = dict(left.terms)
    for var, times in right.terms:
        terms[var] = terms.get(var, 0) + factor * times
    return Linear(tuple([(var, times) for var, times in terms.items() if times]), total)


def scale(linear: Linear, factor: int) -> Linear:
    return combine(constant(0), linear, factor)


def shifted(formula: Formula, var: Var, by: int) -> Formula:
    """Return the formula with `var - by` in place of `var`, which is a plain variable or a length.

    `var` must occur in the formula only as a term of a linear sum.
    """
    match formula:
        case AtLeastZero(linear):
            factor = dict(linear.terms).get(var, 0)
            return AtLeastZero(Linear(linear.terms, linear.constant - factor * by)) if factor else formula
        case And(parts):
            return And(tuple([shifted(part, var, by) for part in parts]))
        case Or(parts):
            return Or(tuple([shifted(part, var, by) for part in parts]))
        case _:
            return formula


def at_least(left: Linear, right: Linear) -> Formula:
    """Return the condition left >= right."""
    return AtLeastZero(combine(left, right, -1))


def less(left: Linear, right: Linear) -> Formula:
    """Return the condition left < right."""
    return AtLeastZero(combine(combine(right, left, -1), constant(-1)))


def equal(left: Linear, right: Linear) -> Formula:
    return And((at_least(left, right), at_least(right, left)))


def negate(formula: Formula) -> Formula:
    """Return the negation of a formula."""
    match formula:
        case AtLeastZero(linear):
            return AtLeastZero(combine(constant(-1), linear, -1))
        case BoolFact(key, holds):
            return BoolFact(key, not holds)
        case And(parts):
            return Or(tuple(negate(p) for p in parts))
        case Or(parts):
            return And(tuple(negate(p) for p in parts))
        case UnknownCondition():
            return formula
        case _:
            assert_never(formula)


def value_of(linear: Linear, values: Mapping[str, int]) -> int | None:
    """Return the value of a term; None if a variable has no value."""
    total = linear.constant
    for var, factor in linear.terms:
        value = values.get(var) if isinstance(var, str) else _derived(var, values)
        if value is None:
            return None
        total += factor * value
    return total


def _derived(var: Quotient | Remainder | ConditionalTerm | Length | Value, values: Mapping[str, int]) -> int | None:
    match var:
        case Length() | Value():
            return None
        case Quotient(operand, divisor):
            dividend = value_of(operand, values)
            return None if dividend is None else dividend // divisor
        case Remainder(operand, modulus):
            dividend, by = value_of(operand, values), value_of(modulus, values)
            return None if dividend is None or not by else dividend % by
        case ConditionalTerm(condition, then, orelse):
            held = truth(condition, values)
            return None if held is None else value_of(then if held else orelse, values)
        case _:
            assert_never(var)


def truth(formula: Formula, values: Mapping[str, int]) -> bool | None:
    """Return whether a formula holds for the given values; None if this depends on an unknown value or condition."""
    match formula:
        case AtLeastZero(linear):
            value = value_of(linear, values)
            return None if value is None else value >= 0
        case BoolFact() | UnknownCondition():
            return None
        case And(parts):
            found = {truth(p, values) for p in parts}
            return False if False in found else None if None in found else True
        case Or(parts):
            found = {truth(p, values) for p in parts}
            return True if True in found else None if None in found else False
        case _:
            assert_never(formula)


def variables(item: Formula | Linear | Var) -> Iterator[object]:
    """Yield the plain variables of a formula, the keys of its BoolFacts, and `of` of each Length and Value."""
    match item:
        case Linear(terms):
            for var, _ in terms:
                yield from variables(var)
        case AtLeastZero(linear):
            yield from variables(linear)
        case BoolFact(key):
            yield key
        case Length(of) | Value(of):
            yield of
        case And(parts) | Or(parts):
            for part in parts:
                yield from variables(part)
        case Quotient(operand):
            yield from variables(operand)
        case Remainder(operand, divisor):
            yield from variables(operand)
            yield from variables(divisor)
        case ConditionalTerm(condition, then, orelse):
            yield from variables(condition)
            yield from variables(then)
            yield from variables(orelse)
        case str():
            yield item
        case UnknownCondition():
            pass
        case _:
            assert_never(item)


def show(linear: Linear) -> str:
    """Return a term as Koord writes it: `N_SYS - pid - 1`."""
    parts = [(factor, _name(var)) for var, factor in linear.terms]
    parts.sort(key=lambda part: part[0] < 0)
    text = ""
    for factor, name in parts:
        times = name if abs(factor) == 1 else f"{abs(factor)} * {name}"
        sign = (" - " if factor < 0 else " + ") if text else ("-" if factor < 0 else "")
        text += sign + times
    if not text:
        return str(linear.constant)
    return text if not linear.constant else f"{text} {'+-'[linear.constant < 0]} {abs(linear.constant)}"


def _name(var: Var) -> str:
    match var:
        case str():
            return var.rpartition(" ")[2]
        case Quotient(operand, divisor):
            return f"({show(operand)}) // {divisor}"
        case Remainder(operand, modulus):
            return f"({show(operand)}) % ({show(modulus)})"
        case ConditionalTerm() | Value():
            return "(...)"
        case Length(of):
            return f"len({of.rpartition(' ')[2] if isinstance(of, str) else '...'})"
        case _:
            assert_never(var)


def substitute(linear: Linear, var: str, by: Linear) -> Linear:
    """Return a term with the plain variable `var` replaced by the term `by`.

    Occurrences of `var` within derived variables, such as a quotient, are not replaced.
    """
    factor = dict(linear.terms).get(var, 0)
    return combine(combine(linear, variable(var), -factor), by, factor)
