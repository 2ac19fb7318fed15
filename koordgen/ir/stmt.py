"""Typed statements. A block is a tuple of them."""

from __future__ import annotations

from koordgen.ir.expr import Expr
from koordgen.ir.types import Scalar
from koordgen.node import Node
from koordgen.source import Span


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
    """A variable declared inside the event."""

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
    type: Scalar
    value: Expr
    span: Span


class If(Node):
    """`elif` arrives as an If in `orelse`."""

    condition: Expr
    then: Block
    orelse: Block
    span: Span


class Stop(Node):
    """`stop`: the event ends here; once it counts, the robot holds for good."""

    span: Span


Stmt = Assign | Let | If | Stop
Block = tuple[Stmt, ...]
