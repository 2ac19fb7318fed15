"""Analysis of statements: computes the facts known before and after each statement, and applies rules to it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from koordgen.lang.analyze.expressions import analyze_expression
from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.flow import Flow, independent
from koordgen.lang.analyze.facts.induction import (
    LoopModel,
    Step,
    after_loop,
    assuming,
    declared_candidates,
    guessed_bounds,
    proved_candidates,
    writes,
)
from koordgen.lang.analyze.facts.path import Condition, Path, is_open, joined
from koordgen.lang.analyze.facts.runs import Loop
from koordgen.lang.analyze.facts.terms import formula, range_facts, term
from koordgen.lang.analyze.rules.analysis import Analysis
from koordgen.lang.analyze.rules.loop_end import check_end
from koordgen.lang.analyze.rules.lost_update import check_write
from koordgen.lang.analyze.rules.own_slot import check_own
from koordgen.lang.analyze.rules.unreachable import check_branch, check_loop, check_statement
from koordgen.lang.ir import draft, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import BOOL, POISON

MOST_LOOPS = 4  # in loops that are nested more deeply, no loop invariants are searched
_DOUBTS = frozenset(("K030", "K031", "K032", "K033", "K034"))


def analyze_block(block: Sequence[draft.Draft], a: Analysis) -> stmt.Block:
    """Analyse a block and return its statements without draft nodes (`ir.draft`).

    Sets `a.path` to None if the end of the block is unreachable.
    """
    analyzed: list[stmt.Stmt] = []
    reported = a.path is None
    for statement in block:
        if a.path is None and not reported:
            check_statement(statement.span, a)
            reported = True
        found = _statement(statement, a)
        if found is not None and not _is_poisoned(found):
            analyzed.append(found)
    return tuple(analyzed)


def _is_poisoned(statement: stmt.Stmt) -> bool:
    """Return whether a statement has no known effect because it contains an error that is already reported."""
    match statement:
        case stmt.Assign(value=value) | stmt.Let(value=value) | stmt.Return(value) | stmt.For(values=value):
            return value.type is POISON
        case stmt.If(condition) | stmt.While(condition):
            return condition.type is POISON
        case _:
            return False


def _statement(statement: draft.Draft, a: Analysis) -> stmt.Stmt | None:
    match statement:
        case stmt.Assign():
            return _assign(statement, a)
        case stmt.Let(name, type_, value, span):
            value = analyze_expression(value, a)
            _assign_fact(stmt.TempPlace(name), value, a)
            return stmt.Let(name, type_, value, span)
        case stmt.If():
            return _if(statement, a)
        case stmt.For():
            return _for(statement, a)
        case stmt.While():
            return _while(statement, a)
        case stmt.Emit(module, port, items, span):
            return stmt.Emit(module, port, tuple([analyze_expression(item, a) for item in items]), span)
        case stmt.Return(value, span):
            value = analyze_expression(value, a)
            a.path = None
            return stmt.Return(value, span)
        case stmt.Break() | stmt.Continue() | stmt.Stop():
            a.path = None
            return statement
        case draft.WrongStmt(parts):
            for part in parts:
                analyze_expression(part, a)
        case draft.UnparsedStmt():
            a.poisoned = True  # the effect is unknown, so later indices and divisors are not checked
        case draft.Atomic():
            pass
    return None


def _assign_fact(place: stmt.Place, value: ir.Expr, a: Analysis) -> None:
    """Update the facts for `place = value`: drop facts about the old value, and add the new value if known."""
    if a.path is not None:
        a.path = a.path.assigning(place, value)


def _assign(node: stmt.Assign, a: Analysis) -> stmt.Stmt:
    place: stmt.Place | draft.SlotPlace = node.place
    if isinstance(place, draft.SlotPlace):
        check_own(draft.SlotPlace(place.name, analyze_expression(place.index, a), place.span), a)
        place = stmt.OwnSlot(place.name)
    value = analyze_expression(node.value, a)
    if isinstance(place, (stmt.LocalPlace, stmt.SharedPlace)):
        a.mentioned.add(place.name)
    if isinstance(place, stmt.SharedPlace):
        check_write(place.name, node.span, a)
    _assign_fact(place, value, a)
    return node if place is node.place and value is node.value else stmt.Assign(place, value, node.span)


def _if(node: stmt.If, a: Analysis) -> stmt.If:
    """Analyse `if`.

    The condition is known to hold in `then`, and its negation in `orelse`. After the statement, only the facts remain
    that are known at the ends of both branches.
    """
    mentioned = a.mentioned.copy()
    condition = analyze_expression(node.condition, a)
    before = otherwise = a.path
    poisoned = a.poisoned
    if before is not None and condition.type is BOOL:
        passed = Condition(condition, before)
        if not poisoned and not is_open(condition, mentioned):
            check_branch(condition, passed.formula, node.span, before.flow, a)
        a.path, otherwise = before.passing(passed), before.failing(passed)
    a.poisoned = poisoned or condition.type is POISON
    then = analyze_block(node.then, a)
    end, a.path = a.path, otherwise
    orelse = analyze_block(node.orelse, a)
    a.poisoned = poisoned
    a.path = joined([end, a.path])
    return stmt.If(condition, then, orelse, node.span)


# Loops: facts inside and after a loop


def _for(node: stmt.For, a: Analysis) -> stmt.For:
    values = analyze_expression(node.values, a)
    invariants = _invariants(node.invariants, a)
    names = node.names
    single = len(node.types) == 1 and len(names) == 1
    counted = isinstance(values, (ir.Range, ir.Ids))
    before = a.flow
    changed, sized = _changed(node.block)
    after = before.forgetting(changed, sized) if before is not None else None
    a.flow = after
    around, a.loop = a.loop, None
    facts: list[linear.Formula] = []
    if before is not None and after is not None and single:
        facts += range_facts(names[0], values, before, after, changed, sized)
        if counted:
            name = _written_name(names[0], a.text(node.span))
            a.loop = Loop(name, f"temp {names[0]}", values, before, changed, sized, node.block)

    def enter(flow: Flow) -> Flow:
        for fact in facts:
            flow = flow.assuming(fact)
        return flow

    def model(block: stmt.Block) -> LoopModel:
        assert before is not None and after is not None
        if not (counted and names):
            return LoopModel(
                before, after, changed, sized, block, enter, _unchanged, _unchanged, _unchanged, _unchanged
            )
        counting = _counting(names[0], values, before, changed, sized, block)
        return LoopModel(before, after, changed, sized, block, enter, _unchanged, *counting)

    block = _iteration(node.block, after, enter, model, invariants, None, a)
    a.loop = around
    a.path = None if after is None else _point_after_loop(model(block), invariants, None)
    return stmt.For(names, node.types, values, block, node.span, invariants)


def _written_name(temp: str, head: str) -> str:
    """Return the name of a loop's variable in the program's text. Its name in the IR, `temp`, may end with a number."""
    name = re.sub(r"_\d+$", "", temp)
    return temp if re.search(rf"\b{temp}\b", head) else name


def _while(node: stmt.While, a: Analysis) -> stmt.While:
    invariants = _invariants(node.invariants, a)
    before = a.flow
    changed, sized = _changed(node.block)
    start = before.forgetting(changed, sized) if before is not None else None
    a.flow = start
    held = analyze_expression(node.condition, a)
    known: linear.Formula = linear.UNKNOWN
    poisoned = a.poisoned
    if before is not None and start is not None and held.type is BOOL:
        known = formula(held, start)
        check_loop(held, formula(held, before), node.span, before, a)
    a.poisoned = poisoned or held.type is POISON
    leaves = _breaks(node.block)

    def enter(flow: Flow) -> Flow:
        return flow.assuming(known)

    def leave(flow: Flow) -> Flow:
        return flow if leaves else flow.assuming(linear.negate(known))

    def model(block: stmt.Block) -> LoopModel:
        assert before is not None and start is not None
        return LoopModel(before, start, changed, sized, block, enter, leave, _unchanged, _unchanged, _unchanged)

    block = _iteration(node.block, start, enter, model, invariants, held, a)
    a.poisoned = poisoned
    endless = start is None or (known == linear.TRUE and not leaves)
    a.path = None if endless else _point_after_loop(model(block), invariants, held)
    check_end(node, a)
    return stmt.While(held, block, node.span, invariants)


def _invariants(invariants: tuple[stmt.LoopInvariant, ...], a: Analysis) -> tuple[stmt.LoopInvariant, ...]:
    """Analyse the invariants of a loop, without checks of their indices and divisors.

    The checks are not needed: when the program runs, monitors report an invariant that has no value. An
    invariant's reads of shared variables do not count for the rule on lost updates, because no write depends on them.
    """
    if not invariants:
        return ()
    poisoned, shared, path = a.poisoned, a.read_shared.copy(), a.path
    a.poisoned = True
    analyzed = tuple([stmt.LoopInvariant(analyze_expression(i.formula, a), i.span) for i in invariants])
    a.poisoned, a.read_shared, a.path = poisoned, shared, path
    return analyzed


def _changed(block: stmt.Block) -> tuple[frozenset[str], frozenset[str]]:
    """Return two sets: the variables that a loop's block may change, and those of them that keep their lengths.

    The sets contain the names that a Flow uses, such as "local count".
    """
    found = list(writes(block))
    changed = frozenset([name for name, _ in found])
    return changed, changed - {name for name, same_length in found if not same_length}


def _unchanged(flow: Flow) -> Flow:
    return flow


def _counting(
    unique: str, values: ir.Expr, before: Flow, changed: frozenset[str], sized: frozenset[str], block: stmt.Block
) -> tuple[Step, Step, Step, str, linear.Linear | None]:
    """Return five fields of `LoopModel` for a loop over a range or ID: `first`, `next`, `last`, `counter`, `stop`.

    The functions `first`, `next` and `last` set the loop's variable to its first, next and last value; an unknown
    value gives no facts. `stop` is the first value that the variable does not take, or None. It is None if the value
    is unknown or may change in the loop, and for a variable that counts down.
    """
    name = f"temp {unique}"
    first: linear.Linear | None = linear.constant(0)
    stop: linear.Linear | None = linear.variable(linear.N_SYS)
    last, step = stop, 1
    if isinstance(values, ir.Range):
        first, stop, step = term(values.start, before), term(values.stop, before), values.step
        last = None
        if first is not None and stop is not None and step == 1:
            last = linear.variable(linear.ConditionalTerm(linear.at_least(stop, first), stop, first))
    kept = last is not None and independent(last, changed, sized)
    stays = step > 0 and stop is not None and independent(stop, changed, sized)
    moved = any(isinstance(n, stmt.Assign) and n.place == stmt.TempPlace(unique) for n in walk(block))
    following = None if moved else linear.combine(linear.variable(name), linear.constant(step))
    return (
        lambda flow: flow.assigned(name, first),
        lambda flow: _values_as_conditions(flow, name).assigned(name, following),
        lambda flow: flow.assigned(name, last if kept else None),
        name,
        stop if stays else None,
    )


def _values_as_conditions(flow: Flow, name: str) -> Flow:
    """Convert each known value `other = f(name)` to a condition, which remains usable when `name` changes.

    A change of the variable `name` by a step drops known values that depend on it, but shifts conditions on it.
    """
    for other, (value, about) in flow.values.items():
        if name in about and isinstance(value, linear.Linear) and not other.startswith("len "):
            flow = flow.assuming(linear.equal(linear.variable(other), value))
    return flow


def _iteration(
    written: stmt.Block, head: Flow | None, enter: Step, model: Callable[[stmt.Block], LoopModel],
    invariants: tuple[stmt.LoopInvariant, ...], condition: ir.Expr | None, a: Analysis,
) -> stmt.Block:  # fmt: skip
    """Analyse the block of a loop.

    If an index or a divisor in the block may be wrong, search for conditions that hold at the start of each iteration,
    and analyse the block again with these conditions as facts.
    """
    if head is not None:
        a.flow = enter(head)
    saved_state = a.saved_state()
    block = _body(written, a)
    doubtful = any(found.code in _DOUBTS for found in a.found[saved_state.found :])
    if head is None or not doubtful or a.loops >= MOST_LOOPS:
        return block
    whole = model(block)
    found = proved_candidates(whole, [*declared_candidates(invariants), *guessed_bounds(whole, condition)])
    if not found.inside:
        return block
    a.restore(saved_state)
    a.flow = enter(assuming(head, found.inside))
    return _body(written, a)


def _point_after_loop(model: LoopModel, invariants: tuple[stmt.LoopInvariant, ...], condition: ir.Expr | None) -> Path:
    """Return the point after a loop.

    The facts at this point are computed on demand, because they need a search for loop invariants.
    """

    def known() -> Flow:
        found = proved_candidates(model, [*declared_candidates(invariants), *guessed_bounds(model, condition)])
        return after_loop(model, found)

    return Path((), known)


def _body(block: stmt.Block, a: Analysis) -> stmt.Block:
    a.loops += 1
    analyzed = analyze_block(block, a)
    a.loops -= 1
    return analyzed


def _breaks(block: stmt.Block) -> bool:
    """Return whether the block of a loop has a `break` that leaves this loop."""
    for statement in block:
        match statement:
            case stmt.Break():
                return True
            case stmt.If(_, then, orelse) if _breaks(then) or _breaks(orelse):
                return True
            case _:
                pass
    return False
