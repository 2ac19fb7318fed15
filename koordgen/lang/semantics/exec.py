"""Semantics of statements and functions: runs the effect of one event on private copies of the state."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import repeat
from typing import Literal, NamedTuple, assert_never

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import Type
from koordgen.lang.semantics.deadline import present
from koordgen.lang.semantics.eval import (
    Call,
    Discarded,
    StateView,
    charged_for_making,
    counting,
    elements,
    evaluate,
    holds,
    view_of,
)
from koordgen.lang.semantics.state import World
from koordgen.lang.semantics.values import Value, as_, conforms, encodable, flaw, items
from koordgen.lang.source import Span

MAX_TURNS = 1_000_000  # budget of loop turns of one event, more than a robot can run in a round
UNFINISHED = "it is not finished by the end of the round"


class Writes(NamedTuple):
    """Values that an event writes.

    `locals` holds all local variables of the robot. `slots` (the robot's own slots of allread variables), `cells`
    (allwrite variables) and `ports` (actuators) hold only the values that the event wrote. `streams` lists the lines
    written to streams, as ("Module.port", line), in order. `violated` lists the span of each loop invariant that was
    false or had no value, in the event or in a function that it called, without duplicates.
    """

    locals: Mapping[str, Value]
    slots: Mapping[str, Value]
    cells: Mapping[str, Value]
    ports: Mapping[str, Value]
    streams: tuple[tuple[str, str], ...]
    stopped: bool
    violated: tuple[Span, ...] = ()


class Budget:
    """Budget of loop turns of one event, shared with the functions that the event calls.

    `left` is the number of turns that remain; it begins with `turns`, or with MAX_TURNS if `turns` is None.

    Each iteration of a loop and each call of a function costs one turn. `violated` collects the spans of loop
    invariants that were false or had no value. If a deadline is set, spending turns after it raises OutOfTime.
    """

    def __init__(self, turns: int | None = None) -> None:
        self.left = MAX_TURNS if turns is None else turns
        self.violated: dict[Span, None] = {}
        self.deadline = present()

    def spend(self, turns: int, span: Span) -> None:
        """Subtract a number of turns from the budget.

        Raises Discarded if the budget has too few turns left, and OutOfTime if the deadline has passed.
        """
        self.left -= turns
        if self.left < 0:
            raise Discarded(UNFINISHED, span)
        if self.deadline is not None:
            self.deadline.look()


def library(
    program: decl.Program, n_sys: int, params: Mapping[str, Value], world: World, budget: Budget, ask: Call
) -> StateView:
    """Return a View through which expressions call a program's functions; it contains no robot's state.

    Callers add the state of a robot or of the fleet to this View. `ask` answers calls of callable ports. A call of a
    `fun` runs its statements; a call of an extern function runs its Python code and checks its contract.
    """
    functions = {f.name: f for f in program.functions}
    externs = {f.name: f for f in program.externs}

    def call(name: str, args: tuple[Value, ...]) -> Value:
        if name in functions:
            function = functions[name]
            budget.spend(1, function.span)
            temps = {p.name: arg for p, arg in zip(function.parameters, args, strict=True)}
            return Run(program, view._replace(temps=temps), budget).result(function)
        if name in externs:
            return _extern(externs[name], args, view, world)
        return _spec(name, args, world)

    view = view_of(n_sys, params, call, ask, budget.spend)
    return view


class NoMeaning(Exception):
    """Signal a call of a `spec fun`, which is declared without an implementation and cannot be executed."""


def _spec(name: str, args: tuple[Value, ...], world: World) -> Value:
    if name not in world.externs:
        raise NoMeaning(f"{name} is a spec fun, which only axioms describe")
    return world.externs[name](*args)


def _extern(function: decl.ExternFunction, args: tuple[Value, ...], view: StateView, world: World) -> Value:
    """Call an extern function, a Python function. Raises ValueError if the function fails or breaks its contract."""
    name = function.name
    view = view._replace(temps={p.name: arg for p, arg in zip(function.parameters, args, strict=True)})
    for formula in function.requires:
        if not holds(formula, view):
            raise ValueError(f"{name} requires what does not hold")
    try:
        result = world.externs[name](*args)
    except Exception as error:
        raise ValueError(f"{name} failed: {error!r}") from None
    if not conforms(result, function.result):
        raise ValueError(f"{name} returned {result!r}, which is not of type {function.result}")
    view = view._replace(temps={**view.temps, "result": result})
    for formula in function.ensures:
        if not holds(formula, view):
            raise ValueError(f"{name} returned {result!r}, which violates an 'ensures' of its contract")
    return result


Exit = Literal["break", "continue", "return", "stop"] | None


class Run:
    """One run of a block of statements, on private copies of the state in a View."""

    def __init__(self, program: decl.Program, view: StateView, budget: Budget) -> None:
        self.program = program
        self.budget = budget
        self.locals = dict(view.locals)
        self.temps = dict(view.temps)
        self.slots = {name: list(values) for name, values in view.slots.items()}
        self.cells = dict(view.cells)
        self.ports = dict(view.ports)
        self.streams: list[tuple[str, str]] = []
        self.view = view._replace(
            locals=self.locals, temps=self.temps, slots=self.slots, cells=self.cells, ports=self.ports
        )
        self.written: dict[
            tuple[str, str], Span
        ] = {}  # (kind, name) of a variable or port -> span of the last statement that wrote to it
        self.returned: Value | None = None

    def result(self, function: decl.Function) -> Value:
        """Run the body of a function and return its result."""
        if self.block(function.block) != "return" or self.returned is None:
            raise InternalError(f"{function.name} ended without a result")
        return self.returned

    def block(self, block: stmt.Block) -> Exit:
        """Run the statements of a block in order.

        Returns the kind of statement that left the block early ("break", "return", ...), or None if its end was
        reached. Raises Discarded if an expression has no value.
        """
        for statement in block:
            left = self.statement(statement)
            if left is not None:
                return left
        return None

    def statement(self, statement: stmt.Stmt) -> Exit:
        match statement:
            case stmt.Assign(place, value, span):
                self.assign(place, evaluate(value, self.view), span)
            case stmt.Let(name, _, value):
                self.temps[name] = evaluate(value, self.view)
            case stmt.If(condition, then, orelse):
                return self.block(then if holds(condition, self.view) else orelse)
            case stmt.For() | stmt.While():
                return self.loop(statement)
            case stmt.Emit(module, port, parts, span):
                line = charged_for_making(
                    "".join([as_(str, evaluate(part, self.view)) for part in parts]), self.view, span
                )
                self.streams.append((f"{module}.{port}", line))
                self.written["stream", f"{module}.{port}"] = span
            case stmt.Return(value):
                self.returned = evaluate(value, self.view)
                return "return"
            case stmt.Break():
                return "break"
            case stmt.Continue():
                return "continue"
            case stmt.Stop():
                return "stop"
            case _:
                assert_never(statement)
        return None

    def loop(self, loop: stmt.For | stmt.While) -> Exit:
        if isinstance(loop, stmt.While):
            return self.turns(loop, repeat(()))
        counts = counting(loop.values, self.view) if loop.invariants else None
        values = elements(loop.values, self.view) if counts is None else self.counted(*counts, loop.names)
        return self.turns(loop, values)

    def turns(self, loop: stmt.For | stmt.While, values: Iterator[Value]) -> Exit:
        while True:
            value = next(values, None)
            if value is not None and isinstance(loop, stmt.For):
                # As on robots, a `for` loop spends the turn of an iteration before it evaluates the loop's invariants.
                self.budget.spend(1, loop.span)
            self.check_invariants(loop.invariants)
            if value is None or (isinstance(loop, stmt.While) and not holds(loop.condition, self.view)):
                return None
            if isinstance(loop, stmt.For):
                self.bind_element(loop.names, value)
            else:
                self.budget.spend(1, loop.span)
            left = self.block(loop.block)
            if left == "break":
                return None
            if left in ("return", "stop"):
                return left

    def counted(self, values: Iterator[Value], count: Iterator[int], names: tuple[str, ...]) -> Iterator[Value]:
        """Yield the values of a loop over a range or `ID`.

        Sets the loop's variable to each value before the value is yielded. After the last value, sets the variable to
        the value that would come next, so that the loop invariants can be evaluated once more.
        """
        for following in count:
            value = next(values, None)
            self.bind_element(names, following)
            if value is None:
                return
            yield value

    def check_invariants(self, invariants: tuple[stmt.LoopInvariant, ...]) -> None:
        """Record the loop invariants that are false or have no value.

        Raises Discarded if evaluating the invariants uses up the event's budget of loop turns.
        """
        for invariant in invariants:
            try:
                held = holds(invariant.formula, self.view)
            except Discarded:
                if self.budget.left < 0:
                    raise
                held = False
            if not held:
                self.budget.violated[invariant.span] = None

    def bind_element(self, names: tuple[str, ...], value: Value) -> None:
        """Assign an element to the loop's variable, or the element's parts to the loop's variables."""
        parts = (value,) if len(names) == 1 else items(value)
        self.temps.update(zip(names, parts, strict=True))

    def assign(self, place: stmt.Place, value: Value, span: Span) -> None:
        match place:
            case stmt.LocalPlace(name):
                self.locals[name] = value
                self.written["local", name] = span
            case stmt.TempPlace(name):
                self.temps[name] = value
            case stmt.OwnSlot(name):
                self.slots[name][self.view.pid] = value
                self.written["slot", name] = span
            case stmt.SharedPlace(name):
                self.cells[name] = value
                self.written["cell", name] = span
            case stmt.PortPlace(module, port):
                self.ports[f"{module}.{port}"] = value
                self.written["port", f"{module}.{port}"] = span
            case _:
                assert_never(place)

    def writes(self, stopped: bool) -> Writes | Discarded:
        """Return the event's writes, or Discarded if a variable or actuator cannot store the value written last.

        If several of them cannot, the first in this order is reported, as on robots: local variables in the order of
        their declarations, then shared variables, then actuators.
        """
        types = declared(self.program)
        order = {name: place for place, name in enumerate(types)}
        written = sorted(self.written.items(), key=lambda item: (item[0][0] == "stream", order[item[0][1]]))
        values: dict[str, dict[str, Value]] = {"slot": {}, "cell": {}, "port": {}, "local": {}}
        where: dict[str, Mapping[str, Value]] = {"cell": self.cells, "port": self.ports, "local": self.locals}
        for (kind, name), span in written:
            if kind == "stream":
                if not all(encodable(line) for _, line in self.streams):
                    return Discarded(f"{name} would get a text that is not Unicode", span)
                continue
            value = self.slots[name][self.view.pid] if kind == "slot" else where[kind][name]
            wrong = flaw(value, types[name])
            if wrong:
                return Discarded(f"{name} would become {wrong}, which no robot may use", span)
            values[kind][name] = value
        streams = tuple(self.streams)
        violated = tuple(self.budget.violated)
        return Writes(self.locals, values["slot"], values["cell"], values["port"], streams, stopped, violated)


def declared(program: decl.Program) -> dict[str, Type]:
    """Return the types, with capacities, of all variables and ports that an event may write."""
    types = {v.name: v.type for v in program.locals}
    types.update({v.name: v.type for v in program.shared})
    types.update({f"{m.name}.{p.name}": p.type for m in program.modules for p in m.ports})
    return types


def run(program: decl.Program, block: stmt.Block, view: StateView, budget: Budget) -> Writes | Discarded:
    """Run a block of statements on a robot's View. Returns its writes, or Discarded with the reason."""
    working = Run(program, view, budget)
    try:
        left = working.block(block)
    except Discarded as discarded:
        return discarded
    return working.writes(left == "stop")


def constant(node: ir.Expr, view: StateView, type_: Type) -> Value:
    """Return the value of an initial-value expression.

    The checker has ensured that the value is of type `type_`; raises InternalError if it is not.
    """
    value = evaluate(node, view)
    if not conforms(value, type_):
        raise InternalError(f"line {node.span.line}: {value!r} is not of type {type_}")
    return value
