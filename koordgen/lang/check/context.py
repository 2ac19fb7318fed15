"""State of the checker while it walks a program: the names, the place at which it is, the diagnostics."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cached_property
from typing import Any, cast

from koordgen.lang.diagnostics import Diagnostic, Edit, Label
from koordgen.lang.findings import Findings
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
from koordgen.lang.ir.draft import Draft, Section
from koordgen.lang.ir.expr import Const, Expr, Make
from koordgen.lang.ir.stmt import Let
from koordgen.lang.ir.types import GENERIC, NAMED, POISON, Type
from koordgen.lang.node import Node
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax import decl as ast
from koordgen.lang.syntax import stmt as tree

# A Function's block is empty until its body has been checked: its signature is known to all bodies before.
Entity = Param | Module | Shared | Local | Record | ExternType | Function | ExternFunction | SpecFunction
PREDEFINED = ("pid", "N_SYS", "ID", *FUNCTIONS, *CONSTANTS, *NAMED, *GENERIC, "range", "Queue", "Set", "Map")


class Temp(Node):
    """A variable of a block, a loop, a quantifier, or a parameter: `unique` is its name in the IR."""

    unique: str
    type: Type
    span: Span


class Entry:
    """Variables that `old(...)` may name in a loop's invariants. `begun`: temps that exist where the loop begins, by
    their names in the IR; `values`: for each variable that was named, a declaration that keeps its value there."""

    def __init__(self, begun: frozenset[str]) -> None:
        self.begun = begun
        self.values: dict[Expr, Let] = {}


class Context(Findings):
    """Mutable; one for a program. What belongs to one event (or function, or property) is set anew by `enter`."""

    def __init__(self, source: Source, program: ast.Program | None = None) -> None:
        super().__init__(source)
        self.program = program
        self.owners: dict[str, Node] = {}  # a name -> the node that declares it, before it is an entity
        self.entities: dict[str, Entity | None] = {}  # None: declared, but wrongly; its uses are no new mistakes
        self.types: dict[str, Type | None] = {}  # records and extern types by name; None: declared wrongly
        self.calls: dict[str, set[str]] = {}  # function -> the functions it calls
        self.enter("constant")

    def enter(self, place: Section) -> None:
        """Begin a section: it has no temps yet."""
        self.place: Section = place
        self.scopes: list[dict[str, Temp]] = [{}]
        self.minted: set[str] = set()
        self.function = ""  # the `fun` whose body this is
        self.result: Type | None = None  # its result type; None: not known yet (2020 dialect)
        self.module = ""  # the module whose assumption this is
        self.loops = 0  # how many loops stand around
        self.entry: Entry | None = None  # of the loop whose invariant this is
        self.atomic = 0  # how many `atomic` blocks stand around
        self.written: set[str] = set()  # the allwrite variables that `init` has set
        self.hoisted: list[Let] = []  # what must be evaluated before the statement that is being checked

    @cached_property
    def broken(self) -> frozenset[str]:
        """Names that stand in what could not be read: what it may have meant to declare is no second mistake."""
        from koordgen.lang.syntax.walk import broken_names

        return broken_names(self.program) if self.program is not None else frozenset()

    def error(
        self, code: str, message: str, span: Span, help: str = "", labels: tuple[Label, ...] = (), *parts: Expr
    ) -> Expr:
        """Report a mistake; what stands there becomes poison. `parts` of it are still to be judged."""
        self.report("error", code, message, span, help, labels)
        return self.poison(span, *parts)

    def modern(self, old: str, new: str, span: Span, edits: tuple[Edit, ...] | None = None) -> None:
        """Note a spelling of the 2020 dialect; `edits` modernise it (left out: `new` in its place)."""
        edits = (Edit(span, new),) if edits is None else edits
        message = f"{old} is the 2020 dialect's spelling of {new}"
        self.found.append(Diagnostic("K050", "note", message, span, (), "`koordgen fmt --upgrade` rewrites it", edits))

    def poison(self, span: Span, *parts: Expr) -> Expr:
        """Return what stands where something wrong has been reported; `parts` of it are still to be judged."""
        return Make(parts, POISON, span) if parts else Const(0, POISON, span)

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


# Blocks of statements: the way into each.

Out = list[Draft]  # where a checked statement goes, or the several that it becomes
# By the class of the node; stmt.py fills it.
STATEMENTS: dict[type, Callable[[Any, Context, Out], None]] = {}


def check_block(block: tree.Block, c: Context) -> stmt.Block:
    """Return the statements of a block, drafts among them; its declarations end with it."""
    c.scopes.append({})
    checked: Out = []
    for statement in block:
        STATEMENTS[type(statement)](statement, c, checked)
    c.scopes.pop()
    return cast(stmt.Block, tuple(checked))  # the analysis takes the drafts out
