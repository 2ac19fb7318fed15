"""Random well-typed statements of one place of a program."""

from __future__ import annotations

from random import Random

from koordgen.lang.ir import decl as d
from koordgen.lang.ir import expr as e
from koordgen.lang.ir import stmt as s
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import (
    BOOL,
    INT,
    STRING,
    MapOf,
    PerRobot,
    RecordType,
    Sequence,
    TupleOf,
    Type,
    list_of,
)
from koordgen.lang.source import Span
from tests.agree.expressions import Expressions
from tests.agree.general import Temp, binary, call, compare, length
from tests.agree.kinds import AT, random_type, whole

KINDS = ("assign",) * 3 + ("update",) * 3 + ("let", "let", "if", "for", "for", "while", "emit", "pop", "leave")


class Statements(Expressions):
    """Generator for statements of one place; names of temps are unique there."""

    def __init__(self, rng: Random, program: d.Program, place: str, prefix: str) -> None:
        super().__init__(rng, program, place)
        self.prefix = prefix
        self.minted = 0
        self.loops = 0
        self.result: Type | None = None

    def mint(self, type_: Type, writable: bool = True) -> Temp:
        self.minted += 1
        return Temp(f"{self.prefix}{self.minted}", type_, writable)

    def block(self, depth: int, count: int) -> s.Block:
        """Return at least so many statements; their temps end with the block."""
        kept = list(self.temps)
        found: list[s.Stmt] = []
        for _ in range(count):
            kind = self.rng.choice(KINDS)
            if depth == 0 and kind in ("if", "for", "while"):
                kind = "assign"
            found += getattr(self, f"{kind}s" if kind != "leave" else "leaves")(depth)
            if isinstance(found[-1] if found else None, (s.Break, s.Continue, s.Stop, s.Return)):
                break
        self.temps = kept
        return tuple(found)

    def places(self) -> list[tuple[s.Place, Type, e.Expr]]:
        """Return all places that can be written here, with the expression that reads each."""
        found: list[tuple[s.Place, Type, e.Expr]] = [
            (s.TempPlace(t.name), t.type, e.TempRead(t.name, t.type, AT)) for t in self.temps if t.writable
        ]
        if self.place == "function":
            return found
        p = self.program
        found += [(s.LocalPlace(v.name), v.type, e.LocalRead(v.name, v.type, AT)) for v in p.locals]
        for v in p.shared:
            if v.kind == "allread":
                found.append((s.OwnSlot(v.name), v.type, e.SlotRead(v.name, e.Pid(INT, AT), True, v.type, AT)))
            elif self.place != "init":
                found.append((s.SharedPlace(v.name), v.type, e.SharedRead(v.name, v.type, AT)))
        for m in p.modules:
            for port in m.ports:
                if port.direction == "actuator":
                    read = e.PortRead(m.name, port.name, False, port.type, AT)
                    found.append((s.PortPlace(m.name, port.name), port.type, read))
        return found

    def assigns(self, depth: int) -> list[s.Stmt]:
        places = self.places()
        if not places:
            return self.lets(depth)
        place, type_, _ = self.rng.choice(places)
        return [s.Assign(place, self.expr(type_, 3), AT)]

    def updates(self, depth: int) -> list[s.Stmt]:
        """Return `xs.append(v)`, `r.f[i] = v` and the like, in the form that the checker yields."""
        places = [found for found in self.places() if isinstance(found[1], (Sequence, MapOf, TupleOf, RecordType))]
        if not places:
            return self.assigns(depth)
        place, _, read = self.rng.choice(places)
        return [s.Assign(place, self.updated(read, 2), AT)]

    def lets(self, depth: int) -> list[s.Stmt]:
        type_ = random_type(self.rng, 2, tuple([r.type for r in self.program.records]))
        if self.rng.random() < 0.6:
            known = [t for t in self.known() if not isinstance(t, PerRobot)]
            type_ = self.rng.choice(known)
        value = self.expr(type_, 2)
        temp = self.mint(type_)
        self.temps.append(temp)
        return [s.Let(temp.name, type_, value, AT)]

    def ifs(self, depth: int) -> list[s.Stmt]:
        orelse: s.Block = ()
        condition = self.expr(BOOL, 2)
        then = self.block(depth - 1, self.rng.randrange(1, 3))
        if self.rng.random() < 0.5:
            orelse = self.block(depth - 1, self.rng.randrange(1, 3))
        return [s.If(condition, then, orelse, AT)]

    def body(self, depth: int) -> s.Block:
        busy, self.busy = self.busy, True
        self.loops += 1
        block = self.block(depth - 1, self.rng.randrange(1, 4))
        self.loops -= 1
        self.busy = busy
        return block

    def fors(self, depth: int) -> list[s.Stmt]:
        values, element = self.domain()
        types: tuple[Type, ...] = (element,)
        if isinstance(element, TupleOf) and self.rng.random() < 0.7:
            types = element.items
        kept = list(self.temps)
        taken = [self.mint(type_) for type_ in types]
        ends: e.Expr | None = None  # what a loop that counts ends at, mostly
        if isinstance(values, (e.Range, e.Ids)):
            self.temps += taken
            ends = values.stop if isinstance(values, e.Range) else e.NSys(INT, AT)
        invariants = self.invariants(taken[0], ends)
        self.temps = [*kept, *taken]
        block = (*self.meddling(values), *self.body(depth))
        self.temps = kept
        return [s.For(tuple([t.name for t in taken]), types, values, block, AT, invariants)]

    def invariants(self, counter: Temp, ends: e.Expr | None) -> tuple[s.LoopInvariant, ...]:
        """Return invariants of a loop: true and false conditions, some without a value, each with its own line."""
        busy, place = self.busy, self.place
        self.busy, self.place = True, "guard" if place == "effect" else place  # where no port is called
        found = []
        for _ in range(self.rng.choice((0, 0, 0, 1, 2))):
            formula = self.quantified() if self.rng.random() < 0.3 else self.expr(BOOL, 2)
            if ends is not None and self.rng.random() < 0.5:
                formula = compare(self.rng.choice(("<", "<=", "!=")), e.TempRead(counter.name, INT, AT), ends)
            if not any(isinstance(node, e.PortCall) for node in walk(formula)):
                found.append(s.LoopInvariant(formula, Span(*[self.rng.randrange(2, 10**6)] * 4)))
        self.busy, self.place = busy, place
        return tuple(found)

    def quantified(self) -> e.Expr:
        """`forall i in range(0, n): ...`"""
        temp = self.mint(INT, writable=False)
        self.temps.append(temp)
        body = self.expr(BOOL, 2)
        self.temps.remove(temp)
        domain = e.Range(whole(0), whole(self.rng.randrange(4)), 1, list_of(INT), AT)
        return e.Quantified(self.rng.choice(("forall", "exists")), temp.name, domain, body, BOOL, AT)

    def meddling(self, values: e.Expr) -> list[s.Stmt]:
        """Return changes to the value that a loop iterates over, which the loop must not see."""
        places = [place for place, _, read in self.places() if read == values]
        if not places or self.rng.random() < 0.5:
            return []
        busy, self.busy = self.busy, True
        found: list[s.Stmt] = [s.Assign(places[0], self.updated(values, 1), AT)]
        self.busy = busy
        return found

    def domain(self) -> tuple[e.Expr, Type]:
        """Return the value that a loop iterates over: it is short."""
        choice = self.rng.randrange(7)
        if choice < 2:
            start, stop = (e.Binary("%", self.expr(INT, 1), whole(5), True, INT, AT) for _ in "ab")
            step_ = self.rng.choice((1, 1, 2, -1, -2, 3))
            return e.Range(whole(0) if self.rng.random() < 0.5 else start, stop, step_, list_of(INT), AT), INT
        if choice == 2 and self.place != "function":
            return e.Ids(list_of(INT), AT), INT
        known = [t for t in self.known() if isinstance(t, (Sequence, MapOf, PerRobot))]
        shared = [PerRobot(v.type) for v in self.program.shared if v.kind == "allread"]
        type_ = self.rng.choice([*known, *(shared if self.place == "effect" else []), list_of(TupleOf((INT, STRING)))])
        if isinstance(type_, PerRobot):
            found = self.slots(type_.element)
            assert found is not None
            return found, type_.element
        assert isinstance(type_, (Sequence, MapOf))
        return self.expr(type_, self.rng.randrange(3)), type_.key if isinstance(type_, MapOf) else type_.element

    def whiles(self, depth: int) -> list[s.Stmt]:
        """Return a loop with a counter that is increased first, so that every path through the loop ends."""
        counter = self.mint(INT, writable=False)
        read = e.TempRead(counter.name, INT, AT)
        kept = list(self.temps)
        self.temps.append(counter)
        condition: e.Expr = compare("<", read, whole(self.rng.randrange(1, 5)))
        if self.rng.random() < 0.4:
            condition = e.Logic("and", condition, self.expr(BOOL, 2), BOOL, AT)
        invariants = self.invariants(counter, whole(self.rng.randrange(1, 5)))
        count = s.Assign(s.TempPlace(counter.name), binary("+", read, whole(1), INT), AT)
        block = (count, *self.body(depth))
        self.temps = kept if self.rng.random() < 0.5 else [*kept, counter]
        return [s.Let(counter.name, INT, whole(0), AT), s.While(condition, block, AT, invariants)]

    def emits(self, depth: int) -> list[s.Stmt]:
        if self.place == "function":
            return self.lets(depth)
        items = [self.expr(STRING, 2) for _ in range(self.rng.randrange(1, 4))]
        return [s.Emit("Log", "stdout", tuple(items), AT)]

    def pops(self, depth: int) -> list[s.Stmt]:
        """Return `T x = xs.pop()`: a read and a removal, under a test that the list is not empty."""
        found = [(p, t, r) for p, t, r in self.places() if isinstance(t, Sequence) and t.name in ("List", "Queue")]
        if not found:
            return self.assigns(depth)
        place, type_, xs = self.rng.choice(found)
        assert isinstance(type_, Sequence)
        temp = self.mint(type_.element, writable=False)
        last = binary("-", length(xs), whole(1), INT)
        if type_.name == "Queue":
            value, left = call("first", type_.element, xs), call("without", type_, xs, whole(0))
        else:
            value, left = e.At(xs, last, False, type_.element, AT), call("popped", type_, xs)
        both = (s.Let(temp.name, type_.element, value, AT), s.Assign(place, left, AT))
        return [s.If(compare("<", whole(0), length(xs)), both, (), AT)]

    def leaves(self, depth: int) -> list[s.Stmt]:
        """Return, now and then, a statement that leaves a loop, a function or an event."""
        out: s.Stmt
        if self.loops and self.rng.random() < 0.8:
            out = self.rng.choice((s.Break(AT), s.Continue(AT)))
        elif self.result is not None:
            out = s.Return(self.expr(self.result, 2), AT)
        elif self.place != "function" and self.rng.random() < 0.5:
            out = s.Stop(AT)
        else:
            return self.assigns(depth)
        before = self.assigns(depth) if self.rng.random() < 0.5 else []
        return [s.If(self.expr(BOOL, 2), (*before, out), (), AT)]
