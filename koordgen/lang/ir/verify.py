"""Verifier of the IR's invariants, run after every pass. A violation is a bug of the compiler."""

from __future__ import annotations

from collections.abc import Iterable
from typing import assert_never

from koordgen.lang.ir import decl, expr, stmt
from koordgen.lang.ir.types import (
    BALL,
    BOOL,
    PLANNER,
    POISON,
    RECT,
    STREAM,
    STRING,
    ExternType,
    MapOf,
    PerRobot,
    RecordType,
    Scalar,
    Sequence,
    Sized,
    TupleOf,
    Type,
    is_key,
)
from koordgen.lang.ir.verify_expr import Expressions
from koordgen.lang.ir.verify_type import fail, require
from koordgen.lang.source import Span


def verify(program: decl.Program) -> None:
    """Raise InternalError if a program violates an invariant of the IR.

    Invariants: types agree, names are resolved, temps are in scope, operators exist, each construct is allowed in its
    section, a transaction's variables belong to its lock, and the events of a `priority:` block are adjacent.
    """
    walk = _Walk(program)
    walk.declarations()
    walk.functions()
    walk.enter("init")
    walk.block(program.init)
    for event in program.events:
        walk.event(event)
    for module in program.modules:
        for assumption in module.assumptions:
            walk.enter("assume")
            walk.module = module.name
            for name, type_ in decl.goals(assumption).items():
                walk.declare(name, type_, assumption.span)
            walk.typed(assumption.formula, BOOL)
    for property_ in program.properties:
        walk.enter("property")
        for name, type_ in decl.free(property_.formula).items() if property_.kind == "axiom" else ():
            walk.declare(name, type_, property_.span)
        walk.typed(property_.formula, BOOL)
    walk.interface()


class _Walk(Expressions):
    def declarations(self) -> None:
        p = self.program
        named: list[tuple[str, Span]] = [(r.type.name, r.span) for r in p.records]
        for group in (p.extern_types, p.functions, p.externs, p.specs, p.params, p.modules, p.shared, p.locals):
            named += [(item.name, item.span) for item in group]
        _distinct("declaration", named)
        _distinct("event", [(e.name, e.span) for e in p.events])
        self.blocks()
        _distinct("property", [(q.name, q.span) for q in p.properties if q.name])
        for record in p.records:
            require(len(record.defaults) == len(record.type.fields), "a record lacks defaults", record.span)
            for value, (_, type_) in zip(record.defaults, record.type.fields, strict=True):
                self.variable("literal", type_, value, record.span)
        for param in p.params:
            self.variable("literal", param.type, param.default, param.span)
        variables: tuple[decl.Shared | decl.Local, ...] = (*p.shared, *p.locals)
        for variable in variables:
            self.variable("constant", variable.type, variable.initial, variable.span)
        for module in p.modules:
            _distinct("port", [(port.name, port.span) for port in module.ports])
            for port in module.ports:
                special = {"callable": PLANNER, "stream": STREAM}.get(port.direction)
                require(
                    special is None or port.type == special, f"the port {port.name} has the type {port.type}", port.span
                )
                if special is None:
                    self.plain(port.type, port.span)
        self.locks()

    def variable(self, place: str, type_: Type, value: expr.Expr, span: Span) -> None:
        self.plain(type_, span)
        self.enter(place)
        self.typed(value, type_)

    def plain(self, type_: Type, span: Span) -> None:
        """Verify that values of a type can be stored: no port, region or poison.

        Ordered keys; positive capacities.
        """
        match type_:
            case Scalar():
                require(
                    type_ not in (POISON, PLANNER, STREAM, RECT, BALL), f"values of type {type_} cannot be stored", span
                )
            case Sized(name, capacity):
                require(capacity > 0, f"the capacity {capacity} of a {name} is not positive", span)
            case Sequence(name, element, capacity):
                require(
                    name in ("List", "Queue", "Set") and capacity > 0,
                    f"{type_} with the capacity {capacity} is not a valid type",
                    span,
                )
                require(name != "Set" or is_key(element), f"{type_} has elements without an order", span)
                self.plain(element, span)
            case MapOf(key, value, capacity):
                require(is_key(key) and capacity > 0, f"{type_} with the capacity {capacity} is not a valid type", span)
                self.plain(value, span)
            case TupleOf(items):
                require(len(items) > 1, "a tuple has one item", span)
                for item in items:
                    self.plain(item, span)
            case RecordType(name):
                require(self.records.get(name) == type_, f"the record {name} is not declared", span)
            case ExternType(name):
                require(name in self.extern_types, f"the extern type {name} is not declared", span)
            case PerRobot():
                require(False, f"values of type {type_} cannot be stored", span)
            case _:
                assert_never(type_)

    def locks(self) -> None:
        at = Span(1, 1, 1, 1)
        _distinct("locked variable", [(name, at) for group in self.program.locks for name in group])
        declared = {v.name for v in self.program.shared}
        for group in self.program.locks:
            require(
                bool(group) and declared.issuperset(group),
                f"a lock has undeclared variables, or none: {', '.join(group)}",
                at,
            )

    def interface(self) -> None:
        """Verify exports and imports: their variables are declared, and guarantees read the exported one only."""
        p = self.program
        _distinct("export", [(export.variable, export.span) for export in p.exports])
        kinds = {v.name: v for v in p.shared}
        for export in p.exports:
            variable = kinds.get(export.variable)
            if variable is None:
                fail(f"the exported variable {export.variable} is not declared", export.span)
                continue
            require(variable.kind == "allwrite" or not export.is_written, "an exported slot is written", export.span)
            type_: Type = PerRobot(variable.type) if variable.kind == "allread" else variable.type
            for guarantee in export.guarantees:
                self.enter("guarantee")
                self.declare(guarantee.before, type_, guarantee.span)
                self.declare(guarantee.after, type_, guarantee.span)
                self.typed(guarantee.formula, BOOL)
        for module in p.provides:
            self.provided(module)
        for imported in p.imports:
            for name in imported.variables:
                require(name in self.cells, f"the imported variable {name} is not declared", imported.span)
            inside = {*imported.slots, *imported.written} <= set(imported.variables)
            require(inside and not {*imported.slots} & {*imported.written}, "an import is inconsistent", imported.span)
            members = imported.size in self.params and imported.pid in self.locals
            require(members, f"the members of {imported.name} are not declared", imported.span)

    def provided(self, module: decl.Provides) -> None:
        """Verify that sensors have values of their types, and that commands are written to allwrite variables."""
        _distinct(f"provided port of {module.name}", [(p.port.name, p.port.span) for p in module.ports])
        for provided in module.ports:
            self.enter("provided")
            self.typed(provided.value, provided.port.type)
            is_variable = isinstance(provided.value, expr.SharedRead)
            require(
                provided.port.direction == "sensor" or (provided.port.direction == "actuator" and is_variable),
                "an actuator is no variable", provided.port.span,
            )  # fmt: skip

    def functions(self) -> None:
        callees: set[str] = set()
        for function in self.program.functions:
            self.callees = callees  # functions before this one
            self.enter("function")
            self.parameters(function.parameters, function.span)
            self.plain(function.result, function.span)
            self.result = function.result
            self.block(function.block)
            require(_returns(function.block), f"{function.name} can end without a result", function.span)
            callees.add(function.name)
        for extern in self.program.externs:
            self.enter("contract")
            self.parameters(extern.parameters, extern.span)
            self.plain(extern.result, extern.span)
            for formula in extern.requires:
                self.typed(formula, BOOL)
            require("result" not in self.temps, f"a parameter of {extern.name} is called result", extern.span)
            self.temps["result"] = extern.result
            for formula in extern.ensures:
                self.typed(formula, BOOL)
        for spec in self.program.specs:
            self.enter("contract")
            self.parameters(spec.parameters, spec.span)
            self.plain(spec.result, spec.span)

    def parameters(self, parameters: tuple[decl.Parameter, ...], span: Span) -> None:
        for parameter in parameters:
            type_ = parameter.type
            self.plain(type_.element if isinstance(type_, PerRobot) else type_, span)
            self.declare(parameter.name, type_, span)

    def blocks(self) -> None:
        """Verify that `priority:` blocks are numbered from 0 in text order and that their events are adjacent."""
        last, before = -1, None
        for event in self.program.events:
            block = event.priority
            known = block is None or block == last + 1 or (block == last and block == before)
            require(known, f"{event.name} is in the priority block {block}, out of order", event.span)
            last, before = last if block is None else block, block

    def event(self, event: decl.Event) -> None:
        self.enter("guard")
        self.typed(event.guard, BOOL)
        self.place = "effect"
        self.block(event.effect)
        if event.lock is not None:
            locks = self.program.locks
            require(0 <= event.lock < len(locks), f"the lock {event.lock} does not exist", event.span)
            require(
                self.shared.issubset(locks[event.lock]), f"{event.name} uses variables outside of its lock", event.span
            )

    # Statements

    def block(self, block: stmt.Block) -> None:
        own = []
        for statement in block:
            match statement:
                case stmt.Assign(place, value, span):
                    self.typed(value, self.target(place, span))
                case stmt.Let(name, type_, value, span):
                    self.typed(value, type_)
                    self.plain(type_, span)
                    self.declare(name, type_, span)
                    own.append(name)
                case stmt.If(condition, then, orelse):
                    self.typed(condition, BOOL)
                    self.block(then)
                    self.block(orelse)
                case stmt.For():
                    self.loop(statement)
                case stmt.While(condition, inner):
                    self.invariants(statement)
                    self.typed(condition, BOOL)
                    self.loops += 1
                    self.block(inner)
                    self.loops -= 1
                case _:
                    self.simple(statement)
        for name in own:
            del self.temps[name]

    def loop(self, node: stmt.For) -> None:
        element = self.element(node.values)
        if len(node.names) > 1:
            pairs = isinstance(element, TupleOf) and element.items == node.types
            require(pairs, f"an element of type {element} cannot be assigned to {len(node.names)} names", node.span)
        else:
            require(
                (element,) == node.types,
                f"an element of type {element} cannot be assigned to a {node.types[0]}",
                node.span,
            )
        named = isinstance(node.values, (expr.Range, expr.Ids))
        if not named:
            self.invariants(node)
        for name, type_ in zip(node.names, node.types, strict=True):
            self.declare(name, type_, node.span)
        if named:
            self.invariants(node)
        self.loops += 1
        self.block(node.block)
        self.loops -= 1
        for name in node.names:
            del self.temps[name]

    def invariants(self, loop: stmt.For | stmt.While) -> None:
        self.at_head = True
        for invariant in loop.invariants:
            self.typed(invariant.formula, BOOL)
        self.at_head = False

    def simple(self, node: stmt.Break | stmt.Continue | stmt.Return | stmt.Emit | stmt.Stop) -> None:
        match node:
            case stmt.Break(span) | stmt.Continue(span):
                require(self.loops > 0, "break or continue outside of a loop", span)
            case stmt.Return(value, span):
                require(self.place == "function" and self.result is not None, "return outside of a function", span)
                assert self.result is not None
                self.typed(value, self.result)
            case stmt.Stop(span):
                require(self.place in ("init", "effect"), f"stop is not allowed in a {self.place}", span)
            case stmt.Emit(module, port, items, span):
                require(self.place in ("init", "effect"), f"writing to a stream is not allowed in a {self.place}", span)
                found = self.ports.get((module, port))
                require(found is not None and found.direction == "stream", f"{module}.{port} is not a stream", span)
                for item in items:
                    self.typed(item, STRING)
            case _:
                assert_never(node)

    def target(self, place: stmt.Place, span: Span) -> Type:
        if self.place not in ("init", "effect") and not isinstance(place, stmt.TempPlace):
            require(False, f"an assignment is not allowed in a {self.place}", span)
        match place:
            case stmt.LocalPlace(name):
                return self.known(self.locals, name, span)
            case stmt.OwnSlot(name):
                self.shared.add(name)
                return self.known(self.slots, name, span)
            case stmt.SharedPlace(name):
                self.shared.add(name)
                return self.known(self.cells, name, span)
            case stmt.TempPlace(name):
                return self.known(self.temps, name, span)
            case stmt.PortPlace(module, port):
                found = self.ports.get((module, port))
                if found is None or found.direction != "actuator":
                    return fail(f"{module}.{port} is not an actuator", span)
                return found.type
            case _:
                assert_never(place)


def _distinct(what: str, named: Iterable[tuple[str, Span]]) -> None:
    seen: set[str] = set()
    for name, span in named:
        require(name not in seen, f"two {what}s are called {name}", span)
        seen.add(name)


def _returns(block: stmt.Block) -> bool:
    """Return whether every path through a block ends in a `return` or in an endless loop."""
    for statement in block:
        match statement:
            case stmt.Return():
                return True
            case stmt.If(_, then, orelse) if _returns(then) and _returns(orelse):
                return True
            case stmt.While(expr.Const(True), inner) if not _breaks(inner):
                return True
            case _:
                pass
    return False


def _breaks(block: stmt.Block) -> bool:
    """Return whether a block may leave the enclosing loop by `break`."""
    return any(
        isinstance(s, stmt.Break) or (isinstance(s, stmt.If) and (_breaks(s.then) or _breaks(s.orelse))) for s in block
    )
