"""Statements on symbols: every way through a block at once, its ends merged by the conditions of the ways.

`loop.py` decides how a loop is encoded. A loop over few elements is unrolled. A loop whose turns leave nothing behind
but their exits is a search: the first element that leaves it, or none. Any other loop is cut at its head: there, what
the turns write may be anything that the loop's invariants and the facts about its turns (`turns.py`) allow.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple, assert_never

from koordgen.ir import expr as ir
from koordgen.ir import stmt
from koordgen.ir.types import Type
from koordgen.prove import term as t
from koordgen.prove.encode.expr import Encoder
from koordgen.prove.encode.loop import Loop, Way, WayOf, has_loop, has_next_turn, is_search, kept_by, key_of, tells
from koordgen.prove.encode.quantifier import Domain, domain
from koordgen.prove.encode.state import Key, State, Written, slots
from koordgen.prove.encode.tree import nodes
from koordgen.prove.encode.turns import facts_of_turns
from koordgen.prove.encode.values import Fleet, Val, pick
from koordgen.prove.obligation import Fact
from koordgen.prove.term import Term

Env = dict[Key, Val]
Path = tuple[Term, ...]


class Exit:
    """One way out of a block: "break", "continue", "return", "stop"; where it is taken, and what is written by then."""

    def __init__(self, kind: str, path: Path, env: Env, value: Val | None) -> None:
        self.kind, self.path, self.env, self.value = kind, path, env, value


class Place(NamedTuple):
    """One place of an event while it is encoded: the values there, the path to it, its position, and the operations
    before it that must have had a value."""

    frame: Frame
    path: Term
    position: int
    demands: tuple[Fact, ...]

    @property
    def reached(self) -> Term:
        """The condition that a run gets to this place."""
        return t.all_of([self.path, *[demand.term for demand in self.demands]])


class Head:
    """The head of one loop that is cut: `entry` is the place before the first turn, `turn` the head before any turn or
    behind the last one, `back` the place at which a turn has ended that leads to the head again (None: no turn does).
    """

    def __init__(self, loop: Loop, kept: tuple[Key, ...], entry: Place) -> None:
        self.loop, self.kept, self.entry = loop, kept, entry
        self.turn = entry
        self.back: Place | None = None


class Frame:
    """One run of an effect or a function. `now` is the state that is written, `seen` the one whose shared variables are
    read; both None in a function. `types` are those of the run's own variables. `know` is told each loop's head, and
    adds the facts that hold there. `way` decides how loops are encoded; None: by how many elements are seen to be."""

    def __init__(
        self, encoder: Encoder, pid: Term, now: State | None, seen: State | None,
        ask: Callable[[ir.PortCall, tuple[Val, ...]], Val], types: Mapping[str, Type],
        know: Callable[[Head], None], way: WayOf | None = None,
    ) -> None:  # fmt: skip
        self.e, self.room = encoder, encoder.room
        self.pid, self.now, self.seen = pid, now, seen
        self.ask, self.types, self.know, self.way = ask, types, know, way
        self.env: Env = {}
        self.temps: dict[str, Val] = {}
        self.exits: list[Exit] = []
        self.heads: list[Head] = []
        self.brief = False  # of the turns of loops only little is told

    def place(self) -> Place:
        """This place, as it is now."""
        copy = Frame(self.e, self.pid, self.now, self.seen, self.ask, self.types, self.know, self.way)
        copy.env, copy.temps, copy.brief = dict(self.env), dict(self.temps), self.brief
        return Place(copy, t.all_of(self.room.path), self.room.position, tuple(self.room.demands))

    def state(self) -> Written:
        """The fleet's state if the event ended here. Its name is its own: variables as a whole are told apart by it."""
        assert self.now is not None
        writes = {key: value for key, value in self.env.items() if key[0] != "wrote"}
        self.room.fresh += 1
        return Written(self.room, self.now, self.pid, writes, f"@place{self.room.fresh}")

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
        versions = [(self.room.version(value), self.room.version(self.pid)) for value in written.values()]
        moment = f"{self.seen.moment}@{versions[0][0]}@{versions[0][1]}" if versions else self.seen.moment
        return slots(Written(self.room, self.seen, self.pid, written, moment), name)

    def local_of(self, name: str, robot: Term) -> Val:
        raise AssertionError("an effect reads its own robot's")

    port_of = local_of

    # Statements

    def block(self, block: stmt.Block) -> Term:
        """Runs statements; when its end is reached, of those times in which its beginning is."""
        live: Term = t.TRUE
        for place, statement in enumerate(block):
            if live is t.FALSE and not has_loop(block[place:]):
                break
            with self.room.under(live):
                live = t.and_(live, self.statement(statement))
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
        self.put(key, value)
        if key[0] in ("cell", "port"):
            self.env["wrote", key[1]] = t.TRUE

    def put(self, key: Key, value: Val) -> None:
        """Let a variable have a value from here on."""
        if key[0] == "temp":
            self.temps[key[1]] = value
        else:
            self.env[key] = value

    def leave(self, kind: str, value: Val | None = None) -> Term:
        self.exits.append(Exit(kind, self.room.path, self.snapshot(), value))
        return t.FALSE

    def branch(self, node: stmt.If) -> Term:
        condition = self.e.term(node.condition, self)
        if isinstance(condition, t.Value) and not has_loop(node.orelse if condition.value else node.then):
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

    def loop(self, loop: Loop) -> Term:
        around, self.exits = self.exits, []
        start, depth = self.snapshot(), len(self.room.path)
        over = None
        if isinstance(loop, stmt.For):
            over = domain(self.e, loop.values, self, (loop.block, loop.invariants), loop.names[0])
        way = self.way_of(loop, over)
        if way == "unrolled":
            assert isinstance(loop, stmt.For) and over is not None and over.few is not None
            live = self.unrolled(loop, over.few)
        elif way == "search":
            assert isinstance(loop, stmt.For) and over is not None
            live = self.search(loop, over)
        else:
            live = self.cut(loop, over)
        breaks = [e for e in self.exits if e.kind == "break"]
        self.exits = around + [e for e in self.exits if e.kind != "break"]
        for left in breaks:
            condition = t.all_of(left.path[depth:])
            env = left.env if live is t.FALSE else self.merged(condition, left.env, self.snapshot())
            self.restore(env)
            live = t.or_(live, condition)
        self.restore({k: v for k, v in self.snapshot().items() if k[0] != "temp" or k in start})
        return live

    def way_of(self, loop: Loop, over: Domain | None) -> Way:
        if self.way is not None:
            return self.way(loop)
        if over is None or not isinstance(loop, stmt.For) or loop.invariants:
            return "cut"
        if over.few is not None:
            return "unrolled"
        inner = [n for n in nodes(loop.block) if isinstance(n, (stmt.For, stmt.While))]
        return "search" if all(isinstance(n, stmt.For) and is_search(n) for n in (loop, *inner)) else "cut"

    def unrolled(self, loop: stmt.For, elements: list[Val]) -> Term:
        live: Term = t.TRUE
        for element in elements:
            with self.room.under(live):
                live = t.and_(live, self.run(loop, element))
            if live is t.FALSE and not has_loop(loop.block):
                break
        return live

    def run(self, loop: Loop, element: Val | None) -> Term:
        """One turn of a loop; when its end, or a `continue`, is reached."""
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
        """No turn changes anything, so the first element that leaves the loop decides."""
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

        many = len(room.demands)
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
            return t.implies(here, t.and_(found, over.not_after(first, index)))

        with room.about("what a loop looks for", loop.span.line):
            room.element(first, over.robots, over.places and first not in room.ignored)
            room.for_all(instance, over.robots, over.places)
        if len(room.demands) > many:
            del room.demands[many:]
            self.demanded(loop, over, found, first, start)
        self.restore(start)
        self.exits = [Exit(e.kind, (*e.path[:depth], found, *e.path[depth:]), e.env, e.value) for e in exits]
        return t.not_(found)

    def demanded(self, loop: stmt.For, over: Domain, found: Term, first: Term, start: Env) -> None:
        """Demand that each turn that is taken has a value: those of all elements up to the one that leaves the loop."""
        any_ = self.room.new(f"{loop.names[0].split('@')[0]}@taken", t.INT)
        self.looked_at(any_, over, not self.brief)
        taken = t.and_(over.inside(any_), t.implies(found, over.not_after(any_, first)))
        around, self.exits = self.exits, []
        self.restore(start)
        with self.room.under(taken):
            self.run(loop, over.element(any_))
        self.exits = around

    def cut(self, loop: Loop, over: Domain | None) -> Term:
        """At the head what the turns write may be anything that the facts there allow; one turn from there leads to
        `back`, and where there is none, the loop has ended."""
        room, index = self.room, None
        if self.now is not None:
            line = loop.span.line
            room.note(f"line {line}: of what the loop writes only its invariants and facts about turns are known")
        if over is not None:
            self.count(loop, over.start)
        kept = tuple(kept_by(loop))
        head = Head(loop, kept, self.place())
        room.position += 1
        for key in kept:
            self.restore({**self.snapshot(), key: room.any(key[1].split("@")[0], self.type_of(key))})
            if key[0] in ("cell", "port"):
                self.env["wrote", key[1]] = room.new(f"wrote {key[1]}", t.BOOL)
        if over is not None:
            assert isinstance(loop, stmt.For)
            index = room.new(loop.names[0].split("@")[0], t.INT)
            self.looked_at(index, over, not self.brief or self.now is not None)
            self.count(loop, index)
        head.turn = self.place()
        facts_of_turns(head, over, index, self.brief)
        if over is None:
            assert isinstance(loop, stmt.While)
            condition, element = self.e.term(loop.condition, self), None
        else:
            assert index is not None
            condition, element = over.ahead(index), over.element(index)
        start = self.snapshot()
        with room.under(condition):
            live = self.run(loop, element)
            if live is not t.FALSE or has_next_turn(loop):  # as `count.py` has it, which folds no constants
                if over is not None:
                    assert index is not None
                    self.count(loop, t.add(index, t.integer(over.step)))
                with room.under(live):
                    head.back = self.place()
        room.position += 1
        self.restore(start)
        self.heads.append(head)
        self.know(head)
        return t.not_(condition)

    def looked_at(self, index: Term, over: Domain, told: bool) -> None:
        """Instantiate what holds of all robots, or of all places in lists, for this one, if so much is told."""
        if told:
            self.room.element(index, over.robots, over.places)
        else:
            self.room.ignored.add(index)
            self.room.partial = True

    def count(self, loop: Loop, index: Term) -> None:
        """The variable of a loop over numbers, for the loop's invariants: the next value."""
        if isinstance(loop, stmt.For) and isinstance(loop.values, (ir.Range, ir.Ids)):
            self.temps[loop.names[0]] = index

    def type_of(self, key: Key) -> Type:
        if key[0] == "temp":
            return self.types[key[1]]
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
