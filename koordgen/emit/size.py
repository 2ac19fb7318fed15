"""Static bounds of sizes: what surely stays small is emitted without a look at its size.

before: 2 * pid + 1, k += 1      after: the same
before: k * k, s + s             after: product(k, k), made(s + s)
"""

from __future__ import annotations

from koordgen.ir import expr as ir
from koordgen.ir.types import INT, STRING, Sequence

# Those of koordgen/runtime/turns.py (a test compares them).
ELEMENTS_A_TURN = 100
MOST_BITS = 4096
SMALL_BITS = 64

_ROBOTS = 16  # bits of a pid
_PLACES = 32  # bits of a length
_CHECKED = {"+": "plus", "-": "minus", "*": "product"}


def checked(node: ir.Binary) -> str:
    """Return the function of the runtime that computes `node` and looks at its size; empty where no look is due."""
    if node.type == INT and node.op in _CHECKED:
        left, right = _bits(node.left), _bits(node.right)
        if node.op != "*" and min(left, right) <= SMALL_BITS:
            return ""
        size = left + right if node.op == "*" else max(left, right) + 1
        return _CHECKED[node.op] if size > MOST_BITS else ""
    if node.op == "+" and (node.type == STRING or isinstance(node.type, Sequence)):
        return "made" if _length(node) >= ELEMENTS_A_TURN else ""
    return ""


def _bits(node: ir.Expr) -> int:
    """Return a bound of the bits of an int."""
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
    """Return a bound of the characters of a text, or the elements of a list."""
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
