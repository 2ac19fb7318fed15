"""Programs over exact numbers: each float is replaced by a Fraction of the same value, and nothing is rounded.

The prover reasons about real numbers. Running its counterexamples on exact numbers shows that they do not depend on
rounding. The same evaluator runs both kinds of programs: only the numbers in the program differ.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import reduce, total_ordering
from itertools import pairwise
from typing import Any, TypeVar

from koordgen.lang.ir import decl, expr
from koordgen.lang.ir.tree import transform
from koordgen.lang.ir.types import BOOL, FLOAT, INT
from koordgen.lang.node import Node
from koordgen.lang.source import Span
from koordgen.runtime.values.points import Grid, Point, Pose

MAX_BITS = 1 << 16  # limit on the size of a numerator or denominator
_TOO_LONG = f"a number of more than {MAX_BITS} bits"
N = TypeVar("N")


class NotExact(Exception):
    """Signal that an operation has no exact result: it is irrational, or it needs too many bits."""


@total_ordering
class Root:
    """An irrational square root of a rational number.

    A Root can be compared exactly; other operations on it raise NotExact.
    """

    def __init__(self, square: Fraction) -> None:
        self.square = square

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Root) and self.square == other.square

    def __hash__(self) -> int:
        return hash(("root", self.square))

    def __lt__(self, other: object) -> bool:
        if isinstance(other, Root):
            return self.square < other.square
        if isinstance(other, (int, Fraction)):
            return other > 0 and self.square < other * other
        return NotImplemented

    def _refuse(self, *_: object) -> Any:
        raise NotExact(f"the root of {self.square}")

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = _refuse
    __floordiv__ = __rfloordiv__ = __mod__ = __rmod__ = __pow__ = __rpow__ = __neg__ = __abs__ = _refuse
    __floor__ = __ceil__ = __round__ = __float__ = _refuse


Exact = Fraction | Root


def root(square: Fraction | int) -> Exact:
    """Return the square root of a number: a Fraction if it is rational, else a Root. Raises ValueError below zero."""
    exact = Fraction(square)
    if exact < 0:
        raise ValueError("math domain error")
    over, under = math.isqrt(exact.numerator), math.isqrt(exact.denominator)
    if over * over == exact.numerator and under * under == exact.denominator:
        return Fraction(over, under)
    return Root(exact)


def distance(p: Point, q: Point) -> Exact:
    """Return the distance of two Points with exact coordinates, in metres."""
    gaps: list[Any] = [p.x - q.x, p.y - q.y, p.z - q.z]
    return root(sum((Fraction(gap * gap) for gap in gaps), Fraction(0)))


def power(base: Any, exponent: Any) -> Fraction:
    """Return `base` to the power of an integral `exponent`.

    Raises NotExact if the base is a Root, the exponent is no integer, or the result is too large. Raises
    ZeroDivisionError for a negative power of zero.
    """
    if isinstance(base, Root) or isinstance(exponent, Root) or Fraction(exponent).denominator != 1:
        raise NotExact("a power that is not a rational number")
    if abs(exponent) * (_bits(Fraction(base)) - 1) > MAX_BITS:
        raise NotExact(_TOO_LONG)
    return within_exact(Fraction(base) ** int(exponent))


def within_exact(number: N) -> N:
    """Return a number unchanged. Raises NotExact if it is a Fraction of more than MAX_BITS bits."""
    if isinstance(number, Fraction) and _bits(number) > MAX_BITS:
        raise NotExact(_TOO_LONG)
    return number


def _bits(number: Fraction) -> int:
    return max(number.numerator.bit_length(), number.denominator.bit_length())


def path_distance(a: tuple[Point, ...], b: tuple[Point, ...]) -> Exact | float:
    """Return the least distance of two paths with exact coordinates, in metres.

    The distance is infinite if either path has no points.
    """
    if not a or not b:
        return math.inf
    return root(min(_squared(p, q, r, s) for p, q in _segments(a) for r, s in _segments(b)))


def _segments(path: tuple[Point, ...]) -> list[tuple[Point, Point]]:
    return list(pairwise(path)) if len(path) > 1 else [(path[0], path[0])]


def _squared(p: Point, q: Point, r: Point, s: Point) -> Fraction:
    """Return the squared distance of two segments: from p to q, and from r to s.

    The squared distance of the points p + x (q - p) and r + y (s - r) is a convex function of x and y. Its least value
    for 0 <= x <= 1 and 0 <= y <= 1 is at one end of a segment, or where both partial derivatives are zero.
    """
    if p == q or r == s:
        return _beyond(p, r, s) if p == q else _beyond(r, p, q)
    d, e, w = _minus(q, p), _minus(s, r), _minus(p, r)
    best = min(_beyond(p, r, s), _beyond(q, r, s), _beyond(r, p, q), _beyond(s, p, q))
    dd, ee, de, dw, ew = _dot(d, d), _dot(e, e), _dot(d, e), _dot(d, w), _dot(e, w)
    square = dd * ee - de * de
    if square:
        x, y = (de * ew - ee * dw) / square, (dd * ew - de * dw) / square
        if 0 <= x <= 1 and 0 <= y <= 1:
            gap = [w[i] + x * d[i] - y * e[i] for i in range(3)]
            best = min(best, _dot(gap, gap))
    return best


def _beyond(x: Point, p: Point, q: Point) -> Fraction:
    """Return the squared distance of a point from the segment between p and q."""
    w = _minus(x, p)
    if p == q:
        return _dot(w, w)
    d = _minus(q, p)
    along = _dot(d, d)
    t = min(max(_dot(w, d) / along, Fraction(0)), Fraction(1)) if along else Fraction(0)
    gap = [w[i] - t * d[i] for i in range(3)]
    return _dot(gap, gap)


def _minus(a: Point, b: Point) -> list[Fraction]:
    return [Fraction(a.x) - Fraction(b.x), Fraction(a.y) - Fraction(b.y), Fraction(a.z) - Fraction(b.z)]


def _dot(a: list[Fraction], b: list[Fraction]) -> Fraction:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


# Builtin functions that round their result if they are applied to floats.
ROUNDING = frozenset(
    ("distance", "sqrt", "path_distance", "clear", "sum", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp",
     "log", "GridMap", "center", "cell", "is_free", "is_occupied", "is_known", "mark_free", "mark_occupied")
)  # fmt: skip


def applied(name: str, args: list[Any]) -> Any:
    """Return the result of a builtin function in ROUNDING for arguments of which at least one is exact.

    Raises NotExact if the result is neither a rational number nor the square root of one.
    """
    match name, args:
        case "distance", [p, q]:
            return distance(p, q)
        case "sqrt", [x]:
            return root(x) if not isinstance(x, Root) else x._refuse()
        case "path_distance", [a, b]:
            return path_distance(a, b)
        case "clear", [path, paths, eps]:
            return all(path_distance(path, other) > eps for other in paths)
        case "sum", [xs]:
            return reduce(lambda total, x: within_exact(total + x), xs, type(xs[0])())
        case _:
            raise NotExact(f"{name} has no exact result")


_INEXACT = frozenset((int, float, bool, str))


def is_exact(*values: object) -> bool:
    """Return whether one of the values is, or contains, an exact number."""
    for value in values:
        if type(value) in _INEXACT:
            continue
        if isinstance(value, Point):
            value = (value.x, value.y, value.z)
        if isinstance(value, (Fraction, Root)) or (isinstance(value, tuple) and is_exact(*value)):
            return True
    return False


def made_exact(value: Any) -> Any:
    """Return a Koord value with each float replaced by a Fraction of the same value."""
    if isinstance(value, float):
        return Fraction(value)
    if isinstance(value, Point):
        return Point(*(made_exact(part) for part in (value.x, value.y, value.z)))
    if isinstance(value, Pose):
        return Pose(made_exact(value.position), made_exact(value.yaw))
    if isinstance(value, Grid):
        return Grid(value.x, value.y, made_exact(value.size))
    if type(value) is tuple:
        return tuple([made_exact(part) for part in value])
    if isinstance(value, tuple):  # a Koord record is a subclass of tuple
        return type(value)(*[made_exact(part) for part in value])
    return value


def exact(program: decl.Program) -> decl.Program:
    """Return the program with a Fraction in place of each float.

    Before: x := 1 / 4. After: x := (0 + 1) / 4, where 0 is a Fraction, so that the quotient is a Fraction, too.
    """
    made = transform(program, _exact)
    assert isinstance(made, decl.Program)
    return made


def _exact(node: Node) -> Node:
    """Return the exact form of a node whose children are exact already."""
    match node:
        case expr.Const(value, type_, span) if isinstance(value, float):
            return expr.Const(Fraction(value), type_, span)  # type: ignore[arg-type]
        case expr.Widen(operand, _, span):
            return _widened(operand, span)
        case expr.Builtin("sum", (values,), type_, span) if type_ == FLOAT:
            return _summed(values, node, span)
        case expr.Binary("/", left, right, proved, type_, span) if left.type == INT:
            return expr.Binary("/", _widened(left, span), right, proved, type_, span)
        case _:
            return node


def _summed(values: expr.Expr, whole: expr.Expr, span: Span) -> expr.Expr:
    """Return the expression `whole`, a sum over `values`, changed so that the sum of an empty list is an exact zero."""
    some = expr.Compare("<", expr.Const(0, INT, span), expr.Builtin("len", (values,), INT, span), BOOL, span)
    return expr.Conditional(some, whole, expr.Const(Fraction(0), FLOAT, span), FLOAT, span)  # type: ignore[arg-type]


def _widened(operand: expr.Expr, span: Span) -> expr.Expr:
    zero = expr.Const(Fraction(0), FLOAT, span)  # type: ignore[arg-type]
    return expr.Binary("+", zero, operand, True, FLOAT, span)
