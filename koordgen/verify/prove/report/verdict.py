"""Verdicts of invariants.

The module asks the solver about all obligations. Then it drops the invariants that fail, proves the remaining
invariants without them, and explains the failures.

An invariant is PROVED only under three conditions. The solver gave the proving answer for each of its obligations. All
invariants that these obligations assume are PROVED. The solver showed that the assumptions are consistent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir.expr import Expr
from koordgen.lang.node import replace
from koordgen.verify.prove.obligations.generate import assumptions, obligation_groups, obligations
from koordgen.verify.prove.obligations.interface import ALONE, Interface
from koordgen.verify.prove.obligations.output import OF_TWO
from koordgen.verify.prove.obligations.part_encoder import Detail
from koordgen.verify.prove.report.ledger import Ledger, LedgerEntry
from koordgen.verify.prove.smt.obligation import HeadFormula, Obligation
from koordgen.verify.prove.smt.smtlib import script
from koordgen.verify.prove.smt.solve import CrossCheck, ObligationResult, Solver, SolverAnswer

if TYPE_CHECKING:  # imported only for type checking, since a proof needs no Explainer and its import takes long
    from koordgen.verify.prove.report.explain import FailureExplanation

VerdictName = Literal["PROVED", "VACUOUS", "FALSIFIED", "NOT INDUCTIVE", "UNKNOWN", "UNSOUND"]
WELL_DEFINED = "(well-defined)"
MORE: tuple[Detail, ...] = ("usual", "most")


class Question(NamedTuple):
    """Question to the prover.

    `program`: a checked program.
    `robots`: the number of robots; None for any number.
    `params`: the values of fixed params. All other params are arbitrary.
    `interface`: the interface to the other applications of the fleet."""

    program: decl.Program
    robots: int | None = None
    params: Mapping[str, Expr] | None = None
    interface: Interface = ALONE


class SolvedObligations(NamedTuple):
    """Results of all obligations, after formulas that fail at loop heads were dropped.

    `dropped`: the formulas that failed at a loop's head.
    `lost`: the failed obligations of invariants that the program states at loops."""

    outcomes: list[ObligationResult]
    dropped: frozenset[HeadFormula]
    lost: dict[str, tuple[ObligationResult, ...]]


class InvariantVerdict(NamedTuple):
    """Verdict of one invariant.

    `reason`: a sentence that explains why the invariant is not PROVED.
    `rests_on`: the other invariants that the proof assumes."""

    invariant: str
    verdict: VerdictName
    robots: int | None
    outcomes: tuple[ObligationResult, ...]
    reason: str
    explanation: FailureExplanation | None
    rests_on: tuple[str, ...]
    assumptions: tuple[LedgerEntry, ...]


def prove(question: Question, solver: Solver | CrossCheck) -> list[InvariantVerdict]:
    """Return a verdict for each invariant: first well-definedness, then the program's order.

    Raises SolverMissing."""
    solver.start()
    program = question.program
    question = question._replace(interface=question.interface.with_commands(program))
    asked = _as_for_any(question, program, solver) or settled(
        question, program, solver, SolvedObligations([], frozenset(), {})
    )
    names = _names(program, asked)
    groups = _groups(asked.outcomes)
    failed: dict[str, tuple[tuple[ObligationResult, ...], decl.Program, Interface]] = {}
    while failing := [name for name, group in groups.items() if not all(o.holds for o in group)]:
        failed.update({name: (groups[name], program, question.interface) for name in failing})
        without = [p for p in program.properties if p.kind == "invariant" and p.name in failing]
        interface = question.interface.without(failing)
        if not without and interface is question.interface:
            break
        question = question._replace(interface=interface)
        program = replace(program, properties=tuple([p for p in program.properties if p not in without]))
        asked = settled(question, program, solver, asked)
        groups = {name: group for name, group in _groups(asked.outcomes).items() if name not in failed}
    failed.update({name: (group, program, question.interface) for name, group in asked.lost.items()})
    outcomes = asked.outcomes
    contradiction, doubt = consistency_of(outcomes, solver)
    explained = {} if contradiction else _explained(question, failed, solver, program, asked.dropped)
    found, ledger = [], Ledger(question.program)
    for name in names:
        group = failed[name][0] if name in failed else groups[name]
        explanation = explained.get(name)
        verdict, reason = _verdict(question.program, group, explanation, contradiction, doubt)
        assumed = ledger.of([o.obligation for o in group])
        rests = _rests_on(name, group, program, question.interface) if verdict == "PROVED" else ()
        found.append(InvariantVerdict(name, verdict, question.robots, group, reason, explanation, rests, assumed))
    return found


def _explained(
    question: Question,
    failed: Mapping[str, tuple[tuple[ObligationResult, ...], decl.Program, Interface]],
    solver: Solver | CrossCheck,
    proved: decl.Program,
    dropped: frozenset[HeadFormula],
) -> dict[str, FailureExplanation]:
    """Return the explanation of each failed invariant, by the invariant's name.

    `proved`: the program with only its PROVED invariants."""
    if not failed:
        return {}
    from koordgen.verify.prove.report.explain import Explainer

    explainer = Explainer(question.program, question.robots, question.params, solver, proved, dropped)
    return {name: explainer.explain(name, group, relied, scope) for name, (group, relied, scope) in failed.items()}


def settled(
    question: Question,
    program: decl.Program,
    solver: Solver | CrossCheck,
    before: SolvedObligations,
    more: Sequence[Detail] = MORE,
) -> SolvedObligations:
    """Ask about all obligations until no formula that is assumed at a loop's head fails.

    Formulas that fail at a loop's head are dropped. Then all obligations are asked again."""
    dropped, lost = before.dropped, dict(before.lost)
    while True:
        outcomes = _asked(question, program, solver, dropped, more)
        failing = [o for o in outcomes if o.obligation.at is not None and not o.holds]
        if not failing:
            return SolvedObligations(outcomes, dropped, lost)
        dropped |= {o.obligation.at for o in failing if o.obligation.at is not None}
        stated = {o.obligation.invariant for o in failing} - {p.name for p in program.properties}
        groups = _groups(outcomes)
        lost.update({name: groups[name] for name in stated})


def _asked(
    question: Question,
    program: decl.Program,
    solver: Solver | CrossCheck,
    dropped: frozenset[HeadFormula],
    more: Sequence[Detail],
) -> list[ObligationResult]:
    """Return the results of all obligations.

    Each obligation is asked with few facts first. An obligation that is not proved is asked again with more facts, if
    more facts change its text."""
    robots, params = question.robots, question.params
    found = [
        ObligationResult(*each)
        for each in solver.ask_all(
            obligation_groups(program, robots, params, "little", dropped, None, question.interface)
        )
    ]
    for detail in more:
        if all(outcome.holds or outcome.obligation.too_large for outcome in found):
            break  # more facts would only enlarge formulas that are too large already
        others = {o.name: o for o in obligations(program, robots, params, detail, dropped, None, question.interface)}
        found = [outcome if outcome.holds else _again(outcome, others, solver) for outcome in found]
    return found


def _as_for_any(question: Question, program: decl.Program, solver: Solver | CrossCheck) -> SolvedObligations | None:
    """Answer a question about one number of robots by a proof for any number of robots.

    A proof for any number covers the given number, and the solver finds it faster. The consistency of the assumptions
    must still be shown for the given number. Returns None if the proof for any number fails."""
    if question.robots is None:
        return None
    general = settled(question._replace(robots=None), program, solver, SolvedObligations([], frozenset(), {}), MORE[:1])
    # SOUND: use either all results or no results. For any number of robots, the facts after a loop rest on the loop's
    # invariants. For the given number, the loop may be unrolled, and then its invariants have no obligations.
    if general.lost or not all(outcome.holds for outcome in general.outcomes):
        return None
    numbered = solver.ask_all([[o] for o in assumptions(program, question.robots, question.params, question.interface)])
    others = [o for o in general.outcomes if o.obligation.kind != "consistency"]
    return general._replace(outcomes=[*(ObligationResult(*each) for each in numbered), *others])


def _again(
    outcome: ObligationResult, others: Mapping[str, Obligation], solver: Solver | CrossCheck
) -> ObligationResult:
    other = others.get(outcome.obligation.name)
    if other is None:
        return outcome
    if script(other) == script(outcome.obligation):
        return ObligationResult(other, outcome.answer)
    answer = solver.ask(other)
    return ObligationResult(other, answer._replace(seconds=answer.seconds + outcome.answer.seconds))


def _groups(outcomes: Sequence[ObligationResult]) -> dict[str, tuple[ObligationResult, ...]]:
    """Return the results of each invariant's obligations, by the invariant's name."""
    found: dict[str, list[ObligationResult]] = {}
    for outcome in outcomes:
        if outcome.obligation.kind != "consistency":
            found.setdefault(outcome.obligation.invariant, []).append(outcome)
    return {name: tuple(group) for name, group in found.items()}


def _names(program: decl.Program, asked: SolvedObligations) -> list[str]:
    found = dict.fromkeys(o.obligation.invariant for o in asked.outcomes if o.obligation.kind != "consistency")
    found.update(dict.fromkeys(asked.lost))
    found.update(dict.fromkeys(p.name for p in program.properties if p.kind == "invariant"))
    return list(found)


def consistency_of(outcomes: Sequence[ObligationResult], solver: Solver | CrossCheck) -> tuple[str, str]:
    """Return a contradiction among the assumptions, and a reason why consistency is undecided.

    Both values are texts. Both texts are empty if the assumptions are consistent."""
    doubt = ""
    for outcome in outcomes:
        obligation = outcome.obligation
        if obligation.kind != "consistency" or outcome.holds or _is_dead(obligation, outcome.answer, solver):
            continue
        if outcome.answer.result == "unknown":
            place = f"{obligation.name} ({obligation.file}:{obligation.line})"
            doubt = f"{place}: consistency of the assumptions is undecided: {outcome.answer.reason}"
            continue
        core = solver.ask(obligation, core=True).core or range(len(obligation.facts))
        facts = [obligation.facts[place] for place in core if obligation.facts[place].line]
        conflicting = dict.fromkeys(f"{fact.label} ({fact.file}:{fact.line})" for fact in facts)
        state = "state of two robots or more" if obligation.event == OF_TWO else "state"
        return f"no {state} satisfies {' and '.join(conflicting) or 'the assumptions'}: anything follows from that", ""
    return "", doubt


def _is_dead(obligation: Obligation, answer: SolverAnswer, solver: Solver | CrossCheck) -> bool:
    """Return whether an event cannot reach its end, even without the assumptions about its calls."""
    if not obligation.event or answer.result != "unsat":
        return False
    own = tuple([f for f in obligation.facts if not f.label.startswith(("contract of ", "axiom ", "assume of "))])
    return solver.ask(replace(obligation, facts=own)).result == "unsat"


def _verdict(
    program: decl.Program,
    group: tuple[ObligationResult, ...],
    explanation: FailureExplanation | None,
    contradiction: str,
    doubt: str,
) -> tuple[VerdictName, str]:
    if contradiction:
        return "VACUOUS", contradiction
    if explanation is not None and explanation.run is not None:
        return "FALSIFIED", ""
    if explanation is not None and explanation.counterexample is not None:
        return "NOT INDUCTIVE", ""
    failing = [o for o in group if not o.holds]
    if failing:
        first = next((o for o in failing if o.answer.result == "unknown"), failing[0])
        from koordgen.verify.prove.report.unknown import unknown_reason

        return "UNKNOWN", unknown_reason(
            program, first.obligation, first.answer, explanation.unshown if explanation else ""
        )
    return ("UNKNOWN", doubt) if doubt or not group else ("PROVED", "")


def _rests_on(
    name: str, group: tuple[ObligationResult, ...], program: decl.Program, interface: Interface
) -> tuple[str, ...]:
    """Return the names of the other invariants, and of the guarantees, that an invariant's obligations assume."""
    facts = [fact for outcome in group for fact in outcome.obligation.facts]
    lines = {fact.line for fact in facts if fact.file == program.path}
    others = [p for p in program.properties if p.kind == "invariant" and p.name != name]
    rests = [p.name for p in others if lines.intersection(range(p.span.line, p.span.end_line + 1))]
    if interface.guarantees:
        labels = {fact.label for fact in facts}
        for guarantee in [g for g in interface.guarantees if g.label != name]:
            if any(label.startswith(f"{guarantee.label} ") or label == guarantee.label for label in labels):
                rests.append(guarantee.label)
    return tuple(rests)
