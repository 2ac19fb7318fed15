"""Assumption ledger: the assumptions of a verdict, each with the component that checks it at run time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import FLOAT, POINT, POSE, MapOf, PerRobot, RecordType, Sequence, TupleOf, Type
from koordgen.lang.source import Span
from koordgen.verify.prove.encode.geometry import DISTANCES, PATHS
from koordgen.verify.prove.report.koord_text import to_koord
from koordgen.verify.prove.smt.obligation import Obligation

AGENTS = (
    "agents and simulator check the contract at each call and discard the event if it fails (runtime/program/extern.py)"
)
DISCARDED = "agents discard such an event; a property that compares NaN has no value (`koordgen docs proofs`)"
SIMULATOR = "the simulator checks the assumption in each run (`koordgen docs sim`)"
UNCHECKED = ""
HARMLESS = "no check is needed: an approximation can make a proof fail, but cannot make a proof wrong"
STARTED = "every robot's init has a result: otherwise no mission begins"
AGENTS_START = (
    "agents hold until every init has a result; a robot whose init is discarded ends (`koordgen docs safety`)"
)
COMPARED = "koordgen's own tests compare the lemma with the robots' computations (`koordgen docs proofs`)"
LEMMAS = frozenset((DISTANCES, PATHS))


class LedgerEntry(NamedTuple):
    """Assumption of a verdict.

    `kind`: the kind of assumption.
    `text`: the assumption as text.
    `line`: the assumption's line in the program; 0 if the program does not state the assumption.
    `checked`: the component that checks the assumption at run time; empty if no component does."""

    kind: str
    text: str
    file: str
    line: int
    checked: str


class Ledger:
    """Assumptions of the verdicts about one program."""

    def __init__(self, program: decl.Program) -> None:
        self.program = program
        self.written = tuple(_written(program))
        self.general = tuple(_general(program))

    def of(self, obligations: Iterable[Obligation]) -> tuple[LedgerEntry, ...]:
        """Return the assumptions of some obligations.

        The assumptions are the program's formulas among the obligations' facts, and the obligations' notes."""
        used: set[int] = set()
        notes: dict[str, None] = {}
        for obligation in obligations:
            used.update([fact.line for fact in obligation.facts])
            notes.update(dict.fromkeys(obligation.notes))
        written = [entry for entry, span in self.written if used.intersection(range(span.line, span.end_line + 1))]
        return (*written, *self.general, *[_noted(note, self.program) for note in notes])


def _noted(note: str, program: decl.Program) -> LedgerEntry:
    if note in LEMMAS:
        return LedgerEntry("lemma", note, program.path, 0, COMPARED)
    return LedgerEntry("approximation", note, program.path, 0, HARMLESS)


def _written(program: decl.Program) -> Iterator[tuple[LedgerEntry, Span]]:
    """Yield the assumptions in the program's text, each with its position in the source."""
    for module in program.modules:
        for assumption in module.assumptions:
            text = f"{module.name}: {to_koord(assumption.formula)}"
            checked = _watched(assumption.formula, program)
            yield LedgerEntry("port assumption", text, program.path, assumption.span.line, checked), assumption.span
    for property_ in program.properties:
        if property_.kind in ("initially", "axiom"):
            text = f"{property_.name}: {to_koord(property_.formula)}".removeprefix(": ")
            checked = _watched(property_.formula, program) if property_.kind == "initially" else UNCHECKED
            yield LedgerEntry(property_.kind, text, program.path, property_.span.line, checked), property_.span
    for extern in program.externs:
        for word, formulas in (("requires", extern.requires), ("ensures", extern.ensures)):
            for formula in formulas:
                text = f"{extern.name} {word} {to_koord(formula)}"
                yield LedgerEntry("contract", text, program.path, formula.span.line, AGENTS), formula.span


def _watched(formula: ir.Expr, program: decl.Program) -> str:
    """Return the name of the component that checks a formula at run time.

    No component can evaluate a `spec fun`, so a formula that calls a `spec fun` is not checked."""
    specs = {spec.name for spec in program.specs}
    return UNCHECKED if any(isinstance(n, ir.Call) and n.name in specs for n in walk(formula)) else SIMULATOR


def _general(program: decl.Program) -> Iterator[LedgerEntry]:
    if program.init:
        yield LedgerEntry("start", STARTED, program.path, program.init[0].span.line, AGENTS_START)
    types = [v.type for v in program.shared] + [v.type for v in program.locals] + [v.type for v in program.params]
    types += [port.type for module in program.modules for port in module.ports]
    if any(map(_real, types)):
        text = "numbers are real numbers; robots round each result to 53 bits, and to infinity beyond 1.8e308"
        yield LedgerEntry("arithmetic", text, program.path, 0, UNCHECKED)
        text = "no event compares NaN, nor keeps or sends NaN or infinity"
        yield LedgerEntry("arithmetic", text, program.path, 0, DISCARDED)


def _real(type_: Type) -> bool:
    """Return whether values of a type contain real numbers."""
    match type_:
        case Sequence(_, element) | PerRobot(element):
            return _real(element)
        case MapOf(key, value):
            return _real(key) or _real(value)
        case TupleOf(items):
            return any(map(_real, items))
        case RecordType(_, fields):
            return any(_real(field) for _, field in fields)
        case _:
            return type_ in (FLOAT, POINT, POSE)
