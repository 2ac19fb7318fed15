"""Random expressions that exist for every type: reads, calls, and parts of larger values."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from random import Random
from typing import NamedTuple

from koordgen.lang.ir import decl as d
from koordgen.lang.ir import expr as e
from koordgen.lang.ir.types import (
    BOOL,
    GRID,
    GRIDMAP,
    INT,
    POINT,
    POSE,
    MapOf,
    PerRobot,
    RecordType,
    Sequence,
    TupleOf,
    Type,
    list_of,
)
from koordgen.runtime.values.points import Point
from tests.agree.kinds import AT, SIZE, constant, parts, random_value, real, whole

PATH = list_of(POINT)
Maker = Callable[[int], e.Expr | None]  # None: not here


class Temp(NamedTuple):
    name: str
    type: Type
    writable: bool


def binary(op: str, left: e.Expr, right: e.Expr, type_: Type) -> e.Expr:
    return e.Binary(op, left, right, op not in ("/", "//", "%"), type_, AT)


def compare(op: str, left: e.Expr, right: e.Expr) -> e.Expr:
    return e.Compare(op, left, right, BOOL, AT)


def call(name: str, type_: Type, *args: e.Expr) -> e.Expr:
    return e.Builtin(name, args, type_, AT)


def length(of: e.Expr) -> e.Expr:
    return call("len", INT, of)


def remainder(i: e.Expr, n: e.Expr) -> e.Expr:
    return e.Binary("%", i, n, False, INT, AT)


def when(condition: e.Expr, then: e.Expr, orelse: e.Expr) -> e.Expr:
    return e.Conditional(condition, then, orelse, then.type, AT)


def remainder_of(i: e.Expr, n: int) -> e.Expr:
    return e.Binary("%", i, whole(n), True, INT, AT)


class General(ABC):
    """Generator for one place of one program; expressions.py completes it."""

    def __init__(self, rng: Random, program: d.Program, place: str) -> None:
        self.rng = rng
        self.program = program
        self.place = place  # as koordgen/lang/ir/verify_expr.py names places
        self.temps: list[Temp] = []
        self.busy = place == "function"  # may run often: nothing must grow by squaring or doubling

    def expr(self, type_: Type, depth: int) -> e.Expr:
        """Return an expression of a type with limited depth, not counting guards against faults."""
        if depth <= 0 or self.rng.random() < 0.15:
            return self.leaf(type_)
        makers = self.general(type_)
        own = self.special(type_)
        for _ in range(4):
            made = self.rng.choice(own if own and self.rng.random() < 0.6 else makers)(depth - 1)
            if made is not None:
                return made
        return self.leaf(type_)

    def wild(self, share: float) -> bool:
        """Return whether to leave out the guards that keep a value from failing. Initial values must not fail."""
        return self.place != "literal" and self.rng.random() < share

    # Leaves

    def leaf(self, type_: Type) -> e.Expr:
        found = self.reads(type_)
        if found and self.rng.random() < 0.75:
            return self.rng.choice(found)
        if type_ == GRIDMAP and self.rng.random() < 0.6:
            low, high = self.rng.choice((-1.0, 0.0)), self.rng.choice((1.0, 1.5))
            corners = constant(Point(low, low, 0.0), POINT), constant(Point(high, high, 0.0), POINT)
            return call("GridMap", GRIDMAP, *corners, real(SIZE))
        if type_ == list_of(INT) and self.place in ("effect", "init", "guard") and self.rng.random() < 0.2:
            return e.Ids(type_, AT)
        return constant(random_value(self.rng, type_, wild=self.rng.random() < 0.1), type_)

    def reads(self, type_: Type) -> list[e.Expr]:
        """Return all reads of a type."""
        p, acting = self.program, self.place in ("effect", "init", "guard")
        found: list[e.Expr] = [e.TempRead(t.name, t.type, AT) for t in self.temps if t.type == type_]
        found *= 2
        if self.place != "literal":
            found += [e.ParamRead(v.name, v.type, AT) for v in p.params if v.type == type_]
        if acting:
            found += [e.LocalRead(v.name, v.type, AT) for v in p.locals if v.type == type_]
            found += [
                e.PortRead(m.name, port.name, False, port.type, AT)
                for m in p.modules
                for port in m.ports
                if port.type == type_ and port.direction in ("sensor", "actuator")
            ]
            if type_ == INT:
                found += [e.Pid(INT, AT), e.NSys(INT, AT)]
        for v in p.shared if acting else ():
            if v.type == type_ and v.kind == "allread":
                found.append(e.SlotRead(v.name, self.robot(), True, v.type, AT))
            elif v.type == type_ and self.place != "init":
                found.append(e.SharedRead(v.name, v.type, AT))
        return found

    def robot(self) -> e.Expr:
        """Return the index of a robot, in a form that is proved to be one."""
        pid: e.Expr = e.Pid(INT, AT)
        if self.place == "init":
            return pid
        size = e.NSys(INT, AT)
        after = e.Binary("%", binary("+", pid, whole(1), INT), size, True, INT, AT)
        return self.rng.choice((pid, whole(0), binary("-", size, whole(1), INT), after))

    # What any type can be made by

    def general(self, type_: Type) -> list[Maker]:
        found: list[Maker] = [lambda n: when(self.expr(BOOL, n), self.expr(type_, n), self.expr(type_, n))]
        acting = self.place in ("effect", "guard")
        slots = [v for v in self.program.shared if v.kind == "allread" and v.type == type_] if acting else []
        if slots:
            found.append(lambda n: self.slot(self.rng.choice(slots), n))
        calls = self.callable(type_)
        if calls:
            found += [lambda n: self.calling(self.rng.choice(calls), n)] * 2
        sources = [t for t in self.known() if type_ in parts(t)]
        if sources:
            found += [lambda n: self.projected(self.rng.choice(sources), type_, n)] * 2
        return found

    def known(self) -> list[Type]:
        """Return the types of which a value can be read here."""
        found = [t.type for t in self.temps]
        if self.place in ("effect", "guard", "init"):
            p = self.program
            found += [*[v.type for v in p.locals], *[v.type for v in p.params], *[v.type for v in p.shared]]
        return [*found, POINT, POSE, GRID]

    def slot(self, v: d.Shared, n: int) -> e.Expr:
        index = self.expr(INT, n)
        if not self.wild(0.1):
            index = e.Binary("%", index, e.NSys(INT, AT), self.rng.random() < 0.5, INT, AT)
            return e.SlotRead(v.name, index, self.rng.random() < 0.5, v.type, AT)
        return e.SlotRead(v.name, index, False, v.type, AT)

    def callable(self, type_: Type) -> list[d.Function | d.ExternFunction]:
        if self.place in ("literal", "contract", "constant"):
            return []
        found: list[d.Function | d.ExternFunction] = [f for f in self.program.functions if f.result == type_]
        return found + [f for f in self.program.externs if f.result == type_]

    def calling(self, f: d.Function | d.ExternFunction, n: int) -> e.Expr | None:
        found = [self.argument(p.type, n) for p in f.parameters]
        args = [arg for arg in found if arg is not None]
        if len(args) < len(found):
            return None
        kind = e.Call if isinstance(f, d.Function) else e.ExternCall
        return kind(f.name, tuple(args), f.result, AT)

    def argument(self, type_: Type, n: int) -> e.Expr | None:
        """Return an argument. A value per robot is also a list, and is needed for some parameters."""
        wanted = type_.element if isinstance(type_, PerRobot) else None
        if isinstance(type_, Sequence) and type_.name == "List" and self.rng.random() < 0.3:
            whole_ = self.slots(type_.element)
            if whole_ is not None:
                return whole_
        return self.expr(type_, n) if wanted is None else self.slots(wanted)

    def slots(self, element: Type) -> e.Expr | None:
        """Return a whole allread variable, or a parameter with one value per robot."""
        found: list[e.Expr] = [e.TempRead(t.name, t.type, AT) for t in self.temps if t.type == PerRobot(element)]
        if self.place in ("effect", "guard"):
            shared = [v for v in self.program.shared if v.kind == "allread" and v.type == element]
            found += [e.SlotsRead(v.name, PerRobot(v.type), AT) for v in shared]
        return self.rng.choice(found) if found else None

    def projected(self, source: Type, type_: Type, n: int) -> e.Expr | None:
        """Return a part of a larger value."""
        match source:
            case Sequence("List" | "Queue", element) if element == type_:
                xs = self.leaf(source)
                return when(compare(">", length(xs), whole(0)), self.element(xs, type_, n), self.leaf(type_))
            case MapOf(key, value):
                return self.looked_up(self.leaf(source), key, value, type_, n)
            case TupleOf(items):
                places = [i for i, item in enumerate(items) if item == type_]
                return e.Item(self.expr(source, n), self.rng.choice(places), type_, AT)
            case RecordType(_, fields):
                names = [name for name, field in fields if field == type_]
                return e.Field(self.expr(source, n), self.rng.choice(names), type_, AT)
            case _:
                return self.field(source, type_, n)

    def element(self, xs: e.Expr, type_: Type, n: int) -> e.Expr:
        """Return an element of a value that is not empty."""
        if self.rng.random() < 0.3:
            return call(self.rng.choice(("first", "last")), type_, xs)
        if self.wild(0.15):
            return e.At(xs, self.expr(INT, n), False, type_, AT)
        proved = self.rng.random() < 0.5
        return e.At(xs, remainder(self.expr(INT, n), length(xs)), proved, type_, AT)

    def looked_up(self, m: e.Expr, key: Type, value: Type, type_: Type, n: int) -> e.Expr | None:
        if type_ == list_of(key) and self.rng.random() < 0.5:
            return call("keys", type_, m)
        if type_ == list_of(value):
            return call("values", type_, m)
        if type_ != value:
            return None
        k = self.leaf(key)
        if self.rng.random() < 0.5:
            return call("get", value, m, k, self.expr(value, n))
        if self.wild(0.1):
            return call("map_at", value, m, k)
        return when(e.Contains(k, m, BOOL, AT), call("map_at", value, m, k), self.leaf(value))

    def field(self, source: Type, type_: Type, n: int) -> e.Expr | None:
        if source == GRID and type_ == POINT:
            return call("center", POINT, self.expr(GRID, n))
        names = {
            ("Point", "float"): "xyz", ("Pose", "Point"): ("position",), ("Pose", "float"): ("yaw",),
            ("Grid", "int"): "xy", ("Grid", "float"): ("size",), ("Scan", "float"): ("max_range",),
            ("Scan", "List<float>"): ("angles", "ranges"),
        }.get((str(source), str(type_)))  # fmt: skip
        return e.Field(self.expr(source, n), self.rng.choice(names), type_, AT) if names else None

    @abstractmethod
    def special(self, type_: Type) -> list[Maker]:
        """Return an expression that exists for this type only."""
