"""Terms of many-sorted logic: the formulas of proof obligations.

Only the constructors in this module build terms. They fold constants, and return the same object for equal arguments.
So identical objects are equal terms, but equal terms need not be identical objects. Numbers are never rounded: a float
of the program becomes a Fraction.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction

from koordgen.lang.node import Node


class Sort(Node):
    """Sort of terms: `BOOL`, `INT`, `REAL`, or an uninterpreted sort."""

    name: str


BOOL, INT, REAL = Sort("Bool"), Sort("Int"), Sort("Real")


class FunctionSymbol(Node):
    """Declared function symbol. A constant is a function without arguments."""

    name: str
    domain: tuple[Sort, ...]
    result: Sort


class LiteralTerm(Node):
    """Literal: a bool, an int, or a Fraction for a real number."""

    value: bool | int | Fraction
    sort: Sort
    traits: int
    __eq__ = object.__eq__
    __hash__ = object.__hash__


class Apply(Node):
    """Application of a declared symbol to arguments."""

    function: FunctionSymbol
    args: tuple[Term, ...]
    sort: Sort
    traits: int
    __eq__ = object.__eq__
    __hash__ = object.__hash__


class Op(Node):
    """Application of an operator of the logic. `name` is the operator's name in SMT-LIB.

    The names are: and or not => = ite + - * / div mod < <= to_real to_int. `-` has one or two arguments; `and`, `or`
    and `+` have two or more. The constructors express `>`, `>=` and `distinct` by these operators."""

    name: str
    args: tuple[Term, ...]
    sort: Sort
    traits: int
    __eq__ = object.__eq__
    __hash__ = object.__hash__


Term = LiteralTerm | Apply | Op

# Bit flags of a term: the features of the term and its subterms that the logic of an obligation must support.
REALS, NONLINEAR = 1, 2
# Operators that make a term nonlinear, unless a factor or the divisor is a literal.
_NONLINEAR = frozenset(("*", "/", "div", "mod"))

# MOST_STEPS limits the number of terms and expressions that are built for one part of a program. Above this limit,
# encoding takes minutes, and no solver decides the result. MOST_BITS limits the numbers that constant folding computes.
MOST_STEPS = 200_000
MOST_BITS = 1 << 16
_steps = 0


class EncodingTooLarge(Exception):
    """Raised if the formulas of a program part exceed a limit. The message names the limit."""


def step() -> None:
    """Count one step of the encoding. Raises EncodingTooLarge if the count exceeds MOST_STEPS."""
    global _steps
    _steps += 1
    if _steps > MOST_STEPS:
        raise EncodingTooLarge(
            f"the formulas take more than {MOST_STEPS:,} steps to write down, because the body of each called function "
            "is written out: split the event, or call fewer functions"
        )


_TERMS: dict[object, Term] = {}  # (operator or symbol, arguments) -> the only term of this form
_LITERALS: dict[object, LiteralTerm] = {}

TRUE, FALSE = LiteralTerm(True, BOOL, 0), LiteralTerm(False, BOOL, 0)


def forget() -> None:
    """Drop the table of terms.

    A term that is built after the call is not identical to an equal term that was built before the call."""
    _TERMS.clear()


def count_anew() -> None:
    """Reset the count of encoding steps before the next part of a program."""
    global _steps
    _steps = 0


def integer(value: int) -> Term:
    if value.bit_length() > MOST_BITS:
        raise EncodingTooLarge(f"a number in the formulas has more than {MOST_BITS:,} bits")
    found = _LITERALS.get(("Int", value))
    return found or _LITERALS.setdefault(("Int", value), LiteralTerm(value, INT, 0))


def real(value: int | float | Fraction) -> Term:
    """Return a real literal. A float becomes the fraction that it represents, without rounding."""
    found = _LITERALS.get(("Real", value))
    return found or _LITERALS.setdefault(("Real", value), LiteralTerm(Fraction(value), REAL, REALS))


def boolean(value: bool) -> Term:
    return TRUE if value else FALSE


def apply(function: FunctionSymbol, *args: Term) -> Term:
    # The key contains the arguments and the sort of the result: x@1 may be a bool in one context and a list in another.
    key = (function.name, function.result.name, args)
    found = _TERMS.get(key)
    if found is None:
        assert tuple(a.sort for a in args) == function.domain, f"{function.name} of {[a.sort.name for a in args]}"
        traits = REALS if function.result is REAL else 0
        for arg in args:
            traits |= arg.traits
        found = _TERMS[key] = Apply(function, args, function.result, traits)
    return found


def constant(name: str, sort: Sort) -> Term:
    return apply(FunctionSymbol(name, (), sort))


def _op(name: str, sort: Sort, *args: Term) -> Term:
    step()
    key = (name, sort.name, args)
    found = _TERMS.get(key)
    if found is None:
        traits = REALS if sort is REAL else 0
        for arg in args:
            traits |= arg.traits
        if name in _NONLINEAR and not any(isinstance(arg, LiteralTerm) for arg in (args if name == "*" else args[1:])):
            traits |= NONLINEAR
        found = _TERMS[key] = Op(name, args, sort, traits)
    return found


def number(term: Term) -> int | Fraction | None:
    """Return the number of a numeric literal; None for any other term."""
    return term.value if type(term) is LiteralTerm and term.sort is not BOOL else None


# Constructors of truth values


def not_(a: Term) -> Term:
    if isinstance(a, LiteralTerm):
        return FALSE if a.value else TRUE
    if isinstance(a, Op) and a.name == "not":
        return a.args[0]
    return _op("not", BOOL, a)


def and_(*parts: Term) -> Term:
    return all_of(parts)


def or_(*parts: Term) -> Term:
    return any_of(parts)


def all_of(parts: Iterable[Term]) -> Term:
    return _joined("and", parts, TRUE, FALSE)


def any_of(parts: Iterable[Term]) -> Term:
    return _joined("or", parts, FALSE, TRUE)


def _joined(name: str, parts: Iterable[Term], neutral: Term, absorbing: Term) -> Term:
    found: dict[Term, None] = {}
    for part in parts:
        if part is absorbing:
            return absorbing
        if type(part) is Op and part.name == name:
            found.update(dict.fromkeys(part.args))
        elif part is not neutral:
            found[part] = None
    for part in found:
        if type(part) is Op and part.name == "not" and part.args[0] in found:
            return absorbing
    if len(found) < 2:
        return next(iter(found), neutral)
    return _op(name, BOOL, *found)


def implies(a: Term, b: Term) -> Term:
    if a is TRUE or b is TRUE or a is b:
        return b if a is not b else TRUE
    if a is FALSE:
        return TRUE
    if b is FALSE:
        return not_(a)
    return _op("=>", BOOL, a, b)


def ite(condition: Term, then: Term, orelse: Term) -> Term:
    if condition is TRUE or then is orelse:
        return then
    if condition is FALSE:
        return orelse
    if isinstance(condition, Op) and condition.name == "not":
        return ite(condition.args[0], orelse, then)
    if isinstance(then, Op) and then.name == "ite" and then.args[0] is condition:
        then = then.args[1]
    if isinstance(orelse, Op) and orelse.name == "ite" and orelse.args[0] is condition:
        orelse = orelse.args[2]
    if then is orelse:
        return then
    if then.sort is BOOL and (isinstance(then, LiteralTerm) or isinstance(orelse, LiteralTerm)):
        return _of_truths(condition, then, orelse)
    return _op("ite", then.sort, condition, then, orelse)


def _of_truths(condition: Term, then: Term, orelse: Term) -> Term:
    """Build an `ite` that has a literal as one of its two alternatives."""
    if then is TRUE:
        return or_(condition, orelse)
    if then is FALSE:
        return and_(not_(condition), orelse)
    return and_(condition, then) if orelse is FALSE else or_(not_(condition), then)


def equals(a: Term, b: Term) -> Term:
    if a is b:
        return TRUE
    if isinstance(a, LiteralTerm) and isinstance(b, LiteralTerm):
        return boolean(a.value == b.value)
    if a.sort is BOOL:
        for one, other in ((a, b), (b, a)):
            if isinstance(one, LiteralTerm):
                return other if one.value else not_(other)
    if isinstance(a, LiteralTerm):
        a, b = b, a
    if isinstance(b, LiteralTerm) and isinstance(a, Op) and a.name == "ite":
        condition, then, orelse = a.args
        if isinstance(then, LiteralTerm) or isinstance(orelse, LiteralTerm):
            return ite(condition, equals(then, b), equals(orelse, b))
    apart = _offset(a, b)
    if apart is not None:
        return boolean(apart == 0)
    return _op("=", BOOL, a, b)


def _offset(a: Term, b: Term) -> int | Fraction | None:
    """Return b - a if the terms differ by a literal, as i and i + 1 do; otherwise None."""
    if type(a) is not Op and type(b) is not Op:
        return 0 if a is b else None
    base, more = _split(a)
    other, further = _split(b)
    return further - more if base is other else None


def _split(a: Term) -> tuple[Term, int | Fraction]:
    """Split a term into a base term and a literal, whose sum is the term."""
    if type(a) is Op and a.name == "+" and len(a.args) == 2:
        last = number(a.args[1])
        if last is not None:
            return a.args[0], last
    return a, 0


# Constructors of numbers


def add(a: Term, b: Term) -> Term:
    x, y = number(a), number(b)
    if x is not None and y is not None:
        return _literal(x + y, a.sort)
    if x is not None:
        a, b, x, y = b, a, y, x
    if y == 0:
        return a
    base, more = _split(a)
    if y is not None and base is not a:
        return add(base, _literal(more + y, a.sort))
    return _op("+", a.sort, a, b)


def subtract(a: Term, b: Term) -> Term:
    x, y = number(a), number(b)
    if y is not None:
        return add(a, _literal(-y, a.sort))
    if a is b:
        return _literal(0, a.sort)
    if x == 0:
        return negate(b)
    return _op("-", a.sort, a, b)


def negate(a: Term) -> Term:
    x = number(a)
    if x is not None:
        return _literal(-x, a.sort)
    if isinstance(a, Op) and a.name == "-" and len(a.args) == 1:
        return a.args[0]
    return _op("-", a.sort, a)


def multiply(a: Term, b: Term) -> Term:
    x, y = number(a), number(b)
    if x is not None and y is not None:
        return _literal(x * y, a.sort)
    if y is not None:
        a, b, x, y = b, a, y, x
    if x == 0:
        return a
    if x == 1:
        return b
    return _op("*", a.sort, a, b)


def divide(a: Term, b: Term) -> Term:
    """Return the quotient of two reals. The quotient by zero is an unspecified number."""
    x, y = number(a), number(b)
    if y is not None and y != 0:
        return _literal(Fraction(x) / y, REAL) if x is not None else multiply(real(1 / Fraction(y)), a)
    return _op("/", REAL, a, b)


def floor_divide(a: Term, b: Term) -> Term:
    """Return `a // b` of ints, rounded down as in Python, also for negative divisors.

    SMT-LIB's `div` rounds down for positive divisors only."""
    x, y = number(a), number(b)
    if x is not None and y:
        return integer(int(x // y))
    if y is not None and y > 0:
        return _op("div", INT, a, b)
    other = _op("div", INT, negate(a), negate(b))
    return other if y is not None else ite(less(integer(0), b), _op("div", INT, a, b), other)


def remainder(a: Term, b: Term) -> Term:
    """Return `a % b` of ints. As in Python, the remainder has the divisor's sign."""
    x, y = number(a), number(b)
    if x is not None and y:
        return integer(int(x % y))
    if y is not None and y > 0:
        return _op("mod", INT, a, b)
    return subtract(a, multiply(b, floor_divide(a, b)))


def less(a: Term, b: Term) -> Term:
    x, y = number(a), number(b)
    if x is not None and y is not None:
        return boolean(x < y)
    apart = _offset(a, b)
    return boolean(apart > 0) if apart is not None else _op("<", BOOL, a, b)


def at_most(a: Term, b: Term) -> Term:
    x, y = number(a), number(b)
    if x is not None and y is not None:
        return boolean(x <= y)
    apart = _offset(a, b)
    return boolean(apart >= 0) if apart is not None else _op("<=", BOOL, a, b)


def to_real(a: Term) -> Term:
    x = number(a)
    return real(x) if x is not None else _op("to_real", REAL, a)


def to_int(a: Term) -> Term:
    """Return the greatest int that is not greater than a real."""
    x = number(a)
    if x is not None:
        return integer(x // 1)
    return a.args[0] if isinstance(a, Op) and a.name == "to_real" else _op("to_int", INT, a)


def _literal(value: int | Fraction, sort: Sort) -> Term:
    return integer(int(value)) if sort is INT else real(value)
