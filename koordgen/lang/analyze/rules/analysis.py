"""State of the analysis while it walks a program: what is known at the point that it judges, and its diagnostics."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from koordgen.lang.analyze.facts.linear import Formula
from koordgen.lang.analyze.facts.path import Condition, Path, known
from koordgen.lang.analyze.facts.runs import Loop
from koordgen.lang.analyze.facts.terms import Flow, term
from koordgen.lang.findings import Findings
from koordgen.lang.ir.decl import Param
from koordgen.lang.ir.draft import Section
from koordgen.lang.ir.types import INT
from koordgen.lang.node import Node
from koordgen.lang.source import Source


class Site(Node):
    """An index or a divisor that is wrong where `facts` (all but the event's guard) and `bad` hold."""

    facts: tuple[Formula, ...]
    bad: Formula


# `back` leaves alone what belongs to the whole program.
_LASTING = frozenset(("source", "found", "params", "defaults"))


class Mark(NamedTuple):
    """A state of an Analysis: how many diagnostics there were, and what belongs to the present section."""

    found: int
    kept: dict[str, Any]


def _copied(value: Any) -> Any:
    return value.copy() if isinstance(value, (list, dict, set)) else value


class Analysis(Findings):
    """Mutable; one for a program. `enter` sets anew what belongs to one event, function or property."""

    def __init__(self, source: Source, params: Iterable[Param]) -> None:
        super().__init__(source)
        self.params = {param.name: param for param in params}
        self.defaults: dict[str, int] = {}  # "param k" -> its default, for examples
        for param in self.params.values():
            value = term(param.default, Flow()) if param.type == INT else None
            if value is not None and not value.terms:
                self.defaults[f"param {param.name}"] = value.constant
        self.enter("constant")

    def enter(self, place: Section) -> None:
        """Begin a section: nothing is known."""
        self.place: Section = place
        self.path: Path | None = Path()  # None: no run gets here
        self.guard: Condition | None = None
        self.mentioned: set[str] = set()  # the robot's variables, shared ones, and pid, as far as they were used
        self.poisoned = False  # a condition on the way was wrong: what depends on it is not judged
        self.sites: list[Site] = []
        self.refuted: list[int] = []  # where in `found` the errors about sites are
        self.read_shared: set[str] = set()
        self.written_shared: set[str] = set()
        self.loops = 0  # how many loops stand around
        self.loop: Loop | None = None  # the innermost `for`, if it counts
        self.transaction = False  # the event contains `atomic` somewhere

    @property
    def flow(self) -> Flow | None:
        """The facts known here; None: no run gets here."""
        return None if self.path is None else self.path.flow

    @flow.setter
    def flow(self, flow: Flow | None) -> None:
        self.path = None if flow is None else known(flow)

    def mark(self) -> Mark:
        """Return the present state, for `back`."""
        kept = {name: _copied(value) for name, value in vars(self).items() if name not in _LASTING}
        return Mark(len(self.found), kept)

    def back(self, mark: Mark) -> None:
        """Restore the state at the mark, as if nothing had been judged since."""
        del self.found[mark.found :]
        vars(self).update({name: _copied(value) for name, value in mark.kept.items()})

    def error(self, code: str, message: str, span: Any, help: str = "", labels: Any = ()) -> None:
        """Add an error."""
        self.report("error", code, message, span, help, labels)

    def site_error(self, code: str, message: str, span: Any, help: str = "") -> None:
        """Add an error about an index or a divisor. The opposite of the guard may be named as its repair later."""
        self.refuted.append(len(self.found))
        self.error(code, message, span, help)
