"""Loops: what they run over, what is known in them and behind them, and whether their end can be seen."""

from __future__ import annotations

from collections.abc import Callable

from koordgen.lang.analyze import linear
from koordgen.lang.analyze.facts import Flow, formula, range_facts, term
from koordgen.lang.analyze.flow import independent
from koordgen.lang.analyze.induction import Step, Turns, behind, counters, kept, knowing, written_down
from koordgen.lang.analyze.path import Path
from koordgen.lang.analyze.runs import Loop
from koordgen.lang.analyze.walk import statements
from koordgen.lang.check import bounds
from koordgen.lang.check.base import a, condition
from koordgen.lang.check.context import Context, Out, check_block
from koordgen.lang.check.expressions.collection import check_domain, declare, elements
from koordgen.lang.check.expressions.dialect import old_for
from koordgen.lang.check.expressions.name import module_named
from koordgen.lang.check.invariant import check_invariants, split
from koordgen.lang.check.statements.progress import ends
from koordgen.lang.check.statements.target import updates
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt
from koordgen.lang.ir.decl import Local, Shared
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import BOOL, POISON, MapOf, Sequence, TupleOf, Type
from koordgen.lang.syntax import expr as ast
from koordgen.lang.syntax import stmt as tree

MOST_LOOPS = 4  # within one another; in deeper ones nothing is looked for
_DOUBTS = frozenset(("K030", "K031", "K032", "K033", "K034"))


def check_counted(node: tree.CountedFor, c: Context, out: Out) -> None:
    check_for(old_for(node, c), c, out)


def check_for(node: tree.For, c: Context, out: Out) -> None:
    values = check_domain(node.values, c)
    types = _types(node, values.type, elements(values), c)
    c.scopes.append({})
    temps = [declare(name.name, type_, name.span, c) for name, type_ in zip(node.names, types, strict=True)]
    names = tuple([temp.unique for temp in temps if temp is not None])
    head, rest = split(node.block)
    counted = isinstance(values, (ir.Range, ir.Ids))
    invariants = check_invariants(head, c, out, () if counted else names, names)
    before = c.flow
    changed = written(node.block, c)
    sized = changed - written(node.block, c, True)
    after = before.forgetting(changed, sized) if before is not None else None
    c.flow = after
    around, c.loop = c.loop, None
    facts: list[linear.Formula] = []
    if before is not None and after is not None and len(temps) == 1 and temps[0] is not None:
        facts += range_facts(temps[0].unique, values, before, after, changed, sized)
        if counted:
            c.loop = Loop(node.names[0].name, f"temp {temps[0].unique}", values, before, changed, sized, node.block)

    def enter(flow: Flow) -> Flow:
        for fact in facts:
            flow = flow.knowing(fact)
        return flow

    def turns(block: stmt.Block) -> Turns:
        assert before is not None and after is not None
        if not (counted and names):
            return Turns(before, after, changed, sized, block, enter, _same, _same, _same, _same)
        counting = _counting(names[0], values, before, changed, sized, block)
        return Turns(before, after, changed, sized, block, enter, _same, *counting)

    block = _checked(rest, after, enter, turns, invariants, None, c)
    c.loop = around
    c.scopes.pop()
    c.path = None if after is None else _behind(turns(block), invariants, None)
    if values.type is POISON or POISON in types or None in temps:
        return
    out.append(stmt.For(names, types, values, block, node.span, invariants))


def _same(flow: Flow) -> Flow:
    return flow


def _counting(
    unique: str, values: ir.Expr, before: Flow, changed: frozenset[str], sized: frozenset[str], block: stmt.Block
) -> tuple[Step, Step, Step, str, linear.Linear | None]:
    """Return the steps that put the first, the next and the last value into the variable of a loop that counts; the
    variable; and the first value that it does not take, where it counts up. A value of which nothing is known may be
    any."""
    name = f"temp {unique}"
    first: linear.Linear | None = linear.constant(0)
    stop: linear.Linear | None = linear.variable(linear.N_SYS)
    last, step = stop, 1
    if isinstance(values, ir.Range):
        first, stop, step = term(values.start, before), term(values.stop, before), values.step
        last = None
        if first is not None and stop is not None and step == 1:
            last = linear.variable(linear.Choice(linear.at_least(stop, first), stop, first))
    kept = last is not None and independent(last, changed, sized)
    stays = step > 0 and stop is not None and independent(stop, changed, sized)
    moved = any(isinstance(n, stmt.Assign) and n.place == stmt.TempPlace(unique) for n in walk(block))
    following = None if moved else linear.combine(linear.variable(name), linear.constant(step))
    return (
        lambda flow: flow.assigned(name, first),
        lambda flow: _stated(flow, name).assigned(name, following),
        lambda flow: flow.assigned(name, last if kept else None),
        name,
        stop if stays else None,
    )


def _stated(flow: Flow, name: str) -> Flow:
    """Return the facts with each value that depends on a variable as a condition: a step of the variable moves it."""
    for other, (value, about) in flow.values.items():
        if name in about and isinstance(value, linear.Linear) and not other.startswith("len "):
            flow = flow.knowing(linear.equal(linear.variable(other), value))
    return flow


def _checked(
    rest: tree.Block, head: Flow | None, enter: Step, turns: Callable[[stmt.Block], Turns],
    invariants: tuple[stmt.LoopInvariant, ...], condition: ir.Expr | None, c: Context,
) -> stmt.Block:  # fmt: skip
    """Check the block of a loop. If an index or a divisor in it is doubtful, look for conditions that each turn keeps,
    and check the block again with these."""
    if head is not None:
        c.flow = enter(head)
    mark = c.mark()
    block = _body(rest, c)
    doubtful = any(found.code in _DOUBTS for found in c.found[mark.found :])
    if head is None or not doubtful or c.loops >= MOST_LOOPS:
        return block
    whole = turns(block)
    found = kept(whole, [*written_down(invariants), *counters(whole, condition)])
    if not found.inside:
        return block
    c.back(mark)
    c.flow = enter(knowing(head, found.inside))
    return _body(rest, c)


def _behind(turns: Turns, invariants: tuple[stmt.LoopInvariant, ...], condition: ir.Expr | None) -> Path:
    """The point behind a loop. What its turns keep is looked for when somebody asks what is known there."""

    def known() -> Flow:
        found = kept(turns, [*written_down(invariants), *counters(turns, condition)])
        return behind(turns, found)

    return Path((), known)


def _types(node: tree.For, values: Type, element: Type, c: Context) -> tuple[Type, ...]:
    """The types of the loop's variables."""
    count = len(node.names)
    if count == 1 or element is POISON:
        return (element,) * count
    if isinstance(element, TupleOf):
        if len(element.items) == count:
            return element.items
        c.error("K014", f"each element has {len(element.items)} parts, not {count}", node.values.span)
    else:
        over_map = count == 2 and isinstance(values, MapOf)
        help = f"write {c.text(node.values.span)}.items()" if over_map else ""
        c.error("K012", f"each element is {a(element)}, not {count} values", node.values.span, help)
    return (POISON,) * count


def check_while(node: tree.While, c: Context, out: Out) -> None:
    head, rest = split(node.block)
    invariants = check_invariants(head, c, out)
    before = c.flow
    changed = written(node.block, c)
    sized = changed - written(node.block, c, True)
    start = before.forgetting(changed, sized) if before is not None else None
    c.flow = start
    held = condition(node.condition, c, "the condition of 'while'")
    known: linear.Formula = linear.UNKNOWN
    poisoned = c.poisoned
    if start is not None and held.type is BOOL:
        known = formula(held, start)
        assert before is not None
        first = formula(held, before)
        if not poisoned and bounds.impossible(first, before):
            c.warn("K043", f"this loop can never run: {c.text(node.condition.span)} does not hold here", node.span)
    c.poisoned = poisoned or held.type is POISON
    leaves = _breaks(node.block)

    def enter(flow: Flow) -> Flow:
        return flow.knowing(known)

    def leave(flow: Flow) -> Flow:
        return flow if leaves else flow.knowing(linear.negate(known))

    def turns(block: stmt.Block) -> Turns:
        assert before is not None and start is not None
        return Turns(before, start, changed, sized, block, enter, leave, _same, _same, _same)

    block = _checked(rest, start, enter, turns, invariants, held, c)
    c.poisoned = poisoned
    endless = start is None or (known == linear.TRUE and not leaves)
    c.path = None if endless else _behind(turns(block), invariants, held)
    if held.type is POISON:
        return
    if not ends(node, c):
        help = "a round must end: let the condition compare a number that each way through the loop moves on by a step"
        c.warn("K035", "nothing shows that this loop ends", node.span, help)
    out.append(stmt.While(held, block, node.span, invariants))


def _body(block: tree.Block, c: Context) -> stmt.Block:
    c.loops += 1
    checked = check_block(block, c)
    c.loops -= 1
    return checked


def _breaks(block: tree.Block) -> bool:
    """Whether a `break` leaves the loop of which this is the block."""
    for statement in block:
        match statement:
            case tree.Break():
                return True
            case tree.If(branches, orelse):
                if _breaks(orelse) or any(_breaks(branch.block) for branch in branches):
                    return True
            case tree.Atomic(inner):
                if _breaks(inner):
                    return True
            case _:
                pass
    return False


def written(block: tree.Block, c: Context, lengths: bool = False) -> frozenset[str]:
    """The variables that a loop's block may change, by their names in `facts`; only those whose lengths it may change,
    if `lengths`. Those that it declares itself are not known outside."""
    found: set[str] = set()
    for statement in statements(block):
        match statement:
            case tree.Assign(target, _, value):
                if not (lengths and _of_element(target, c)):
                    _add(target, found, c)
                _add_update(value, found, c, lengths)
            case tree.Declare(value=value) | tree.Evaluate(value):
                _add_update(value, found, c, lengths)
            case _:
                pass
    return frozenset(found)


def _add_update(node: ast.Expr | None, found: set[str], c: Context, lengths: bool) -> None:
    if updates(node, c):
        assert isinstance(node.function, ast.Attribute)
        if not (lengths and _of_element(node.function.value, c)):
            _add(node.function.value, found, c)


def _of_element(target: ast.Expr, c: Context) -> bool:
    """Whether only an element of a variable that is a List is written, or a part of one: the list keeps its length."""
    inner: ast.Expr | None = None
    while isinstance(target, (ast.Index, ast.Attribute)):
        inner, target = target, target.value
    if not isinstance(inner, ast.Index) or not isinstance(target, ast.Name):
        return False
    temp = c.temp(target.name)
    entity = c.entities.get(target.name)
    kept = temp if temp is not None else entity if isinstance(entity, Local) or _is_shared_value(entity) else None
    type_ = getattr(kept, "type", None)
    return isinstance(type_, Sequence) and type_.name == "List"


def _is_shared_value(entity: object) -> bool:
    return isinstance(entity, Shared) and entity.kind == "allwrite"


def _add(target: ast.Expr, found: set[str], c: Context) -> None:
    """What is written when a part of something is."""
    while isinstance(target, (ast.Index, ast.Attribute, ast.Slice)):
        if isinstance(target, ast.Attribute):
            module = module_named(target.value, c)
            if module is not None:
                found.add(f"port {module.name}.{target.name}")
                return
        target = target.value
    if not isinstance(target, ast.Name):
        return
    temp = c.temp(target.name)
    match c.entities.get(target.name):
        case _ if temp is not None:
            found.add(f"temp {temp.unique}")
        case Local(name):
            found.add(f"local {name}")
        case Shared(name, kind):
            found.add(f"{'slot' if kind == 'allread' else 'shared'} {name}")
        case _:
            pass
