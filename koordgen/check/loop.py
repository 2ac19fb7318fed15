"""Loops: what they run over, what is known in them and behind them, and whether their end can be seen."""

from __future__ import annotations

from koordgen.check import bounds, linear
from koordgen.check.base import a, condition
from koordgen.check.block import Out, check_block
from koordgen.check.collection import check_domain, declare, elements
from koordgen.check.context import Context
from koordgen.check.dialect import old_for
from koordgen.check.facts import formula, range_facts
from koordgen.check.invariant import check_invariants, split
from koordgen.check.name import module_named
from koordgen.check.progress import ends
from koordgen.check.runs import Loop
from koordgen.check.update import updates
from koordgen.check.walk import statements
from koordgen.ir import expr as ir
from koordgen.ir import stmt
from koordgen.ir.decl import Local, Shared
from koordgen.ir.types import BOOL, POISON, MapOf, Sequence, TupleOf, Type
from koordgen.syntax import expr as ast
from koordgen.syntax import stmt as tree


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
    if before is not None and after is not None and len(temps) == 1 and temps[0] is not None:
        c.flow = after
        for fact in range_facts(temps[0].unique, values, before, after, changed, sized):
            c.flow = c.flow.knowing(fact)
        if counted:
            c.loop = Loop(node.names[0].name, f"temp {temps[0].unique}", values, before, changed, sized, node.block)
    block = _body(rest, c)
    c.loop = around
    c.scopes.pop()
    c.flow = after
    if values.type is POISON or POISON in types or None in temps:
        return
    out.append(stmt.For(names, types, values, block, node.span, invariants))


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
        c.flow = start.knowing(known)
        assert before is not None
        first = formula(held, before)
        if not poisoned and bounds.impossible(first, before):
            c.warn("K043", f"this loop can never run: {c.text(node.condition.span)} does not hold here", node.span)
    c.poisoned = poisoned or held.type is POISON
    block = _body(rest, c)
    c.poisoned = poisoned
    leaves = _breaks(node.block)
    if start is None or (known == linear.TRUE and not leaves):
        c.flow = None
    else:
        c.flow = start if leaves else start.knowing(linear.negate(known))
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
