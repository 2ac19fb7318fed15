"""Facts about the turns of a loop that is cut: what holds at its head by the meaning of loops alone.

Each rule is stated in docs/semantics.md ("Loops") with the reason why it is sound. None needs an obligation. All of
them can be satisfied whatever the program does: by the values at loop entry, with no turn taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from koordgen.ir import expr as ir
from koordgen.ir import stmt
from koordgen.prove import term as t
from koordgen.prove.encode.loop import Bound, Write, Writes, bound_of, conjuncts, step_of
from koordgen.prove.encode.quantifier import Domain, names_robots
from koordgen.prove.encode.state import Key
from koordgen.prove.encode.tree import nodes
from koordgen.prove.encode.values import Val, truth
from koordgen.prove.term import Term

if TYPE_CHECKING:
    from koordgen.prove.encode.stmt import Frame, Head

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

        robots = any(isinstance(n, ir.NSys) for n in nodes(tuple(parts))) or names_robots(tuple(parts), key[1])
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
