"""Guarantees and interference: the obligations that an application has because of its exports and imports (ADR 0055).

B: first values and each `init` establish the state guarantees. E: each write keeps the guarantees of its variable
(`of_event` in generate.py). I: the invariants survive whatever other applications may do. P: step guarantees are
reflexive and transitive. docs/reference/semantics.md ("Several applications") has the theorem and its proof.

What may be assumed: state guarantees before a step and at the round's start, and step guarantees between the round's
start and the state before the step. A guarantee of the step that is being shown is never assumed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

from koordgen.verify.prove.encode.loop import written
from koordgen.verify.prove.encode.scope import FleetScope
from koordgen.verify.prove.encode.state import ArbitraryState, HavockedState, Key, RoundStart, SymbolicState, slots
from koordgen.verify.prove.encode.values import Val, as_term
from koordgen.verify.prove.obligations.goal import goal, goal_at
from koordgen.verify.prove.obligations.interface import GuaranteeInScope, ImportFact
from koordgen.verify.prove.obligations.mission_start import LaunchState, StartState, assume_initially
from koordgen.verify.prove.obligations.output import AFTERWARDS, Goal, PartOutput
from koordgen.verify.prove.obligations.part_encoder import PartEncoder, ProofProblem
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.obligation import Obligation
from koordgen.verify.prove.smt.term import Term

FIRST_VALUES = "(first values)"
REFLEXIVE, TRANSITIVE = "(reflexive)", "(transitive)"


def value_in(state: SymbolicState, key: Key) -> Val:
    """Return the value of a shared variable; for an allread variable, all slots."""
    return slots(state, key[1]) if key[0] == "slot" else state.of(key, t.integer(-1))


def scope_of(guarantee: GuaranteeInScope, before: SymbolicState, after: SymbolicState) -> FleetScope:
    """Return the scope in which a guarantee reads its variable in two states; a state guarantee reads `before`."""
    scope = FleetScope(before)
    scope.temps = {
        guarantee.before: value_in(before, guarantee.key),
        guarantee.after: value_in(after, guarantee.key),
    }
    return scope


# Facts that a proof may use


def assume_imports(part_encoder: PartEncoder, state: SymbolicState) -> None:
    """Assume the facts about the exporters' members. They never change, so they may be assumed in any state."""
    _assume_facts(part_encoder, part_encoder.problem.interface.facts, state)


def _assume_facts(part_encoder: PartEncoder, facts: Iterable[ImportFact], state: SymbolicState) -> None:
    for fact in facts:
        with part_encoder.context.about(fact.label, fact.line):
            part_encoder.assume(fact.formula, FleetScope(state))


def assume_state(
    part_encoder: PartEncoder, state: SymbolicState, keys: Collection[Key] | None = None, when: str = ""
) -> None:
    """Assume, in one state, the state guarantees and the sizes of imported slots.

    `keys`: the variables whose guarantees are assumed; None for all."""
    interface = part_encoder.problem.interface
    _assume_facts(part_encoder, interface.sizes, state)
    for guarantee in interface.guarantees if keys is None else interface.of(keys):
        if not guarantee.is_step:
            with part_encoder.context.about(guarantee.label + when, guarantee.line, guarantee.file):
                part_encoder.assume(guarantee.formula, scope_of(guarantee, state, state))


def assume_step(
    part_encoder: PartEncoder, before: SymbolicState, after: SymbolicState, keys: Collection[Key], when: str
) -> None:
    """Assume the step guarantees of the variables `keys` between two states."""
    for guarantee in part_encoder.problem.interface.of(keys):
        if guarantee.is_step:
            with part_encoder.context.about(guarantee.label + when, guarantee.line, guarantee.file):
                part_encoder.assume(guarantee.formula, scope_of(guarantee, before, after))


def assume_launch(part_encoder: PartEncoder, launch: SymbolicState) -> None:
    """Assume what is known of the state before `init`: the first values satisfy the state guarantees."""
    assume_imports(part_encoder, launch)
    assume_state(part_encoder, launch, when=" of the first values")


def assume_since_start(part_encoder: PartEncoder, round_start: RoundStart, now: SymbolicState) -> None:
    """Assume what is known of the variables that other applications may have changed since the round's start."""
    interface = part_encoder.problem.interface
    assume_state(part_encoder, round_start, when=" at the round's start")
    assume_step(part_encoder, round_start, now, interface.foreign, " since the round's start")
    assume_cleared(part_encoder, round_start, now)


def assume_cleared(part_encoder: PartEncoder, before: SymbolicState, after: SymbolicState) -> None:
    """Assume that sensors that another application may clear have not become true between two states of a round."""
    context, cleared = part_encoder.context, part_encoder.problem.interface.cleared

    def instance(robot: Term) -> Term:
        fell = [t.implies(as_term(after.of(key, robot)), as_term(before.of(key, robot))) for key in cleared]
        return t.implies(context.within(robot), t.all_of(fell))

    if cleared:
        with context.about("within a round, sensors are only cleared", 0):
            context.for_all(instance, inner=True)


def sensed_ports(
    part_encoder: PartEncoder, own: Term, now: SymbolicState, round_start: RoundStart
) -> dict[Key, SymbolicState]:
    """Return the state from which an event reads each port that another application may have changed in the round.

    The event may see the port as it was at the round's start or as it is now, so its value is a third one. A sensor
    that may only be cleared lies between both."""
    context, interface = part_encoder.context, part_encoder.problem.interface
    sensed = ArbitraryState(context, part_encoder.problem.types, "@seen")
    with context.about("within a round, sensors are only cleared", 0):
        for key in interface.cleared:
            value = as_term(sensed.of(key, own))
            context.fact(t.implies(as_term(now.of(key, own)), value))
            context.fact(t.implies(value, as_term(round_start.of(key, own))))
    return dict.fromkeys(interface.ports, sensed)


# Goals and parts


def goals_of_step(
    part_encoder: PartEncoder, keys: Collection[Key], before: SymbolicState, after: SymbolicState
) -> Iterator[Goal]:
    """Yield the guarantees of the variables that a step writes (E): `before` is the state just before the write."""
    for guarantee in part_encoder.problem.interface.of(keys):
        yield _goal(part_encoder, guarantee, before if guarantee.is_step else after, after)


def _goal(part_encoder: PartEncoder, guarantee: GuaranteeInScope, before: SymbolicState, after: SymbolicState) -> Goal:
    with part_encoder.context.about(guarantee.label, guarantee.line, guarantee.file):
        parts = goal_at(part_encoder, guarantee.label, guarantee.formula, scope_of(guarantee, before, after), t.TRUE)
    return Goal(guarantee.label, parts, kind="guarantee")


def own_state_guarantees(problem: ProofProblem) -> list[GuaranteeInScope]:
    """Return the state guarantees of the application's own variables, which the first values must satisfy."""
    return [g for g in problem.interface.guarantees if g.is_own and not g.is_step]


def of_first_values(problem: ProofProblem) -> list[Obligation]:
    """Return the obligations that the first values satisfy the state guarantees (B)."""
    part_encoder = PartEncoder(problem)
    launch = LaunchState(part_encoder)
    assume_initially(part_encoder, launch)
    goals = [_goal(part_encoder, guarantee, launch, launch) for guarantee in own_state_guarantees(problem)]
    cells = part_encoder.cells([("before", launch), ("after", launch)])
    line = goals[0].conjuncts[0].line if goals and goals[0].conjuncts else 1
    return PartOutput(part_encoder, "guarantee", FIRST_VALUES, line, part_encoder.close(), cells).all(goals, (), ())


def init_guarantees(problem: ProofProblem) -> list[GuaranteeInScope]:
    """Return the state guarantees of the variables that `init` writes."""
    return [g for g in problem.interface.of(written(problem.program.init)) if not g.is_step]


def of_init_guarantees(problem: ProofProblem) -> list[Obligation]:
    """Return the obligations that the application's `init` establishes the state guarantees of what it writes (B).

    The state after every `init` of this application alone is judged, since every other application shows the same of
    its own writes, and the value of a shared variable is the one that was written last."""
    part_encoder = PartEncoder(problem)
    ready = StartState(part_encoder, frozenset())
    assume_initially(part_encoder, ready.launch)
    assume_launch(part_encoder, ready.launch)
    part_encoder.context.some_robot("pid")
    goals = [_goal(part_encoder, guarantee, ready, ready) for guarantee in init_guarantees(problem)]
    cells = part_encoder.cells([("before", ready.launch), ("after", ready)])
    line = problem.program.init[0].span.line
    return PartOutput(part_encoder, "guarantee", "init", line, part_encoder.close(), cells).all(goals, (), ())


def of_others(problem: ProofProblem) -> list[Obligation]:
    """Return the obligations of rule I: the invariants survive the steps of other applications.

    Such a step changes foreign variables and ports, and nothing else. It keeps the guarantees of each variable that it
    writes."""
    part_encoder, interface = PartEncoder(problem), problem.interface
    now = ArbitraryState(part_encoder.context, problem.types)
    after = HavockedState(now, ArbitraryState(part_encoder.context, problem.types, "@after"), interface.moved)
    part_encoder.holds(problem.invariants, now)
    assume_imports(part_encoder, now)
    assume_state(part_encoder, now)
    assume_state(part_encoder, after, interface.foreign, AFTERWARDS)
    assume_step(part_encoder, now, after, interface.foreign, " by another application")
    assume_cleared(part_encoder, now, after)
    goals = [Goal(p.name, goal(part_encoder, p, after), kind="interference") for p in problem.touched(interface.moved)]
    part_encoder.holds(problem.invariants, after, when=AFTERWARDS)
    cells = part_encoder.cells([("before", now), ("after", after)])
    spans = [
        each.span for of in (problem.program.imports, problem.program.exports, problem.program.provides) for each in of
    ]
    line = spans[0].line if spans else 1
    return PartOutput(part_encoder, "interference", interface.others, line, part_encoder.close(), cells).all(
        goals, (), ()
    )


def own_step_guarantees(problem: ProofProblem) -> list[GuaranteeInScope]:
    """Return the step guarantees that the application must show to be reflexive and transitive."""
    return [g for g in problem.interface.guarantees if g.is_own and g.is_step]


def of_reflexivity(problem: ProofProblem, guarantee: GuaranteeInScope) -> list[Obligation]:
    """Return the obligation that a step guarantee allows a step that leaves the variable as it is (P)."""
    part_encoder = PartEncoder(problem)
    now = ArbitraryState(part_encoder.context, problem.types)
    assume_state(part_encoder, now, (guarantee.key,))
    return _about_steps(part_encoder, guarantee, REFLEXIVE, now, now)


def of_transitivity(problem: ProofProblem, guarantee: GuaranteeInScope) -> list[Obligation]:
    """Return the obligation that two steps that keep a step guarantee keep it together (P).

    All three states satisfy the state guarantees of the variable, because every reachable state does."""
    part_encoder = PartEncoder(problem)
    first, second, third = (
        ArbitraryState(part_encoder.context, problem.types, name) for name in ("@start", "", "@after")
    )
    for state in (first, second, third):
        assume_state(part_encoder, state, (guarantee.key,))
    for before, after in ((first, second), (second, third)):
        with part_encoder.context.about(guarantee.label, guarantee.line, guarantee.file):
            part_encoder.assume(guarantee.formula, scope_of(guarantee, before, after))
    return _about_steps(part_encoder, guarantee, TRANSITIVE, first, third, second)


def _about_steps(
    part_encoder: PartEncoder, guarantee: GuaranteeInScope, event: str, before: SymbolicState, after: SymbolicState,
    between: SymbolicState | None = None,
) -> list[Obligation]:  # fmt: skip
    wanted = _goal(part_encoder, guarantee, before, after)
    cells = part_encoder.cells([("round start", before), ("before", between or before), ("after", after)])
    out = PartOutput(part_encoder, "guarantee", event, guarantee.line, part_encoder.close(), cells)
    return out.all([wanted], (), ())
