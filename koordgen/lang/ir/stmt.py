"""IR of statements. A block is a tuple of statements.

A change of a part of a value is an assignment of the whole: `a[i] = v` is `a := updated(a, i, v)`. `atomic` blocks are
inlined: an event that contains one is a transaction as a whole.
"""

from __future__ import annotations

from koordgen.lang.ir.expr import Expr
from koordgen.lang.ir.types import Type
from koordgen.lang.node import Node
from koordgen.lang.source import Span


class LocalPlace(Node):
    """Target: a variable of the `local` section."""

    name: str


class OwnSlot(Node):
    """Target `x[pid] = ...`: the robot's own slot of an allread variable."""

    name: str


class SharedPlace(Node):
    """Target: an allwrite variable as a whole."""

    name: str


class PortPlace(Node):
    """Target: an actuator."""

    module: str
    port: str


class TempPlace(Node):
    """Target: a temporary of the event or function."""

    name: str


Place = LocalPlace | OwnSlot | SharedPlace | PortPlace | TempPlace


class Assign(Node):
    """Assignment `place = value`; both have the same type. `x += v` is `x = x + v` here."""

    place: Place
    value: Expr
    span: Span


class Let(Node):
    """Declaration `Point goal = value` of a temporary, which exists until the end of its block."""

    name: str
    type: Type
    value: Expr
    span: Span


class If(Node):
    """Statement `if`. An `elif` is an If in `orelse`."""

    condition: Expr
    then: Block
    orelse: Block
    span: Span


class LoopInvariant(Node):
    """Loop invariant: a condition evaluated at the loop's head, before each iteration and after the last.

    A false one is reported and changes nothing.
    """

    formula: Expr
    span: Span


class For(Node):
    """Loop `for`, over the value that `values` has when the loop begins.

    A single name takes each element (of a Map: each key); several names take the items of each element, a tuple of that
    length. The names exist within the block. For a Range or Ids, an invariant may read the name; there it is the next
    value: `start` at first, at the end the first unused value.
    """

    names: tuple[str, ...]
    types: tuple[Type, ...]
    values: Expr
    block: Block
    span: Span
    invariants: tuple[LoopInvariant, ...] = ()


class While(Node):
    """Loop `while condition:`."""

    condition: Expr
    block: Block
    span: Span
    invariants: tuple[LoopInvariant, ...] = ()


class Break(Node):
    """Statement `break`: leaves the innermost loop."""

    span: Span


class Continue(Node):
    """Statement `continue`: goes on with the next iteration of the innermost loop."""

    span: Span


class Return(Node):
    """Statement `return value`, only in functions. Every path through a function ends with one."""

    value: Expr
    span: Span


class Emit(Node):
    """Statement `Log.stdout << a << b`: writes a line to a stream unless the event is discarded.

    The line is the concatenation of the items. They are strings: the checker puts `str` around numbers, bools and
    Points, which are shown as `(x, y, z)`.
    """

    module: str
    port: str
    items: tuple[Expr, ...]
    span: Span


class Stop(Node):
    """Statement `stop`: ends the event. Unless the event is discarded, the robot stops for good."""

    span: Span


Stmt = Assign | Let | If | For | While | Break | Continue | Return | Emit | Stop
Block = tuple[Stmt, ...]
