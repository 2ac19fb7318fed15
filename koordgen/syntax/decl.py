"""Sections of a program as they were written, in their order of writing."""

from __future__ import annotations

from typing import Literal

from koordgen.node import Node
from koordgen.source import Span
from koordgen.syntax.expr import Expr
from koordgen.syntax.stmt import Block


class Port(Node):
    """`Type name` under `sensors` or `actuators`."""

    type: str
    type_span: Span
    name: str
    span: Span


class Ports(Node):
    """A `sensors:` or `actuators:` block."""

    direction: Literal["sensor", "actuator"]
    ports: tuple[Port, ...]
    span: Span


class Using(Node):
    """`using Name:`; its span is the header's."""

    name: str
    groups: tuple[Ports, ...]
    span: Span


class Param(Node):
    """`param Type name = default`; its span is the name's."""

    type: str
    type_span: Span
    name: str
    default: Expr
    span: Span


class Variable(Node):
    """`Type name[size] = initial`, size and initial optional; its span is the name's."""

    type: str
    type_span: Span
    name: str
    size: Expr | None
    initial: Expr | None
    span: Span


class Variables(Node):
    """An `allread:`, `allwrite:` or `local:` block."""

    kind: Literal["allread", "allwrite", "local"]
    variables: tuple[Variable, ...]
    span: Span


class Init(Node):
    """`init:`"""

    block: Block
    span: Span


class Guard(Node):
    """`pre:`"""

    condition: Expr
    span: Span


class Effect(Node):
    """`eff:`"""

    block: Block
    span: Span


class Event(Node):
    """`Name:` with what stands under it, whatever the order; its span is the name's."""

    name: str
    clauses: tuple[Guard | Effect, ...]
    span: Span


Section = Using | Param | Variables | Init | Event


class Program(Node):
    """All that could be read of a text."""

    sections: tuple[Section, ...]
