"""State of the checker while it walks a program: names in scope, current section, diagnostics."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cached_property
from typing import Any, cast

from koordgen.lang.diagnostics import Diagnostic, Edit, Label
from koordgen.lang.ir import stmt
from koordgen.lang.ir.builtins import CONSTANTS, FUNCTIONS
from koordgen.lang.ir.decl import (
    ExternFunction,
    ExternTypeDef,
    Function,
    Import,
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
from koordgen.lang.reporter import Reporter
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax import decl as ast
from koordgen.lang.syntax import stmt as tree

# Declaration that a name refers to. The block of a Function is empty until its body has been checked; the checks of
# other bodies need only the function's signature.
Entity = Param | Module | Shared | Local | Record | ExternTypeDef | Function | ExternFunction | SpecFunction | Import
PREDEFINED = ("pid", "N_SYS", "ID", *FUNCTIONS, *CONSTANTS, *NAMED, *GENERIC, "range", "Queue", "Set", "Map")


class Temp(Node):
    """Temp: a variable of a block, loop or quantifier, or a parameter. `unique` is its name in the IR."""

    unique: str
    type: Type
    span: Span


class LoopEntry:
    """Start of a loop, to which `old(...)` in the loop's invariants refers.

    `temps_before` is the set of the temps that exist before the loop, by their names in the IR. `values` maps each
    variable in an `old(...)` to the declaration that saves the variable's value before the loop.
    """

    def __init__(self, temps_before: frozenset[str]) -> None:
        self.temps_before = temps_before
        self.values: dict[Expr, Let] = {}


class Context(Reporter):
    """Mutable state of the check of a program. `enter` resets the part that belongs to one section."""

    def __init__(self, source: Source, program: ast.Program | None = None) -> None:
        super().__init__(source)
        self.program = program
        self.owners: dict[str, Node] = {}  # name -> syntax node that declares it; filled before `entities`
        self.entities: dict[str, Entity | None] = {}  # by name; None: wrong, and its uses are not reported
        self.types: dict[str, Type | None] = {}  # records and extern types by name; None: the declaration is wrong
        self.imported: dict[str, Import] = {}  # imported variable -> the import that declares it
        self.calls: dict[str, set[str]] = {}  # function -> the functions it calls
        self.enter("constant")

    def enter(self, place: Section) -> None:
        """Begin the check of a section: reset the attributes that belong to one section."""
        self.place: Section = place
        self.scopes: list[dict[str, Temp]] = [{}]
        self.minted: set[str] = set()
        self.function = ""  # name of the `fun` whose body is being checked
        self.result: Type | None = None  # the function's result type; None: not known yet (2020 dialect)
        self.guaranteed = ""  # exported variable whose guarantee is being checked
        self.module = ""  # module whose assumption is being checked
        self.loops = 0  # number of enclosing loops
        self.entry: LoopEntry | None = None  # start of the loop whose invariant is being checked
        self.atomic = 0  # number of enclosing `atomic` blocks
        self.written: set[str] = set()  # allwrite variables that `init` has set
        self.hoisted: list[Let] = []  # declarations to evaluate before the statement that is being checked

    @cached_property
    def broken(self) -> frozenset[str]:
        """Names that occur in text that could not be parsed.

        The text may declare these names, so uses of these names are not reported as undefined.
        """
        from koordgen.lang.syntax.walk import broken_names

        return broken_names(self.program) if self.program is not None else frozenset()

    def error(
        self, code: str, message: str, span: Span, help: str = "", labels: tuple[Label, ...] = (), *parts: Expr
    ) -> Expr:
        """Report an error and return poison, an expression that causes no further errors.

        `parts` are subexpressions of the wrong expression, which the second check still analyses.
        """
        self.report("error", code, message, span, help, labels)
        return self.poison(span, *parts)

    def report_old_spelling(self, old: str, new: str, span: Span, edits: tuple[Edit, ...] | None = None) -> None:
        """Report a spelling of the 2020 dialect, with edits that modernise it.

        By default, the edit replaces the text at `span` by `new`.
        """
        edits = (Edit(span, new),) if edits is None else edits
        message = f"{old} is the 2020 dialect's spelling of {new}"
        self.found.append(
            Diagnostic("K050", "note", message, span, (), "`koordgen fmt --upgrade` rewrites the old spelling", edits)
        )

    def poison(self, span: Span, *parts: Expr) -> Expr:
        """Return poison: an expression whose error is already reported.

        The second check still analyses its subexpressions `parts`.
        """
        return Make(parts, POISON, span) if parts else Const(0, POISON, span)

    def temp(self, name: str) -> Temp | None:
        if name in self.minted:  # `minted` has the names of all scopes, and a look-up in it is faster
            for scope in reversed(self.scopes):
                if name in scope:
                    return scope[name]
        return None

    def mint(self, name: str) -> str:
        """Return a name in the IR for a new temp, different from the names of all other temps of this section."""
        unique, number = name, 2
        while unique in self.minted:
            unique, number = f"{name}_{number}", number + 1
        self.minted.add(unique)
        return unique

    def suggestion(self, name: str, known: Iterable[str], meant: dict[str, str] | None = None) -> str:
        """Return a help that suggests a similar name; empty if no name is similar."""
        if meant and name in meant:
            return f"did you mean '{meant[name]}'?"
        from difflib import get_close_matches

        # In a short name one letter makes a large difference: sin is not a misspelling of min.
        nearness = 0.6 if len(name) > 3 else 0.75
        for close in get_close_matches(name, known, 1, nearness) or [k for k in known if k.lower() == name.lower()]:
            return f"did you mean '{close}'?"
        return ""

    def visible_names(self) -> list[str]:
        """Return all names that the current section can see."""
        return [*(n for scope in self.scopes for n in scope), *self.entities, *PREDEFINED]


# Dispatch of the checks of statements.

Out = list[Draft]  # output of a statement's check: one statement may become several
# Checker function of each class of statement in the syntax tree; stmt.py and invariant.py fill this table.
STATEMENTS: dict[type, Callable[[Any, Context, Out], None]] = {}


def check_block(block: tree.Block, c: Context) -> stmt.Block:
    """Check a block and return its statements, with draft nodes (`ir.draft`) among them.

    The names that the block declares end with the block.
    """
    c.scopes.append({})
    checked: Out = []
    for statement in block:
        STATEMENTS[type(statement)](statement, c, checked)
    c.scopes.pop()
    return cast(stmt.Block, tuple(checked))  # the second check removes the draft nodes from the block
