"""Sections of a program as they were written, in their order of writing."""

from __future__ import annotations

from typing import Literal

from koordgen.lang.node import Node
from koordgen.lang.source import Span
from koordgen.lang.syntax.expr import Expr
from koordgen.lang.syntax.stmt import Block
from koordgen.lang.syntax.types import TypeExpr


class Mark(Node):
    """What a port means: `as position`, `at sensor`, `clears sensor`; its span is the name's."""

    word: Literal["as", "at", "clears"]
    name: str
    span: Span


class Port(Node):
    """`Type name marks` under `sensors` or `actuators`; `Type name` directly under `using`. Its span is the name's."""

    type: TypeExpr
    name: str
    marks: tuple[Mark, ...]
    span: Span


class Ports(Node):
    """A `sensors:` or `actuators:` block; a port directly under `using` stands in a block of its own whose direction
    is empty (a callable port or a stream)."""

    direction: Literal["sensor", "actuator", ""]
    ports: tuple[Port, ...]
    span: Span


class Assume(Node):
    """`assume formula` under `using`; its span is the word's."""

    formula: Expr
    span: Span


class Using(Node):
    """`using Name:`; its span is the header's."""

    name: str
    items: tuple[Ports | Assume, ...]
    span: Span


class Param(Node):
    """`param Type name max 8 = default`; its span is the name's."""

    type: TypeExpr
    name: str
    capacities: tuple[Expr, ...]
    default: Expr
    span: Span


class Variable(Node):
    """`Type name[size] max 16, 8 = initial`, all but the first two optional; its span is the name's."""

    type: TypeExpr
    name: str
    size: Expr | None
    capacities: tuple[Expr, ...]
    initial: Expr | None
    span: Span


class Variables(Node):
    """An `allread:`, `allwrite:` or `local:` block."""

    kind: Literal["allread", "allwrite", "local"]
    variables: tuple[Variable, ...]
    span: Span


class RecordDef(Node):
    """`def Task:` with its fields; its span is the name's."""

    name: str
    fields: tuple[Variable, ...]
    span: Span


class Parameter(Node):
    """`Type name` or `Type name[N_SYS]` among the parameters of a function; its span is the name's."""

    type: TypeExpr
    name: str
    size: Expr | None
    span: Span


class Function(Node):
    """`fun name(parameters) -> Type:`; its span is the name's. `def fun` of the 2020 dialect names no result and has
    the `def_span` of its `def`."""

    name: str
    parameters: tuple[Parameter, ...]
    result: TypeExpr | None
    block: Block
    def_span: Span | None
    span: Span


class Contract(Node):
    """`requires: formula` or `ensures: formula` under an extern function; its span is the word's."""

    kind: Literal["requires", "ensures"]
    formula: Expr
    span: Span


class ExternFunction(Node):
    """`extern fun name(parameters) -> Type`, contracts indented under it after a colon; its span is the name's."""

    name: str
    parameters: tuple[Parameter, ...]
    result: TypeExpr
    contracts: tuple[Contract, ...]
    span: Span


class ExternType(Node):
    """`extern type Name`; its span is the name's."""

    name: str
    span: Span


class SpecFunction(Node):
    """`spec fun name(parameters) -> Type`; its span is the name's."""

    name: str
    parameters: tuple[Parameter, ...]
    result: TypeExpr
    span: Span


class Property(Node):
    """`initially: formula` (its name is empty), `invariant NAME: formula`, `axiom NAME: formula`; its span is the
    name's, or the word's where there is none."""

    kind: Literal["initially", "invariant", "axiom"]
    name: str
    formula: Expr
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


class Priority(Node):
    """`priority:` with events indented under it, whose text order is their priority; its span is the word's."""

    events: tuple[Event, ...]
    span: Span


class BrokenSection(Node):
    """A section of which nothing could be read; it has been reported. `names` are the names that stand in it."""

    names: tuple[str, ...]
    span: Span


Section = (
    Using | Param | Variables | RecordDef | Function | ExternFunction | ExternType | SpecFunction | Property | Init
    | Event | Priority | BrokenSection
)  # fmt: skip


class Program(Node):
    """All that was read of a text; what could not be read is in it as broken nodes."""

    sections: tuple[Section, ...]
