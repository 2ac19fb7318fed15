"""Loop invariants by induction: conditions that hold before a loop, and that each iteration preserves.

Candidates are the program's loop invariants, and guessed bounds: a variable stays above (or below) its initial value,
and within the bound that the condition of `while` sets. A candidate that is not proved on each path through the block
is dropped, and the other candidates are tried again. The candidates that remain are known inside the loop. They are
known after the loop, too, if they also hold at each `break`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple, assert_never

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.decide import unsat
from koordgen.lang.analyze.facts.flow import independent, names_of, variable_of
from koordgen.lang.analyze.facts.linear import Formula, Linear
from koordgen.lang.analyze.facts.terms import Flow, after_assignment, formula, term
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt
from koordgen.lang.ir.tree import statements
from koordgen.lang.ir.types import INT

MOST_PATHS = 16  # limit on the paths through a loop's block; with more paths, no invariant is proved
MOST_COUNTERS = 4  # limit on the variables of one loop for which bounds are guessed

# A candidate for a loop invariant: maps the facts known at a point to the candidate's formula at this point.
Candidate = Callable[[Flow], Formula]
Step = Callable[[Flow], Flow]


class LoopModel(NamedTuple):
    """Loop, described for induction.

    `before` holds the facts before the loop. `start` holds the facts at the loop's head, which depend only on values
    that the loop does not change: variables outside of `changed`, and lengths of variables in `sized`. `enter` adds the
    facts at the beginning of an iteration, `leave` the facts when the loop ends without `break`.

    For a loop over a range or `ID`, `counter` is the loop's variable. `first`, `next` and `last` set this variable to
    its value at the loop's beginning, in the next iteration, and at the loop's end. `stop` is the first value that the
    variable does not take, if it counts up and the value is known.
    """

    before: Flow
    start: Flow
    changed: frozenset[str]
    sized: frozenset[str]
    block: stmt.Block
    enter: Step
    leave: Step
    first: Step
    next: Step
    last: Step
    counter: str = ""
    stop: Linear | None = None


class ProvedCandidates(NamedTuple):
    """Candidates that are proved at the head of each iteration, and the subset that also holds after the loop."""

    inside: tuple[Candidate, ...]
    after_loop: tuple[Candidate, ...]


class _Paths:
    """Facts known at each end of an iteration, and at each `break` that leaves the loop."""

    def __init__(self) -> None:
        self.turned: list[Flow] = []
        self.broken: list[Flow] = []


class _TooManyPaths(Exception):
    """Raised if there are more than `MOST_PATHS` paths through a loop's block."""


def proved_candidates(model: LoopModel, candidates: list[Candidate]) -> ProvedCandidates:
    """Return the candidates that always hold at the loop's head.

    The result is sound: each candidate is proved before the loop, and also at the end of each path through the block,
    under the assumption that all returned candidates hold at the loop's head.
    """
    begins = model.first(model.before)
    found = [candidate for candidate in candidates if _proved(candidate, begins)]
    while found:
        paths = _Paths()
        flow = model.enter(assuming(model.start, found))
        try:
            paths.turned += _paths_through(model.block, [flow], paths)
        except _TooManyPaths:
            break
        ends = [model.next(end) for end in paths.turned]
        left = [candidate for candidate in found if all(_proved(candidate, end) for end in ends)]
        if len(left) == len(found):
            return ProvedCandidates(
                tuple(found), tuple([c for c in found if _holds_after_loop(c, model, paths.broken)])
            )
        found = left
    return ProvedCandidates((), ())


def _holds_after_loop(candidate: Candidate, model: LoopModel, broken: list[Flow]) -> bool:
    """Return whether a condition that holds at the loop's head also holds at each `break`."""
    if model.counter in names_of(candidate(model.start)):
        broken = [model.last(end) for end in broken]
    return all(_proved(candidate, end) for end in broken)


def after_loop(model: LoopModel, found: ProvedCandidates) -> Flow:
    """Return the facts known after a loop."""
    return model.leave(assuming(model.last(model.start), found.after_loop))


def assuming(flow: Flow, candidates: list[Candidate] | tuple[Candidate, ...]) -> Flow:
    """Return the facts at a point, with the candidates added."""
    known = flow
    for candidate in candidates:
        known = known.assuming(candidate(flow))
    return known


def _proved(candidate: Candidate, flow: Flow) -> bool:
    condition = candidate(flow)
    if condition is linear.UNKNOWN:
        return False
    return unsat((*flow.relevant(names_of(condition)), linear.negate(condition)))


def _paths_through(block: stmt.Block, flows: list[Flow], paths: _Paths) -> list[Flow]:
    """Return the facts at the end of a block, for each path to its end. Raises _TooManyPaths."""
    for statement in block:
        match statement:
            case stmt.Assign(place, value):
                flows = [after_assignment(flow, place, value) for flow in flows]
            case stmt.Let(name, _, value):
                flows = [after_assignment(flow, stmt.TempPlace(name), value) for flow in flows]
            case stmt.If(condition, then, orelse):
                held = [(flow, formula(condition, flow)) for flow in flows]
                yes = _paths_through(then, [flow.assuming(known) for flow, known in held], paths)
                no = _paths_through(orelse, [flow.assuming(linear.negate(known)) for flow, known in held], paths)
                flows = yes + no
            case stmt.For() | stmt.While():
                flows = [_after_inner_loop(statement, flow) for flow in flows]
            case stmt.Break():
                paths.broken += flows
                return []
            case stmt.Continue():
                paths.turned += flows
                return []
            case stmt.Return() | stmt.Stop():
                return []
            case stmt.Emit():
                pass
            case _:
                assert_never(statement)
        if len(flows) + len(paths.turned) + len(paths.broken) > MOST_PATHS:
            raise _TooManyPaths
    return flows


def _after_inner_loop(loop: stmt.For | stmt.While, flow: Flow) -> Flow:
    """Return the facts after a nested loop. Facts about variables that the nested loop may write are dropped."""
    changed = {name for name, _ in writes(loop.block)}
    sized = changed - {name for name, same_length in writes(loop.block) if not same_length}
    if isinstance(loop, stmt.For):
        changed.update(f"temp {name}" for name in loop.names)
    return flow.forgetting(frozenset(changed), frozenset(sized))


def writes(block: stmt.Block) -> Iterator[tuple[str, bool]]:
    """Yield each write in a block: the variable's name in a Flow, and whether the write keeps its length."""
    for statement in statements(block):
        match statement:
            case stmt.Assign(place, ir.Builtin("updated", (changed, *_))) if variable_of(changed) == variable_of(place):
                yield variable_of(place) or "", True
            case stmt.Assign(place):
                yield variable_of(place) or "", False
            case stmt.Let(name):
                yield f"temp {name}", False
            case _:
                pass


# Candidates for loop invariants


def declared_candidates(invariants: tuple[stmt.LoopInvariant, ...]) -> list[Candidate]:
    """Return the program's loop invariants as candidates, one for each condition that 'and' joins."""
    return [_holds(part) for invariant in invariants for part in conjuncts(invariant.formula)]


def conjuncts(node: ir.Expr) -> list[ir.Expr]:
    """Return the parts of a condition that 'and' joins."""
    if isinstance(node, ir.Logic) and node.op == "and":
        return conjuncts(node.left) + conjuncts(node.right)
    return [node]


def _holds(node: ir.Expr) -> Candidate:
    return lambda flow: formula(node, flow)


def guessed_bounds(model: LoopModel, condition: ir.Expr | None) -> list[Candidate]:
    """Return guessed bounds of the int variables that a loop writes.

    The guesses use the variables' values before the loop, the condition of `while`, and the loop's variable.
    """
    reads = dict.fromkeys(_assigned_ints(model.block))
    found: list[Candidate] = []
    for read in list(reads)[:MOST_COUNTERS]:
        begin = model.before.value(variable_of(read) or "")
        if isinstance(begin, Linear) and independent(begin, model.changed, model.sized):
            found += [_at_least(read, begin), _at_most(read, begin)]
        found += _known(read, model)
        if model.stop is not None:  # a search loop may save the index of an element: at most the current index
            here = linear.variable(model.counter)
            found += [_at_most(read, here), _at_most(read, linear.combine(here, linear.constant(-1)))]
            found.append(_at_most(read, linear.combine(model.stop, linear.constant(-1))))
    for part in conjuncts(condition) if condition is not None else ():
        match part:
            case ir.Compare("<" | "<=" | "!=" as op, left, right) if left in reads:
                found += _within(left, right, int(op == "<="), 1, model)
            case ir.Compare(">" | ">=" | "!=" as op, left, right) if left in reads:
                found += _within(left, right, int(op == ">="), -1, model)
        match part:
            case ir.Compare(">" | ">=" | "!=" as op, left, right) if right in reads:
                found += _within(right, left, int(op == ">="), 1, model)
            case ir.Compare("<" | "<=" | "!=" as op, left, right) if right in reads:
                found += _within(right, left, int(op == "<="), -1, model)
    return found


def _assigned_ints(block: stmt.Block) -> Iterator[ir.Expr]:
    """Yield a read of each int variable that a block assigns."""
    for statement in statements(block):
        match statement:
            case stmt.Assign(stmt.TempPlace(name), value, span) if value.type is INT:
                yield ir.TempRead(name, INT, span)
            case stmt.Assign(stmt.LocalPlace(name), value, span) if value.type is INT:
                yield ir.LocalRead(name, INT, span)
            case stmt.Assign(stmt.SharedPlace(name), value, span) if value.type is INT:
                yield ir.SharedRead(name, INT, span)
            case _:
                pass


def _known(read: ir.Expr, model: LoopModel) -> Iterator[Candidate]:
    """Yield the comparisons with a variable that are known to hold before the loop."""
    name = variable_of(read)
    for fact in model.before.facts:
        for part in fact.parts if isinstance(fact, linear.And) else (fact,):
            if isinstance(part, linear.AtLeastZero) and isinstance(name, str):
                rest = linear.substitute(part.linear, name, linear.constant(0))
                if rest != part.linear and independent(rest, model.changed, model.sized):
                    yield _compared(read, name, part.linear)


def _compared(read: ir.Expr, name: str, known: Linear) -> Candidate:
    return lambda flow: linear.AtLeastZero(linear.substitute(known, name, _term(read, flow)))


def _at_least(read: ir.Expr, bound: Linear) -> Candidate:
    return lambda flow: linear.at_least(_term(read, flow), _bound_at(bound, flow))


def _at_most(read: ir.Expr, bound: Linear) -> Candidate:
    return lambda flow: linear.at_least(_bound_at(bound, flow), _term(read, flow))


def _bound_at(bound: Linear, flow: Flow) -> Linear:
    """Return a bound at a point: each variable in it whose value is known at the point is replaced by the value."""
    for var, _ in bound.terms:
        known = flow.value(var) if isinstance(var, str) else None
        if isinstance(var, str) and isinstance(known, Linear):
            bound = linear.substitute(bound, var, known)
    return bound


def _term(read: ir.Expr, flow: Flow) -> Linear:
    found = term(read, flow)
    assert found is not None, "an int variable is a term"
    return found


def _within(read: ir.Expr, bound: ir.Expr, beyond: int, sign: int, model: LoopModel) -> list[Candidate]:
    """Return the candidate sign * read <= sign * bound + beyond.

    If the variable may begin outside of this bound, the candidate also allows values up to its initial value.
    """

    def within(flow: Flow) -> Formula:
        end = term(bound, flow)
        if end is None:
            return linear.UNKNOWN
        rest = linear.combine(end, _term(read, flow), -1)
        return linear.AtLeastZero(linear.combine(linear.constant(beyond), rest, sign))

    begin = model.before.value(variable_of(read) or "")
    if not isinstance(begin, Linear) or not independent(begin, model.changed, model.sized):
        return [within]
    if _proved(within, model.before):
        return [within]
    least = _at_most(read, begin) if sign > 0 else _at_least(read, begin)

    def either(flow: Flow) -> Formula:
        known = within(flow)
        return known if known is linear.UNKNOWN else linear.Or((known, least(flow)))

    return [either]
