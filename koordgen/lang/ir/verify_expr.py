"""Verifier of expressions: checks the type of each node against its parts, and that its section allows it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, assert_never

from koordgen.lang.ir import decl, expr
from koordgen.lang.ir.types import (
    BALL,
    BOOL,
    FLOAT,
    GRID,
    GRIDMAP,
    INT,
    PLANNER,
    POINT,
    RECT,
    SCAN,
    STREAM,
    STRING,
    ExternType,
    MapOf,
    PerRobot,
    RecordType,
    Sequence,
    TupleOf,
    Type,
    list_of,
)
from koordgen.lang.ir.verify_type import (
    ORDERED_TYPES,
    at_type,
    binary_type,
    builtin_type,
    fail,
    fields_of,
    fits,
    literal_type,
    require,
)
from koordgen.lang.node import Node
from koordgen.lang.source import Span

# Sections that allow a node, if not all do: `literal` (defaults of params and records), `constant` (other initial
# values), `init`, `guard`, `effect`, `function`, `contract`, `property`, `assume`, `guarantee`, `provided`.
_ACTING = frozenset(("init", "guard", "effect"))
_PLACES: dict[type, frozenset[str]] = {
    expr.Pid: _ACTING | {"assume"},
    expr.NSys: _ACTING | {"property", "assume", "guarantee", "provided"},
    expr.Ids: _ACTING | {"property", "assume", "guarantee", "provided"},
    expr.ParamRead: _ACTING | {"constant", "function", "contract", "property", "assume", "guarantee", "provided"},
    expr.LocalRead: _ACTING,
    expr.SlotRead: _ACTING | {"property", "provided"},
    expr.SlotsRead: frozenset(("guard", "effect", "property", "provided")),
    expr.SharedRead: frozenset(("guard", "effect", "property", "provided")),
    expr.PortRead: _ACTING | {"assume"},
    expr.LocalOf: frozenset(("property",)),
    expr.PortOf: frozenset(("property",)),
    expr.Quantified: frozenset(("contract", "property", "assume", "guarantee", "provided")),
    expr.Call: _ACTING | {"function", "contract", "property", "assume", "guarantee", "provided"},
    expr.ExternCall: _ACTING | {"function", "contract", "property", "assume", "guarantee", "provided"},
    expr.PortCall: frozenset(("init", "effect", "assume")),
}


class Expressions:
    """Verifier of a program's expressions: its declarations, and the state of the current section."""

    def __init__(self, program: decl.Program) -> None:
        self.program = program
        self.params: dict[str, Type] = {p.name: p.type for p in program.params}
        self.locals: dict[str, Type] = {v.name: v.type for v in program.locals}
        self.slots: dict[str, Type] = {v.name: v.type for v in program.shared if v.kind == "allread"}
        self.cells: dict[str, Type] = {v.name: v.type for v in program.shared if v.kind == "allwrite"}
        self.ports = {(m.name, p.name): p for m in program.modules for p in m.ports}
        self.records = {r.type.name: r.type for r in program.records}
        self.extern_types = {t.name for t in program.extern_types}
        self.signatures = {f.name: f for f in program.functions}
        self.externs = {f.name: f for f in program.externs}
        self.specs = {f.name: f for f in program.specs}
        self.callees = set(self.signatures)  # functions that may be called; in a function: those before it
        self.enter("constant")

    def enter(self, place: str) -> None:
        """Begin a section, without temps."""
        self.place = place
        self.temps: dict[str, Type] = {}
        self.minted: set[str] = set()
        self.shared: set[str] = set()  # shared variables that the section reads or writes
        self.module = ""
        self.result: Type | None = None
        self.loops = 0
        self.at_head = False  # inside a loop invariant

    def declare(self, name: str, type_: Type, span: Span) -> None:
        require(name not in self.minted, f"{name} is declared twice in one {self.place}", span)
        self.minted.add(name)
        self.temps[name] = type_

    def known(self, declared: dict[str, Type], name: str, span: Span) -> Type:
        found = declared.get(name)
        return fail(f"{name} is not declared", span) if found is None else found

    def typed(self, node: expr.Expr, type_: Type) -> None:
        """Verify a node and that it has a type."""
        found = self.type_of(node)
        if found is not type_ and found != type_:
            require(False, f"expected a {type_}, found a {found}", node.span)

    def type_of(self, node: expr.Expr) -> Type:
        """Verify a node and return its type, which is derived from its parts."""
        kind = type(node)
        places = _PLACES.get(kind)
        if self.at_head and kind is expr.PortCall:
            require(False, "a PortCall is not allowed in a loop invariant", node.span)
        if places is not None and self.place not in places and not (self.at_head and kind is expr.Quantified):
            require(False, f"a {kind.__name__} is not allowed in a {self.place}", node.span)
        found: Type = _READERS.get(kind, Expressions.unknown)(self, node)
        if found is not node.type and found != node.type:
            require(False, f"a node has the type {node.type}, but its parts yield {found}", node.span)
        return found

    def unknown(self, node: Node) -> Type:
        return fail(f"{type(node).__name__} is not an expression", node.span)  # type: ignore[attr-defined]

    # Reads

    def const(self, node: expr.Const) -> Type:
        return literal_type(node.value, node.span)

    def temp(self, node: expr.TempRead) -> Type:
        return self.known(self.temps, node.name, node.span)

    def index(self, node: expr.Pid | expr.NSys) -> Type:
        return INT

    def local(self, node: expr.LocalRead) -> Type:
        return self.known(self.locals, node.name, node.span)

    def slot(self, node: expr.SlotRead) -> Type:
        self.shared.add(node.name)
        self.typed(node.index, INT)
        require(
            self.place != "init" or isinstance(node.index, expr.Pid), "init reads the slot of another robot", node.span
        )
        return self.known(self.slots, node.name, node.span)

    def cell(self, node: expr.SharedRead) -> Type:
        self.shared.add(node.name)
        return self.known(self.cells, node.name, node.span)

    def port_read(self, node: expr.PortRead) -> Type:
        require(not node.primed or self.place == "assume", "a primed port is only allowed in an assumption", node.span)
        return self.port(node.module, node.port, node.span)

    def read(self, node: expr.ParamRead | expr.SlotsRead | expr.LocalOf | expr.PortOf | expr.Ids) -> Type:
        span = node.span
        match node:
            case expr.ParamRead(name):
                return self.known(self.params, name, span)
            case expr.SlotsRead(name):
                self.shared.add(name)
                return PerRobot(self.known(self.slots, name, span))
            case expr.LocalOf(name, robot):
                self.typed(robot, INT)
                return self.known(self.locals, name, span)
            case expr.PortOf(module, port, robot):
                self.typed(robot, INT)
                return self.port(module, port, span)
            case expr.Ids():
                return list_of(INT)
            case _:
                assert_never(node)

    def port(self, module: str, port: str, span: Span) -> Type:
        found = self.ports.get((module, port))
        if found is None or found.direction not in ("sensor", "actuator"):
            return fail(f"{module}.{port} cannot be read", span)
        if self.place == "assume" and module != self.module:
            require(False, f"{module}.{port} belongs to another module", span)
        return found.type

    # Operations

    def binary(self, node: expr.Binary) -> Type:
        op = node.op
        if not node.proved and op not in ("/", "//", "%"):
            require(False, f"{op} cannot fail, but is not marked as proved", node.span)
        return binary_type(op, self.type_of(node.left), self.type_of(node.right), node.span)

    def compare(self, node: expr.Compare) -> Type:
        op, type_ = node.op, self.type_of(node.left)
        self.typed(node.right, type_)
        if type_ is INT or type_ is FLOAT or type_ in ORDERED_TYPES:
            require(op in ("==", "!=", "<", "<=", ">", ">="), "the operator is not a comparison", node.span)
        elif type_ in (RECT, BALL, PLANNER, STREAM) or op not in ("==", "!="):
            require(False, f"{op} does not apply to {type_}", node.span)
        return BOOL

    def logic(self, node: expr.Logic) -> Type:
        require(node.op in ("and", "or"), "the operator is neither 'and' nor 'or'", node.span)
        self.typed(node.left, BOOL)
        self.typed(node.right, BOOL)
        return BOOL

    def widen(self, node: expr.Widen) -> Type:
        self.typed(node.operand, INT)
        return FLOAT

    def operation(
        self, node: expr.Unary | expr.Conditional | expr.Contains | expr.Quantified | expr.Range
    ) -> Type:  # fmt: skip
        span = node.span
        match node:
            case expr.Unary(op, operand):
                type_ = self.type_of(operand)
                allowed = {"not": (BOOL,), "-": (INT, FLOAT, POINT)}.get(op, ())
                require(type_ in allowed, f"{op} does not apply to {type_}", span)
                return type_
            case expr.Conditional(condition, then, orelse):
                self.typed(condition, BOOL)
                type_ = self.type_of(then)
                self.typed(orelse, type_)
                return type_
            case expr.Contains(item, values):
                return self.contains(item, values)
            case expr.Quantified(kind, name, domain, body):
                require(kind in ("forall", "exists"), f"{kind} is not a quantifier", span)
                self.declare(name, self.element(domain), span)
                self.typed(body, BOOL)
                del self.temps[name]
                return BOOL
            case expr.Range():
                return fail("a range is only allowed as the domain of a loop or a quantifier", span)
            case _:
                assert_never(node)

    def contains(self, item: expr.Expr, values: expr.Expr) -> Type:
        held = self.type_of(values)
        match held:
            case Sequence(_, element) | PerRobot(element) | MapOf(element):
                self.typed(item, element)
            case _:
                require(held in (STRING, RECT, BALL), f"in does not apply to a {held}", values.span)
                self.typed(item, STRING if held == STRING else POINT)
        return BOOL

    def element(self, node: expr.Expr) -> Type:
        """Return the type of the elements of a loop's or quantifier's domain."""
        if isinstance(node, expr.Range):
            self.typed(node.start, INT)
            self.typed(node.stop, INT)
            require(node.step != 0 and node.type == list_of(INT), "a range has the step 0 or the wrong type", node.span)
            return INT
        match self.type_of(node):
            case Sequence(_, element) | PerRobot(element) | MapOf(element):
                return element
            case other:
                return fail(f"a {other} has no elements to iterate over", node.span)

    def part(
        self, node: expr.Builtin | expr.Field | expr.Make | expr.At | expr.Item | expr.Slice | expr.With
    ) -> Type:  # fmt: skip
        span = node.span
        match node:
            case expr.Builtin(name, args):
                return self.builtin(name, args, span)
            case expr.Field(operand, name):
                fields = fields_of(self.type_of(operand))
                return self.known(fields, name, span)
            case expr.Make(items, type_):
                self.make(items, type_, span)
                return type_
            case expr.At(operand, index):
                self.typed(index, INT)
                return at_type(self.type_of(operand), span)
            case expr.Item(operand, index):
                type_ = self.type_of(operand)
                require(
                    isinstance(type_, TupleOf) and 0 <= index < len(type_.items), f"the tuple has no item {index}", span
                )
                assert isinstance(type_, TupleOf)
                return type_.items[index]
            case expr.Slice(operand, start, stop):
                for bound in (start, stop):
                    if bound is not None:
                        self.typed(bound, INT)
                type_ = self.type_of(operand)
                require(
                    type_ == STRING or (isinstance(type_, Sequence) and type_.name == "List"),
                    f"a {type_} has no slices",
                    span,
                )
                return type_
            case expr.With(operand, name, value):
                type_ = self.type_of(operand)
                require(isinstance(type_, (RecordType, TupleOf)), f"a {type_} has no part {name} to replace", span)
                self.typed(value, self.known(fields_of(type_), name, span))
                return type_
            case _:
                assert_never(node)

    def make(self, items: tuple[expr.Expr, ...], type_: Type, span: Span) -> None:
        wanted: tuple[Type, ...]
        match type_:
            case Sequence(_, element):
                wanted = (element,) * len(items)
            case MapOf(key, value):
                wanted = (TupleOf((key, value)),) * len(items)
            case TupleOf(parts):
                wanted = parts
            case RecordType(name, fields):
                require(self.records.get(name) == type_, f"the record {name} is not declared", span)
                wanted = tuple([field for _, field in fields])
            case _:
                empty = type_ in (GRIDMAP, SCAN) or (isinstance(type_, ExternType) and type_.name in self.extern_types)
                require(empty, f"a {type_} is not made of parts", span)
                wanted = ()
        require(len(items) == len(wanted), f"a {type_} is made of {len(items)} parts", span)
        for item, part in zip(items, wanted, strict=True):
            self.typed(item, part)

    def call(self, node: expr.Call | expr.ExternCall | expr.PortCall) -> Type:
        span = node.span
        match node:
            case expr.Call(name, args):
                require(
                    name in self.callees or (name in self.specs and self.place in ("property", "guarantee")),
                    f"the function {name} cannot be called here",
                    span,
                )
                known = self.specs.get(name) or self.signatures[name]
                self.arguments(name, args, known.parameters, span)
                return known.result
            case expr.ExternCall(name, args):
                require(name in self.externs, f"the extern function {name} is not declared", span)
                self.arguments(name, args, self.externs[name].parameters, span)
                return self.externs[name].result
            case expr.PortCall(module, port, args):
                found = self.ports.get((module, port))
                require(found is not None and found.direction == "callable", f"{module}.{port} cannot be called", span)
                require(len(args) in (1, 2), f"a planner has {len(args)} arguments", span)
                self.typed(args[0], POINT)
                if len(args) == 2:
                    obstacles = self.type_of(args[1])
                    require(
                        obstacles in (list_of(GRID), list_of(POINT)),
                        f"the obstacles of a planner have the type {obstacles}",
                        span,
                    )
                return list_of(POINT)
            case _:
                assert_never(node)

    def arguments(
        self, name: str, args: tuple[expr.Expr, ...], parameters: tuple[decl.Parameter, ...], span: Span
    ) -> None:
        require(len(args) == len(parameters), f"{name} is called with {len(args)} arguments", span)
        for arg, parameter in zip(args, parameters, strict=True):
            type_ = self.type_of(arg)
            require(fits(type_, parameter.type), f"expected a {parameter.type}, found a {type_}", arg.span)

    def builtin(self, name: str, args: tuple[expr.Expr, ...], span: Span) -> Type:
        return builtin_type(name, [self.type_of(arg) for arg in args], span)


# Verifier of each class of node. A table, because dispatch takes most of the time. A test ensures that it has all
# expressions.
_READERS: dict[type, Callable[[Expressions, Any], Type]] = {
    expr.Const: Expressions.const,
    expr.Pid: Expressions.index,
    expr.NSys: Expressions.index,
    expr.TempRead: Expressions.temp,
    expr.LocalRead: Expressions.local,
    expr.SlotRead: Expressions.slot,
    expr.SharedRead: Expressions.cell,
    expr.PortRead: Expressions.port_read,
    expr.Binary: Expressions.binary,
    expr.Compare: Expressions.compare,
    expr.Logic: Expressions.logic,
    expr.Widen: Expressions.widen,
    **dict.fromkeys((expr.ParamRead, expr.SlotsRead, expr.LocalOf, expr.PortOf, expr.Ids), Expressions.read),
    **dict.fromkeys((expr.Unary, expr.Conditional, expr.Contains, expr.Quantified, expr.Range), Expressions.operation),
    **dict.fromkeys((expr.Builtin, expr.Field, expr.Make, expr.At, expr.Item, expr.Slice, expr.With), Expressions.part),
    **dict.fromkeys((expr.Call, expr.ExternCall, expr.PortCall), Expressions.call),
}
