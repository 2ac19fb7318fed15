"""Syntax tree of a program's sections, in the order of the text."""

from __future__ import annotations

from typing import Literal

from koordgen.lang.node import Node
from koordgen.lang.source import Span
from koordgen.lang.syntax.expr import Expr
from koordgen.lang.syntax.stmt import Block
from koordgen.lang.syntax.types import TypeExpr


class Mark(Node):
    """Mark that gives a port a meaning: `as position`, `at sensor`, `clears sensor`.

    Its span is the name's.
    """

    word: Literal["as", "at", "clears"]
    name: str
    span: Span


class Port(Node):
    """Port: `Type name marks` under `sensors` or `actuators`, `Type name` directly under `using`.

    Span of the name.
    """

    type: TypeExpr
    name: str
    marks: tuple[Mark, ...]
    span: Span


class Ports(Node):
    """Block `sensors:` or `actuators:`.

    A port directly under `using`, which is a callable port or a stream, is a block of its own with an empty direction.
    """

    direction: Literal["sensor", "actuator", ""]
    ports: tuple[Port, ...]
    span: Span


class Assume(Node):
    """Assumption: `assume formula` under `using`. Its span is the keyword's."""

    formula: Expr
    span: Span


class Using(Node):
    """Section `using Name:`. Its span is the header's."""

    name: str
    items: tuple[Ports | Assume, ...]
    span: Span


class Param(Node):
    """Section `param Type name max 8 = default`. Its span is the name's."""

    type: TypeExpr
    name: str
    capacities: tuple[Expr, ...]
    default: Expr
    span: Span


class Variable(Node):
    """Variable: `Type name[size] max 16, 8 = initial`; only type and name are required.

    Its span is the name's.
    """

    type: TypeExpr
    name: str
    size: Expr | None
    capacities: tuple[Expr, ...]
    initial: Expr | None
    span: Span


class Variables(Node):
    """Section `allread:`, `allwrite:` or `local:`."""

    kind: Literal["allread", "allwrite", "local"]
    variables: tuple[Variable, ...]
    span: Span


class RecordDef(Node):
    """Section `def Task:` with its fields. Its span is the name's."""

    name: str
    fields: tuple[Variable, ...]
    span: Span


class Parameter(Node):
    """Parameter of a function: `Type name` or `Type name[N_SYS]`. Its span is the name's."""

    type: TypeExpr
    name: str
    size: Expr | None
    span: Span


class Function(Node):
    """Section `fun name(parameters) -> Type:`. Its span is the name's.

    `def fun` of the 2020 dialect declares no result type; `def_span` is the span of its `def`.
    """

    name: str
    parameters: tuple[Parameter, ...]
    result: TypeExpr | None
    block: Block
    def_span: Span | None
    span: Span


class Contract(Node):
    """Contract of an extern function: `requires: formula` or `ensures: formula`.

    Its span is the keyword's.
    """

    kind: Literal["requires", "ensures"]
    formula: Expr
    span: Span


class ExternFunction(Node):
    """Section `extern fun name(parameters) -> Type`, with indented contracts after a colon.

    Its span is the name's.
    """

    name: str
    parameters: tuple[Parameter, ...]
    result: TypeExpr
    contracts: tuple[Contract, ...]
    span: Span


class ExternType(Node):
    """Section `extern type Name`. Its span is the name's."""

    name: str
    span: Span


class SpecFunction(Node):
    """Section `spec fun name(parameters) -> Type`. Its span is the name's."""

    name: str
    parameters: tuple[Parameter, ...]
    result: TypeExpr
    span: Span


class Property(Node):
    """Section `initially: formula`, `invariant NAME: formula` or `axiom NAME: formula`.

    `initially` has an empty name. The span is the name's, or the keyword's if there is no name.
    """

    kind: Literal["initially", "invariant", "axiom"]
    name: str
    formula: Expr
    span: Span


class Init(Node):
    """Section `init:`."""

    block: Block
    span: Span


class Guard(Node):
    """Guard of an event: `pre:`."""

    condition: Expr
    span: Span


class Effect(Node):
    """Effect of an event: `eff:`."""

    block: Block
    span: Span


class Event(Node):
    """Event: `Name:` and its clauses in the order of the text. Its span is the name's."""

    name: str
    clauses: tuple[Guard | Effect, ...]
    span: Span


class Priority(Node):
    """Section `priority:` with indented events, in the order of their priority. Its span is the keyword's."""

    events: tuple[Event, ...]
    span: Span


class Guarantee(Node):
    """Guarantee of an exported variable: `guarantee Name: formula`. Its span is the name's."""

    name: str
    formula: Expr
    span: Span


class Exported(Node):
    """Exported variable: `Type name` or `Type name[N_SYS]`, and its guarantees.

    `is_written`: with `write` before it, other applications may write the variable. Its span is the name's.
    """

    type: TypeExpr
    name: str
    size: Expr | None
    is_written: bool
    guarantees: tuple[Guarantee, ...]
    span: Span


class Export(Node):
    """Section `export:`. Its span is the keyword's."""

    variables: tuple[Exported, ...]
    span: Span


class Imported(Node):
    """Imported variable: `Type name[Name.N_SYS] max 16`, or `write Type name` if this program writes it.

    Its span is the name's.
    """

    type: TypeExpr
    name: str
    size: Expr | None
    capacities: tuple[Expr, ...]
    is_written: bool
    span: Span


class Import(Node):
    """Section `import Name:`. Its span is the name's."""

    name: str
    items: tuple[Imported | SpecFunction, ...]
    span: Span


class Provided(Node):
    """Port that the program provides: `Type name as position = value`. Its span is the name's."""

    type: TypeExpr
    name: str
    marks: tuple[Mark, ...]
    value: Expr
    span: Span


class ProvidedPorts(Node):
    """Block `sensors:` or `actuators:` under `provides Name:`. Its span is the keyword's."""

    direction: Literal["sensor", "actuator"]
    ports: tuple[Provided, ...]
    span: Span


class Provides(Node):
    """Section `provides Name:`. Its span is the header's."""

    name: str
    items: tuple[ProvidedPorts, ...]
    span: Span


class BrokenSection(Node):
    """A section that could not be parsed; the error is already reported. `names` has all names in it."""

    names: tuple[str, ...]
    span: Span


Section = (
    Using | Param | Variables | RecordDef | Function | ExternFunction | ExternType | SpecFunction | Property | Init
    | Event | Priority | Export | Import | Provides | BrokenSection
)  # fmt: skip


class Program(Node):
    """Syntax tree of a program. Text that could not be parsed is in it as broken nodes."""

    sections: tuple[Section, ...]
