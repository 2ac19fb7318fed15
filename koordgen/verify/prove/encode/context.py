"""Proof context: facts, demands and universal formulas, gathered while a program part is encoded.

A demand is a condition under which an operation has a value. A variable keeps its name from the program as its symbol.
Every other symbol contains an `@`. No name in a program contains an `@`, so symbols never collide.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.types import Type
from koordgen.verify.prove.encode.values import Val, build, shape
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.obligation import LabelledFormula
from koordgen.verify.prove.smt.term import Apply, FunctionSymbol, LiteralTerm, Op, Sort, Term

# Names that SMT-LIB defines. A program's variable with one of these names gets another symbol.
_RESERVED = frozenset(
    (
        *(
            "and",
            "or",
            "not",
            "xor",
            "ite",
            "distinct",
            "true",
            "false",
            "let",
            "forall",
            "exists",
            "match",
            "par",
            "as",
        ),
        *("abs", "div", "mod", "to_real", "to_int", "is_int", "select", "store", "const"),
        *("Int", "Real", "Bool", "Array", "String"),
    )
)
_ZERO = t.integer(0)
# Number of passes of `instantiate` that register the terms of new instances. Later passes register no new terms.
GENERATIONS = 1


def symbol(name: str) -> str:
    """Return the SMT symbol for a name of the program: the name, plus an `@` if SMT-LIB reserves it."""
    return f"{name}@" if name in _RESERVED else name


def symbols(name: str, args: tuple[Term, ...], type_: Type) -> list[FunctionSymbol]:
    """Return the symbols of a value that is a function of `args`: one symbol for each part of its type."""
    domain = tuple([a.sort for a in args])
    return [FunctionSymbol(name + suffix, domain, sort) for suffix, sort in shape(type_)]


class Universal:
    """Universal formula: a formula that holds for every int of a domain.

    `instance`: returns the formula for one int. The formula includes the condition that the int is in the domain.
    `robots`: whether the ints may be pids of robots.
    `places`: whether the ints may be positions in lists.
    `inner`: whether the formula arose in an instance of another universal formula.
    `known_from`: the position in the event from which on the formula is known.
    `done`: the terms at which the formula was instantiated."""

    def __init__(
        self, instance: Callable[[Term], Term], robots: bool, places: bool, inner: bool, label: str, line: int,
        file: str, known_from: int,
    ) -> None:  # fmt: skip
        self.instance, self.robots, self.places, self.inner = instance, robots, places, inner
        self.label, self.line, self.file, self.known_from = label, line, file, known_from
        self.done: set[Term] = set()


class ProofContext:
    """Proof context of one part of a program.

    `robots`: the number of robots if `unrolled`, that is, if each robot is named by its number; None otherwise.
    `size`: the term of N_SYS, the number of robots. It is a literal if the number is known.

    Universal formulas over robots are instantiated at each robot's number if `unrolled`. Otherwise they are
    instantiated at the terms that name robots."""

    def __init__(self, program: Program, robots: int | None, unrolled: bool) -> None:
        self.program, self.robots = program, robots if unrolled else None
        self.size = t.constant("N_SYS", t.INT) if robots is None else t.integer(robots)
        self.facts: list[LabelledFormula] = []
        self.seen: dict[Term, int] = {}  # term of a fact -> the first position from which the fact is known
        self.demands: list[LabelledFormula] = []  # conditions under which all operations encoded so far have values
        self.notes: dict[str, None] = {}
        self.path: tuple[Term, ...] = ()
        self.indices: dict[Term, bool] = {}  # term that may name a robot -> whether it surely names a robot.
        # The terms of `indices` that are witnesses, or that arose in instances of universal formulas.
        self.witnesses: dict[Term, None] = {}
        self.ignored: set[Term] = set()  # terms at which universal formulas are never instantiated
        self.places: dict[Term, None] = {}  # terms that denote positions in lists
        self.universals: list[Universal] = []
        self.own: Term | None = None  # pid of the robot that runs the event
        self.others: set[Term] = set()  # terms that never equal `own`: each names another robot, or no robot
        self.known: dict[Term, Term] = {}  # variable as a term -> the value that the event's guard gives it
        self.instantiating = False
        self.passes = 0
        self.position = 0  # number of loop heads and loop ends encoded in this event
        self.known_from = 0  # value of `position` from which on a new fact holds
        self.absent: dict[tuple[object, ...], Term] = {}  # item -> the term "no robot has this item".
        # Int terms over which the current quantifier ranges. Each term is a robot's pid.
        self.granted: set[Term] = set()
        self.folds: set[Term] = set()  # sums over all robots whose facts have been added
        self.texts: dict[str, Term] = {}  # text of a string literal -> its constant
        self.versions: dict[int, tuple[int, Val]] = {}
        self.fresh = 0
        self.label, self.line, self.file = "", 0, program.path  # default label, line and file of a new fact
        if robots is None:
            self.fact(t.at_most(t.integer(1), self.size), "the fleet has at least one robot", 0)
        if robots is not None and unrolled:
            self.indices = {t.integer(i): True for i in range(robots)}

    # Recording of facts and demands

    def fact(self, formula: Term, label: str = "", line: int = 0) -> None:
        """Add a formula that holds in every model, known from the position `known_from` on.

        A goal uses only facts that are known at the goal's own position."""
        if formula is not t.TRUE and self.known_from < self.seen.get(formula, 1 << 30):
            self.seen[formula] = self.known_from
            found = LabelledFormula(label or self.label, formula, self.file, line or self.line, self.known_from)
            self.facts.append(found)

    def fact_if_reached(self, formula: Term, label: str = "", line: int = 0) -> None:
        """Add a formula that holds if a run reaches the current program point.

        Goals at the current position of the event and later may use this fact."""
        with self.known_at(self.position):
            self.fact(t.implies(self.reached(), formula), label, line)

    def reached(self) -> Term:
        """Return the condition that a run reaches the current program point.

        The run must take the path to this point, and every earlier operation must have a value. Without the second
        condition, a fact at this point could prove that an earlier operation has a value. Such a proof would be
        circular."""
        return t.all_of([*self.path, *[demand.term for demand in self.demands]])

    def demand(self, formula: Term, label: str, line: int) -> None:
        """Demand a condition under which an operation at the current program point has a value.

        The semantics discards an event as a whole if one of its operations has no value."""
        if formula is not t.TRUE:
            self.demands.append(LabelledFormula(label, t.implies(t.all_of(self.path), formula), self.file, line))

    @contextmanager
    def known_at(self, position: int) -> Iterator[None]:
        """Within a `with` block, record new facts as known from `position` of the event on."""
        kept, self.known_from = self.known_from, position
        try:
            yield
        finally:
            self.known_from = kept

    @contextmanager
    def outermost(self) -> Iterator[None]:
        """Within a `with` block, encode with an empty path condition.

        The terms that are encoded in the block hold at every program point."""
        kept, self.path = self.path, ()
        try:
            yield
        finally:
            self.path = kept

    @contextmanager
    def under(self, *conditions: Term) -> Iterator[None]:
        """Within a `with` block, extend the path condition by `conditions`."""
        kept, self.path = self.path, (*self.path, *conditions)
        try:
            yield
        finally:
            self.path = kept

    @contextmanager
    def grant(self, robot: object) -> Iterator[None]:
        """Within a `with` block, treat the int `robot` as the pid of a robot, without a demand for a proof."""
        new = isinstance(robot, (LiteralTerm, Apply, Op)) and robot not in self.granted
        if new:
            self.granted.add(robot)  # type: ignore[arg-type]
        try:
            yield
        finally:
            if new:
                self.granted.discard(robot)

    @contextmanager
    def about(self, label: str, line: int, file: str = "") -> Iterator[None]:
        """Within a `with` block, give new facts a label, a line and, unless it is the program's own, a file."""
        kept, self.label, self.line = (self.label, self.line, self.file), label, line
        self.file = file or self.file
        try:
            yield
        finally:
            self.label, self.line, self.file = kept

    @contextmanager
    def separate_demands(self) -> Iterator[list[LabelledFormula]]:
        """Within a `with` block, collect new demands in a separate list."""
        kept, self.demands = self.demands, []
        try:
            yield self.demands
        finally:
            self.demands = kept

    def note(self, text: str) -> None:
        self.notes[text] = None

    # Creation of symbols

    def new(self, hint: str, sort: Sort) -> Term:
        """Return a new constant about which no fact is known."""
        self.fresh += 1
        return t.constant(f"{hint}@{self.fresh}", sort)

    def any(self, hint: str, type_: Type) -> Val:
        """Return a new value of a type, about which no fact is known."""
        self.fresh += 1
        number = self.fresh
        return build(type_, iter([t.constant(f"{hint}{suffix}@{number}", sort) for suffix, sort in shape(type_)]))

    def function(self, name: str, args: tuple[Term, ...], type_: Type) -> Val:
        """Return a value of a type that depends on the terms `args` only."""
        return self.applied(symbols(name, args, type_), args, type_)

    def applied(self, functions: list[FunctionSymbol], args: tuple[Term, ...], type_: Type) -> Val:
        leaves = [t.apply(function, *args) for function in functions]
        if self.known:
            leaves = [self.known.get(leaf, leaf) for leaf in leaves]
        return build(type_, iter(leaves))

    def learn(self, formula: Term) -> None:
        """Learn from a formula the values of variables, and use the values in all terms that are built later."""
        for part in formula.args if isinstance(formula, Op) and formula.name == "and" else (formula,):
            match part:
                case Apply():
                    self.known[part] = t.TRUE
                case Op("not", (Apply() as inner,)):
                    self.known[inner] = t.FALSE
                case Op("=", (Apply() as inner, LiteralTerm() as value)):
                    self.known[inner] = value
                case _:
                    pass

    def version(self, value: Val) -> int:
        """Return a number that identifies a value. Different values have different numbers.

        The context keeps the value alive, so that Python does not reuse the value's id."""
        return self.versions.setdefault(id(value), (len(self.versions), value))[0]

    # Terms that name robots

    def within(self, index: Term) -> Term:
        """Return the term "`index` is the pid of a robot"."""
        return t.and_(t.at_most(_ZERO, index), t.less(index, self.size))

    def robot(self, index: Term, known: bool = False, witness: bool = False) -> None:
        """Register a term at which universal formulas over robots are instantiated.

        `known`: the term surely is the pid of a robot.
        `witness`: the term is the witness of a quantifier."""
        if self.robots is None and index not in self.ignored and (known or index not in self.indices):
            if self.instantiating and self.passes > GENERATIONS:
                return  # Without this limit, instances would create new terms and the terms new instances, without end.
            self.indices[index] = known
            if witness or self.instantiating:
                self.witnesses[index] = None

    def element(self, place: Term, robots: bool, places: bool) -> None:
        """Register a term at which universal formulas over robots or over list positions are instantiated."""
        if robots:
            self.robot(place, witness=True)
        if places and not (self.instantiating and self.passes > GENERATIONS):
            self.places[place] = None

    def acting(self, name: str) -> Term:
        """Create the pid of the acting robot (the robot that runs the event), and return it."""
        self.own = self.some_robot(name)
        return self.own

    def another(self, name: str) -> Term:
        """Return the pid of an arbitrary robot other than the acting robot.

        In a fleet of one robot, the returned term is the pid of no robot."""
        assert self.own is not None
        index = t.constant(name, t.INT)
        self.fact(t.not_(t.equals(index, self.own)), "another robot")
        self.others.add(index)
        self.robot(index)
        return index

    def same(self, robot: Term, own: Term) -> Term:
        """Return the term "`robot` is the same robot as `own`"."""
        return t.FALSE if own is self.own and robot in self.others else t.equals(robot, own)

    def some_robot(self, name: str) -> Term:
        """Return the pid of an arbitrary robot."""
        index = t.constant(name, t.INT)
        self.fact(self.within(index), "a robot")
        self.robot(index, known=True)
        return index

    def for_all(
        self, instance: Callable[[Term], Term], robots: bool = True, places: bool = False, inner: bool = False
    ) -> None:
        """Add a universal formula.

        `instance` returns the formula for one int, with the domain's bounds as a condition."""
        inner = inner or self.instantiating
        found = Universal(instance, robots, places, inner, self.label, self.line, self.file, self.known_from)
        self.universals.append(found)

    def instantiate(self) -> None:
        """Instantiate universal formulas at every registered term, until no new term or formula appears.

        A universal formula inside another universal formula is not instantiated at witnesses. Otherwise the number of
        pairs of robots would be too large for the solver."""
        self.instantiating = True
        while True:
            self.passes += 1
            many = len(self.universals), len(self.indices), len(self.places)
            robots, places = list(self.indices) or [_ZERO], list(self.places)
            outer = [index for index in robots if index not in self.witnesses]
            at = 0
            while at < len(self.universals):
                self._apply(self.universals[at], robots, outer, places)
                at += 1
            if many == (len(self.universals), len(self.indices), len(self.places)):
                break
        self.instantiating = False

    def _apply(self, universal: Universal, robots: list[Term], outer: list[Term], places: list[Term]) -> None:
        terms: list[Term] = []
        if universal.robots:
            terms += outer if universal.inner else robots
        if universal.places:
            terms += places
        terms = [index for index in terms if index not in universal.done]
        if not terms:
            return
        with self.about(universal.label, universal.line, universal.file), self.known_at(universal.known_from):
            for index in terms:
                universal.done.add(index)
                self.fact(universal.instance(index))
