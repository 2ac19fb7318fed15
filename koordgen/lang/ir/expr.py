"""Typed expressions: every node knows its type, every name is resolved, every widening is a node.

All expressions are pure; a port call alone brings in something from outside. `proved` on a node that can fail says
that the checker showed it cannot, under the guard and the path; otherwise it is checked at run time, and the event is
discarded when it fails.
"""

from __future__ import annotations

from koordgen.lang.ir.types import Type
from koordgen.lang.node import Node
from koordgen.lang.source import Span


class Const(Node):
    """A literal: int, float (finite), bool or string."""

    value: int | float | bool | str
    type: Type
    span: Span


class Pid(Node):
    """`pid`: this robot's index, an int in [0, N_SYS)."""

    type: Type
    span: Span


class NSys(Node):
    """`N_SYS`: how many robots the fleet has, an int >= 1."""

    type: Type
    span: Span


class Ids(Node):
    """`ID`: all robot indices, ascending, a List<int>."""

    type: Type
    span: Span


class ParamRead(Node):
    """A constant of the build."""

    name: str
    type: Type
    span: Span


class LocalRead(Node):
    """A variable of the `local` section."""

    name: str
    type: Type
    span: Span


class TempRead(Node):
    """A variable declared inside an event, of a loop, a quantifier or a function's parameter; names are unique within
    the event, the function or the property after checking. In a contract's `ensures`, `result` is one."""

    name: str
    type: Type
    span: Span


class SlotRead(Node):
    """`x[index]` of an allread variable: 0 <= index < N_SYS."""

    name: str
    index: Expr
    proved: bool
    type: Type
    span: Span


class SlotsRead(Node):
    """An allread variable as a whole, by pid: an argument, or what a loop runs over. Its type is PerRobot."""

    name: str
    type: Type
    span: Span


class SharedRead(Node):
    """An allwrite variable."""

    name: str
    type: Type
    span: Span


class PortRead(Node):
    """`Motion.position`: a sensor as sampled at the round's start, or an actuator's last written value.
    In an assumption `primed` stands for its value at any moment of the following delta."""

    module: str
    port: str
    primed: bool
    type: Type
    span: Span


class LocalOf(Node):
    """`v[robot]` in a property: that robot's variable of the `local` section."""

    name: str
    robot: Expr
    type: Type
    span: Span


class PortOf(Node):
    """`Motion.position[robot]` in a property: that robot's port."""

    module: str
    port: str
    robot: Expr
    type: Type
    span: Span


class Widen(Node):
    """int -> float."""

    operand: Expr
    type: Type
    span: Span


class Unary(Node):
    """op: `-` on int, float, Point; `not` on bool."""

    op: str
    operand: Expr
    type: Type
    span: Span


class Binary(Node):
    """op: `+ - * / // % **` with Python's meaning: `/` always yields a float (or a Point), `//` and `%` floor.
    Operands are of one type (widened by the checker) except Point * float, float * Point and Point / float; `+` also
    joins two strings and two lists. `proved` holds for `/ // %` whose divisor was shown to differ from zero, and for
    all others."""

    op: str
    left: Expr
    right: Expr
    proved: bool
    type: Type
    span: Span


class Compare(Node):
    """op: `== != < <= > >=` on operands of one type; order on int, float and string only."""

    op: str
    left: Expr
    right: Expr
    type: Type
    span: Span


class Contains(Node):
    """`item in values`: of a List, Queue, Set, of a Map (its keys), of a string (a part of it), or a Point in a
    Rect or Ball."""

    item: Expr
    values: Expr
    type: Type
    span: Span


class Logic(Node):
    """op: `and` or `or`; the right side is evaluated only when the left does not decide."""

    op: str
    left: Expr
    right: Expr
    type: Type
    span: Span


class Conditional(Node):
    """`then if condition else orelse`."""

    condition: Expr
    then: Expr
    orelse: Expr
    type: Type
    span: Span


class Quantified(Node):
    """`forall name in domain: body` (`exists`), in a property; the domain is `Ids`, a `Range` or a list. Several names
    arrive nested."""

    kind: str
    name: str
    domain: Expr
    body: Expr
    type: Type
    span: Span


class Range(Node):
    """`range(start, stop, step)`: only what a loop or a quantifier runs over. `step` is not 0."""

    start: Expr
    stop: Expr
    step: int
    type: Type
    span: Span


class Make(Node):
    """A value from its parts, in order: List, Queue, Set, tuple (its items), record (all its fields), Map (its keys
    and values as tuples). The type says which."""

    items: tuple[Expr, ...]
    type: Type
    span: Span


class Field(Node):
    """`operand.name`: of a Point (x, y, z: metres, local ENU frame), Pose, Grid, Scan or record."""

    operand: Expr
    name: str
    type: Type
    span: Span


class Item(Node):
    """`operand[index]` of a tuple."""

    operand: Expr
    index: int
    type: Type
    span: Span


class At(Node):
    """`operand[index]` of a List, Queue, string or PerRobot value (0 <= index < length)."""

    operand: Expr
    index: Expr
    proved: bool
    type: Type
    span: Span


class Slice(Node):
    """`operand[start:stop]` of a List or string: clipped at the length; a negative bound discards."""

    operand: Expr
    start: Expr | None
    stop: Expr | None
    proved: bool
    type: Type
    span: Span


class With(Node):
    """The operand with one part replaced: of a record `name`; of a tuple `name` is the index in digits."""

    operand: Expr
    name: str
    value: Expr
    type: Type
    span: Span


class Builtin(Node):
    """A call of a builtin, a method with its object first, or an update of a value (see ir/builtins.py)."""

    name: str
    args: tuple[Expr, ...]
    type: Type
    span: Span


class Call(Node):
    """A call of a `fun`, or in a property of a `spec fun`."""

    name: str
    args: tuple[Expr, ...]
    type: Type
    span: Span


class ExternCall(Node):
    """A call of an `extern fun`."""

    name: str
    args: tuple[Expr, ...]
    type: Type
    span: Span


class PortCall(Node):
    """A call of a callable port: an input, the same as often as the event is run again."""

    module: str
    port: str
    args: tuple[Expr, ...]
    type: Type
    span: Span


Expr = (
    Const | Pid | NSys | Ids | ParamRead | LocalRead | TempRead | SlotRead | SlotsRead | SharedRead | PortRead
    | LocalOf | PortOf | Widen | Unary | Binary | Compare | Contains | Logic | Conditional | Quantified | Range | Make
    | Field | Item | At | Slice | With | Builtin | Call | ExternCall | PortCall
)  # fmt: skip
