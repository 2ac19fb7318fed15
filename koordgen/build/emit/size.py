"""Static bounds of sizes: a value that always stays small is emitted without a size check.

before: 2 * pid + 1, k += 1      after: the same
before: k * k, s + s             after: product(k, k), made(s + s)
before: 3 in few, sum(many)      after: the same, sum(looked(many)); `few` has a capacity below ELEMENTS_A_TURN
"""

from __future__ import annotations

from collections.abc import Container
from math import inf

from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt
from koordgen.lang.ir.types import (
    INT,
    STRING,
    ExternType,
    MapOf,
    PerRobot,
    RecordType,
    Scalar,
    Sequence,
    Sized,
    TupleOf,
    Type,
)

# These limits are equal to those of koordgen/runtime/values/turns.py (a test compares them).
ELEMENTS_A_TURN = 100
CELLS_AN_ELEMENT = 100
MOST_BITS = 4096
SMALL_BITS = 64

_ROBOTS = 16  # largest number of bits of a pid
_PLACES = 32  # largest number of bits of a length or an index
_CHECKED = {"+": "plus", "-": "minus", "*": "product"}


def checked(node: ir.Binary) -> str:
    """Return the runtime function that computes `node` and checks the result's size; "" if no check is needed."""
    if node.type == INT and node.op in _CHECKED:
        left, right = _bits(node.left), _bits(node.right)
        if node.op != "*" and min(left, right) <= SMALL_BITS:
            return ""
        size = left + right if node.op == "*" else max(left, right) + 1
        return _CHECKED[node.op] if size > MOST_BITS else ""
    if node.op == "+" and (node.type == STRING or isinstance(node.type, Sequence)):
        return "made" if _length(node) >= ELEMENTS_A_TURN else ""
    return ""


def is_small(node: ir.Expr) -> bool:
    """Return whether the value of an int expression always fits into a variable, whatever the expression reads."""
    return _bits(node) < SMALL_BITS


def _bits(node: ir.Expr) -> int:
    """Return an upper bound of the number of bits of an int expression's value."""
    match node:
        case ir.Const(int() as value):
            return value.bit_length()
        case ir.Compare() | ir.Logic():
            return 1
        case ir.Pid() | ir.NSys():
            return _ROBOTS
        case ir.Unary("-", operand) | ir.Builtin("abs", (operand,)):
            return _bits(operand)
        case ir.Builtin("len" | "count" | "index"):
            return _PLACES
        case ir.Builtin("min" | "max", (left, right)) | ir.Conditional(_, left, right):
            return max(_bits(left), _bits(right))
        case ir.Binary("%", _, right):
            return _bits(right)
        case ir.Binary("//" | "/", left):
            return _bits(left) + 1
        case ir.Binary("+" | "-", left, right):
            return max(_bits(left), _bits(right)) + 1
        case ir.Binary("*", left, right):
            return _bits(left) + _bits(right)
        case _:
            return MOST_BITS + SMALL_BITS


def _length(node: ir.Expr) -> int:
    """Return an upper bound of the number of characters of a text, or of elements of a list."""
    match node:
        case ir.Const(str() as value):
            return len(value)
        case ir.Make(items):
            return len(items)
        case ir.Conditional(_, left, right):
            return max(_length(left), _length(right))
        case ir.Binary("+", left, right):
            return _length(left) + _length(right)
        case _:
            return ELEMENTS_A_TURN


def looks(node: ir.Expr, written: Container[stmt.Place]) -> str:
    """Return the runtime function that counts the turns of an iteration over a value; "" if they are always 0.

    The value of a variable that the block has not `written` is within its declared capacity.
    """
    if _weight(node, written) < ELEMENTS_A_TURN:
        return ""
    is_flat = node.type == STRING or (isinstance(node.type, Sequence) and not _most(node.type.element, False))
    return "looked" if is_flat else "looked_in"


def _weight(node: ir.Expr, written: Container[stmt.Place]) -> float:
    """Return an upper bound of the number of elements of a value. The runtime's function `elements` counts them."""
    match node:
        case ir.Const(str() as text):
            return len(text)
        case ir.Ids():
            return 0
        case ir.Make(items, type_):
            own = 0 if isinstance(type_, RecordType) else len(items)
            return own + sum(_weight(item, written) for item in items)
        case ir.Conditional(_, left, right):
            return max(_weight(left, written), _weight(right, written))
        case ir.LocalRead(name) if stmt.LocalPlace(name) not in written:
            return _most(node.type, True)
        case ir.SlotRead(name) if stmt.OwnSlot(name) not in written:
            return _most(node.type, True)
        case ir.SharedRead(name) if stmt.SharedPlace(name) not in written:
            return _most(node.type, True)
        case ir.ParamRead() | ir.LocalOf():
            return _most(node.type, True)
        case _:
            return _most(node.type, False)


def _most(type_: Type, kept: bool) -> float:
    """Return the most elements of a value of a type.

    `kept`: the value was stored in a variable, so capacities hold. Otherwise containers have no bound (infinity).
    """
    match type_:
        case Sized("GridMap", capacity) if kept:
            return capacity // CELLS_AN_ELEMENT
        case Sized(name, capacity) if kept:
            return capacity if name == "string" else 2 * capacity
        case Sequence(_, element, capacity) if kept:
            return capacity * (1 + _most(element, kept))
        case MapOf(key, value, capacity) if kept:
            return capacity * (3 + _most(key, kept) + _most(value, kept))
        case Sized() | Sequence() | MapOf():
            return inf
        case TupleOf(items):
            return len(items) + sum(_most(item, kept) for item in items)
        case RecordType(_, fields):
            return sum(_most(field, kept) for _, field in fields)
        case PerRobot(element):
            return 0 if _is_plain(element) else inf
        case _:
            return 0


def _is_plain(type_: Type) -> bool:
    """Return whether values of a type have no elements."""
    return isinstance(type_, (Scalar, ExternType))
