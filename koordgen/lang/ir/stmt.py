"""Typed statements. A block is a tuple of them.

What changes a part of a value arrives as an assignment of the whole: `a[i] = v` as `a := updated(a, i, v)`. `atomic`
blocks are inlined: an event that contains one is a transaction as a whole.
"""

from __future__ import annotations

from koordgen.lang.ir.expr import Expr
from koordgen.lang.ir.types import Type
from koordgen.lang.node import Node
from koordgen.lang.source import Span


class LocalPlace(Node):
    """A variable of the `local` section."""

    name: str


class OwnSlot(Node):
    """The acting robot's slot of an allread variable: `x[pid] = ...`."""

    name: str


class SharedPlace(Node):
    """An allwrite variable, as a whole."""

    name: str


class PortPlace(Node):
    """An actuator."""

    module: str
    port: str


class TempPlace(Node):
    """A variable declared inside the event or function."""

    name: str


Place = LocalPlace | OwnSlot | SharedPlace | PortPlace | TempPlace


class Assign(Node):
    """`place = value`; both of one type. `+=` and friends arrive here already spelled out."""

    place: Place
    value: Expr
    span: Span


class Let(Node):
    """`Point goal = value`: a variable that lives to the end of its block."""

    name: str
    type: Type
    value: Expr
    span: Span


class If(Node):
    """`elif` arrives as an If in `orelse`."""

    condition: Expr
    then: Block
    orelse: Block
    span: Span


class LoopInvariant(Node):
    """A condition that is evaluated at a loop's head: before the first turn, before each further turn, and when the
    condition of `while` is false or the elements of `for` are used up. A false one is reported and changes nothing."""

    formula: Expr
    span: Span


class For(Node):
    """Runs over the value of `values` as it is at the start. One name takes each element (of a Map: each key); several
    names take the items of each element, a tuple of that length. The names live in the block. Over a Range or Ids, the
    name may stand in an invariant, where it is the next value: `start` at first, at the end the first value not taken.
    """

    names: tuple[str, ...]
    types: tuple[Type, ...]
    values: Expr
    block: Block
    span: Span
    invariants: tuple[LoopInvariant, ...] = ()


class While(Node):
    """`while condition:`"""

    condition: Expr
    block: Block
    span: Span
    invariants: tuple[LoopInvariant, ...] = ()


class Break(Node):
    """Leaves the innermost loop."""

    span: Span


class Continue(Node):
    """Goes on with the innermost loop."""

    span: Span


class Return(Node):
    """A function's result; only in functions, every way through one ends in it."""

    value: Expr
    span: Span


class Emit(Node):
    """`Log.stdout << a << b`: one line of text to a stream, the items' texts joined, when the event counts.
    The items are strings (the checker puts `str` around numbers and bools, and shows a Point as `(x, y, z)`)."""

    module: str
    port: str
    items: tuple[Expr, ...]
    span: Span


class Stop(Node):
    """`stop`: the event ends here; once it counts, the robot holds for good."""

    span: Span


Stmt = Assign | Let | If | For | While | Break | Continue | Return | Emit | Stop
Block = tuple[Stmt, ...]
