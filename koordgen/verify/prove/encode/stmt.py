"""Statements on symbols: every way through a block at once, its ends merged by the conditions of the ways.

`loop.py` decides how a loop is encoded. A loop over few elements is unrolled. A loop whose turns leave nothing behind
but their exits is a search: the first element that leaves it, or none. Any other loop is cut at its head: there, what
the turns write may be anything that the loop's invariants and the facts about its turns (`facts_of_turns`) allow.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, assert_never

from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt
from koordgen.lang.ir.tree import statements, walk
from koordgen.lang.ir.types import Type
from koordgen.verify.prove.encode.expr import Encoder
from koordgen.verify.prove.encode.loop import (
    Bound,
    Loop,
    Way,
    WayOf,
    Write,
    Writes,
    bound_of,
    conjuncts,
    has_loop,
    has_next_turn,
    is_search,
    kept_by,
    key_of,
    step_of,
    tells,
)
from koordgen.verify.prove.encode.quantifier import Domain, domain, names_robots
from koordgen.verify.prove.encode.state import Key, State, Written, slots
from koordgen.verify.prove.encode.values import Fleet, Val, pick, truth
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.obligation import Fact
from koordgen.verify.prove.smt.term import Term

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
        inner = [s for s in statements(loop.block) if isinstance(s, (stmt.For, stmt.While))]
        return "search" if all(isinstance(s, stmt.For) and is_search(s) for s in (loop, *inner)) else "cut"

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


# Facts about the turns of a loop that is cut: what holds at its head by the meaning of loops alone. Each rule is stated
# in docs/reference/semantics.md ("Loops") with the reason why it is sound. None needs an obligation. All of them can be
# satisfied whatever the program does: by the values at loop entry, with no turn taken.
_ZERO, _ONE = t.integer(0), t.integer(1)


def facts_of_turns(head: Head, over: Domain | None, index: Term | None, brief: bool) -> None:
    """Add all that is known at a loop's head before any turn or behind the last one; `index` is the place in `over`
    that a `for` has come to. `brief`: add only which places these may be, and what is counted."""
    turns = _Turns(head, over, index)
    with turns.room.about(f"turns of the loop in line {head.loop.span.line}", head.loop.span.line):
        turns.places()
        turns.written()
        for key in head.kept:
            turns.counted(key)
        if brief:
            return
        groups: dict[tuple[int, int], list[Write]] = {}
        for write in turns.writes.all:
            if write.key in head.kept and turns.writes.only(write.key) is write:
                if over is not None:
                    groups.setdefault(write.group, []).append(write)
                bound = bound_of(write)
                if over is not None and bound is not None:
                    turns.bounded(bound)
                if over is None:
                    turns.passed(write)
        for group in groups.values():
            turns.last_written(group)


class _Turns:
    def __init__(self, head: Head, over: Domain | None, index: Term | None) -> None:
        self.head, self.over, self.index = head, over, index
        self.loop = head.loop
        self.before, self.now = head.entry.frame, head.turn.frame
        self.room = self.now.room
        self.writes = Writes(self.loop)

    # Rule "places": a `for` has come to a place of its domain, or to its end.

    def places(self) -> None:
        if self.over is None or self.index is None:
            return
        over, index, room = self.over, self.index, self.room
        room.fact(over.not_after(over.start, index))
        if abs(over.step) == 1:
            room.fact(t.or_(t.equals(index, over.start), over.not_after(index, over.stop)))
        else:
            last = t.subtract(index, t.integer(over.step))
            room.fact(t.or_(t.equals(index, over.start), over.ahead(last)))
            for fact in over.on_grid(index):
                room.fact(fact)

    # Rule "written": a variable that no turn has written is as it was.

    def written(self) -> None:
        for kind, name in self.head.kept:
            wrote = self.now.env.get(("wrote", name))
            if kind not in ("cell", "port") or wrote is None:
                continue
            self.room.fact(t.implies(truth(self.before.env.get(("wrote", name), t.FALSE)), truth(wrote)))
            same = self.same((kind, name))
            self.room.fact(t.or_(truth(wrote), same))

    # Rule "counted": what only grows is never below its value at loop entry, and not above it by more than one step a
    # turn; what grows in each turn is exactly so much above.

    def counted(self, key: Key) -> None:
        writes = self.writes.of(key)
        steps = [step_of(write) for write in writes]
        known = [step for step in steps if step is not None]
        if not writes or len(known) < len(steps) or not (min(known) >= 0 or max(known) <= 0):
            return
        first, now = truth(self.before.own(key)), truth(self.now.own(key))
        if now.sort is not t.INT:
            return
        rises = max(known) > 0
        self.room.fact(t.at_most(first, now) if rises else t.at_most(now, first))
        if self.over is None or self.index is None or len(writes) > 1 or abs(self.over.step) != 1:
            return
        gone = t.subtract(self.index, self.over.start)
        taken = gone if self.over.step > 0 else t.negate(gone)
        most = t.add(first, t.multiply(t.integer(known[0]), taken))
        if writes[0].sure and not writes[0].guards:
            self.room.fact(t.equals(now, most))
        else:
            self.room.fact(t.at_most(now, most) if rises else t.at_most(most, now))

    # Rule "last written": what one statement alone writes is as it was, or as that statement made it in an earlier
    # turn.

    def last_written(self, group: Sequence[Write]) -> None:
        fixed = [write for write in group if self.writes.is_fixed(write.value, write.lets)]
        if not fixed:
            return
        assert self.over is not None and self.index is not None
        turn = self.room.new(f"{self.name()}@last", t.INT)
        self.room.element(turn, self.over.robots, self.over.places)
        frame = self.at(turn, fixed[-1].lets)
        made = [self.equal(self.now.own(write.key), self.value(write.value, frame)) for write in fixed]
        held = self.guards(fixed[0].guards, fixed[0].lets, frame)
        kept = [self.same(write.key) for write in fixed]
        self.room.fact(t.or_(t.all_of(kept), t.all_of([self.over.passed(turn, self.index), *made, *held])))

    # Rule "bounded": what keeps the least value is not above the value at loop entry, nor above that of any turn that
    # was taken.

    def bounded(self, bound: Bound) -> None:
        write = bound.write
        if not self.writes.is_fixed(bound.value, write.lets):
            return
        assert self.over is not None and self.index is not None
        over, at = self.over, self.index
        now = truth(self.now.own(write.key))
        self.room.fact(self.order(now, truth(self.before.own(write.key)), bound.least))
        if not write.sure or not all(self.writes.is_fixed(guard, write.lets) for guard, _ in bound.guards):
            return

        def instance(turn: Term) -> Term:
            frame = self.at(turn, write.lets)
            value = truth(self.value(bound.value, frame))
            held = self.guards(bound.guards, write.lets, frame)
            return t.implies(t.all_of([over.passed(turn, at), *held]), self.order(now, value, bound.least))

        self.room.for_all(instance, over.robots, over.places)

    # Rule "passed": the condition of a `while` held for each value that its counter has left behind.

    def passed(self, write: Write) -> None:
        step = step_of(write)
        if not isinstance(self.loop, stmt.While) or step is None or step == 0:
            return
        key, parts = write.key, []
        if truth(self.now.own(key)).sort is not t.INT:
            return
        others = set(self.writes.changed) - {key}
        for part in conjuncts(self.loop.condition):
            if self.reads_only_fixed(part, others):
                parts.append(part)
        if not parts:
            return
        first, now = truth(self.before.own(key)), truth(self.now.own(key))

        def held(value: Term) -> Term:
            frame = self.before.place().frame
            frame.put(key, value)
            return t.all_of([truth(self.value(part, frame)) for part in parts])

        self.room.fact(t.or_(t.equals(now, first), held(t.subtract(now, t.integer(step)))))
        if abs(step) != 1:
            return

        def instance(value: Term) -> Term:
            between = (
                t.and_(t.at_most(first, value), t.less(value, now))
                if step > 0
                else t.and_(t.less(now, value), t.at_most(value, first))
            )
            return t.implies(between, held(value))

        robots = any(isinstance(n, ir.NSys) for n in walk(tuple(parts))) or names_robots(tuple(parts), key[1])
        self.room.for_all(instance, robots, True)

    def reads_only_fixed(self, part: ir.Expr, others: set[Key]) -> bool:
        changed, self.writes.changed = self.writes.changed, dict.fromkeys(others)
        try:
            return self.writes.is_fixed(part, ())
        finally:
            self.writes.changed = changed

    # What stands in the rules

    def name(self) -> str:
        return self.loop.names[0].split("@")[0] if isinstance(self.loop, stmt.For) else "turn"

    def at(self, turn: Term, lets: Sequence[stmt.Let]) -> Frame:
        """The values of a turn that depend on nothing but its element."""
        assert self.over is not None and isinstance(self.loop, stmt.For)
        frame = self.before.place().frame
        frame.take(self.loop, self.over.element(turn))
        for place, let in enumerate(lets):
            if self.writes.is_fixed(let.value, tuple(lets[:place])):
                frame.temps[let.name] = self.value(let.value, frame)
        return frame

    def value(self, node: ir.Expr, frame: Frame) -> Val:
        """The value of an expression, whether or not it has one: no demand is made."""
        with self.room.outermost(), self.room.aside():
            return frame.e.value(node, frame)

    def guards(self, guards: Sequence[tuple[ir.Expr, bool]], lets: tuple[stmt.Let, ...], frame: Frame) -> list[Term]:
        """Those of the conditions that depend on nothing but the turn's element."""
        fixed = [(guard, held) for guard, held in guards if self.writes.is_fixed(guard, lets)]
        terms = [(truth(self.value(guard, frame)), held) for guard, held in fixed]
        return [term if held else t.not_(term) for term, held in terms]

    def same(self, key: Key) -> Term:
        return self.equal(self.now.own(key), self.before.own(key))

    def equal(self, a: Val, b: Val) -> Term:
        return self.now.e.lists.same(a, b)

    def order(self, now: Term, other: Term, least: bool) -> Term:
        assert now.sort in (t.INT, t.REAL)
        return t.at_most(now, other) if least else t.at_most(other, now)
