"""Random well-typed expressions over the values that a place may read. Most have a value, so that few events fail."""

from __future__ import annotations

from koordgen.lang.ir import expr as e
from koordgen.lang.ir.types import (
    BALL,
    BOOL,
    FLOAT,
    GRID,
    GRIDMAP,
    INT,
    POINT,
    POSE,
    RECT,
    STRING,
    MapOf,
    PerRobot,
    RecordType,
    Sequence,
    TupleOf,
    Type,
    is_key,
    list_of,
)
from koordgen.runtime.values.points import Point
from tests.agree.general import PATH, General, Maker, binary, call, compare, length, remainder, remainder_of, when
from tests.agree.kinds import AT, SIZE, constant, random_type, real, whole


class Expressions(General):
    """The complete generator."""

    # Type by type

    def special(self, type_: Type) -> list[Maker]:
        match type_:
            case Sequence(name):
                return (
                    self.of_list(type_)
                    if name == "List"
                    else self.of_set(type_)
                    if name == "Set"
                    else (self.of_queue(type_))
                )
            case MapOf():
                return self.of_map(type_)
            case TupleOf(items):
                made: Maker = lambda n: e.Make(tuple([self.expr(item, n) for item in items]), type_, AT)  # noqa: E731
                return [made, lambda n: self.replaced(type_, [str(i) for i in range(len(items))], list(items), n)]
            case RecordType(_, fields):
                names, types = [name for name, _ in fields], [field for _, field in fields]
                made = lambda n: e.Make(tuple([self.expr(field, n) for field in types]), type_, AT)  # noqa: E731
                return [made, lambda n: self.replaced(type_, names, types, n)]
            case _:
                word = {"int": self.of_int, "float": self.of_float, "bool": self.of_bool, "string": self.of_string,
                        "Point": self.of_point, "GridMap": self.of_map_of_cells}  # fmt: skip
                if str(type_) in word:
                    return word[str(type_)]()
                if type_ == POSE:
                    return [lambda n: call("Pose", POSE, self.expr(POINT, n), self.expr(FLOAT, n))]
                if type_ == GRID:
                    cell: Maker = lambda n: call("cell", GRID, self.expr(POINT, n), real(SIZE))  # noqa: E731
                    return [cell, lambda n: call("Grid", GRID, self.expr(INT, n), self.expr(INT, n), real(SIZE))]
                return []

    def replaced(self, type_: Type, names: list[str], types: list[Type], n: int) -> e.Expr:
        i = self.rng.randrange(len(names))
        return e.With(self.expr(type_, n), names[i], self.expr(types[i], n), type_, AT)

    def of_int(self) -> list[Maker]:
        def sums(n: int) -> e.Expr:
            return binary(self.rng.choice("+-"), self.expr(INT, n), self.expr(INT, n), INT)

        def product(n: int) -> e.Expr:
            made = binary("*", self.expr(INT, n), self.expr(INT, n), INT)
            return e.Binary("%", made, whole(97), True, INT, AT) if self.busy else made

        def quotient(n: int) -> e.Expr:
            divisor, proved = self.divisor(n)
            return e.Binary(self.rng.choice(("//", "%")), self.expr(INT, n), divisor, proved, INT, AT)

        def power(n: int) -> e.Expr:
            base = e.Binary("%", self.expr(INT, n), whole(self.rng.choice((5, -5))), True, INT, AT)
            return binary("**", base, self.expr(INT, n) if self.wild(0.25) else whole(self.rng.randrange(4)), INT)

        def counted(n: int) -> e.Expr:
            element = self.rng.choice((INT, STRING, POINT, FLOAT))
            xs = self.expr(list_of(element), n)
            return call("count", INT, xs, self.leaf(element))

        def found(n: int) -> e.Expr:
            n = 0 if self.place in ("property", "assume", "provided") else n  # names of quantifiers stand once
            xs = e.Make((self.expr(INT, n), self.expr(INT, n)), list_of(INT), AT)
            item = self.leaf(INT) if self.wild(0.2) else self.rng.choice(xs.items)
            return call("index", INT, xs, item)

        def rounded(n: int) -> e.Expr:
            return call(self.rng.choice(("floor", "ceil", "round")), INT, self.expr(FLOAT, n))

        return [
            sums, sums, product, quotient, power, counted, found, rounded,
            lambda n: e.Unary("-", self.expr(INT, n), INT, AT),
            lambda n: call("abs", INT, self.expr(INT, n)),
            lambda n: call(self.rng.choice(("min", "max")), INT, self.expr(INT, n), self.expr(INT, n)),
            lambda n: length(self.slots(INT) or self.expr(self.container(), n)),
            lambda n: call("sum", INT, self.argument(list_of(INT), n) or self.leaf(list_of(INT))),
        ]  # fmt: skip

    def container(self) -> Type:
        """Return a type with a length."""
        found = [t for t in self.known() if isinstance(t, (Sequence, MapOf))]
        made = random_type(self.rng, 2)
        return self.rng.choice([*found, STRING, made if isinstance(made, (Sequence, MapOf)) else list_of(made)])

    def divisor(self, n: int) -> tuple[e.Expr, bool]:
        """Return a divisor of an int, and whether it is known not to be zero."""
        chance = self.rng.random()
        if self.wild(0.06):
            return self.expr(INT, n), False
        if chance < 0.5:
            return whole(self.rng.choice((-3, -2, 2, 3, 5))), self.rng.random() < 0.5
        above = binary("+", call("abs", INT, self.expr(INT, n)), whole(1), INT)
        return (e.Unary("-", above, INT, AT) if chance > 0.8 else above), self.rng.random() < 0.5

    def of_float(self) -> list[Maker]:
        def positive(n: int) -> e.Expr:
            return binary("+", call("abs", FLOAT, self.expr(FLOAT, n)), real(0.5), FLOAT)

        def quotient(n: int) -> e.Expr:
            if self.rng.random() < 0.3:
                divisor, proved = self.divisor(n)
                return e.Binary("/", self.expr(INT, n), divisor, proved, FLOAT, AT)
            by = self.expr(FLOAT, n) if self.wild(0.1) else positive(n)
            return binary(self.rng.choice(("/", "/", "//", "%")), self.expr(FLOAT, n), by, FLOAT)

        def power(n: int) -> e.Expr:
            base = self.expr(FLOAT, n) if self.wild(0.2) else positive(n)
            return binary("**", base, call("sin", FLOAT, self.expr(FLOAT, n)), FLOAT)

        def angle(n: int) -> e.Expr:
            inner = call("sin", FLOAT, self.expr(FLOAT, n))
            return call(self.rng.choice(("asin", "acos", "atan", "cos", "tan")), FLOAT, inner)

        def apart(n: int) -> e.Expr:
            paths = self.argument(PATH, n) or self.leaf(PATH), self.expr(PATH, n)
            return call("min", FLOAT, call("path_distance", FLOAT, *paths), real(99.0))

        def beyond(n: int) -> e.Expr | None:
            """Return an infinity, made by overflow, or its combination with another number, which may be NaN."""
            if not self.wild(0.3):
                return None
            infinity = binary("*", real(1e308), real(10.0), FLOAT)
            other = self.rng.choice((real(0.0), infinity, infinity, self.expr(FLOAT, n)))
            made = binary(self.rng.choice("+-*/%"), infinity, other, FLOAT)
            return binary("*", real(1e308), self.expr(FLOAT, n), FLOAT) if self.rng.random() < 0.3 else made

        return [
            quotient, quotient, power, angle, angle, apart, beyond,
            lambda n: binary(self.rng.choice("+-*"), self.expr(FLOAT, n), self.expr(FLOAT, n), FLOAT),
            lambda n: binary(self.rng.choice("+-*"), self.expr(FLOAT, n), self.expr(FLOAT, n), FLOAT),
            lambda n: e.Unary("-", self.expr(FLOAT, n), FLOAT, AT),
            lambda n: e.Widen(self.expr(INT, n), FLOAT, AT),
            lambda n: call(self.rng.choice(("abs", "cos", "sin")), FLOAT, self.expr(FLOAT, n)),
            lambda n: call(self.rng.choice(("sqrt", "log")), FLOAT, positive(n)),
            lambda n: call("exp", FLOAT, call("min", FLOAT, self.expr(FLOAT, n), real(3.0))),
            lambda n: call("atan2", FLOAT, self.expr(FLOAT, n), self.expr(FLOAT, n)),
            lambda n: call(self.rng.choice(("min", "max")), FLOAT, self.expr(FLOAT, n), self.expr(FLOAT, n)),
            lambda n: call("distance", FLOAT, self.expr(POINT, n), self.expr(POINT, n)),
            lambda n: call("sum", FLOAT, self.expr(list_of(FLOAT), n)),
        ]  # fmt: skip

    def of_bool(self) -> list[Maker]:
        def equal(n: int) -> e.Expr:
            type_ = self.rng.choice((*[t for t in self.known() if not isinstance(t, PerRobot)], INT, STRING))
            return compare(self.rng.choice(("==", "!=")), self.expr(type_, n), self.expr(type_, n))

        def ordered(n: int) -> e.Expr:
            type_ = self.rng.choice((INT, FLOAT, STRING))
            return compare(self.rng.choice(("<", "<=", ">", ">=")), self.expr(type_, n), self.expr(type_, n))

        def within(n: int) -> e.Expr:
            region = call("Rect", RECT, self.expr(POINT, n), self.expr(POINT, n))
            if self.rng.random() < 0.5:
                region = call("Ball", BALL, self.expr(POINT, n), self.expr(FLOAT, n))
            return e.Contains(self.expr(POINT, n), region, BOOL, AT)

        def contained(n: int) -> e.Expr:
            held = self.container()
            match held:
                case Sequence(_, element) | MapOf(element):
                    pass
                case _:
                    element = STRING
            return e.Contains(self.expr(element, n), self.expr(held, n), BOOL, AT)

        def looked(n: int) -> e.Expr:
            name = self.rng.choice(("is_free", "is_occupied", "is_known"))
            cell = call("Grid", GRID, *[remainder_of(self.expr(INT, n), 3) for _ in "xy"], real(SIZE))
            return call(name, BOOL, self.expr(GRIDMAP, n), self.expr(GRID, n) if self.wild(0.2) else cell)

        def clear(n: int) -> e.Expr:
            others = self.argument(list_of(PATH), n) or self.leaf(list_of(PATH))
            return call("clear", BOOL, self.expr(PATH, n), others, self.expr(FLOAT, n))

        def logic(n: int) -> e.Expr:
            return e.Logic(self.rng.choice(("and", "or")), self.expr(BOOL, n), self.expr(BOOL, n), BOOL, AT)

        def guarded(n: int) -> e.Expr:
            """Return an expression whose right operand has a value only if the left one says so."""
            divisor = self.leaf(INT)
            safe = compare("!=", divisor, whole(0))
            quotient = e.Binary(self.rng.choice(("//", "%")), self.expr(INT, n), divisor, True, INT, AT)
            test = compare(self.rng.choice(("<", ">")), quotient, self.expr(INT, n))
            if self.rng.random() < 0.5:
                return e.Logic("and", safe, test, BOOL, AT)
            return e.Logic("or", e.Unary("not", safe, BOOL, AT), test, BOOL, AT)

        return [
            equal, equal, ordered, ordered, within, contained, contained, looked, clear, logic, logic, guarded,
            lambda n: e.Unary("not", self.expr(BOOL, n), BOOL, AT),
        ]  # fmt: skip

    def of_string(self) -> list[Maker]:
        def joined(n: int) -> e.Expr:
            return self.short(binary("+", self.expr(STRING, n), self.expr(STRING, n), STRING))

        def character(n: int) -> e.Expr:
            text = self.leaf(STRING)
            return when(compare(">", length(text), whole(0)), self.letter(text, n), self.leaf(STRING))

        def shown(n: int) -> e.Expr:
            return call("str", STRING, self.expr(self.rng.choice((INT, FLOAT, BOOL, STRING, POINT)), n))

        return [joined, character, shown, lambda n: self.sliced(STRING, n)]

    def letter(self, text: e.Expr, n: int) -> e.Expr:
        if self.wild(0.1):
            return e.At(text, self.expr(INT, n), False, STRING, AT)
        return e.At(text, remainder(self.expr(INT, n), length(text)), self.rng.random() < 0.5, STRING, AT)

    def sliced(self, type_: Type, n: int) -> e.Expr:
        ends = [call("abs", INT, self.expr(INT, n)) if self.rng.random() < 0.7 else None for _ in "ab"]
        proved = self.rng.random() < 0.5
        if self.wild(0.1):
            ends, proved = [self.expr(INT, n), None], False
        return e.Slice(self.expr(type_, n), ends[0], ends[1], proved, type_, AT)

    def short(self, node: e.Expr) -> e.Expr:
        """Return a part of a value that would double in each turn of a loop."""
        return e.Slice(node, None, whole(8), True, node.type, AT) if self.busy else node

    def of_point(self) -> list[Maker]:
        def scaled(n: int) -> e.Expr:
            by = call("cos", FLOAT, self.expr(FLOAT, n))
            if self.rng.random() < 0.5:
                return binary("*", by, self.expr(POINT, n), POINT)
            op = self.rng.choice("*/")
            if op == "/":
                by = binary("+", call("abs", FLOAT, by), real(0.25), FLOAT)
            return binary(op, self.expr(POINT, n), by, POINT)

        return [
            scaled, scaled,
            lambda n: binary(self.rng.choice("+-"), self.expr(POINT, n), self.expr(POINT, n), POINT),
            lambda n: e.Unary("-", self.expr(POINT, n), POINT, AT),
            lambda n: call("Point", POINT, *[self.expr(FLOAT, n) for _ in "xyz"]),
        ]  # fmt: skip

    def of_map_of_cells(self) -> list[Maker]:
        def marked(n: int) -> e.Expr:
            low, high = constant(Point(0.0, 0.0, 0.0), POINT), constant(Point(2.0, 2.0, 0.0), POINT)
            room = call("GridMap", GRIDMAP, low, high, real(SIZE))
            cell = call("Grid", GRID, *[remainder_of(self.expr(INT, n), 4) for _ in "xy"], real(SIZE))
            name = self.rng.choice(("mark_free", "mark_occupied"))
            if self.wild(0.1):
                cell = self.leaf(GRID)
            return call(name, GRIDMAP, call("merge", GRIDMAP, self.expr(GRIDMAP, n), room), cell)

        return [marked, lambda n: call("merge", GRIDMAP, self.expr(GRIDMAP, n), self.expr(GRIDMAP, n))]

    def of_list(self, type_: Sequence) -> list[Maker]:
        element = type_.element
        found: list[Maker] = [
            lambda n: e.Make(tuple([self.expr(element, n) for _ in range(self.rng.randrange(4))]), type_, AT),
            lambda n: self.short(binary("+", self.expr(type_, n), self.expr(type_, n), type_)),
            lambda n: self.sliced(type_, n),
            lambda n: call("reversed", type_, self.expr(type_, n)),
            lambda n: self.updated(self.leaf(type_), n),
            lambda n: self.updated(self.leaf(type_), n),
        ]
        if element in (INT, FLOAT, STRING):
            found += [lambda n: call("sorted", type_, self.expr(type_, n))] * 2
        if element == POINT and self.place in ("effect", "init"):
            found += [self.planned] * 2
        if isinstance(element, TupleOf) and len(element.items) == 2 and is_key(element.items[0]):
            held = MapOf(element.items[0], element.items[1], 64)
            found.append(lambda n: call("items", type_, self.expr(held, n)))
        return found

    def planned(self, n: int) -> e.Expr:
        args = (self.expr(POINT, n),) if self.rng.random() < 0.5 else (self.expr(POINT, n), self.expr(list_of(GRID), n))
        return e.PortCall("Motion", "planner", args, PATH, AT)

    def of_queue(self, type_: Sequence) -> list[Maker]:
        return [
            lambda n: e.Make(tuple([self.expr(type_.element, n) for _ in range(self.rng.randrange(3))]), type_, AT),
            lambda n: self.updated(self.leaf(type_), n),
        ]

    def of_set(self, type_: Sequence) -> list[Maker]:
        def both(n: int) -> e.Expr:
            name = self.rng.choice(("union", "intersection", "difference"))
            return call(name, type_, self.expr(type_, n), self.expr(type_, n))

        return [
            both, both,
            lambda n: e.Make(tuple([self.expr(type_.element, n) for _ in range(self.rng.randrange(4))]), type_, AT),
            lambda n: self.updated(self.leaf(type_), n),
        ]  # fmt: skip

    def of_map(self, type_: MapOf) -> list[Maker]:
        pair = TupleOf((type_.key, type_.value))

        def made(n: int) -> e.Expr:
            pairs = [
                e.Make((self.expr(type_.key, n), self.expr(type_.value, n)), pair, AT)
                for _ in range(self.rng.randrange(3))
            ]
            return e.Make(tuple(pairs), type_, AT)

        return [made, lambda n: self.updated(self.leaf(type_), n)]

    # Updates, as the checker spells changes of parts

    def updated(self, read: e.Expr, n: int) -> e.Expr:
        """Return a value with a changed part, at some depth."""
        type_ = read.type
        match type_:
            case RecordType(_, fields):
                name, field = self.rng.choice(fields)
                return e.With(read, name, self.updated(e.Field(read, name, field, AT), n), type_, AT)
            case TupleOf(items):
                i = self.rng.randrange(len(items))
                return e.With(read, str(i), self.updated(e.Item(read, i, items[i], AT), n), type_, AT)
            case Sequence("Set", element):
                return self.set_updated(read, element, n)
            case Sequence(name, element):
                return self.list_updated(read, name, element, n)
            case MapOf(key, value):
                return self.map_updated(read, key, value, n)
            case _:
                return self.expr(type_, n)

    def list_updated(self, xs: e.Expr, name: str, element: Type, n: int) -> e.Expr:
        type_ = xs.type
        some = compare(">", length(xs), whole(0))
        index = remainder(self.expr(INT, n), length(xs))
        choices = ["append", "without", "clear"]
        if name == "List":
            choices += ["insert", "remove", "pop", "set", "set", "extend"]
        match self.rng.choice(choices):
            case "append":
                return call("appended", type_, xs, self.expr(element, n))
            case "clear":
                return call("cleared", type_, xs)
            case "extend":
                return self.short(call("extended", type_, xs, self.argument(type_, n) or self.leaf(type_)))
            case "insert":
                at = remainder(self.expr(INT, n), binary("+", length(xs), whole(1), INT))
                return call("inserted", type_, xs, self.leaf(INT) if self.wild(0.1) else at, self.expr(element, n))
            case "remove":
                v = self.leaf(element)
                if self.rng.random() < 0.5:  # perhaps one of two
                    return call("removed", type_, call("appended", type_, xs, v), v)
                return when(e.Contains(v, xs, BOOL, AT), call("removed", type_, xs, v), xs)
            case "pop":
                left = call("popped", type_, xs)
                return left if self.wild(0.1) else when(some, left, xs)
            case "without":
                return when(some, call("without", type_, xs, index if name == "List" else whole(0)), xs)
            case _:
                at = e.At(xs, index, self.rng.random() < 0.5, element, AT)
                return when(some, call("updated", type_, xs, index, self.updated(at, n)), xs)

    def set_updated(self, s: e.Expr, element: Type, n: int) -> e.Expr:
        match self.rng.randrange(5):
            case 0:
                v = self.leaf(element)
                return when(e.Contains(v, s, BOOL, AT), call("set_without", s.type, s, v), s)
            case 1:
                return call("cleared", s.type, s)
            case _:
                return call("set_with", s.type, s, self.expr(element, n))

    def map_updated(self, m: e.Expr, key: Type, value: Type, n: int) -> e.Expr:
        k = self.leaf(key)
        there = e.Contains(k, m, BOOL, AT)
        match self.rng.randrange(6):
            case 0:
                return when(there, call("map_without", m.type, m, k), m)
            case 1:
                return call("cleared", m.type, m)
            case 2:
                changed = self.updated(call("map_at", value, m, k), n)
                return when(there, call("map_with", m.type, m, k, changed), m)
            case 3 if self.wild(0.3):
                return call("map_without", m.type, m, k)
            case _:
                return call("map_with", m.type, m, self.expr(key, n), self.expr(value, n))
