"""Declarations and the whole program, as every back end reads it."""

from __future__ import annotations

from typing import Literal

from koordgen.ir.expr import Expr
from koordgen.ir.stmt import Block
from koordgen.ir.types import Scalar
from koordgen.node import Node
from koordgen.source import Span


class Param(Node):
    """`param float margin = 0.5`: a constant of the build; `default` reads nothing but other literals."""

    name: str
    type: Scalar
    default: Expr
    span: Span


class Port(Node):
    """One sensor or actuator of a module."""

    name: str
    type: Scalar
    direction: Literal["sensor", "actuator"]
    span: Span


class Module(Node):
    """`using Motion:`: the ports that the program uses of one of the robot's modules."""

    name: str
    ports: tuple[Port, ...]
    span: Span


class Shared(Node):
    """A shared variable. `allread`: one slot of `type` a robot, written by its owner only;
    `allwrite`: one value that every robot may write. `initial` is constant, params included."""

    name: str
    kind: Literal["allread", "allwrite"]
    type: Scalar
    initial: Expr
    span: Span


class Local(Node):
    """A variable of the robot's own."""

    name: str
    type: Scalar
    initial: Expr
    span: Span


class Event(Node):
    """`guard` has no effects; `effect` takes place as a whole or not at all."""

    name: str
    guard: Expr
    effect: Block
    span: Span


class Program(Node):
    """A checked program. `path` is the source's file name without its folders (bundles quote it)."""

    name: str
    path: str
    params: tuple[Param, ...]
    modules: tuple[Module, ...]
    shared: tuple[Shared, ...]
    locals: tuple[Local, ...]
    init: Block
    events: tuple[Event, ...]
