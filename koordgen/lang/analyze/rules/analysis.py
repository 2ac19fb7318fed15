"""State of the analysis while it walks a program: facts at the current point, and diagnostics."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.linear import Formula
from koordgen.lang.analyze.facts.path import Condition, Path, point_with_facts
from koordgen.lang.analyze.facts.runs import Loop
from koordgen.lang.analyze.facts.terms import Flow, names_of, term
from koordgen.lang.ir.decl import Import, Program
from koordgen.lang.ir.draft import Section
from koordgen.lang.ir.types import INT
from koordgen.lang.node import Node
from koordgen.lang.reporter import Reporter
from koordgen.lang.source import Source


class Site(Node):
    """Index or divisor in the effect of an event.

    The index or divisor is wrong in a state in which both `facts` and `bad` hold. `facts` do not include the guard.
    """

    facts: tuple[Formula, ...]
    bad: Formula


# Attributes that belong to the whole program: `restore` does not restore them.
_LASTING = frozenset(("source", "found", "params", "defaults"))


class SavedState(NamedTuple):
    """Saved state of an Analysis: the number of diagnostics, and the attributes of the current section."""

    found: int
    kept: dict[str, Any]


def _facts_about(imports: Iterable[Import]) -> Flow:
    """Return the facts that hold everywhere.

    An imported allread variable has a slot for each of the exporter's members; `Name.pid` is a member's pid or -1.
    """
    values: dict[str, tuple[linear.Linear | Formula, frozenset[str]]] = {}
    conditions: list[Formula] = []
    for imported in imports:
        size, pid = linear.variable(f"param {imported.size}"), linear.variable(f"local {imported.pid}")
        for name in imported.slots:
            values[f"len shared {name}"] = size, names_of(size)
        conditions += [linear.at_least(size, linear.constant(1)), linear.at_least(pid, linear.constant(-1))]
        conditions.append(linear.less(pid, size))
    about = frozenset(name for _, names in values.values() for name in names)
    return Flow((), values, about).assuming(linear.And(tuple(conditions)))


def _copied(value: Any) -> Any:
    return value.copy() if isinstance(value, (list, dict, set)) else value


class Analysis(Reporter):
    """Mutable state of the analysis of a program. `enter` resets the part that belongs to one section."""

    def __init__(self, source: Source, program: Program) -> None:
        super().__init__(source)
        self.params = {param.name: param for param in program.params}
        self.flow_at_start = _facts_about(program.imports)
        self.defaults: dict[str, int] = {}  # "param k" -> default of the param k, for examples in messages
        for param in self.params.values():
            value = term(param.default, Flow()) if param.type == INT else None
            if value is not None and not value.terms:
                self.defaults[f"param {param.name}"] = value.constant
        self.enter("constant")

    def enter(self, place: Section) -> None:
        """Begin the analysis of a section: reset the attributes that belong to one section."""
        self.place: Section = place
        self.path: Path | None = point_with_facts(self.flow_at_start)  # None if the current point is unreachable
        self.guard: Condition | None = None
        self.mentioned: set[str] = set()  # names used before this point: local and shared variables, "pid"
        self.poisoned = False  # a condition on the path is wrong, so code that depends on it is not checked
        self.sites: list[Site] = []
        self.refuted: list[int] = []  # indices in `found` of errors about indices and divisors
        self.read_shared: set[str] = set()
        self.written_shared: set[str] = set()
        self.loops = 0  # number of enclosing loops
        self.loop: Loop | None = None  # the innermost `for`, if it is over a range or over ID
        self.transaction = False  # True if the event contains `atomic`

    @property
    def flow(self) -> Flow | None:
        """Facts at the current point; None if the point is unreachable."""
        return None if self.path is None else self.path.flow

    @flow.setter
    def flow(self, flow: Flow | None) -> None:
        self.path = None if flow is None else point_with_facts(flow)

    def saved_state(self) -> SavedState:
        """Return a copy of the current state, to which `restore` can return."""
        kept = {name: _copied(value) for name, value in vars(self).items() if name not in _LASTING}
        return SavedState(len(self.found), kept)

    def restore(self, saved_state: SavedState) -> None:
        """Restore a saved state; drop the diagnostics that were added after the state was saved."""
        del self.found[saved_state.found :]
        vars(self).update({name: _copied(value) for name, value in saved_state.kept.items()})

    def error(self, code: str, message: str, span: Any, help: str = "", labels: Any = ()) -> None:
        """Add an error."""
        self.report("error", code, message, span, help, labels)

    def site_error(self, code: str, message: str, span: Any, help: str = "") -> None:
        """Add an error about an index or a divisor. The help of the error may later suggest the negated guard."""
        self.refuted.append(len(self.found))
        self.error(code, message, span, help)
