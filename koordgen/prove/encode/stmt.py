"""Statements on symbols: every way through a block at once, its ends merged by the conditions of the ways.

A loop over few elements is unrolled. One whose runs leave nothing behind but its exits is a search: the first element
that leaves it, or none. Any other loop is cut: the invariants must hold where it begins and be kept by each run; behind
it, and at the start of each run, what it writes may be anything that they allow.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import assert_never

from koordgen.ir import expr as ir
from koordgen.ir import stmt
from koordgen.ir.types import Type
from koordgen.prove import term as t
from koordgen.prove.encode.block import kept_by, key_of, tells
from koordgen.prove.encode.expr import Encoder
from koordgen.prove.encode.quantifier import Domain, domain
from koordgen.prove.encode.state import Key, State, Written, slots
from koordgen.prove.encode.values import Fleet, Val, pick
from koordgen.prove.term import Term

Env = dict[Key, Val]
Path = tuple[Term, ...]


class Unsummarised(Exception):
    """A loop of a function that is no search: what the function yields is not known."""


class Exit:
    """One way out of a block: "break", "continue", "return", "stop"; where it is taken, and what is written by then."""

    def __init__(self, kind: str, path: Path, env: Env, value: Val | None) -> None:
        self.kind, self.path, self.env, self.value = kind, path, env, value


class Cut:
    """A loop's beginning or a run's end ("begins", "goes on"), where the invariants are shown; or a run's beginning
    ("run"), where they are known."""

    def __init__(self, kind: str, path: Path, state: Written, line: int) -> None:
        self.kind, self.path, self.state, self.line = kind, path, state, line


class Frame:
    """One run of an effect or a function. `now` is the state that is written, `seen` the one whose shared variables are
    read; both None in a function."""

    def __init__(
        self, encoder: Encoder, pid: Term, now: State | None, seen: State | None,
        ask: Callable[[ir.PortCall, tuple[Val, ...]], Val],
    ) -> None:  # fmt: skip
        self.e, self.room = encoder, encoder.room
        self.pid, self.now, self.seen = pid, now, seen
        self.ask = ask
        self.env: Env = {}
        self.temps: dict[str, Val] = {}
        self.exits: list[Exit] = []
        self.cuts: list[Cut] = []

    # What is read

    def own(self, key: Key) -> Val:
        if key in self.env:
            return self.env[key]
        if key[0] == "temp":
            return self.temps[key[1]]
        state = self.seen if key[0] in ("slot", "cell") else self.now
        assert state is not None
        return state.of(key, self.pid)

    def local(self, name: str) -> Val:
        return self.own(("local", name))

    def cell(self, name: str) -> Val:
        return self.own(("cell", name))

    def port(self, name: str, primed: bool) -> Val:
        return self.own(("port", name))

    def slot(self, name: str, index: Term) -> Val:
        return self.slots(name).slot(index)

    def slots(self, name: str) -> Fleet:
        assert self.seen is not None
        written = {key: value for key, value in self.env.items() if key == ("slot", name)}
        versions = [self.room.version(value) for value in written.values()]
        moment = f"{self.seen.moment}@{versions[0]}" if versions else self.seen.moment
        return slots(Written(self.room, self.seen, self.pid, written, moment), name)

    def local_of(self, name: str, robot: Term) -> Val:
        raise AssertionError("an effect reads its own robot's")

    port_of = local_of

    # Statements

    def block(self, block: stmt.Block) -> Term:
        """Runs statements; when its end is reached, of those times in which its beginning is."""
        live: Term = t.TRUE
        for statement in block:
            with self.room.under(live):
                live = t.and_(live, self.statement(statement))
            if live is t.FALSE:
                break
        return live

    def statement(self, statement: stmt.Stmt) -> Term:
        match statement:
            case stmt.Assign(place, value):
                self.assign(place, self.e.value(value, self))
            case stmt.Let(name, _, value):
                self.temps[name] = self.e.value(value, self)
            case stmt.If():
                return self.branch(statement)
            case stmt.For() | stmt.While():
                return self.loop(statement)
            case stmt.Emit(_, _, items):
                for item in items:
                    self.e.value(item, self)
            case stmt.Return(value):
                return self.leave("return", self.e.value(value, self))
            case stmt.Break():
                return self.leave("break")
            case stmt.Continue():
                return self.leave("continue")
            case stmt.Stop():
                return self.leave("stop")
            case _:
                assert_never(statement)
        return t.TRUE

    def assign(self, place: stmt.Place, value: Val) -> None:
        key = key_of(place)
        if key[0] == "temp":
            self.temps[key[1]] = value
        else:
            self.env[key] = value
            if key[0] in ("cell", "port"):
                self.env["wrote", key[1]] = t.TRUE

    def leave(self, kind: str, value: Val | None = None) -> Term:
        self.exits.append(Exit(kind, self.room.path, self.snapshot(), value))
        return t.FALSE

    def branch(self, node: stmt.If) -> Term:
        condition = self.e.term(node.condition, self)
        if isinstance(condition, t.Value):
            return self.block(node.then if condition.value else node.orelse)
        before = self.snapshot()
        with self.room.under(condition):
            then = self.block(node.then)
        after = self.snapshot()
        self.restore(before)
        with self.room.under(t.not_(condition)):
            orelse = self.block(node.orelse)
        if orelse is t.FALSE:
            self.restore(after)
        elif then is not t.FALSE:
            self.restore(self.merged(condition, after, self.snapshot()))
        return t.ite(condition, then, orelse)

    # Loops

    def loop(self, loop: stmt.For | stmt.While) -> Term:
        around, self.exits = self.exits, []
        start, depth = self.snapshot(), len(self.room.path)
        if isinstance(loop, stmt.For):
            over = domain(self.e, loop.values, self)
            if over.few is not None:
                live = self.unrolled(loop, over.few)
            elif not (kept := kept_by(loop.block, frozenset(self.temps))):
                live = self.search(loop, over)
            else:
                live = self.cut(loop, kept, over)
        else:
            live = self.cut(loop, kept_by(loop.block, frozenset(self.temps)), None)
        breaks = [e for e in self.exits if e.kind == "break"]
        self.exits = around + [e for e in self.exits if e.kind != "break"]
        for left in breaks:
            condition = t.all_of(left.path[depth:])
            env = left.env if live is t.FALSE else self.merged(condition, left.env, self.snapshot())
            self.restore(env)
            live = t.or_(live, condition)
        self.restore({k: v for k, v in self.snapshot().items() if k[0] != "temp" or k in start})
        return live

    def unrolled(self, loop: stmt.For, elements: list[Val]) -> Term:
        live: Term = t.TRUE
        for element in elements:
            with self.room.under(live):
                live = t.and_(live, self.run(loop, element))
            if live is t.FALSE:
                break
        return live

    def run(self, loop: stmt.For | stmt.While, element: Val | None) -> Term:
        """One run of a loop's block; when its end, or a `continue`, is reached."""
        if isinstance(loop, stmt.For):
            assert element is not None
            self.take(loop, element)
        depth = len(self.room.path)
        live = self.block(loop.block)
        for left in [e for e in self.exits if e.kind == "continue"]:
            condition = t.all_of(left.path[depth:])
            self.restore(left.env if live is t.FALSE else self.merged(condition, left.env, self.snapshot()))
            live = t.or_(live, condition)
        self.exits = [e for e in self.exits if e.kind != "continue"]
        return live

    def take(self, loop: stmt.For, element: Val) -> None:
        parts = (element,) if len(loop.names) == 1 else element
        assert isinstance(parts, tuple)
        self.temps.update(zip(loop.names, parts, strict=True))

    def search(self, loop: stmt.For, over: Domain) -> Term:
        """No run changes anything, so the first element that leaves the loop decides."""
        room, start = self.room, self.snapshot()
        found, first = room.new("found", t.BOOL), room.new(loop.names[0].split("@")[0], t.INT)
        path, depth = room.path, len(room.path)
        if not tells(loop.block, loop.names):
            room.ignored.add(first)
            room.partial = True

        def leaves(index: Term) -> Term:
            self.restore(start)
            with room.under(over.inside(index)):
                self.run(loop, over.element(index))
            return t.any_of([t.all_of(e.path[depth:]) for e in self.exits])

        left = leaves(first)
        exits = self.exits
        room.fact(t.implies(found, left), "what a loop looks for", loop.span.line)

        def instance(index: Term) -> Term:
            kept, around = room.path, (self.exits, self.snapshot())
            room.path, self.exits = path, []
            try:
                with room.aside():
                    here = leaves(index)
            finally:
                room.path, self.exits = kept, around[0]
                self.restore(around[1])
            step = loop.values.step if isinstance(loop.values, ir.Range) else 1
            order = t.at_most(first, index) if step > 0 else t.at_most(index, first)
            return t.implies(here, t.and_(found, order))

        with room.about("what a loop looks for", loop.span.line):
            room.element(first, over.robots, over.places and first not in room.ignored)
            room.for_all(instance, over.robots, over.places)
        self.restore(start)
        self.exits = [Exit(e.kind, (*e.path[:depth], found, *e.path[depth:]), e.env, e.value) for e in exits]
        return t.not_(found)

    def cut(self, loop: stmt.For | stmt.While, kept: dict[Key, None], over: Domain | None) -> Term:
        if self.now is None:
            raise Unsummarised
        room, line = self.room, loop.span.line
        room.note(f"line {line}: of what the loop writes nothing is known behind it but the invariants")
        self.mark("begins", line)
        for key in kept:
            self.restore({**self.snapshot(), key: room.any(key[1], self.type_of(key))})
            if key[0] in ("cell", "port"):
                self.env["wrote", key[1]] = room.new(f"wrote {key[1]}", t.BOOL)
        self.mark("run", line)
        ended = room.new("ended", t.BOOL)
        start, value = self.snapshot(), None
        with room.under(t.not_(ended)):
            if isinstance(loop, stmt.For):
                assert over is not None
                index = room.new(loop.names[0].split("@")[0], t.INT)
                room.element(index, over.robots, over.places)
                condition, value = over.inside(index), over.element(index)
            else:
                condition = self.e.term(loop.condition, self)
            with room.under(condition):
                live = self.run(loop, value)
                with room.under(live):
                    self.mark("goes on", line)
        self.restore(start)
        return ended if isinstance(loop, stmt.For) else t.and_(ended, t.not_(condition))

    def mark(self, kind: str, line: int) -> None:
        assert self.now is not None
        writes = {key: value for key, value in self.env.items() if key[0] != "wrote"}
        self.cuts.append(Cut(kind, self.room.path, Written(self.room, self.now, self.pid, writes, f"@{line}"), line))

    def type_of(self, key: Key) -> Type:
        if key[0] == "temp":
            return self.room.temps[key[1]]
        assert self.now is not None
        return self.now.types[key]

    # Ways that come together

    def snapshot(self) -> Env:
        return {**self.env, **{("temp", name): value for name, value in self.temps.items()}}

    def restore(self, env: Env) -> None:
        self.env = {key: value for key, value in env.items() if key[0] != "temp"}
        self.temps = {key[1]: value for key, value in env.items() if key[0] == "temp"}

    def merged(self, condition: Term, then: Env, orelse: Env) -> Env:
        """What is written after either of two ways; temps that only one of them has are gone."""
        found: Env = {}
        for key in {**then, **orelse}:
            if key[0] == "temp":
                if key in then and key in orelse:
                    found[key] = pick(condition, then[key], orelse[key])
                continue
            a, b = (way[key] if key in way else self.before(key) for way in (then, orelse))
            found[key] = pick(condition, a, b)
        return found

    def before(self, key: Key) -> Val:
        if key[0] == "wrote":
            return t.FALSE
        state = self.seen if key[0] in ("slot", "cell") else self.now
        assert state is not None
        return state.of(key, self.pid)

    def writes(self) -> Env:
        """What is written at the end, whichever way was taken; call it once the block has run."""
        env = self.snapshot()
        for left in self.exits:
            env = self.merged(t.all_of(left.path), left.env, env)
        return {key: value for key, value in env.items() if key[0] != "temp"}
