"""Output of a part: its goals become obligations, which share the part's facts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from koordgen.lang.node import replace
from koordgen.verify.prove.obligations.part_encoder import PartEncoder
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.obligation import HeadFormula, Kind, LabelledFormula, Obligation, StateCell

WELL_DEFINED = "(well-defined)"
AFTERWARDS = " afterwards"
OF_TWO = "(two robots)"


class Goal(NamedTuple):
    """Goal of a proof: an invariant, as conjuncts that must be proved.

    `at`: the loop head and its formula, if the goal belongs to a loop's head; None for other goals.
    `place`: "entry" or "turn" (the end of an iteration), if the goal belongs to a loop's head.
    `position`: the goal may use only facts up to this position in the event.
    `demands`: conditions that the goal may assume.
    `kind`: the kind of the goal's obligation, if it is not that of its part."""

    invariant: str
    conjuncts: tuple[LabelledFormula, ...]
    at: HeadFormula | None = None
    place: str = ""
    line: int = 0
    position: int = 1 << 30
    demands: tuple[LabelledFormula, ...] = ()
    kind: Kind | None = None


def named(invariant: str, kind: Kind, event: str) -> str:
    where = {"base": "init", "environment": "environment"}.get(kind, event.strip("()").replace(" ", "-"))
    return f"{'well-defined' if invariant == WELL_DEFINED else invariant}-{where}"


def named_at_head(invariant: str, kind: Kind, event: str, line: int, place: str) -> str:
    return f"{named(invariant.replace(' ', '-'), kind, event)}-loop-{line}-{place}"


class PartOutput:
    """Builder of a part's obligations, which share the part's facts."""

    def __init__(
        self,
        part_encoder: PartEncoder,
        kind: Kind,
        event: str,
        line: int,
        facts: tuple[LabelledFormula, ...],
        cells: tuple[StateCell, ...],
    ) -> None:
        self.part_encoder, self.kind, self.event, self.line = part_encoder, kind, event, line
        self.facts, self.cells = facts, cells
        self.notes = tuple(part_encoder.context.notes)
        self.traits = 0
        for fact in facts:
            self.traits |= fact.term.traits
        self.names: Counter[str] = Counter()

    def all(
        self,
        goals: Sequence[Goal],
        demands: Sequence[LabelledFormula],
        ended: tuple[LabelledFormula, ...],
    ) -> list[Obligation]:
        """Return one obligation per goal, and one obligation that all operations have values.

        A goal may assume that all operations have values, because an event with an operation without a value is
        discarded and changes nothing. `ended`: the condition that the effect has reached its end. Goals at a loop's
        head do not assume `ended`."""
        found = []
        for wanted in goals:
            if wanted.at is None:
                found.append(self.one(named(wanted.invariant, self.kind, self.event), wanted, wanted.kind, ended))
            else:
                name = named_at_head(wanted.invariant, self.kind, self.event, wanted.line, wanted.place)
                found.append(self.one(name, wanted, "loop", wanted.demands))
        parts = tuple([d for d in demands if d.term is not t.TRUE])
        if parts:
            name = named(WELL_DEFINED, self.kind, self.event)
            found.append(self.one(name, Goal(WELL_DEFINED, parts), "well-defined", ()))
        return found

    def one(self, name: str, wanted: Goal, kind: Kind | None, assumed: tuple[LabelledFormula, ...]) -> Obligation:
        program, conjuncts = self.part_encoder.problem.program, wanted.conjuncts
        self.names[name] += 1
        if self.names[name] > 1:  # the loop is inside an unrolled loop, so the name is taken
            name = f"{name}-{self.names[name]}"
        goal = None
        if self.kind != "consistency":
            file, line = (conjuncts[0].file, conjuncts[0].line) if conjuncts else (program.path, self.line)
            goal = LabelledFormula(wanted.invariant, t.all_of([c.term for c in conjuncts]), file, line)
        facts = self.before(wanted) + assumed
        for fact in (*assumed, *([goal] if goal else [])):
            self.traits |= fact.term.traits
        return Obligation(
            name, kind or self.kind, wanted.invariant, self.event, program.path, self.line, self.logic(), facts,
            goal, "sat" if goal is None else "unsat", conjuncts, self.cells,
            self.part_encoder.problem.robots, self.notes, wanted.at,
        )  # fmt: skip

    def satisfiable(self, name: str, assumed: tuple[LabelledFormula, ...]) -> Obligation:
        """Return an obligation that asks whether the event can reach its end.

        The facts of the obligation include the assumptions about the event's calls."""
        found = self.one(name, Goal("", ()), "consistency", assumed)
        return replace(found, goal=None, expected="sat")

    def before(self, wanted: Goal) -> tuple[LabelledFormula, ...]:
        """Return the facts that a goal may use.

        The result omits facts from later points of the event. It also omits facts that state, after the environment's
        step, the goal's own invariant or a later invariant."""
        names = [p.name for p in self.part_encoder.problem.invariants]
        if wanted.invariant in names:
            names = names[names.index(wanted.invariant) :]
        later = {f"invariant {name}{AFTERWARDS}" for name in names}
        return tuple([f for f in self.facts if f.position <= wanted.position and f.label not in later])

    def logic(self) -> str:
        """Return the smallest logic of SMT-LIB that contains all terms of the part."""
        return f"QF_UF{'N' if self.traits & t.NONLINEAR else 'L'}{'IRA' if self.traits & t.REALS else 'IA'}"
