"""Typed expressions: every node knows its type, every name is resolved, every widening is a node."""

from __future__ import annotations

from koordgen.ir.types import Scalar
from koordgen.node import Node
from koordgen.source import Span


class Const(Node):
    """A literal: int, float (finite) or bool."""

    value: int | float | bool
    type: Scalar
    span: Span


class Pid(Node):
    """`pid`: this robot's index, an int in [0, N_SYS)."""

    type: Scalar
    span: Span


class NSys(Node):
    """`N_SYS`: how many robots the fleet has, an int >= 1."""

    type: Scalar
    span: Span


class ParamRead(Node):
    """A constant of the build."""

    name: str
    type: Scalar
    span: Span


class LocalRead(Node):
    """A variable of the `local` section."""

    name: str
    type: Scalar
    span: Span


class TempRead(Node):
    """A variable declared inside an event; names are unique within the event after checking."""

    name: str
    type: Scalar
    span: Span


class SlotRead(Node):
    """`x[index]` of an allread variable. `proved`: the checker showed 0 <= index < N_SYS under the guard and
    the path; otherwise it is checked at run time and the event is discarded when it fails."""

    name: str
    index: Expr
    proved: bool
    type: Scalar
    span: Span


class SharedRead(Node):
    """An allwrite variable."""

    name: str
    type: Scalar
    span: Span


class PortRead(Node):
    """`Motion.position`: a sensor as sampled at the round's start, or an actuator's last written value."""

    module: str
    port: str
    type: Scalar
    span: Span


class Widen(Node):
    """int -> float."""

    operand: Expr
    type: Scalar
    span: Span


class Unary(Node):
    """op: `-` on int, float, Point; `not` on bool."""

    op: str
    operand: Expr
    type: Scalar
    span: Span


class Binary(Node):
    """op: `+ - * / // %` with Python's meaning: `/` always yields a float (or a Point), `//` and `%` floor.
    Operands are of one type (widened by the checker) except Point * float, float * Point and Point / float.
    `proved` holds for `/ // %` whose divisor the checker showed to differ from zero, and for all others."""

    op: str
    left: Expr
    right: Expr
    proved: bool
    type: Scalar
    span: Span


class Compare(Node):
    """op: `== != < <= > >=` on operands of one type; order only on int and float."""

    op: str
    left: Expr
    right: Expr
    type: Scalar
    span: Span


class Logic(Node):
    """op: `and` or `or`; the right side is evaluated only when the left does not decide."""

    op: str
    left: Expr
    right: Expr
    type: Scalar
    span: Span


class Conditional(Node):
    """`then if condition else orelse`."""

    condition: Expr
    then: Expr
    orelse: Expr
    type: Scalar
    span: Span


class Coordinate(Node):
    """`p.x`, `p.y`, `p.z`: metres, local ENU frame."""

    operand: Expr
    axis: str
    type: Scalar
    span: Span


class Builtin(Node):
    """A call of a builtin: Point(x, y, z), distance(p, q), abs, min, max (two operands), sqrt."""

    name: str
    args: tuple[Expr, ...]
    type: Scalar
    span: Span


Expr = (
    Const | Pid | NSys | ParamRead | LocalRead | TempRead | SlotRead | SharedRead | PortRead | Widen
    | Unary | Binary | Compare | Logic | Conditional | Coordinate | Builtin
)  # fmt: skip
