"""Verdicts about two levels: what an outer program assumes about its robots, each of which is a fleet (ADR 0056)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal, NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir.expr import Expr, PortRead
from koordgen.lang.ir.tree import walk
from koordgen.verify.prove.obligations.provided import ProvidedAssumption, ProvidedModules
from koordgen.verify.prove.report.koord_text import to_koord
from koordgen.verify.prove.report.ledger import Ledger, LedgerEntry
from koordgen.verify.prove.report.show import ledger_lines, wrapped
from koordgen.verify.prove.report.verdict import (
    InvariantVerdict,
    Question,
    SolvedObligations,
    consistency_of,
    prove,
    settled,
)
from koordgen.verify.prove.smt.obligation import Kind
from koordgen.verify.prove.smt.solve import CrossCheck, ObligationResult, Solver

# Not asked of a kept assumption: it is about any earlier time, and a command begins a new outer round.
NOT_KEPT: frozenset[Kind] = frozenset(("base", "interference"))
SLACK_ROUNDS = 3  # inner rounds from a command of the outer program until the inner round that applies it, at most
SLACK = (
    "not covered: the time before the first command, and from a command until the inner round that applies it, at most "
    "three inner rounds"
)


class InnerRobots(NamedTuple):
    """Robots of an outer fleet file that are fleets of one inner program, with equal params and rounds.

    `names`: of the robots. `delta`: seconds in a round of their fleets."""

    names: tuple[str, ...]
    delta: float


class ProvidedVerdict(NamedTuple):
    """Verdict about one assumption of the outer program.

    `reason`: why it is not PROVED.
    `validated`: the runs that kept it, as text; "" if the verdict is not VALIDATED.
    `has_slack`: whether the time until a command is applied is not covered, because the assumption reads an actuator.
    `rests_on`: the invariants of the inner program that the proof uses."""

    assumption: decl.Assumption
    module: str
    verdict: Literal["PROVED", "VALIDATED", "UNPROVED"]
    reason: str
    has_slack: bool
    rests_on: tuple[str, ...] = ()
    validated: str = ""


class LevelVerdicts(NamedTuple):
    """Verdicts about what the outer program assumes, and about the inner program.

    `assumed`: the assumptions on which all of them rest. `robots`: the robots whose fleets run the inner program; None
        without a fleet file."""

    outer: str
    inner: str
    provided: tuple[ProvidedVerdict, ...]
    invariants: tuple[InvariantVerdict, ...]
    assumed: tuple[LedgerEntry, ...]
    robots: InnerRobots | None = None

    @property
    def slack(self) -> str:
        """Limit of a verdict about an assumption that reads an actuator, as text."""
        seconds = self.slack_seconds
        return SLACK if seconds is None else f"{SLACK} ({seconds:g} s)"

    @property
    def slack_seconds(self) -> float | None:
        return None if self.robots is None else round(SLACK_ROUNDS * self.robots.delta, 9)

    @property
    def is_proved(self) -> bool:
        return all(each.verdict == "PROVED" for each in self.provided)


def prove_levels(
    inner: decl.Program, outer: decl.Program, inner_params: Mapping[str, Expr], outer_params: Mapping[str, Expr],
    solver: Solver | CrossCheck,
) -> LevelVerdicts:  # fmt: skip
    """Prove for every number of inner robots what the outer program assumes about its modules.

    Raises SolverMissing."""
    invariants = prove(Question(inner, None, inner_params), solver)
    proved = {v.invariant for v in invariants if v.verdict == "PROVED"}
    kept = tuple([p for p in inner.properties if p.kind != "invariant" or p.name in proved])
    stated = ProvidedModules(inner, outer, outer_params)
    search = _Search(stated, {**inner_params, **stated.fixed()}, solver, kept)
    search.run()
    provided = [_verdict(each, search) for each in stated.assumptions]
    relied = {name for each in provided for name in each.rests_on}
    own = [o.obligation for o in search.used]
    own += [o.obligation for v in invariants if v.invariant in _all_relied(relied, invariants) for o in v.outcomes]
    ledger = Ledger(inner).of(own) if own else ()
    return LevelVerdicts(outer.path, inner.path, tuple(provided), tuple(invariants), ledger)


def _all_relied(names: set[str], invariants: Sequence[InvariantVerdict]) -> set[str]:
    """Return names of invariants, and the invariants on which their proofs rest, directly or not."""
    found, rests = set(names), {v.invariant: v.rests_on for v in invariants}
    while more := {other for name in found for other in rests[name] if other in rests} - found:
        found |= more
    return found


class _Search:
    """Proof of the properties that state the outer program's assumptions.

    A property that fails is dropped, and the others are proved again without it.

    `failed`: name of a property -> the steps that may break it. `used`: obligations that the proofs use.
    `inconsistent`: why the assumptions of the inner program contradict one another, or may do so; then nothing is
        proved."""

    def __init__(
        self, stated: ProvidedModules, params: Mapping[str, Expr], solver: Solver | CrossCheck,
        proved: tuple[decl.Property, ...],
    ) -> None:  # fmt: skip
        self.stated, self.params, self.solver, self.proved = stated, params, solver, proved
        self.failed: dict[str, list[str]] = {}
        self.used: list[ObligationResult] = []
        self.inconsistent = ""

    def run(self) -> None:
        every = self.stated.assumptions
        once = self._shown([p for each in every for p in each.once], self.proved, frozenset())
        names = {p.name for p in once}
        pairs = [each.kept for each in every if each.kept is not None and {p.name for p in each.once} <= names]
        self._shown(pairs, (*self.proved, *once), NOT_KEPT)

    def _shown(
        self, properties: Sequence[decl.Property], known: tuple[decl.Property, ...], skipped: Collection[Kind]
    ) -> list[decl.Property]:
        """Return the properties that every step keeps. Obligations of the kinds `skipped` do not count."""
        left = list(properties)
        while left:
            program = self.stated.program((*known, *left))
            question = Question(program, None, self.params)
            question = question._replace(interface=question.interface.with_commands(program))
            asked = settled(question, program, self.solver, SolvedObligations([], frozenset(), {}))
            names = {p.name for p in left}
            own = [o for o in asked.outcomes if o.obligation.invariant in names and o.obligation.kind not in skipped]
            failing = {o.obligation.invariant for o in own if not o.holds}
            for outcome in own:
                if not outcome.holds:
                    self.failed.setdefault(outcome.obligation.invariant, []).append(_step(outcome))
            if not failing:
                self.inconsistent = self.inconsistent or "".join(consistency_of(asked.outcomes, self.solver))
                self.used += own
                break
            left = [p for p in left if p.name not in failing]
        return left


def _step(outcome: ObligationResult) -> str:
    event, undecided = outcome.obligation.event, outcome.answer.result == "unknown"
    step = {"init": "the state after init", "(environment)": "a step of the environment"}.get(event)
    if step is None:
        step = "a command" if event.startswith("(") else f"the event {event}"
    return f"{step} (undecided: {outcome.answer.reason})" if undecided else step


def _verdict(each: ProvidedAssumption, search: _Search) -> ProvidedVerdict:
    has_slack = each.kept is not None and _reads_actuator(each, search.stated)

    def found(
        verdict: Literal["PROVED", "UNPROVED"], reason: str = "", rests_on: tuple[str, ...] = ()
    ) -> ProvidedVerdict:
        return ProvidedVerdict(each.assumption, each.module, verdict, reason, has_slack, rests_on)

    if each.kept is None:
        return found("UNPROVED", each.why)
    if search.inconsistent:
        return found("UNPROVED", search.inconsistent)
    once = [(property_, "it is not true at once") for property_ in each.once]
    for property_, what in (*once, (each.kept, "it is not kept")):
        if property_.name in search.failed:
            steps = ", ".join(dict.fromkeys(search.failed[property_.name]))
            return found("UNPROVED", f"{what}: {steps} may break it")
    own = [o for o in search.used if o.obligation.invariant in {p.name for p in (*each.once, each.kept)}]
    path = search.stated.inner.path
    lines = {fact.line for o in own for fact in o.obligation.facts if fact.file == path}
    rests = [
        p.name for p in search.proved if p.kind == "invariant" and lines & set(range(p.span.line, p.span.end_line + 1))
    ]
    return found("PROVED", "", tuple(rests))


def _reads_actuator(each: ProvidedAssumption, stated: ProvidedModules) -> bool:
    module = next(m for m in stated.outer.modules if m.name == each.module)
    actuators = {port.name for port in module.ports if port.direction == "actuator"}
    return any(isinstance(n, PortRead) and n.port in actuators for n in walk(each.assumption.formula))


def with_validation(levels: LevelVerdicts, validated: Mapping[int, str]) -> LevelVerdicts:
    """Return the verdicts, with VALIDATED for assumptions that are not proved but were kept in all runs.

    `validated`: line of an assumption -> the runs as text."""

    def noted(each: ProvidedVerdict) -> ProvidedVerdict:
        runs = validated.get(each.assumption.span.line, "")
        if each.verdict != "UNPROVED" or not runs:
            return each
        return each._replace(verdict="VALIDATED", validated=runs)

    return levels._replace(provided=tuple(map(noted, levels.provided)))


def with_levels(verdicts: Sequence[InvariantVerdict], levels: Sequence[LevelVerdicts]) -> list[InvariantVerdict]:
    """Return the outer program's verdicts, with ledgers that say which inner programs keep an assumption, and why."""
    kept: dict[int, list[str]] = {}
    for each in levels:
        whose = f" for {', '.join(each.robots.names)}" if each.robots else ""
        for one in each.provided:
            if one.verdict != "UNPROVED":
                note = f"{one.verdict} of {each.inner}{whose}, see below"
                kept.setdefault(one.assumption.span.line, []).append(note)

    def noted(entry: LedgerEntry) -> LedgerEntry:
        notes = kept.get(entry.line, []) if entry.kind == "port assumption" else []
        return entry._replace(checked="; ".join([*notes, *filter(None, [entry.checked])]))

    return [verdict._replace(assumptions=tuple(map(noted, verdict.assumptions))) for verdict in verdicts]


def levels_text(found: LevelVerdicts) -> str:
    """Return the verdicts about both levels as text."""
    whose = f"each robot of {found.outer} is a fleet of {found.inner}"
    if found.robots is not None:
        whose = f"{', '.join(found.robots.names)} of {found.outer}: a fleet of {found.inner}"
    lines = [f"{whose}, for every number of inner robots", ""]
    for each in found.provided:
        text = f"assume {to_koord(each.assumption.formula)}"
        lines.append(f"{each.verdict:<9} {text}  ({found.outer}:{each.assumption.span.line})")
        if each.reason:
            lines += wrapped(f"not proved: {each.reason}" if each.validated else each.reason)
        if each.validated:
            lines += wrapped(each.validated)
        if each.rests_on:
            lines += wrapped(f"rests on {', '.join(each.rests_on)} of {found.inner}")
        if each.verdict == "PROVED" and each.has_slack:
            lines += wrapped(found.slack)
    if not found.provided:
        lines.append(f"{found.outer} assumes nothing about its modules")
    if any(each.verdict == "PROVED" for each in found.provided):
        lines += ["", f"assumed in {found.inner}:"]
        lines += ledger_lines(found.assumed)
    return "\n".join(lines) + "\n"


def levels_document(found: LevelVerdicts) -> dict[str, Any]:
    """Return the verdicts about both levels as data for JSON."""
    return {
        "outer": found.outer,
        "inner": found.inner,
        "robots": None if found.robots is None else list(found.robots.names),
        "assumptions": [
            {
                "module": each.module,
                "text": to_koord(each.assumption.formula),
                "line": each.assumption.span.line,
                "verdict": each.verdict,
                "reason": each.reason or None,
                "validated": each.validated or None,
                "slack": found.slack if each.has_slack else None,
                "slack_seconds": found.slack_seconds if each.has_slack else None,
                "rests_on": list(each.rests_on),
            }
            for each in found.provided
        ],
        "invariants": [{"name": v.invariant, "verdict": v.verdict} for v in found.invariants],
        "assumed": [entry._asdict() for entry in found.assumed],
    }
