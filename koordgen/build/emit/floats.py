"""NaN analysis: finds the floats that may be NaN where generated code compares them.

Only these are checked at run time. Stored and sent values are finite, so a variable, port or param is finite until the
event itself writes it. One operation on finite numbers may overflow to infinity, but does not yield NaN:

    distance(Motion.position, x[i]) < eps         needs no check
    a * b - c * d < eps                           needs one: infinity minus infinity
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from koordgen.build.emit.types import with_floats
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import INT
from koordgen.lang.ir.types import Sequence as SequenceOf

FINITE, NUMBER, ANY = range(3)  # NUMBER: finite or infinite, not NaN. For a value with parts: the worst of its floats

Kinds = Mapping[stmt.Place, int]
NOTHING_WRITTEN: Kinds = {}

_TO_FINITE = ("sin", "cos", "tan", "asin", "acos", "atan", "atan2")  # for infinity they raise or return an angle
_LIKE_DIFFERENCES = ("distance", "center")
_ALWAYS_FINITE = ("cell", "GridMap", "merge", "mark_free", "mark_occupied")


def kinds(block: stmt.Block, parameters: tuple[str, ...] = ()) -> Kinds:
    """Return the kind of float that each place written by a block may hold, for any order of its statements.

    Parameters, and temps that the block does not declare, are ANY.
    """
    writes = list(_writes(block))
    found = {place: FINITE for place, _ in writes} | {stmt.TempPlace(name): ANY for name in parameters}
    changed = True
    while changed:
        changed = False
        for place, value in writes:
            new = kind(value, found)
            if new > found[place]:
                found[place], changed = new, True
    return found


def _writes(block: stmt.Block) -> Iterator[tuple[stmt.Place, ir.Expr]]:
    for statement in block:
        match statement:
            case stmt.Assign(place, value):
                yield place, value
            case stmt.Let(name, _, value):
                yield stmt.TempPlace(name), value
            case stmt.If(_, then, orelse):
                yield from _writes(then)
                yield from _writes(orelse)
            case stmt.For(variables, _, values, inner):
                yield from [(stmt.TempPlace(name), values) for name in variables]
                yield from _writes(inner)
            case stmt.While(_, inner):
                yield from _writes(inner)
            case _:
                pass


def kind(node: ir.Expr, known: Kinds) -> int:
    """Return the kind of the floats in a value. `known`: kinds of the places that the block writes."""
    if not with_floats(node.type):
        return FINITE
    match node:
        case ir.TempRead(name):
            return known.get(stmt.TempPlace(name), ANY)
        case ir.LocalRead(name):
            return known.get(stmt.LocalPlace(name), FINITE)
        case ir.SlotRead(name) | ir.SlotsRead(name):
            return known.get(stmt.OwnSlot(name), FINITE)
        case ir.SharedRead(name):
            return known.get(stmt.SharedPlace(name), FINITE)
        case ir.PortRead(module, port):
            return known.get(stmt.PortPlace(module, port), FINITE)
        case ir.Const() | ir.Widen() | ir.ParamRead() | ir.LocalOf() | ir.PortOf() | ir.PortCall():
            return FINITE
        case ir.Unary(_, part) | ir.Field(part) | ir.Item(part) | ir.At(part) | ir.Slice(part):
            return kind(part, known)
        case ir.Conditional(_, one, other) | ir.With(one, _, other):
            return max(kind(one, known), kind(other, known))
        case ir.Make(parts):
            return _worst(parts, known)
        case ir.Binary(op, left, right):
            return _of_operator(op, left, right, known)
        case ir.Builtin(name, args):
            return _of_builtin(name, args, known)
        case _:
            return ANY


def _worst(parts: Sequence[ir.Expr], known: Kinds) -> int:
    return max([kind(part, known) for part in parts], default=FINITE)


def _of_operator(op: str, left: ir.Expr, right: ir.Expr, known: Kinds) -> int:
    """Return the kind of a result. Operands are numbers, Points, or lists that are concatenated."""
    first, second = kind(left, known), kind(right, known)
    match op:
        case "+" if isinstance(left.type, SequenceOf):
            return max(first, second)
        case "/" if left.type == INT and right.type == INT:
            return FINITE  # an overflow raises an exception
        case "+" | "-" | "/":
            return _NUMBER_UNLESS_TWICE[first + second]
        case "*" if first + second == NUMBER and not (is_nonzero_literal(left) or is_nonzero_literal(right)):
            return ANY  # infinity times zero
        case "*":
            return _NUMBER_UNLESS_TWICE[first + second]
        case "//":
            return NUMBER if first + second == FINITE else ANY
        case _:  # the operators % and **; ** raises for an overflow
            return FINITE if first + second == FINITE else ANY


# Indexed by the sum of two kinds: infinity minus infinity is possible only if both operands may be infinite.
_NUMBER_UNLESS_TWICE = (NUMBER, NUMBER, ANY, ANY, ANY)


def is_nonzero_literal(node: ir.Expr) -> bool:
    """Return whether a factor or divisor is a literal that is not zero."""
    node = node.operand if isinstance(node, ir.Widen) else node
    return isinstance(node, ir.Const) and bool(node.value)


def _of_builtin(name: str, args: tuple[ir.Expr, ...], known: Kinds) -> int:
    worst = _worst(args, known)
    match name:
        case "min" | "max" | "sorted":  # functions that compare their arguments, so they raise for NaN
            return min(worst, NUMBER)
        case "path_distance":  # the operation raises for NaN
            return NUMBER
        case "sum":
            return NUMBER if worst == FINITE else ANY
        case _ if name in _LIKE_DIFFERENCES:
            return _NUMBER_UNLESS_TWICE[sum(kind(arg, known) for arg in args)]
        case _ if name in _TO_FINITE:
            return ANY if worst == ANY else FINITE
        case _ if name in _ALWAYS_FINITE:
            return FINITE
        case _:  # Point, abs, sqrt, appended, first, ...: the kind of the worst argument
            return worst


def may_meet_nan(formula: ir.Expr) -> bool:
    """Return whether a comparison in a formula may meet NaN although all values that the formula reads are finite."""
    for node in walk(formula):
        match node:
            case ir.Compare(_, left, right) if _worst((left, right), NOTHING_WRITTEN) == ANY:
                return True
            case ir.Contains(item, ir.Builtin("Rect" | "Ball", args)) if _worst((item, *args), NOTHING_WRITTEN):
                return True
            case _:
                pass
    return False
