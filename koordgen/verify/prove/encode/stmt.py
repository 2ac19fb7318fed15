"""Symbolic execution of statements: all paths through a block at once, merged at the end of the block.

`loop.py` chooses the encoding of a loop. A loop over few elements is unrolled. A loop without loop-carried variables is
a search: the first element at which the loop is left decides the result. Any other loop is cut at its head: the
variables that it writes get arbitrary values, constrained by the loop's invariants and by facts about its iterations
(`facts_of_turns`).
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
    EncodingOf,
    Loop,
    LoopEncoding,
    LoopWrite,
    LoopWrites,
    RunningExtreme,
    conjuncts,
    exposes_element,
    has_loop,
    has_next_turn,
    is_search,
    key_of,
    loop_carried,
    running_extreme_of,
    step_of,
)
from koordgen.verify.prove.encode.quantifier import IterationDomain, domain, names_robots
from koordgen.verify.prove.encode.state import Key, SymbolicState, UpdatedState, slots
from koordgen.verify.prove.encode.values import FleetValue, Val, as_term, pick
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.obligation import LabelledFormula
from koordgen.verify.prove.smt.term import Term

Env = dict[Key, Val]
Path = tuple[Term, ...]


class Exit:
    """Exit of a block.

    `kind`: "break", "continue", "return" or "stop".
    `path`: the condition under which the exit is taken.
    `env`: the values of the variables written before the exit.
    `value`: the result, if the exit is the "return" of a function."""

    def __init__(self, kind: str, path: Path, env: Env, value: Val | None) -> None:
        self.kind, self.path, self.env, self.value = kind, path, env, value


class ProgramPoint(NamedTuple):
    """Point in an event or function, recorded while the event or function is encoded.

    `frame`: a copy of the values at the point.
    `path`: the path condition.
    `position`: facts up to this position are known at the point.
    `demands`: the conditions under which all operations before the point have values."""

    frame: SymbolicFrame
    path: Term
    position: int
    demands: tuple[LabelledFormula, ...]

    @property
    def reached(self) -> Term:
        """Return the condition that a run reaches the program point.

        The run must take the path to the point, and all earlier operations must have values."""
        return t.all_of([self.path, *[demand.term for demand in self.demands]])


class LoopHead:
    """Head of a loop that is encoded by its invariants instead of being unrolled.

    `loop`: the loop.
    `kept`: the loop-carried variables, which have arbitrary values at the head.
    `entry`: the program point before the first iteration.
    `turn`: the head before an arbitrary iteration, or after the last iteration.
    `back`: the end of an iteration that leads back to the head; None if no iteration does."""

    def __init__(self, loop: Loop, kept: tuple[Key, ...], entry: ProgramPoint) -> None:
        self.loop, self.kept, self.entry = loop, kept, entry
        self.turn = entry
        self.back: ProgramPoint | None = None


class SymbolicFrame:
    """Symbolic execution of one effect or function.

    `now`: the state that the effect changes; None in a function.
    `seen`: the state from which shared variables are read; None in a function.
    `types`: the types of the local variables of the block.
    `assume_at_head`: receives each loop head and adds the facts that hold at the head.
    `encoding`: chooses the encoding of a loop. If None, the number of the loop's elements decides."""

    def __init__(
        self, encoder: Encoder, pid: Term, now: SymbolicState | None, seen: SymbolicState | None,
        ask: Callable[[ir.PortCall, tuple[Val, ...]], Val], types: Mapping[str, Type],
        assume_at_head: Callable[[LoopHead], None], encoding: EncodingOf | None = None,
    ) -> None:  # fmt: skip
        self.e, self.context = encoder, encoder.context
        self.pid, self.now, self.seen = pid, now, seen
        self.ask, self.types, self.assume_at_head, self.encoding = ask, types, assume_at_head, encoding
        self.env: Env = {}
        self.temps: dict[str, Val] = {}
        self.exits: list[Exit] = []
        self.heads: list[LoopHead] = []
        self.brief = False  # True to add fewer facts about loop iterations
        # State from which the robot reads ports that another application may have changed since the round's start
        self.sensed: Mapping[Key, SymbolicState] = {}

    def place(self) -> ProgramPoint:
        """Return the current program point, with a copy of all values."""
        copy = SymbolicFrame(
            self.e, self.pid, self.now, self.seen, self.ask, self.types, self.assume_at_head, self.encoding
        )
        copy.env, copy.temps, copy.brief, copy.sensed = dict(self.env), dict(self.temps), self.brief, self.sensed
        return ProgramPoint(copy, t.all_of(self.context.path), self.context.position, tuple(self.context.demands))

    def state(self) -> UpdatedState:
        """Return the state that the fleet would have if the event ended at the current program point.

        Each returned state has a unique name, so its variables differ from the variables of all other states."""
        assert self.now is not None
        writes = self.changes(self.env)
        self.context.fresh += 1
        return UpdatedState(self.context, self.now, self.pid, writes, f"@place{self.context.fresh}")

    def changes(self, env: Env) -> Env:
        """Return the variables of the state that have new values after the writes in `env`.

        On a path that does not write an allwrite variable, the variable keeps its value in `now`, which another robot
        may have written since the round's start. `env` has the value that the event reads there."""
        found = {key: value for key, value in env.items() if key[0] != "wrote"}
        for key, value in found.items():
            if key[0] == "cell" and self.now is not None and self.seen is not self.now:
                wrote = as_term(env.get(("wrote", key[1]), t.TRUE))
                found[key] = pick(wrote, value, self.now.of(key, self.pid))
        return found

    # Reads of variables and ports

    def own(self, key: Key) -> Val:
        if key in self.env:
            return self.env[key]
        if key[0] == "temp":
            return self.temps[key[1]]
        state = self.sensed.get(key) or (self.seen if key[0] in ("slot", "cell") else self.now)
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

    def slots(self, name: str) -> FleetValue:
        assert self.seen is not None
        written = {key: value for key, value in self.env.items() if key == ("slot", name)}
        versions = [(self.context.version(value), self.context.version(self.pid)) for value in written.values()]
        state_name = f"{self.seen.state_name}@{versions[0][0]}@{versions[0][1]}" if versions else self.seen.state_name
        return slots(UpdatedState(self.context, self.seen, self.pid, written, state_name), name)

    def local_of(self, name: str, robot: Term) -> Val:
        raise AssertionError("an effect reads a local or a port of a named robot")

    port_of = local_of

    # Execution of statements

    def block(self, block: stmt.Block) -> Term:
        """Execute the statements of a block.

        Returns the condition under which a run that begins the block reaches the end of the block."""
        live: Term = t.TRUE
        for place, statement in enumerate(block):
            if live is t.FALSE and not has_loop(block[place:]):
                break
            with self.context.under(live):
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
        """Set a variable to a new value."""
        if key[0] == "temp":
            self.temps[key[1]] = value
        else:
            self.env[key] = value

    def leave(self, kind: str, value: Val | None = None) -> Term:
        self.exits.append(Exit(kind, self.context.path, self.snapshot(), value))
        return t.FALSE

    def branch(self, node: stmt.If) -> Term:
        condition = self.e.term(node.condition, self)
        if isinstance(condition, t.LiteralTerm) and not has_loop(node.orelse if condition.value else node.then):
            return self.block(node.then if condition.value else node.orelse)
        before = self.snapshot()
        with self.context.under(condition):
            then = self.block(node.then)
        after = self.snapshot()
        self.restore(before)
        with self.context.under(t.not_(condition)):
            orelse = self.block(node.orelse)
        if orelse is t.FALSE:
            self.restore(after)
        elif then is not t.FALSE:
            self.restore(self.merged(condition, after, self.snapshot()))
        return t.ite(condition, then, orelse)

    # Execution of loops

    def loop(self, loop: Loop) -> Term:
        around, self.exits = self.exits, []
        start, depth = self.snapshot(), len(self.context.path)
        over = None
        if isinstance(loop, stmt.For):
            over = domain(self.e, loop.values, self, (loop.block, loop.invariants), loop.names[0])
        encoding = self.encoding_of(loop, over)
        if encoding == "unrolled":
            assert isinstance(loop, stmt.For) and over is not None and over.listed is not None
            live = self.unrolled(loop, over.listed)
        elif encoding == "search":
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

    def encoding_of(self, loop: Loop, over: IterationDomain | None) -> LoopEncoding:
        if self.encoding is not None:
            return self.encoding(loop)
        if over is None or not isinstance(loop, stmt.For) or loop.invariants:
            return "cut"
        if over.listed is not None:
            return "unrolled"
        inner = [s for s in statements(loop.block) if isinstance(s, (stmt.For, stmt.While))]
        return "search" if all(isinstance(s, stmt.For) and is_search(s) for s in (loop, *inner)) else "cut"

    def unrolled(self, loop: stmt.For, elements: list[Val]) -> Term:
        live: Term = t.TRUE
        for element in elements:
            with self.context.under(live):
                live = t.and_(live, self.run(loop, element))
            if live is t.FALSE and not has_loop(loop.block):
                break
        return live

    def run(self, loop: Loop, element: Val | None) -> Term:
        """Execute one iteration. Return the condition that the run reaches its end or a `continue`."""
        if isinstance(loop, stmt.For):
            assert element is not None
            self.bind_element(loop, element)
        depth = len(self.context.path)
        live = self.block(loop.block)
        for left in [e for e in self.exits if e.kind == "continue"]:
            condition = t.all_of(left.path[depth:])
            self.restore(left.env if live is t.FALSE else self.merged(condition, left.env, self.snapshot()))
            live = t.or_(live, condition)
        self.exits = [e for e in self.exits if e.kind != "continue"]
        return live

    def bind_element(self, loop: stmt.For, element: Val) -> None:
        parts = (element,) if len(loop.names) == 1 else element
        assert isinstance(parts, tuple)
        self.temps.update(zip(loop.names, parts, strict=True))

    def search(self, loop: stmt.For, over: IterationDomain) -> Term:
        """Encode a loop as a search: the first element at which the loop is left decides the result.

        No iteration of such a loop changes a variable that a later iteration reads."""
        context, start = self.context, self.snapshot()
        found, first = context.new("found", t.BOOL), context.new(loop.names[0].split("@")[0], t.INT)
        path, depth = context.path, len(context.path)
        if not exposes_element(loop.block, loop.names):
            context.ignored.add(first)

        def leaves(index: Term) -> Term:
            self.restore(start)
            with context.under(over.inside(index)):
                self.run(loop, over.element(index))
            return t.any_of([t.all_of(e.path[depth:]) for e in self.exits])

        many = len(context.demands)
        left = leaves(first)
        exits = self.exits
        context.fact(t.implies(found, left), "iteration that leaves a loop", loop.span.line)

        def instance(index: Term) -> Term:
            kept, around = context.path, (self.exits, self.snapshot())
            context.path, self.exits = path, []
            try:
                with context.separate_demands():
                    here = leaves(index)
            finally:
                context.path, self.exits = kept, around[0]
                self.restore(around[1])
            return t.implies(here, t.and_(found, over.not_after(first, index)))

        with context.about("iteration that leaves a loop", loop.span.line):
            context.element(first, over.robots, over.places and first not in context.ignored)
            context.for_all(instance, over.robots, over.places)
        if len(context.demands) > many:
            del context.demands[many:]
            self.demanded(loop, over, found, first, start)
        self.restore(start)
        self.exits = [Exit(e.kind, (*e.path[:depth], found, *e.path[depth:]), e.env, e.value) for e in exits]
        return t.not_(found)

    def demanded(self, loop: stmt.For, over: IterationDomain, found: Term, first: Term, start: Env) -> None:
        """Demand that every operation has a value in each iteration that runs.

        If an iteration leaves the loop, the iterations up to and including it run. Otherwise all iterations run."""
        any_ = self.context.new(f"{loop.names[0].split('@')[0]}@taken", t.INT)
        self.register_index(any_, over, not self.brief)
        taken = t.and_(over.inside(any_), t.implies(found, over.not_after(any_, first)))
        around, self.exits = self.exits, []
        self.restore(start)
        with self.context.under(taken):
            self.run(loop, over.element(any_))
        self.exits = around

    def cut(self, loop: Loop, over: IterationDomain | None) -> Term:
        """Encode a loop by a cut at its head.

        The loop-carried variables get arbitrary values at the head, constrained by the facts that hold at the head. One
        iteration is executed from this arbitrary state, and its end is recorded in `back`. The code after the loop
        starts from the same arbitrary state, in which no further iteration follows."""
        context, index = self.context, None
        if self.now is not None:
            line = loop.span.line
            context.note(f"line {line}: the values that the loop writes are known only by invariants and facts")
        if over is not None:
            self.count(loop, over.start)
        kept = tuple(loop_carried(loop))
        head = LoopHead(loop, kept, self.place())
        context.position += 1
        for key in kept:
            self.restore({**self.snapshot(), key: context.any(key[1].split("@")[0], self.type_of(key))})
            if key[0] in ("cell", "port"):
                self.env["wrote", key[1]] = context.new(f"wrote {key[1]}", t.BOOL)
        if over is not None:
            assert isinstance(loop, stmt.For)
            index = context.new(loop.names[0].split("@")[0], t.INT)
            self.register_index(index, over, not self.brief or self.now is not None)
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
        with context.under(condition):
            live = self.run(loop, element)
            # The syntax decides whether another iteration can follow. `count.py` must find the same number of
            # obligations, and it does not fold constants.
            if live is not t.FALSE or has_next_turn(loop):
                if over is not None:
                    assert index is not None
                    self.count(loop, t.add(index, t.integer(over.step)))
                with context.under(live):
                    head.back = self.place()
        context.position += 1
        self.restore(start)
        self.heads.append(head)
        self.assume_at_head(head)
        return t.not_(condition)

    def register_index(self, index: Term, over: IterationDomain, is_instantiated: bool) -> None:
        """Register an index for the instantiation of universal formulas.

        If `is_instantiated` is false, exclude the index from instantiation."""
        if is_instantiated:
            self.context.element(index, over.robots, over.places)
        else:
            self.context.ignored.add(index)

    def count(self, loop: Loop, index: Term) -> None:
        """Set the variable of a loop over numbers to its next value.

        The loop's invariants read this value before each iteration. Loops over other elements are left alone."""
        if isinstance(loop, stmt.For) and isinstance(loop.values, (ir.Range, ir.Ids)):
            self.temps[loop.names[0]] = index

    def type_of(self, key: Key) -> Type:
        if key[0] == "temp":
            return self.types[key[1]]
        assert self.now is not None
        return self.now.types[key]

    # Merging of paths

    def snapshot(self) -> Env:
        return {**self.env, **{("temp", name): value for name, value in self.temps.items()}}

    def restore(self, env: Env) -> None:
        self.env = {key: value for key, value in env.items() if key[0] != "temp"}
        self.temps = {key[1]: value for key, value in env.items() if key[0] == "temp"}

    def merged(self, condition: Term, then: Env, orelse: Env) -> Env:
        """Return the values where two paths meet: `then` if `condition` holds, otherwise `orelse`.

        A local variable that only one path declares is dropped."""
        found: Env = {}
        for key in {**then, **orelse}:
            if key[0] == "temp":
                if key in then and key in orelse:
                    found[key] = pick(condition, then[key], orelse[key])
                continue
            a, b = (side[key] if key in side else self.before(key) for side in (then, orelse))
            found[key] = pick(condition, a, b)
        return found

    def before(self, key: Key) -> Val:
        if key[0] == "wrote":
            return t.FALSE
        state = self.seen if key[0] in ("slot", "cell") else self.now
        assert state is not None
        return state.of(key, self.pid)

    def writes(self) -> Env:
        """Return the values at the end of the effect, merged from all exits.

        Call this method after the block has been executed."""
        env = self.snapshot()
        for left in self.exits:
            env = self.merged(t.all_of(left.path), left.env, env)
        return {key: value for key, value in env.items() if key[0] != "temp"}


# Facts about the iterations of a loop that is cut at its head. These facts follow from the semantics of loops, so they
# need no proof obligation. docs/reference/semantics.md ("Loops") states each rule and why it is sound. The facts never
# contradict one another, because the values at loop entry satisfy all of them.
_ZERO, _ONE = t.integer(0), t.integer(1)


def facts_of_turns(head: LoopHead, over: IterationDomain | None, index: Term | None, brief: bool) -> None:
    """Add the facts that hold at a loop's head, before an arbitrary iteration or after the last iteration.

    `over`: the domain of a `for`; None for a `while`.
    `index`: the current position in the domain.
    `brief`: True to add only the facts of the rules "places", "written" and "counted"."""
    turns = _Turns(head, over, index)
    with turns.context.about(f"iterations of the loop in line {head.loop.span.line}", head.loop.span.line):
        turns.places()
        turns.written()
        for key in head.kept:
            turns.counted(key)
        if brief:
            return
        groups: dict[tuple[int, int], list[LoopWrite]] = {}
        for write in turns.writes.all:
            if write.key in head.kept and turns.writes.only(write.key) is write:
                if over is not None:
                    groups.setdefault(write.group, []).append(write)
                bound = running_extreme_of(write)
                if over is not None and bound is not None:
                    turns.bounded(bound)
                if over is None:
                    turns.passed(write)
        for group in groups.values():
            turns.last_written(group)


class _Turns:
    def __init__(self, head: LoopHead, over: IterationDomain | None, index: Term | None) -> None:
        self.head, self.over, self.index = head, over, index
        self.loop = head.loop
        self.before, self.now = head.entry.frame, head.turn.frame
        self.context = self.now.context
        self.writes = LoopWrites(self.loop)

    # Rule "places": the current position of a `for` is a position in its domain, or the end of the domain.

    def places(self) -> None:
        if self.over is None or self.index is None:
            return
        over, index, context = self.over, self.index, self.context
        context.fact(over.not_after(over.start, index))
        if abs(over.step) == 1:
            context.fact(t.or_(t.equals(index, over.start), over.not_after(index, over.stop)))
        else:
            last = t.subtract(index, t.integer(over.step))
            context.fact(t.or_(t.equals(index, over.start), over.ahead(last)))
            for fact in over.on_grid(index):
                context.fact(fact)

    # Rule "written": a cell or port has its value at loop entry, unless an iteration has written it. If a cell or port
    # was written before the loop, it counts as written in the loop.

    def written(self) -> None:
        for kind, name in self.head.kept:
            wrote = self.now.env.get(("wrote", name))
            if kind not in ("cell", "port") or wrote is None:
                continue
            self.context.fact(t.implies(as_term(self.before.env.get(("wrote", name), t.FALSE)), as_term(wrote)))
            same = self.same((kind, name))
            self.context.fact(t.or_(as_term(wrote), same))

    # Rule "counted": if every write increases a variable, the variable is never below its value at loop entry. If a
    # `for` has a single such statement, the variable exceeds this value by at most one step per iteration, and by
    # exactly one step per iteration if no iteration can skip the statement. The rule for decreasing writes is
    # symmetric.

    def counted(self, key: Key) -> None:
        writes = self.writes.of(key)
        steps = [step_of(write) for write in writes]
        known = [step for step in steps if step is not None]
        if not writes or len(known) < len(steps) or not (min(known) >= 0 or max(known) <= 0):
            return
        first, now = as_term(self.before.own(key)), as_term(self.now.own(key))
        if now.sort is not t.INT:
            return
        rises = max(known) > 0
        self.context.fact(t.at_most(first, now) if rises else t.at_most(now, first))
        if self.over is None or self.index is None or len(writes) > 1 or abs(self.over.step) != 1:
            return
        gone = t.subtract(self.index, self.over.start)
        taken = gone if self.over.step > 0 else t.negate(gone)
        most = t.add(first, t.multiply(t.integer(known[0]), taken))
        if writes[0].sure and not writes[0].guards:
            self.context.fact(t.equals(now, most))
        else:
            self.context.fact(t.at_most(now, most) if rises else t.at_most(most, now))

    # Rule "last written": a variable with a single writing statement has its value at loop entry, or the value that
    # the statement wrote in an earlier iteration.

    def last_written(self, group: Sequence[LoopWrite]) -> None:
        fixed = [write for write in group if self.writes.is_fixed(write.value, write.lets)]
        if not fixed:
            return
        assert self.over is not None and self.index is not None
        turn = self.context.new(f"{self.name()}@last", t.INT)
        self.context.element(turn, self.over.robots, self.over.places)
        frame = self.at(turn, fixed[-1].lets)
        made = [self.equal(self.now.own(write.key), self.value(write.value, frame)) for write in fixed]
        held = self.guards(fixed[0].guards, fixed[0].lets, frame)
        kept = [self.same(write.key) for write in fixed]
        self.context.fact(t.or_(t.all_of(kept), t.all_of([self.over.passed(turn, self.index), *made, *held])))

    # Rule "bounded": a variable that keeps the least value is at most its value at loop entry. The variable is also at
    # most each value that the statement compared in an earlier iteration. The rule for the greatest value is symmetric.

    def bounded(self, bound: RunningExtreme) -> None:
        write = bound.write
        if not self.writes.is_fixed(bound.value, write.lets):
            return
        assert self.over is not None and self.index is not None
        over, at = self.over, self.index
        now = as_term(self.now.own(write.key))
        self.context.fact(self.order(now, as_term(self.before.own(write.key)), bound.least))
        if not write.sure or not all(self.writes.is_fixed(guard, write.lets) for guard, _ in bound.guards):
            return

        def instance(turn: Term) -> Term:
            frame = self.at(turn, write.lets)
            value = as_term(self.value(bound.value, frame))
            held = self.guards(bound.guards, write.lets, frame)
            return t.implies(t.all_of([over.passed(turn, at), *held]), self.order(now, value, bound.least))

        self.context.for_all(instance, over.robots, over.places)

    # Rule "passed": the condition of a `while` was true at the start of each earlier iteration. So the condition held
    # for each earlier value of the loop's counter.

    def passed(self, write: LoopWrite) -> None:
        step = step_of(write)
        if not isinstance(self.loop, stmt.While) or step is None or step == 0:
            return
        key, parts = write.key, []
        if as_term(self.now.own(key)).sort is not t.INT:
            return
        others = set(self.writes.changed) - {key}
        for part in conjuncts(self.loop.condition):
            if self.reads_only_fixed(part, others):
                parts.append(part)
        if not parts:
            return
        first, now = as_term(self.before.own(key)), as_term(self.now.own(key))

        def held(value: Term) -> Term:
            frame = self.before.place().frame
            frame.put(key, value)
            return t.all_of([as_term(self.value(part, frame)) for part in parts])

        self.context.fact(t.or_(t.equals(now, first), held(t.subtract(now, t.integer(step)))))
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
        self.context.for_all(instance, robots, True)

    def reads_only_fixed(self, part: ir.Expr, others: set[Key]) -> bool:
        changed, self.writes.changed = self.writes.changed, dict.fromkeys(others)
        try:
            return self.writes.is_fixed(part, ())
        finally:
            self.writes.changed = changed

    # Operations that several rules use

    def name(self) -> str:
        return self.loop.names[0].split("@")[0] if isinstance(self.loop, stmt.For) else "turn"

    def at(self, turn: Term, lets: Sequence[stmt.Let]) -> SymbolicFrame:
        """Return a frame for one iteration, with the variables that depend only on its element."""
        assert self.over is not None and isinstance(self.loop, stmt.For)
        frame = self.before.place().frame
        frame.bind_element(self.loop, self.over.element(turn))
        for place, let in enumerate(lets):
            if self.writes.is_fixed(let.value, tuple(lets[:place])):
                frame.temps[let.name] = self.value(let.value, frame)
        return frame

    def value(self, node: ir.Expr, frame: SymbolicFrame) -> Val:
        """Return the value of an expression, and discard the demands that the expression has a value."""
        with self.context.outermost(), self.context.separate_demands():
            return frame.e.value(node, frame)

    def guards(
        self, guards: Sequence[tuple[ir.Expr, bool]], lets: tuple[stmt.Let, ...], frame: SymbolicFrame
    ) -> list[Term]:
        """Return the conditions that depend only on the iteration's element, as terms that hold."""
        fixed = [(guard, held) for guard, held in guards if self.writes.is_fixed(guard, lets)]
        terms = [(as_term(self.value(guard, frame)), held) for guard, held in fixed]
        return [term if held else t.not_(term) for term, held in terms]

    def same(self, key: Key) -> Term:
        return self.equal(self.now.own(key), self.before.own(key))

    def equal(self, a: Val, b: Val) -> Term:
        return self.now.e.lists.same(a, b)

    def order(self, now: Term, other: Term, least: bool) -> Term:
        assert now.sort in (t.INT, t.REAL)
        return t.at_most(now, other) if least else t.at_most(other, now)
