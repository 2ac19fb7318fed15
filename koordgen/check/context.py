"""What the checker knows while it walks a program: names, the place it is at, and what it has found."""

from __future__ import annotations

from typing import Literal

from koordgen.check.facts import Flow
from koordgen.check.linear import Formula
from koordgen.diagnostics import Diagnostic, Label, Severity
from koordgen.ir.decl import Local, Module, Param, Shared
from koordgen.ir.expr import Const, Expr
from koordgen.ir.types import NAMED, POISON, Scalar
from koordgen.node import Node
from koordgen.source import Source, Span
from koordgen.syntax.mistake import LATER_TYPES

Entity = Param | Module | Shared | Local
# Where an expression stands decides what it may read.
Place = Literal["constant", "init", "guard", "effect"]

BUILTINS = ("Point", "distance", "abs", "min", "max", "sqrt")
PREDEFINED = ("pid", "N_SYS", "ID", *BUILTINS, *NAMED)


class Temp(Node):
    """A variable of a block: `unique` is its name in the IR."""

    unique: str
    type: Scalar
    span: Span


class Site(Node):
    """An index or a divisor that is wrong where `facts` (all but the event's guard) and `bad` hold."""

    facts: tuple[Formula, ...]
    bad: Formula


class Context:
    """Mutable; one for a program. What belongs to one event is set anew by `enter`."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.found: list[Diagnostic] = []
        self.entities: dict[str, Entity | None] = {}  # None: declared, but wrongly; its uses are no new mistakes
        self.defaults: dict[str, int] = {}  # "param k" -> its default, for examples
        self.enter("constant")

    def enter(self, place: Place) -> None:
        """Begin a section: no temps, nothing known."""
        self.place: Place = place
        self.flow: Flow | None = Flow()  # None: no run gets here
        self.guard: Formula | None = None
        self.guard_text = ""
        self.poisoned = False  # a condition on the way was wrong: what depends on it is not judged
        self.scopes: list[dict[str, Temp]] = [{}]
        self.minted: set[str] = set()
        self.sites: list[Site] = []
        self.refuted: list[int] = []  # where in `found` the errors about sites are
        self.read_shared: set[str] = set()

    def error(self, code: str, message: str, span: Span, help: str = "", labels: tuple[Label, ...] = ()) -> Expr:
        """Report a mistake; what stands there becomes poison."""
        self.report("error", code, message, span, help, labels)
        return Const(0, POISON, span)

    def warn(self, code: str, message: str, span: Span, help: str = "", labels: tuple[Label, ...] = ()) -> None:
        self.report("warning", code, message, span, help, labels)

    def report(
        self, severity: Severity, code: str, message: str, span: Span, help: str, labels: tuple[Label, ...]
    ) -> None:
        self.found.append(Diagnostic(code, severity, message, span, labels, help))

    def temp(self, name: str) -> Temp | None:
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

    def type_named(self, name: str, span: Span) -> Scalar:
        """The type that a name means; POISON after reporting that it means none."""
        if name in NAMED:
            return NAMED[name]
        if name in LATER_TYPES:
            self.error("K003", f"the type {name} is not supported by this version yet", span)
        else:
            self.error("K016", f"{name} is not a type", span, self.nearest(name, [*NAMED, *LATER_TYPES], _OTHER_WORDS))
        return POISON

    def text(self, span: Span) -> str:
        """What the user wrote at a place, on its first line."""
        line = self.source.line(span.line)
        return line[span.column - 1 : span.end_column - 1] if span.end_line == span.line else line[span.column - 1 :]

    def nearest(self, name: str, known: list[str], meant: dict[str, str] | None = None) -> str:
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


_OTHER_WORDS = {"boolean": "bool", "pos": "Point", "double": "float", "real": "float", "integer": "int"}
