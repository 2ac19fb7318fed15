"""Model reader: chooses the terms that the solver must evaluate, and converts results to Koord values.

In a model, a list is described by the functions for its length and its elements. Only short lists are read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

from koordgen.lang.ir import decl
from koordgen.lang.ir.types import (
    BOOL,
    FLOAT,
    GRID,
    INT,
    POINT,
    POSE,
    ExternType,
    RecordType,
    Sized,
    TupleOf,
    Type,
    list_of,
)
from koordgen.lang.ir.types import Sequence as SequenceType
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.property import Asked, holds_assumption
from koordgen.lang.semantics.state import State, World
from koordgen.lang.semantics.values import RecordValue, Value
from koordgen.runtime.values.points import Grid, Opaque, Point, Pose
from koordgen.verify.prove.encode.values import shape
from koordgen.verify.prove.smt.obligation import Obligation
from koordgen.verify.prove.smt.sexpr import ModelValue
from koordgen.verify.prove.smt.smtlib import Printer
from koordgen.verify.prove.smt.term import (
    INT as INT_SORT,
)
from koordgen.verify.prove.smt.term import Apply, FunctionSymbol, Sort, Term, apply, at_most, boolean, integer, real

PATH = list_of(POINT)  # type of a PathPlanner's answer
SHORT = 4  # largest number of elements that a list read from a model may have


class Unshowable(Exception):
    """Raised if the semantics cannot run a counterexample. The message gives the reason."""


class ModelReader:
    """Reader of the models of one obligation.

    The reader chooses the terms to evaluate, and converts the results to Koord values."""

    def __init__(self, obligation: Obligation) -> None:
        self.known = {f.name: f for f in _functions(obligation)}
        self.terms: dict[int, Term] = {}
        self.answers: dict[str, list[tuple[int, Term]]] = {}
        self.lengths: dict[int, Term] = {}
        for cell in obligation.cells:
            for term in ((cell.robot,) if cell.robot is not None else ()) + cell.terms:
                self.terms[id(term)] = term
        for cell in obligation.cells:
            for type_, term in zip(_leaves(cell.type), cell.terms, strict=True):
                if isinstance(type_, SequenceType) and id(term) not in self.lengths:
                    self.ask_for_list(type_, term)
        self.of: dict[int, ModelValue] = {}
        self.ask_for_answers()

    def ask_for_answers(self) -> None:
        """Add the answers of callable ports to the terms to evaluate.

        A symbol such as `Motion.planner@3` denotes the answer of a port to one call."""
        for name, function in self.known.items():
            port, mark, number = name.partition("@")
            if mark and number.isdigit() and "." in port and not function.domain and function.result == Sort(str(PATH)):
                term = apply(function)
                self.terms[id(term)] = term
                self.ask_for_list(PATH, term)
                self.answers.setdefault(port, []).append((int(number), term))

    def answered_by(self, port: str) -> list[Value]:
        """Return the answers of a callable port, in the order of the calls."""
        return [self.listed(PATH, term, port) for _, term in sorted(self.answers.get(port, []), key=lambda a: a[0])]

    def ask_for_list(self, type_: SequenceType, term: Term) -> None:
        """Add the terms for the length and the first elements of a list."""
        for inner in self.parts_of(type_, term):
            self.terms[id(inner)] = inner
        length = self.length_of(type_, term)
        if length is not None:
            self.lengths[id(term)] = length

    def length_of(self, type_: SequenceType, term: Term) -> Term | None:
        length = self.known.get(f"{type_}.len")
        return apply(length, term) if length is not None else None

    def parts_of(self, type_: SequenceType, term: Term) -> Iterator[Term]:
        """Yield the length and the leaves of the first elements of a list, if the obligation mentions them."""
        length = self.length_of(type_, term)
        if length is not None:
            yield length
        for place in range(SHORT):
            for suffix, _ in shape(type_.element):
                function = self.known.get(f"{type_}.at{suffix}")
                if function is not None and function.domain == (Sort(str(type_)), INT_SORT):
                    yield apply(function, term, integer(place))

    def wanted(self) -> list[Term]:
        return list(self.terms.values())

    def short(self) -> list[Term]:
        """Return formulas that are true if all lists are short enough to be read."""
        return [at_most(length, integer(SHORT)) for length in self.lengths.values()]

    def answered(self, values: Sequence[ModelValue]) -> None:
        self.of = {id(term): value for term, value in zip(self.wanted(), values, strict=True)}

    def value(self, type_: Type, terms: tuple[Term, ...], name: str) -> Value:
        """Return a Koord value built from the model.

        Raises Unshowable if the model's value has no counterpart in Koord."""
        return self.built(type_, iter(terms), name)

    def built(self, type_: Type, terms: Iterator[Term], name: str) -> Value:
        match type_:
            case _ if type_ == POINT:
                return Point(*[self.number(terms, name) for _ in range(3)])  # type: ignore[arg-type]
            case _ if type_ == POSE:
                return Pose(self.built(POINT, terms, name), self.number(terms, name))  # type: ignore[arg-type]
            case _ if type_ == GRID:
                x, y = self.whole(terms, name), self.whole(terms, name)
                return Grid(x, y, self.number(terms, name))  # type: ignore[arg-type]
            case _ if type_ in (INT, BOOL):
                return self.whole(terms, name)  # type: ignore[no-any-return]
            case _ if type_ == FLOAT:
                return self.number(terms, name)  # type: ignore[return-value]
            case ExternType():
                return Opaque(str(self.of[id(next(terms))]).encode())
            case Sized("string"):
                return str(self.of[id(next(terms))])
            case RecordType(record, fields):
                return RecordValue(record, tuple([self.built(field, terms, name) for _, field in fields]))
            case TupleOf(items):
                return tuple([self.built(item, terms, name) for item in items])
            case SequenceType("List" | "Queue"):
                return self.listed(type_, next(terms), name)
            case _:
                raise Unshowable(f"a model does not determine the value of {name}, a {type_}")

    def listed(self, type_: SequenceType, term: Term, name: str) -> Value:
        length = self.lengths.get(id(term))
        if length is None:
            return ()
        count = self.of[id(length)]
        if not isinstance(count, int) or not 0 <= count <= SHORT:
            raise Unshowable(f"{name} has {count} elements, but at most {SHORT} are read")
        items = []
        for place in range(count):
            functions = [(self.known.get(f"{type_}.at{suffix}"), sort) for suffix, sort in shape(type_.element)]
            leaves = [apply(f, term, integer(place)) if f is not None else _any_of(sort) for f, sort in functions]
            for leaf in leaves:
                if id(leaf) not in self.of:
                    self.of[id(leaf)] = leaf.value if not isinstance(leaf, Apply) else _unknown(name)  # type: ignore[union-attr]
            items.append(self.built(type_.element, iter(leaves), name))
        return tuple(items)

    def number(self, terms: Iterator[Term], name: str) -> Fraction:
        value = self.of[id(next(terms))]
        if isinstance(value, (bool, str)):
            raise Unshowable(f"{name} is {value}")
        return Fraction(value)

    def whole(self, terms: Iterator[Term], name: str) -> Any:
        value = self.of[id(next(terms))]
        if isinstance(value, (str, Fraction)):
            raise Unshowable(f"{name} is {value}")
        return value


def _unknown(name: str) -> ModelValue:
    raise Unshowable(f"the model has no values for the elements of {name}")


def _any_of(sort: Sort) -> Term:
    """Return an arbitrary literal of a sort, for a part of a value that the obligation does not mention."""
    values = {"Int": integer(0), "Bool": boolean(False), "Real": real(0)}
    if sort.name not in values:
        raise Unshowable(f"no value of type {sort.name} can be chosen for an element that the model leaves open")
    return values[sort.name]


def _functions(obligation: Obligation) -> Iterator[FunctionSymbol]:
    """Yield the function symbols in an obligation."""
    terms = [f.term for f in obligation.facts] + ([obligation.goal.term] if obligation.goal is not None else [])
    yield from Printer(terms).functions.values()


def _leaves(type_: Type) -> Iterator[Type]:
    """Yield the types of the leaves of a value. A collection is one leaf."""
    match type_:
        case RecordType(_, fields):
            for _, field in fields:
                yield from _leaves(field)
        case TupleOf(items):
            for item in items:
                yield from _leaves(item)
        case _:
            for _ in shape(type_):
                yield type_


def flat(value: Any) -> tuple[Term, ...]:
    """Return the literals of a value's parts, in the order of the terms of a cell.

    The result is empty if a part is not a number."""
    match value:
        case bool():
            return (boolean(value),)
        case int():
            return (integer(value),)
        case Fraction() | float():
            return (real(value),)
        case Point(x, y, z):
            return (*flat(x), *flat(y), *flat(z))
        case _:
            return ()


# Answers to the calls of an event, taken from a model. If the model does not determine the result of a call, the
# counterexample cannot be shown.


class ModelAnswers:
    """Answers of a model to the calls of one event, in the order of the calls. The calls are recorded."""

    def __init__(self, program: decl.Program, reader: ModelReader) -> None:
        self.program = program
        self.reader = reader
        self.asked: list[Asked] = []
        self.missing: list[str] = []
        unknown = {f.name: self.unknown(f.name) for f in program.externs}
        self.world = World(unknown, self.answer)

    def unknown(self, name: str):  # type: ignore[no-untyped-def]
        def call(*args: Value) -> Value:
            self.missing.append(name)
            raise LookupError(name)

        return call

    def answer(self, pid: int, port: str, args: tuple[Value, ...]) -> Value:
        before = next((call.answer for call in self.asked if (call.port, call.args) == (port, args)), None)
        if before is not None:
            return before
        known = self.reader.answered_by(port)
        place = sum(call.port == port for call in self.asked)
        if place >= len(known):
            self.missing.append(port)
            raise LookupError(port)
        self.asked.append(Asked(port, args, known[place]))
        return known[place]

    def check(self, state: State, pid: int) -> None:
        """Raise Unshowable if the model has no answer to a call or the answer violates an assumption."""
        if self.missing:
            raise Unshowable(f"the result of {self.missing[0]} is known only by its contract and axioms")
        answered(self.program, state, pid, self.asked, self.world)


def answered(program: decl.Program, state: State, pid: int, asked: Sequence[Asked], world: World) -> None:
    """Raise Unshowable if an answer of a callable port violates an assumption of the program."""
    ports = state.robots[pid].ports
    count = len(state.robots)
    for module in program.modules:
        for assumption in module.assumptions:
            if not any(True for _ in decl.handed(assumption.formula)):
                continue
            try:
                if holds_assumption(assumption, program, ports, ports, pid, count, state.params, world, asked):
                    continue
            except Discarded as error:
                raise Unshowable(
                    f"an assumption has no value in the step of the counterexample: {error.reason}"
                ) from None
            raise Unshowable("the step of the counterexample violates an assumption about a port's answers")
