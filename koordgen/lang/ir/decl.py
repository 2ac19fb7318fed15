"""Declarations and the whole program, as every back end reads it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from koordgen.lang.ir.expr import Expr, PortCall, Quantified, TempRead
from koordgen.lang.ir.stmt import Block
from koordgen.lang.ir.tree import children
from koordgen.lang.ir.types import RecordType, Type
from koordgen.lang.node import Node
from koordgen.lang.source import Span


class Param(Node):
    """`param float margin = 0.5`: a constant of the build; `default` reads nothing but other literals."""

    name: str
    type: Type
    default: Expr
    span: Span


class Record(Node):
    """`def Task:`; `defaults` are the fields' constant first values, in order."""

    type: RecordType
    defaults: tuple[Expr, ...]
    span: Span


class Parameter(Node):
    """A function's parameter, by the unique name that its body reads (TempRead)."""

    name: str
    type: Type


class Function(Node):
    """`fun`: pure; its body reads its parameters, constants of the build and what it calls. Functions stand behind
    those that they call."""

    name: str
    parameters: tuple[Parameter, ...]
    result: Type
    block: Block
    span: Span


class ExternFunction(Node):
    """`extern fun`, implemented in Python: gets copies, must be pure. Contracts read the parameters; `ensures` also
    `result`."""

    name: str
    parameters: tuple[Parameter, ...]
    result: Type
    requires: tuple[Expr, ...]
    ensures: tuple[Expr, ...]
    span: Span


class ExternType(Node):
    """`extern type Ticket`: a class of that name in the Python file."""

    name: str
    span: Span


class SpecFunction(Node):
    """`spec fun`: a name that only properties use; axioms say what is known of it."""

    name: str
    parameters: tuple[Parameter, ...]
    result: Type
    span: Span


class Meaning(Node):
    """Meaning of a port beside its value. The names are those of sensors of the same module.

    `is_position`: the sensor, a Point, is where the robot itself is.
    `held`: the sensor whose value the actuator has before it is written, since an unset actuator holds; "" for the
    type's default. A program need not declare that sensor: then the value may be any.
    `clears`: bool sensors that are true until the first command, and false from a command of this actuator on, until
    the robot says otherwise. Those that the program does not declare play no part in it.
    """

    is_position: bool
    held: str
    clears: tuple[str, ...]


class Port(Node):
    """One port of a module. A callable port has the type PathPlanner, a stream the type stream.

    `meaning` is what all back ends go by; see `ports`, which reads it.
    """

    name: str
    type: Type
    direction: Literal["sensor", "actuator", "callable", "stream"]
    meaning: Meaning
    span: Span


class Assumption(Node):
    """`assume formula` of a module: holds of every robot separately, over that module's ports (primed: at any moment of
    the following delta), params and pid. Temps that it does not bind are handed to callable ports, and stand for all
    values there: see `goals`."""

    formula: Expr
    span: Span


def goals(assumption: Assumption) -> dict[str, Type]:
    """The temps that stand for all values in an assumption, with their types."""
    return {arg.name: arg.type for _, args in handed(assumption.formula) for arg in args.values()}


def handed(node: Node, bound: frozenset[str] = frozenset()) -> Iterator[tuple[PortCall, dict[int, TempRead]]]:
    """The calls of ports in a formula to which temps are handed that it does not bind; and these, by their places."""
    if isinstance(node, Quantified):
        yield from handed(node.domain, bound)
        yield from handed(node.body, bound | {node.name})
        return
    if isinstance(node, PortCall):
        places = enumerate(node.args)
        free = {place: arg for place, arg in places if isinstance(arg, TempRead) and arg.name not in bound}
        if free:
            yield node, free
    for child in children(node):
        yield from handed(child, bound)


def free(node: Node, bound: frozenset[str] = frozenset()) -> dict[str, Type]:
    """The temps that a formula does not bind, with their types: in an axiom they stand for all values."""
    match node:
        case TempRead(name, type_):
            return {} if name in bound else {name: type_}
        case Quantified(_, name, domain, body):
            return {**free(domain, bound), **free(body, bound | {name})}
        case _:
            return {name: type_ for child in children(node) for name, type_ in free(child, bound).items()}


class Module(Node):
    """`using Motion:`: the ports that the program uses of one of the robot's modules."""

    name: str
    ports: tuple[Port, ...]
    assumptions: tuple[Assumption, ...]
    span: Span


class Shared(Node):
    """A shared variable. `allread`: one slot of `type` a robot, written by its owner only;
    `allwrite`: one value that every robot may write. `initial` is constant, params included."""

    name: str
    kind: Literal["allread", "allwrite"]
    type: Type
    initial: Expr
    span: Span


class Local(Node):
    """A variable of the robot's own."""

    name: str
    type: Type
    initial: Expr
    span: Span


class Event(Node):
    """`guard` has no effects; `effect` takes place as a whole or not at all. `lock`: of an event that contains `atomic`
    the index of its group of shared variables in `Program.locks`; None of a plain event. `priority`: the index of the
    `priority:` block in which the event stands; None outside of such blocks."""

    name: str
    guard: Expr
    effect: Block
    lock: int | None
    priority: int | None
    span: Span


class Property(Node):
    """`initially`, `invariant NAME`, `axiom NAME`: over the global store, every robot's locals and ports."""

    kind: Literal["initially", "invariant", "axiom"]
    name: str
    formula: Expr
    span: Span


class Program(Node):
    """A checked program. `path` is the source's file name without its folders (bundles quote it). `locks`: groups of
    shared variables that occur together in atomic events; no two groups share one."""

    name: str
    path: str
    records: tuple[Record, ...]
    extern_types: tuple[ExternType, ...]
    functions: tuple[Function, ...]
    externs: tuple[ExternFunction, ...]
    specs: tuple[SpecFunction, ...]
    params: tuple[Param, ...]
    modules: tuple[Module, ...]
    shared: tuple[Shared, ...]
    locals: tuple[Local, ...]
    locks: tuple[tuple[str, ...], ...]
    init: Block
    events: tuple[Event, ...]
    properties: tuple[Property, ...]

    def earlier(self, event: Event) -> tuple[Event, ...]:
        """The events that stand before `event` in its `priority:` block; none where it stands in no block.

        `event` may run only in a round at whose start each of their guards has a value and is false."""
        if event.priority is None:
            return ()
        block = [other for other in self.events if other.priority == event.priority]
        return tuple(block[: [other.name for other in block].index(event.name)])
