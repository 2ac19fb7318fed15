"""Goals of proofs: a property of a state, split into conjuncts about arbitrary robots."""

from __future__ import annotations

from collections.abc import Iterator

from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.verify.prove.encode.encoder import Scope
from koordgen.verify.prove.encode.quantifier import domain as domain_of
from koordgen.verify.prove.encode.scope import FleetScope
from koordgen.verify.prove.encode.state import SymbolicState, UpdatedState
from koordgen.verify.prove.encode.values import Val
from koordgen.verify.prove.obligations.part_encoder import PartEncoder
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.obligation import LabelledFormula
from koordgen.verify.prove.smt.term import Term

_NAMES = ("i", "j", "k", "l", "m")


def goal(
    part_encoder: PartEncoder, property_: decl.Property, state: SymbolicState, guard: Term = t.TRUE
) -> tuple[LabelledFormula, ...]:
    """Return a property of a state as conjuncts to prove, each under the condition `guard`."""
    said = part_encoder.problem.mentions[property_.name]
    cells = not isinstance(state, UpdatedState) or any(k[0] == "cell" and k in said for k in state.writes)
    bystanders = cells or not _names_robots(property_.formula, frozenset())
    return _parts(
        _Goals(part_encoder, f"invariant {property_.name}", FleetScope(state), bystanders), property_.formula, guard
    )


def goal_at(
    part_encoder: PartEncoder, name: str, formula: ir.Expr, scope: Scope, guard: Term
) -> tuple[LabelledFormula, ...]:
    """Return a formula at a program point as conjuncts to prove, each under the condition `guard`."""
    return _parts(_Goals(part_encoder, name, scope, True), formula, guard)


def _parts(goals: _Goals, formula: ir.Expr, guard: Term) -> tuple[LabelledFormula, ...]:
    encoder = goals.part_encoder.encoder
    kept, encoder.strict = encoder.strict, True
    try:
        goals.add(formula, guard, ())
    finally:
        encoder.strict = kept
    return tuple(goals.found)


class _Goals:
    """Builder that splits a goal into conjuncts.

    After an event, each quantified robot is the acting robot or another robot. Both cases become conjuncts. A conjunct
    about other robots only, without an allwrite variable, is unchanged since before the event, so it needs no proof."""

    def __init__(self, part_encoder: PartEncoder, name: str, scope: Scope, bystanders: bool) -> None:
        self.part_encoder, self.context, self.name = part_encoder, part_encoder.context, name
        self.scope, self.bystanders = scope, bystanders
        self.found: list[LabelledFormula] = []

    def add(self, formula: ir.Expr, guard: Term, robots: tuple[Term, ...]) -> None:
        match formula:
            case ir.Logic("and", left, right):
                self.add(left, guard, robots)
                self.add(right, guard, robots)
            case ir.Quantified("forall", variable, ir.Ids(), body):
                for robot, inside in self.robots(robots, isinstance(body, ir.Quantified)):
                    self.scope.temps[variable] = robot
                    with self.context.grant(robot):
                        self.add(body, t.and_(guard, inside), (*robots, robot))
                    del self.scope.temps[variable]
            case ir.Quantified("forall", variable, domain, body):
                for value, inside in self.elements(domain, body, variable):
                    self.scope.temps[variable] = value
                    self.add(body, t.and_(guard, inside), robots)
                    del self.scope.temps[variable]
            case _ if robots and self.of_others(robots):
                pass
            case _:
                term = t.implies(guard, self.part_encoder.encoder.defined(formula, self.scope))
                label = f"{self.name}{'' if self.part_encoder.brief else f': {formula_text(formula)}'}"
                self.found.append(LabelledFormula(label, term, self.context.file, formula.span.line))

    def of_others(self, robots: tuple[Term, ...]) -> bool:
        """Return whether none of the robots is the acting robot.

        If robots are named by numbers, the answer is False, because each number may be the acting robot's."""
        by_name = self.context.robots is None and self.context.own is not None
        return by_name and not self.bystanders and self.context.own not in robots

    def robots(self, chosen: tuple[Term, ...], more: bool) -> Iterator[tuple[Term, Term]]:
        """Yield the terms for a quantified robot, each with the condition that the term is the pid of a robot.

        If the number of robots is known, the terms are all pids. Otherwise the terms are the acting robot and one
        arbitrary other robot. `more`: another quantifier follows directly."""
        context = self.context
        if context.robots is not None:
            yield from [(t.integer(i), t.TRUE) for i in range(context.robots)]
            return
        at = sum(robot is not context.own for robot in chosen)
        name = f"{_NAMES[at % 5]}@{'goal' if at < 5 else at}"
        if context.own is None:
            yield context.some_robot(name), t.TRUE
            return
        yield context.own, t.TRUE
        other = t.constant(name, t.INT)
        if self.bystanders or more or at == 0 or len(chosen) > at:
            other = context.another(name)
        yield other, context.within(other)

    def elements(self, domain: ir.Expr, body: ir.Expr, name: str) -> Iterator[tuple[Val, Term]]:
        over = domain_of(self.part_encoder.encoder, domain, self.scope, body, name)
        if over.listed is not None:
            yield from [(value, t.TRUE) for value in over.listed]
            return
        place = t.constant(f"place{len(self.scope.temps)}@goal", t.INT)
        if over.robots:
            self.context.robot(place)
        self.context.element(place, False, over.places)
        yield over.element(place), over.inside(place)


def _names_robots(formula: ir.Expr, variables: frozenset[str]) -> bool:
    """Return whether a formula reads only variables of the robots in its outer quantifiers."""
    match formula:
        case ir.Logic("and", left, right):
            return _names_robots(left, variables) and _names_robots(right, variables)
        case ir.Quantified("forall", name, ir.Ids(), body):
            return _names_robots(body, variables | {name})
    for node in walk(formula):
        match node:
            case ir.LocalOf(_, robot) | ir.PortOf(_, _, robot) | ir.SlotRead(_, robot):
                if not (isinstance(robot, ir.TempRead) and robot.name in variables):
                    return False
            case ir.Quantified() | ir.SlotsRead():
                return False
            case _:
                pass
    return True


def formula_text(formula: ir.Expr) -> str:
    """Return a formula as text in Koord, similar to the program's text."""
    from koordgen.lang.ir.printer import expression

    return expression(formula)
