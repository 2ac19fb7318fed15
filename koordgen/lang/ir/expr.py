"""IR of expressions: every node has a type, every name is resolved, every widening is a node.

All expressions are pure; only a port call has an input from outside. `proved` on a node that can fail means that the
analysis has proved that it cannot, given the guard and the path. Otherwise it is checked at run time, and the event is
discarded if it fails.
"""

from __future__ import annotations

from koordgen.lang.ir.types import Type
from koordgen.lang.node import Node
from koordgen.lang.source import Span


class Const(Node):
    """Literal int, float (finite), bool or string."""

    value: int | float | bool | str
    type: Type
    span: Span


class Pid(Node):
    """Name `pid`: this robot's index, an int in [0, N_SYS)."""

    type: Type
    span: Span


class NSys(Node):
    """Name `N_SYS`: the number of robots in the fleet, an int >= 1."""

    type: Type
    span: Span


class Ids(Node):
    """Name `ID`: all robot indices in ascending order, a List<int>."""

    type: Type
    span: Span


class ParamRead(Node):
    """Read of a param: a constant of the build."""

    name: str
    type: Type
    span: Span


class LocalRead(Node):
    """Read of a variable of the `local` section."""

    name: str
    type: Type
    span: Span


class TempRead(Node):
    """Read of a temporary: a variable of a block, a loop or a quantifier, or a function's parameter.

    After the check, names are unique within an event, a function or a property. In `ensures`, `result` is a temporary.
    """

    name: str
    type: Type
    span: Span


class SlotRead(Node):
    """Read of a robot's slot of an allread variable: `x[index]`, with 0 <= index < N_SYS."""

    name: str
    index: Expr
    proved: bool
    type: Type
    span: Span


class SlotsRead(Node):
    """Read of an allread variable as a whole, by pid: as an argument or a loop's domain.

    Its type is PerRobot.
    """

    name: str
    type: Type
    span: Span


class SharedRead(Node):
    """Read of an allwrite variable."""

    name: str
    type: Type
    span: Span


class PortRead(Node):
    """Read of a port, `Motion.position`: a sensor's value at the round's start, an actuator's last value.

    In an assumption `primed` means its value at any time during the following delta.
    """

    module: str
    port: str
    primed: bool
    type: Type
    span: Span


class LocalOf(Node):
    """Read of a robot's local variable in a property: `v[robot]`."""

    name: str
    robot: Expr
    type: Type
    span: Span


class PortOf(Node):
    """Read of a robot's port in a property: `Motion.position[robot]`."""

    module: str
    port: str
    robot: Expr
    type: Type
    span: Span


class Widen(Node):
    """Conversion of an int to a float."""

    operand: Expr
    type: Type
    span: Span


class Unary(Node):
    """Unary operator: `-` on int, float and Point; `not` on bool."""

    op: str
    operand: Expr
    type: Type
    span: Span


class Binary(Node):
    """Binary operator: `+ - * / // % **`, with the meaning that they have in Python.

    `/` always yields a float (or a Point), `//` and `%` floor. Operands are of one type (the checker widens ints),
    except for Point * float, float * Point and Point / float. `+` also joins two strings or two lists. `proved` is true
    for `/ // %` if the divisor is proved to differ from zero, and for all other operators.
    """

    op: str
    left: Expr
    right: Expr
    proved: bool
    type: Type
    span: Span


class Compare(Node):
    """Comparison: `== != < <= > >=` on operands of one type; order only for int, float and string."""

    op: str
    left: Expr
    right: Expr
    type: Type
    span: Span


class Contains(Node):
    """Containment `item in values`.

    `values` is a List, Queue or Set, a Map (its keys), a string (a part of it), or a Rect or Ball (a Point in it).
    """

    item: Expr
    values: Expr
    type: Type
    span: Span


class Logic(Node):
    """Logical operator: `and` or `or`.

    The right side is evaluated only if the left one does not decide the result.
    """

    op: str
    left: Expr
    right: Expr
    type: Type
    span: Span


class Conditional(Node):
    """Conditional `then if condition else orelse`."""

    condition: Expr
    then: Expr
    orelse: Expr
    type: Type
    span: Span


class Quantified(Node):
    """Quantifier `forall name in domain: body`, or `exists`, in a property.

    The domain is `Ids`, a `Range` or a list. A quantifier with several names is nested quantifiers here.
    """

    kind: str
    name: str
    domain: Expr
    body: Expr
    type: Type
    span: Span


class Range(Node):
    """Domain `range(start, stop, step)` of a loop or a quantifier; `step` is not 0. It is not a value."""

    start: Expr
    stop: Expr
    step: int
    type: Type
    span: Span


class Make(Node):
    """Value made of its parts, in order.

    `type` is List, Queue, Set, tuple, record (all fields) or Map (pairs as tuples).
    """

    items: tuple[Expr, ...]
    type: Type
    span: Span


class Field(Node):
    """Field `operand.name` of a Point (x, y, z in metres, local ENU frame), Pose, Grid, Scan or record."""

    operand: Expr
    name: str
    type: Type
    span: Span


class Item(Node):
    """Item `operand[index]` of a tuple."""

    operand: Expr
    index: int
    type: Type
    span: Span


class At(Node):
    """Element `operand[index]` of a List, Queue, string or PerRobot value, with 0 <= index < length."""

    operand: Expr
    index: Expr
    proved: bool
    type: Type
    span: Span


class Slice(Node):
    """Slice `operand[start:stop]` of a List or string.

    It is clipped at the length; a negative bound discards.
    """

    operand: Expr
    start: Expr | None
    stop: Expr | None
    proved: bool
    type: Type
    span: Span


class With(Node):
    """Copy of a record or tuple with one part replaced.

    `name` is the field, or the index of the item in digits.
    """

    operand: Expr
    name: str
    value: Expr
    type: Type
    span: Span


class Builtin(Node):
    """Call of a builtin, a method (its object is the first argument) or an update: see ir/builtins.py."""

    name: str
    args: tuple[Expr, ...]
    type: Type
    span: Span


class Call(Node):
    """Call of a `fun`, or, in a property, of a `spec fun`."""

    name: str
    args: tuple[Expr, ...]
    type: Type
    span: Span


class ExternCall(Node):
    """Call of an `extern fun`."""

    name: str
    args: tuple[Expr, ...]
    type: Type
    span: Span


class PortCall(Node):
    """Call of a callable port. Its answer is an input, which is the same when the event is run again."""

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
