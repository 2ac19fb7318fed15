"""What the checker knows while it walks a program: names, the place it is at, and what it has found."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cached_property
from typing import Any, Literal, NamedTuple

from koordgen.lang.analyze.facts import Flow
from koordgen.lang.analyze.linear import Formula
from koordgen.lang.analyze.path import Condition, Path, known
from koordgen.lang.analyze.runs import Loop
from koordgen.lang.diagnostics import Diagnostic, Edit, Label, Severity
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt
from koordgen.lang.ir.builtins import CONSTANTS, FUNCTIONS
from koordgen.lang.ir.decl import (
    ExternFunction,
    ExternType,
    Function,
    Local,
    Module,
    Param,
    Record,
    Shared,
    SpecFunction,
)
from koordgen.lang.ir.expr import Const, Expr
from koordgen.lang.ir.stmt import Let
from koordgen.lang.ir.types import GENERIC, NAMED, POISON, Type
from koordgen.lang.node import Node
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax import decl as ast
from koordgen.lang.syntax import stmt as tree

# A Function's block is empty until its body has been checked: its signature is known to all bodies before.
Entity = Param | Module | Shared | Local | Record | ExternType | Function | ExternFunction | SpecFunction
# Where an expression stands decides what it may read: `constant` (literals, params), `init`, `guard`, `effect`,
# `function` (parameters, params), `contract` (parameters, params, `result`), `property` (everything, by robot),
# `assume` (one module's ports, primed or not, params, pid).
Place = Literal["constant", "init", "guard", "effect", "function", "contract", "property", "assume"]

PREDEFINED = ("pid", "N_SYS", "ID", *FUNCTIONS, *CONSTANTS, *NAMED, *GENERIC, "range", "Queue", "Set", "Map")


class Temp(Node):
    """A variable of a block, a loop, a quantifier, or a parameter: `unique` is its name in the IR."""

    unique: str
    type: Type
    span: Span


class Site(Node):
    """An index or a divisor that is wrong where `facts` (all but the event's guard) and `bad` hold."""

    facts: tuple[Formula, ...]
    bad: Formula


class Entry:
    """Variables that `old(...)` may name in a loop's invariants. `begun`: temps that exist where the loop begins, by
    their names in the IR; `values`: for each variable that was named, a declaration that keeps its value there."""

    def __init__(self, begun: frozenset[str]) -> None:
        self.begun = begun
        self.values: dict[Expr, Let] = {}


# What `back` leaves alone: all that belongs to the whole program.
_LASTING = frozenset(("source", "program", "found", "entities", "types", "defaults", "calls", "broken"))


class Mark(NamedTuple):
    """A state of a Context: how many diagnostics there were, and what belongs to the present section."""

    found: int
    kept: dict[str, Any]


def _copied(value: Any) -> Any:
    if isinstance(value, list):
        return [_copied(item) for item in value]
    return value.copy() if isinstance(value, (dict, set)) else value


class Context:
    """Mutable; one for a program. What belongs to one event (or function, or property) is set anew by `enter`."""

    def __init__(self, source: Source, program: ast.Program | None = None) -> None:
        self.source = source
        self.program = program
        self.found: list[Diagnostic] = []
        self.owners: dict[str, Node] = {}  # a name -> the node that declares it, before it is an entity
        self.entities: dict[str, Entity | None] = {}  # None: declared, but wrongly; its uses are no new mistakes
        self.types: dict[str, Type | None] = {}  # records and extern types by name; None: declared wrongly
        self.defaults: dict[str, int] = {}  # "param k" -> its default, for examples
        self.calls: dict[str, set[str]] = {}  # function -> the functions it calls
        self.enter("constant")

    def enter(self, place: Place) -> None:
        """Begin a section: no temps, nothing known."""
        self.place: Place = place
        self.path: Path | None = Path()  # None: no run gets here
        self.guard: Condition | None = None
        self.mentions: dict[str, int] = {}  # a variable -> the number of those that were mentioned before it
        self.poisoned = False  # a condition on the way was wrong: what depends on it is not judged
        self.scopes: list[dict[str, Temp]] = [{}]
        self.minted: set[str] = set()
        self.sites: list[Site] = []
        self.refuted: list[int] = []  # where in `found` the errors about sites are
        self.read_shared: set[str] = set()
        self.written_shared: set[str] = set()
        self.function = ""  # the `fun` whose body this is
        self.result: Type | None = None  # its result type; None: not known yet (2020 dialect)
        self.module = ""  # the module whose assumption this is
        self.loops = 0  # how many loops stand around
        self.loop: Loop | None = None  # the innermost `for`, if it counts
        self.entry: Entry | None = None  # of the loop whose invariant this is
        self.atomic = 0  # how many `atomic` blocks stand around
        self.transaction = False  # the event contains `atomic` somewhere
        self.hoisted: list[Let] = []  # what must be evaluated before the statement that is being checked

    @property
    def flow(self) -> Flow | None:
        """What is known here; None: no run gets here."""
        return None if self.path is None else self.path.flow

    @flow.setter
    def flow(self, flow: Flow | None) -> None:
        self.path = None if flow is None else known(flow)

    def mark(self) -> Mark:
        """Return the present state, for `back`."""
        kept = {name: _copied(value) for name, value in vars(self).items() if name not in _LASTING}
        return Mark(len(self.found), kept)

    def back(self, mark: Mark) -> None:
        """Restore the state at the mark, as if nothing had been checked since."""
        del self.found[mark.found :]
        vars(self).update({name: _copied(value) for name, value in mark.kept.items()})

    def mention(self, name: str) -> None:
        """A variable of the robot, a shared one, or pid, is read or written."""
        self.mentions.setdefault(name, len(self.mentions))

    @cached_property
    def broken(self) -> frozenset[str]:
        """Names that stand in what could not be read: what it may have meant to declare is no second mistake."""
        from koordgen.lang.analyze.walk import broken_names

        return broken_names(self.program) if self.program is not None else frozenset()

    def error(self, code: str, message: str, span: Span, help: str = "", labels: tuple[Label, ...] = ()) -> Expr:
        """Report a mistake; what stands there becomes poison."""
        self.report("error", code, message, span, help, labels)
        return Const(0, POISON, span)

    def warn(self, code: str, message: str, span: Span, help: str = "", labels: tuple[Label, ...] = ()) -> None:
        self.report("warning", code, message, span, help, labels)

    def modern(self, old: str, new: str, span: Span, edits: tuple[Edit, ...] | None = None) -> None:
        """Note a spelling of the 2020 dialect; `edits` modernise it (left out: `new` in its place)."""
        edits = (Edit(span, new),) if edits is None else edits
        message = f"{old} is the 2020 dialect's spelling of {new}"
        self.found.append(Diagnostic("K050", "note", message, span, (), "`koordgen fmt --upgrade` rewrites it", edits))

    def report(
        self, severity: Severity, code: str, message: str, span: Span, help: str, labels: tuple[Label, ...]
    ) -> None:
        self.found.append(Diagnostic(code, severity, message, span, labels, help))

    def poison(self, span: Span) -> Expr:
        """What stands where something wrong has been reported already."""
        return Const(0, POISON, span)

    def temp(self, name: str) -> Temp | None:
        if name in self.minted:  # as every name in a scope is
            for scope in reversed(self.scopes):
                if name in scope:
                    return scope[name]
        return None

    def mint(self, name: str) -> str:
        """A name that no other temp of this event has."""
        unique, number = name, 2
        while unique in self.minted:
            unique, number = f"{name}_{number}", number + 1
        self.minted.add(unique)
        return unique

    def text(self, span: Span) -> str:
        """What the user wrote at a place, on its first line."""
        line = self.source.line(span.line)
        return line[span.column - 1 : span.end_column - 1] if span.end_line == span.line else line[span.column - 1 :]

    def nearest(self, name: str, known: Iterable[str], meant: dict[str, str] | None = None) -> str:
        """A help that names what may have been meant; empty when nothing comes near."""
        if meant and name in meant:
            return f"did you mean '{meant[name]}'?"
        from difflib import get_close_matches

        # In a short name one letter is much: sin is not min.
        nearness = 0.6 if len(name) > 3 else 0.75
        for close in get_close_matches(name, known, 1, nearness) or [k for k in known if k.lower() == name.lower()]:
            return f"did you mean '{close}'?"
        return ""

    def visible(self) -> list[str]:
        """All names that can be read here."""
        return [*(n for scope in self.scopes for n in scope), *self.entities, *PREDEFINED]


# Blocks of statements: the way into each, and what is known after an assignment.

Out = list[stmt.Stmt]  # where a checked statement goes, or the several that it becomes
# By the class of the node; stmt.py fills it.
STATEMENTS: dict[type, Callable[[Any, Context, Out], None]] = {}


def check_block(block: tree.Block, c: Context) -> stmt.Block:
    """The statements of a block; its declarations end with it. `c.path` is None if no run gets to the end."""
    c.scopes.append({})
    checked: Out = []
    told = False
    for statement in block:
        if c.path is None and not told and type(statement) is not tree.Pass:
            c.warn("K043", "this statement can never run: every way to it has stopped or left", statement.span)
            told = True
        STATEMENTS[type(statement)](statement, c, checked)
    c.scopes.pop()
    return tuple(checked)


def learn(place: stmt.Place, value: ir.Expr, c: Context) -> None:
    """After `place = value`: what was known of the place is gone, and its new value may be known."""
    if c.path is not None:
        c.path = c.path.assigning(place, value)
