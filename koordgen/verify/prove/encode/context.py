"""Proof context: facts, demands and universal formulas, gathered while a part is encoded.

A symbol has the name of the program's thing. A symbol for anything else contains an `@`, so that names never collide.
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

# Names that SMT-LIB defines itself, quoted or not.
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
GENERATIONS = 1  # passes of instantiation whose new robots are instantiated in turn


def symbol(name: str) -> str:
    """Return the symbol for a name of the program."""
    return f"{name}@" if name in _RESERVED else name


def symbols(name: str, args: tuple[Term, ...], type_: Type) -> list[FunctionSymbol]:
    """Return the symbols of a value that is a function of `args`: one symbol for each part of its type."""
    domain = tuple([a.sort for a in args])
    return [FunctionSymbol(name + suffix, domain, sort) for suffix, sort in shape(type_)]


class Universal:
    """A formula that holds for every int of a domain.

    `instance` returns it for one int, with the domain's bounds. `robots`, `places`: whether the ints are robots, places
    in lists, or both. `inner`: it arose in an instance of another universal."""

    def __init__(
        self, instance: Callable[[Term], Term], robots: bool, places: bool, inner: bool, label: str, line: int,
        known_from: int,
    ) -> None:  # fmt: skip
        self.instance, self.robots, self.places, self.inner = instance, robots, places, inner
        self.label, self.line, self.known_from = label, line, known_from
        self.done: set[Term] = set()


class ProofContext:
    """Proof context of one part of a program.

    `robots`: the number of robots, None for any number >= 1; `size`: its term. If `unrolled`, universals are
    instantiated at each number of a robot, not at terms that name robots."""

    def __init__(self, program: Program, robots: int | None, unrolled: bool) -> None:
        self.program, self.robots = program, robots if unrolled else None
        self.size = t.constant("N_SYS", t.INT) if robots is None else t.integer(robots)
        self.facts: list[LabelledFormula] = []
        self.seen: dict[Term, int] = {}  # a fact's term -> the least position at which it is known
        self.demands: list[LabelledFormula] = []  # conditions under which every operation has a value
        self.notes: dict[str, None] = {}
        self.path: tuple[Term, ...] = ()
        self.indices: dict[Term, bool] = {}  # terms that may name robots -> whether each is known to name one
        self.witnesses: dict[Term, None] = {}  # those of `indices` that are witnesses, and those from instances
        self.ignored: set[Term] = set()  # terms at which no universal need be instantiated
        self.places: dict[Term, None] = {}  # terms that are places in lists
        self.universals: list[Universal] = []
        self.own: Term | None = None  # acting robot
        self.others: set[Term] = set()  # terms that name no robot, or a robot other than the acting one
        self.known: dict[Term, Term] = {}  # values that the guard gives to single variables
        self.instantiating = False
        self.passes = 0
        self.position = 0  # number of loop heads and loop ends that are encoded so far
        self.known_from = 0  # position of the facts that are being gathered
        self.absent: dict[tuple[object, ...], Term] = {}  # item -> that no robot has it
        self.granted: set[Term] = set()  # ints that name robots within the current quantifier
        self.folds: set[Term] = set()  # sums over all robots whose facts are added
        self.texts: dict[str, Term] = {}  # string literals
        self.versions: dict[int, tuple[int, Val]] = {}
        self.fresh = 0
        self.label, self.line = "", 0  # label and line of the next facts
        if robots is None:
            self.fact(t.at_most(t.integer(1), self.size), "there is a robot", 0)
        if robots is not None and unrolled:
            self.indices = {t.integer(i): True for i in range(robots)}

    # Facts

    def fact(self, formula: Term, label: str = "", line: int = 0) -> None:
        """Add a formula that holds in every model, known from the position `known_from` on."""
        if formula is not t.TRUE and self.known_from < self.seen.get(formula, 1 << 30):
            self.seen[formula] = self.known_from
            found = LabelledFormula(label or self.label, formula, self.program.path, line or self.line, self.known_from)
            self.facts.append(found)

    def fact_if_reached(self, formula: Term, label: str = "", line: int = 0) -> None:
        """Add a formula that holds if this place is reached, known from this position on."""
        with self.known_at(self.position):
            self.fact(t.implies(self.reached(), formula), label, line)

    def reached(self) -> Term:
        """Return that this place is reached: its path is taken, and every operation before it has a value.

        Without the second condition, a fact of this place could prove that an operation before it has a value."""
        return t.all_of([*self.path, *[demand.term for demand in self.demands]])

    def demand(self, formula: Term, label: str, line: int) -> None:
        """Demand a condition under which an operation of this place has a value. Without a value the event is
        discarded."""
        if formula is not t.TRUE:
            self.demands.append(
                LabelledFormula(label, t.implies(t.all_of(self.path), formula), self.program.path, line)
            )

    @contextmanager
    def known_at(self, position: int) -> Iterator[None]:
        """Let the facts that are added within be known from this position of the event on."""
        kept, self.known_from = self.known_from, position
        try:
            yield
        finally:
            self.known_from = kept

    @contextmanager
    def outermost(self) -> Iterator[None]:
        """Encode something that does not depend on the current place."""
        kept, self.path = self.path, ()
        try:
            yield
        finally:
            self.path = kept

    @contextmanager
    def under(self, *conditions: Term) -> Iterator[None]:
        """Extend the path by conditions: the places within are reached only if these hold, too."""
        kept, self.path = self.path, (*self.path, *conditions)
        try:
            yield
        finally:
            self.path = kept

    @contextmanager
    def grant(self, robot: object) -> Iterator[None]:
        """Treat an int as the name of a robot within this block."""
        new = isinstance(robot, (LiteralTerm, Apply, Op)) and robot not in self.granted
        if new:
            self.granted.add(robot)  # type: ignore[arg-type]
        try:
            yield
        finally:
            if new:
                self.granted.discard(robot)

    @contextmanager
    def about(self, label: str, line: int) -> Iterator[None]:
        kept, self.label, self.line = (self.label, self.line), label, line
        try:
            yield
        finally:
            self.label, self.line = kept

    @contextmanager
    def separate_demands(self) -> Iterator[list[LabelledFormula]]:
        """Collect the demands that arise within in a list of their own."""
        kept, self.demands = self.demands, []
        try:
            yield self.demands
        finally:
            self.demands = kept

    def note(self, text: str) -> None:
        self.notes[text] = None

    # Symbols

    def new(self, hint: str, sort: Sort) -> Term:
        """Return a new constant, of which nothing is known."""
        self.fresh += 1
        return t.constant(f"{hint}@{self.fresh}", sort)

    def any(self, hint: str, type_: Type) -> Val:
        """Return a new value of a type, of which nothing is known."""
        self.fresh += 1
        number = self.fresh
        return build(type_, iter([t.constant(f"{hint}{suffix}@{number}", sort) for suffix, sort in shape(type_)]))

    def function(self, name: str, args: tuple[Term, ...], type_: Type) -> Val:
        """Return a value of a type that is a function of terms, and of nothing else."""
        return self.applied(symbols(name, args, type_), args, type_)

    def applied(self, functions: list[FunctionSymbol], args: tuple[Term, ...], type_: Type) -> Val:
        leaves = [t.apply(function, *args) for function in functions]
        if self.known:
            leaves = [self.known.get(leaf, leaf) for leaf in leaves]
        return build(type_, iter(leaves))

    def learn(self, formula: Term) -> None:
        """Replace single variables, from now on, by the values that a formula gives them."""
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
        """Return a number for a value, which the context keeps alive. Different values have different numbers."""
        return self.versions.setdefault(id(value), (len(self.versions), value))[0]

    # Robots

    def within(self, index: Term) -> Term:
        """Return that a term names a robot."""
        return t.and_(t.at_most(_ZERO, index), t.less(index, self.size))

    def robot(self, index: Term, known: bool = False, witness: bool = False) -> None:
        """Instantiate universals over robots at this term."""
        if self.robots is None and index not in self.ignored and (known or index not in self.indices):
            if self.instantiating and self.passes > GENERATIONS:
                return  # instances would bring forth new instances without end
            self.indices[index] = known
            if witness or self.instantiating:
                self.witnesses[index] = None

    def element(self, place: Term, robots: bool, places: bool) -> None:
        """Instantiate universals over the elements of a domain at this place."""
        if robots:
            self.robot(place, witness=True)
        if places and not (self.instantiating and self.passes > GENERATIONS):
            self.places[place] = None

    def acting(self, name: str) -> Term:
        """Introduce the acting robot."""
        self.own = self.some_robot(name)
        return self.own

    def another(self, name: str) -> Term:
        """Return a term for any robot but the acting one; it names no robot if there is no other."""
        assert self.own is not None
        index = t.constant(name, t.INT)
        self.fact(t.not_(t.equals(index, self.own)), "another robot")
        self.others.add(index)
        self.robot(index)
        return index

    def same(self, robot: Term, own: Term) -> Term:
        """Return whether a robot is the robot `own`."""
        return t.FALSE if own is self.own and robot in self.others else t.equals(robot, own)

    def some_robot(self, name: str) -> Term:
        """Return a term for any one robot."""
        index = t.constant(name, t.INT)
        self.fact(self.within(index), "a robot")
        self.robot(index, known=True)
        return index

    def for_all(
        self, instance: Callable[[Term], Term], robots: bool = True, places: bool = False, inner: bool = False
    ) -> None:
        """Add a formula about all ints. `instance` includes the domain's bounds."""
        inner = inner or self.instantiating
        known_from = self.known_from
        self.universals.append(Universal(instance, robots, places, inner, self.label, self.line, known_from))

    def instantiate(self) -> None:
        """Instantiate universals at every term that names a robot or a place, until nothing is new.

        Inner universals are not instantiated at witnesses: there would be too many pairs of robots."""
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
        with self.about(universal.label, universal.line), self.known_at(universal.known_from):
            for index in terms:
                universal.done.add(index)
                self.fact(universal.instance(index))
