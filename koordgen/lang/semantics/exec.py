"""What statements and functions mean: one run of one effect, on copies that only it sees."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import repeat
from typing import Literal, NamedTuple, assert_never

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import Type
from koordgen.lang.semantics.deadline import present
from koordgen.lang.semantics.eval import Call, Discarded, View, counting, elements, evaluate, holds, made, view_of
from koordgen.lang.semantics.state import World
from koordgen.lang.semantics.values import Value, as_, conforms, encodable, flaw, items
from koordgen.lang.source import Span

MAX_TURNS = 1_000_000  # of one event; a robot's round is over before
UNFINISHED = "it is not finished by the end of the round"


class Writes(NamedTuple):
    """What an event did: all its robot's locals afterwards; own slots, cells and actuators only where written; the
    lines that it put out, as ("Module.port", line), in order; where the loop invariants stand that were false or had no
    value, those of the functions that it called included, each once."""

    locals: Mapping[str, Value]
    slots: Mapping[str, Value]
    cells: Mapping[str, Value]
    ports: Mapping[str, Value]
    streams: tuple[tuple[str, str], ...]
    stopped: bool
    violated: tuple[Span, ...] = ()


class Budget:
    """One event, its functions included: the turns that are `left` to it, of `turns` or MAX_TURNS (a turn of a loop and
    a call of a function cost one), and the loop invariants that were false or had no value, by where they stand. Where
    there is a deadline, the event is given up when it has passed (OutOfTime)."""

    def __init__(self, turns: int | None = None) -> None:
        self.left = MAX_TURNS if turns is None else turns
        self.violated: dict[Span, None] = {}
        self.deadline = present()

    def spend(self, turns: int, span: Span) -> None:
        """Take so many turns. Raises Discarded, OutOfTime."""
        self.left -= turns
        if self.left < 0:
            raise Discarded(UNFINISHED, span)
        if self.deadline is not None:
            self.deadline.look()


def library(
    program: decl.Program, n_sys: int, params: Mapping[str, Value], world: World, budget: Budget, ask: Call
) -> View:
    """The view of a program's functions, which is a part of every other: nothing of a robot, but its callable ports in
    an assumption. `fun`s run, extern functions are called under their contracts."""
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
    """A `spec fun` was to be executed, and nothing says what it is."""


def _spec(name: str, args: tuple[Value, ...], world: World) -> Value:
    if name not in world.externs:
        raise NoMeaning(f"{name} is a spec fun: only axioms tell of it")
    return world.externs[name](*args)


def _extern(function: decl.ExternFunction, args: tuple[Value, ...], view: View, world: World) -> Value:
    """Raises ValueError where the function fails or its contract does not hold."""
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
        raise ValueError(f"{name} returned {result!r}, which is no {function.result}")
    view = view._replace(temps={**view.temps, "result": result})
    for formula in function.ensures:
        if not holds(formula, view):
            raise ValueError(f"{name} returned {result!r}, which it ensures not to")
    return result


Exit = Literal["break", "continue", "return", "stop"] | None


class Run:
    """One run of one block: copies that it reads back."""

    def __init__(self, program: decl.Program, view: View, budget: Budget) -> None:
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
        self.written: dict[tuple[str, str], Span] = {}  # (what kind, name) -> the last statement that wrote it
        self.returned: Value | None = None

    def result(self, function: decl.Function) -> Value:
        """What a function yields."""
        if self.block(function.block) != "return" or self.returned is None:
            raise InternalError(f"{function.name} ended without a result")
        return self.returned

    def block(self, block: stmt.Block) -> Exit:
        """Runs statements in order; how the block was left, None at its end. Raises Discarded."""
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
                line = made("".join([as_(str, evaluate(part, self.view)) for part in parts]), self.view, span)
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
            if value is not None and isinstance(loop, stmt.For):  # as on robots, before its invariants are evaluated
                self.budget.spend(1, loop.span)
            self.judge(loop.invariants)
            if value is None or (isinstance(loop, stmt.While) and not holds(loop.condition, self.view)):
                return None
            if isinstance(loop, stmt.For):
                self.take(loop.names, value)
            else:
                self.budget.spend(1, loop.span)
            left = self.block(loop.block)
            if left == "break":
                return None
            if left in ("return", "stop"):
                return left

    def counted(self, values: Iterator[Value], count: Iterator[int], names: tuple[str, ...]) -> Iterator[Value]:
        """The values of a loop that counts: at its head its variable is the next one, at last the first not taken."""
        for following in count:
            value = next(values, None)
            self.take(names, following)
            if value is None:
                return
            yield value

    def judge(self, invariants: tuple[stmt.LoopInvariant, ...]) -> None:
        """Note those that are false or have no value. Raises Discarded where they use up the turns of the event."""
        for invariant in invariants:
            try:
                held = holds(invariant.formula, self.view)
            except Discarded:
                if self.budget.left < 0:
                    raise
                held = False
            if not held:
                self.budget.violated[invariant.span] = None

    def take(self, names: tuple[str, ...], value: Value) -> None:
        """One element into the names of a loop."""
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
        """Return what counts at the event's end; a last value that its variable may not keep discards all of it. Of
        several such, the one whose variable is declared first is told, as robots do: locals, shared variables,
        actuators."""
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
    """The types of all that an event may write, with their capacities."""
    types = {v.name: v.type for v in program.locals}
    types.update({v.name: v.type for v in program.shared})
    types.update({f"{m.name}.{p.name}": p.type for m in program.modules for p in m.ports})
    return types


def run(program: decl.Program, block: stmt.Block, view: View, budget: Budget) -> Writes | Discarded:
    """An effect of one robot on what it sees: its writes, or why none of them counts."""
    working = Run(program, view, budget)
    try:
        left = working.block(block)
    except Discarded as discarded:
        return discarded
    return working.writes(left == "stop")


def constant(node: ir.Expr, view: View, type_: Type) -> Value:
    """A first value, which the checker has seen to be one of the type."""
    value = evaluate(node, view)
    if not conforms(value, type_):
        raise InternalError(f"line {node.span.line}: {value!r} is no {type_}")
    return value
