"""IR of declarations and of a whole program."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from koordgen.lang.ir.expr import Expr, PortCall, Quantified, SharedRead, TempRead
from koordgen.lang.ir.stmt import Block
from koordgen.lang.ir.tree import children, walk
from koordgen.lang.ir.types import RecordType, Type
from koordgen.lang.node import Node
from koordgen.lang.source import Span


class Param(Node):
    """Param `param float margin = 0.5`: a constant of the build. `default` has literals only."""

    name: str
    type: Type
    default: Expr
    span: Span


class Record(Node):
    """Record `def Task:`. `defaults` has the constant initial values of its fields, in order."""

    type: RecordType
    defaults: tuple[Expr, ...]
    span: Span


class Parameter(Node):
    """Parameter of a function. `name` is the unique name that a TempRead in its body has."""

    name: str
    type: Type


class Function(Node):
    """Function `fun`. It is pure: its body reads its parameters and params, and calls functions.

    In `Program.functions` it stands after the functions that it calls.
    """

    name: str
    parameters: tuple[Parameter, ...]
    result: Type
    block: Block
    span: Span


class ExternFunction(Node):
    """Extern function `extern fun`, implemented in Python. It gets copies of values and must be pure.

    Its contracts read the parameters; `ensures` also reads `result`.
    """

    name: str
    parameters: tuple[Parameter, ...]
    result: Type
    requires: tuple[Expr, ...]
    ensures: tuple[Expr, ...]
    span: Span


class ExternTypeDef(Node):
    """Extern type `extern type Ticket`: a class of this name in the functions file."""

    name: str
    span: Span


class SpecFunction(Node):
    """Function `spec fun` without an implementation. Only properties use it; axioms describe it."""

    name: str
    parameters: tuple[Parameter, ...]
    result: Type
    span: Span


class Meaning(Node):
    """Meaning that a declaration gives a port. `held` and `clears` contain names of sensors of the same module.

    `is_position`: the sensor, a Point, is the robot's own position.
    `held`: the sensor whose value the actuator has before its first command; with "" the actuator has the default value
    of its type. If the program does not declare this sensor, the actuator may have any value.
    `clears`: bool sensors that are true until the first command, and false after a command of this actuator until the
    robot sets them again. Sensors that the program does not declare are ignored.
    """

    is_position: bool
    held: str
    clears: tuple[str, ...]


class Port(Node):
    """One port of a module. A callable port has the type PathPlanner, a stream the type stream.

    All back ends use `meaning`; the module `ports` has functions that read it.
    """

    name: str
    type: Type
    direction: Literal["sensor", "actuator", "callable", "stream"]
    meaning: Meaning
    span: Span


class Assumption(Node):
    """Assumption `assume formula` of a module. It holds for each robot separately.

    It reads the module's ports (primed: their values at any time during the following delta), params and pid. Temps
    that it does not bind are arguments of callable ports, and stand for all values: see `goals`.
    """

    formula: Expr
    span: Span


def goals(assumption: Assumption) -> dict[str, Type]:
    """Return the temps that stand for all values in an assumption, with their types."""
    return {arg.name: arg.type for _, args in handed(assumption.formula) for arg in args.values()}


def handed(node: Node, bound: frozenset[str] = frozenset()) -> Iterator[tuple[PortCall, dict[int, TempRead]]]:
    """Yield each call of a port whose arguments include temps that the formula does not bind.

    The second item has these temps by the index of the argument.
    """
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
    """Return the temps that a formula does not bind, with their types.

    In an axiom they stand for all values.
    """
    match node:
        case TempRead(name, type_):
            return {} if name in bound else {name: type_}
        case Quantified(_, name, domain, body):
            return {**free(domain, bound), **free(body, bound | {name})}
        case _:
            return {name: type_ for child in children(node) for name, type_ in free(child, bound).items()}


class Module(Node):
    """Module `using Motion:`: the ports of one of the robot's modules that the program uses."""

    name: str
    ports: tuple[Port, ...]
    assumptions: tuple[Assumption, ...]
    span: Span


class Shared(Node):
    """Shared variable.

    `allread`: each robot has a slot of type `type`, which only it may write. `allwrite`: one value that every robot may
    write. `initial` is constant; it may read params.
    """

    name: str
    kind: Literal["allread", "allwrite"]
    type: Type
    initial: Expr
    span: Span


class Local(Node):
    """Local variable: each robot has its own."""

    name: str
    type: Type
    initial: Expr
    span: Span


class Event(Node):
    """Event. Its `effect` takes place as a whole or not at all.

    `lock`: for an event with `atomic`, the index of its group of shared variables in `Program.locks`; None for a plain
    event. `priority`: the index of the event's `priority:` block; None outside of such blocks.
    """

    name: str
    guard: Expr
    effect: Block
    lock: int | None
    priority: int | None
    span: Span


class Property(Node):
    """Property `initially`, `invariant NAME` or `axiom NAME`, over the state of all robots."""

    kind: Literal["initially", "invariant", "axiom"]
    name: str
    formula: Expr
    span: Span


class Guarantee(Node):
    """Guarantee of an exported variable: `guarantee NAME: formula`. Each write of the variable keeps it.

    The formula reads the variable as the temp `before`, and the value after a write as the temp `after`. A formula
    without `after` is a state guarantee: it holds in every state. A formula with it is a step guarantee: it holds
    between the store just before a write and the store after it.
    """

    name: str
    before: str
    after: str
    formula: Expr
    span: Span


def is_step(guarantee: Guarantee) -> bool:
    """Return whether a guarantee compares the values before and after a write."""
    return any(isinstance(node, TempRead) and node.name == guarantee.after for node in walk(guarantee.formula))


class Export(Node):
    """Exported variable: one that other applications of the fleet may import, and write if `is_written`."""

    variable: str
    is_written: bool
    guarantees: tuple[Guarantee, ...]
    span: Span


class Import(Node):
    """Section `import NAME:`, bound to an application by the fleet file.

    `variables` has the names of all imported variables, which are in `Program.shared`: those in `slots` are allread in
    the exporter and lists here, and the program writes those in `written` only. `specs` has the names of the spec
    functions that the exporter declares as well; they are in `Program.specs`.
    """

    name: str
    variables: tuple[str, ...]
    slots: tuple[str, ...]
    written: tuple[str, ...]
    specs: tuple[str, ...]
    span: Span

    @property
    def size(self) -> str:
        """Name of the param that is the number of the exporter's members."""
        return f"{self.name}.N_SYS"

    @property
    def pid(self) -> str:
        """Name of the local variable that is this robot's place among the exporter's members, or -1."""
        return f"{self.name}.pid"


class Provided(Node):
    """Port that the program provides to the program of another fleet, for which this fleet is one robot.

    `value`: the value of a sensor, an expression over shared variables; of an actuator, the read of the allwrite
    variable into which a command is written.
    """

    port: Port
    value: Expr


class Provides(Node):
    """Section `provides NAME:`, with the ports of a module that the fleet has as one robot."""

    name: str
    ports: tuple[Provided, ...]
    span: Span


class Program(Node):
    """A checked program.

    `path` is the source's file name without folders, because bundles quote it. `locks` has disjoint groups of shared
    variables that occur together in atomic events. `shared`, `params`, `locals` and `specs` also contain what the
    imports declare, after the program's own.
    """

    name: str
    path: str
    records: tuple[Record, ...]
    extern_types: tuple[ExternTypeDef, ...]
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
    exports: tuple[Export, ...] = ()
    imports: tuple[Import, ...] = ()
    provides: tuple[Provides, ...] = ()

    def earlier(self, event: Event) -> tuple[Event, ...]:
        """Return the events before `event` in its `priority:` block; none if it stands in no block.

        `event` may only run in a round at whose start all of their guards have a value and are false.
        """
        if event.priority is None:
            return ()
        block = [other for other in self.events if other.priority == event.priority]
        return tuple(block[: [other.name for other in block].index(event.name)])


def commanded(program: Program) -> frozenset[str]:
    """Return the allwrite variables that commands from outside the fleet write; see Provides."""
    return frozenset(
        provided.value.name
        for module in program.provides
        for provided in module.ports
        if provided.port.direction == "actuator" and isinstance(provided.value, SharedRead)
    )


def own_shared(program: Program) -> list[Shared]:
    """Return the shared variables that a program itself declares, without imported ones."""
    imported = {name for each in program.imports for name in each.variables}
    return [variable for variable in program.shared if variable.name not in imported]
