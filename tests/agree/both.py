"""One event of one robot, by the executable semantics and by the generated Python of an agent."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from random import Random
from types import ModuleType
from typing import Any

import msgspec

from koordgen.build.emit.names import Names
from koordgen.build.emit.program import functions_module, program_text
from koordgen.lang.ir import decl as d
from koordgen.lang.ir.printer import show
from koordgen.lang.ir.types import ExternType, MapOf, PerRobot, RecordType, Sequence, TupleOf, Type
from koordgen.lang.semantics import step
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import Writes, declared
from koordgen.lang.semantics.state import State, World
from koordgen.lang.semantics.values import RecordValue, Value, conforms
from koordgen.runtime.program import program as rt
from koordgen.runtime.values.points import Opaque, Point
from tests.agree.kinds import Ticket, not_finite, random_value
from tests.agree.programs import N_SYS, random_program, random_state

Outcome = dict[str, Any] | str
Pass = Callable[[d.Program], d.Program]


def outside(name: str, args: tuple[Any, ...], result: Type) -> Value:
    """Return the result of an extern function; it depends on all arguments, and now and then it fails.

    The arguments need not be finite.
    """
    rng = Random(f"{name} {args!r}")
    if rng.random() < 0.02:
        raise RuntimeError("no answer")
    value = random_value(rng, result, wild=False)
    return not_finite(rng, value) if rng.random() < 0.2 else value


def answer(pid: int, port: str, args: tuple[Any, ...]) -> tuple[Point, ...]:
    """Return the planner's answer; equal arguments always have the same answer."""
    rng = Random(f"{pid} {port} {args!r}")
    if rng.random() < 0.02:
        raise RuntimeError("no way to tell")
    return tuple([Point(float(i), rng.choice((0.0, 1.5)), 0.0) for i in range(rng.randrange(4))])


def key(value: Any, type_: Type) -> Any:
    """Return a key that distinguishes values on both sides: by types, and floats by all their bits."""
    match type_:
        case RecordType(name, fields):
            parts = value.fields if isinstance(value, RecordValue) else msgspec.structs.astuple(value)
            return (name, *[key(part, t) for part, (_, t) in zip(parts, fields, strict=True)])
        case Sequence(word, element):
            assert type(value) is tuple, value
            return (word, *[key(part, element) for part in value])
        case PerRobot(element):
            return ("List", *[key(part, element) for part in value])
        case MapOf(k, v):
            return ("Map", *[(key(a, k), key(b, v)) for a, b in value])
        case TupleOf(items):
            assert type(value) is tuple, value
            return tuple([key(part, t) for part, t in zip(value, items, strict=True)])
        case ExternType():
            opened = value if isinstance(value, Ticket) else (
                msgspec.msgpack.decode(value.data, type=Ticket) if value.data else Ticket()
            )  # fmt: skip
            return ("Ticket", opened.number)
        case _:
            return (type(value).__name__, repr(value))


class Generated:
    """A program as generated Python, loaded with its extern functions."""

    def __init__(self, program: d.Program, text: str) -> None:
        self.ir = program
        self.text = text
        self.records = Names(program).records
        module = sys.modules["generated"] = ModuleType("generated")  # where msgspec looks names up
        self.scope: dict[str, Any] = vars(module)
        self.scope["__file__"] = "random.py"
        exec(compile(text, "random.py", "exec"), self.scope)
        self.program: rt.Program = self.scope["PROGRAM"]
        beside = ModuleType(functions_module(program))
        vars(beside)["Ticket"] = Ticket
        for extern in program.externs:
            vars(beside)[extern.name] = self.function(extern)
        sys.modules[beside.__name__] = beside
        if self.program.library is not None:
            self.program.library.load()

    def function(self, extern: d.ExternFunction) -> Callable[..., Any]:
        def called(*args: Any) -> Any:
            keys = tuple([key(arg, p.type) for arg, p in zip(args, extern.parameters, strict=True)])
            return self.python(outside(extern.name, keys, extern.result), extern.result, user=True)

        return called

    def python(self, value: Any, type_: Type, user: bool = False) -> Any:
        """Return a value of the semantics in the form of robots, or of the user's functions."""
        match type_:
            case RecordType(name, fields):
                parts = zip(value.fields, fields, strict=True)
                return self.scope[self.records[name]](*[self.python(part, t, user) for part, (_, t) in parts])
            case Sequence(_, element) | PerRobot(element):
                return tuple([self.python(part, element, user) for part in value])
            case MapOf(k, v):
                return tuple([(self.python(a, k, user), self.python(b, v, user)) for a, b in value])
            case TupleOf(items):
                return tuple([self.python(part, t, user) for part, t in zip(value, items, strict=True)])
            case ExternType() if user:
                return msgspec.msgpack.decode(value.data, type=Ticket) if value.data else Ticket()
            case _:
                return value

    def frame(self, state: State, pid: int) -> rt.Frame:
        robot, types = state.robots[pid], declared(self.ir)
        ports = {name: self.python(value, types[name]) for name, value in robot.ports.items()}
        shared = {name: tuple([self.python(v, types[name]) for v in held]) for name, held in state.store.slots.items()}
        shared.update({name: self.python(value, types[name]) for name, value in state.store.cells.items()})
        locals_ = {name: self.python(value, types[name]) for name, value in robot.locals.items()}
        return rt.Frame(pid, N_SYS, locals_, shared, ports, ports, lambda port, args: answer(pid, port, args))

    def event(self, state: State, pid: int) -> tuple[str | None, int | None, Outcome]:
        transaction = self.program.begin(self.frame(state, pid))
        chosen = rt.choose(self.program, transaction)
        if chosen is None or isinstance(chosen, rt.Fault):
            return None, None, "none" if chosen is None else "discarded"
        return chosen.name, chosen.lock, self.done(rt.run(self.program, chosen.effect, transaction))

    def init(self, state: State, pid: int) -> Outcome:
        init = self.program.init
        return (
            "none"
            if init is None
            else self.done(rt.run(self.program, init, self.program.begin(self.frame(state, pid))))
        )

    def done(self, done: rt.Effects | rt.Fault) -> Outcome:
        if isinstance(done, rt.Fault):
            return "discarded"
        types = declared(self.ir)
        groups = {"locals": done.locals, "shared": done.shared, "actuators": done.actuators}
        found: dict[str, Any] = {
            word: {name: key(value, types[name]) for name, value in group.items()} for word, group in groups.items()
        }
        return {**found, "stopped": done.stopped, "streams": done.streams, "violated": done.violated}


class Meant:
    """A program in the executable semantics."""

    def __init__(self, program: d.Program) -> None:
        self.ir = program
        self.world = World({f.name: self.function(f) for f in program.externs}, answer)

    def function(self, extern: d.ExternFunction) -> Callable[..., Value]:
        def called(*args: Value) -> Value:
            keys = tuple([key(arg, p.type) for arg, p in zip(args, extern.parameters, strict=True)])
            found: Value = _packed(outside(extern.name, keys, extern.result), extern.result)
            return found

        return called

    def event(self, state: State, pid: int) -> tuple[str | None, int | None, Outcome]:
        chosen = step.select(self.ir, state, pid, self.world)
        if chosen is None or isinstance(chosen, step.Step):
            return None, None, "none" if chosen is None else "discarded"
        return chosen.name, chosen.lock, self.done(step.execute(self.ir, chosen.effect, state, pid, self.world))

    def init(self, state: State, pid: int) -> Outcome:
        if not self.ir.init:
            return "none"
        return self.done(step.execute(self.ir, self.ir.init, state, pid, self.world))

    def done(self, done: Writes | Discarded) -> Outcome:
        if isinstance(done, Discarded):
            return "discarded"
        types = declared(self.ir)
        for name, value in (*done.locals.items(), *done.slots.items(), *done.cells.items(), *done.ports.items()):
            assert conforms(value, types[name]), f"{name} became {value!r}, which is no {types[name]}"
        groups = {"locals": done.locals, "shared": {**done.slots, **done.cells}, "actuators": done.ports}
        found: dict[str, Any] = {
            word: {name: key(value, types[name]) for name, value in group.items()} for word, group in groups.items()
        }
        violated = tuple([span.line for span in done.violated])
        return {**found, "stopped": done.stopped, "streams": done.streams, "violated": violated}


def _packed(value: Any, type_: Type) -> Any:
    """Return a result as it comes back from the user's function: a Ticket that was never made is made now."""
    match type_:
        case ExternType():
            return value if value.data else Opaque(msgspec.msgpack.encode(Ticket()))
        case Sequence(_, element):
            return tuple([_packed(part, element) for part in value])
        case MapOf(_, v):
            return tuple([(a, _packed(b, v)) for a, b in value])
        case TupleOf(items):
            return tuple([_packed(part, t) for part, t in zip(value, items, strict=True)])
        case RecordType(name, fields):
            parts = zip(value.fields, fields, strict=True)
            return RecordValue(name, tuple([_packed(part, t) for part, (_, t) in parts]))
        case _:
            return value


def untouched(program: d.Program) -> d.Program:
    return program


class Difference(AssertionError):
    """Raised if the two meanings of a program differ."""


def nothing(generated: Generated) -> None:
    """Leave a generated program as it is."""


def agree(
    seed: int, seen: Counter[str], emitted: Pass = untouched, spoil: Callable[[Generated], None] = nothing
) -> d.Program:
    """Check that both meanings of a random program are equal on a few random states, on every robot.

    `emitted` and `spoil` seed faults.
    """
    program = random_program(seed)
    generated = Generated(program, program_text(emitted(program)))
    spoil(generated)
    semantics = Meant(program)
    rng = Random(-seed - 1)
    for _ in range(2):
        state = random_state(rng, program)
        for pid in range(N_SYS):
            expected = semantics.event(state, pid)
            _compare(generated.event(state, pid), expected, seed, pid, generated)
            seen["none" if expected[0] is None else "discarded" if expected[2] == "discarded" else "ran"] += 1
            seen["violated"] += isinstance(expected[2], dict) and len(expected[2]["violated"])
    for pid in range(N_SYS):
        _compare(generated.init(state, pid), semantics.init(state, pid), seed, pid, generated)
    return program


def _compare(found: Any, expected: Any, seed: int, pid: int, generated: Generated) -> None:
    if found != expected:
        parts = "\n".join(_differences("", found, expected))
        raise Difference(f"random_program({seed}), robot {pid}:\n{parts}\n{show(generated.ir)}\n{generated.text}")


def _differences(path: str, found: Any, expected: Any) -> Iterator[str]:
    """Return the differences, line by line."""
    if isinstance(found, dict) and isinstance(expected, dict):
        for name in sorted({*found, *expected}):
            yield from _differences(f"{path} {name}", found.get(name), expected.get(name))
    elif isinstance(found, tuple) and isinstance(expected, tuple) and len(found) == len(expected) == 3:
        for i in range(3):
            yield from _differences(path, found[i], expected[i])
    elif found != expected:
        yield f"{path}: the generated code says {str(found)[:2000]}, the semantics {str(expected)[:2000]}"
