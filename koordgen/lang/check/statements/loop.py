"""Checks of loops: the values over which they iterate, and the types of their variables."""

from __future__ import annotations

from koordgen.lang.check.base import condition, with_article
from koordgen.lang.check.context import Context, Out, check_block
from koordgen.lang.check.expressions.collection import check_domain, declare, elements
from koordgen.lang.check.expressions.dialect import old_for
from koordgen.lang.check.invariant import check_invariants, split_invariants
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt
from koordgen.lang.ir.types import POISON, MapOf, TupleOf, Type
from koordgen.lang.syntax import stmt as tree


def check_counted(node: tree.CountedFor, c: Context, out: Out) -> None:
    check_for(old_for(node, c), c, out)


def check_for(node: tree.For, c: Context, out: Out) -> None:
    values = check_domain(node.values, c)
    types = _types(node, values.type, elements(values), c)
    c.scopes.append({})
    temps = [declare(name.name, type_, name.span, c) for name, type_ in zip(node.names, types, strict=True)]
    names = tuple([temp.unique for temp in temps if temp is not None])
    head, rest = split_invariants(node.block)
    counted = isinstance(values, (ir.Range, ir.Ids))
    invariants = check_invariants(head, c, out, () if counted else names, names)
    block = _body(rest, c)
    c.scopes.pop()
    out.append(stmt.For(names, types, values, block, node.span, invariants))


def _types(node: tree.For, values: Type, element: Type, c: Context) -> tuple[Type, ...]:
    """Return the types of the loop's variables."""
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
        c.error("K012", f"each element is {with_article(element)}, not {count} values", node.values.span, help)
    return (POISON,) * count


def check_while(node: tree.While, c: Context, out: Out) -> None:
    head, rest = split_invariants(node.block)
    invariants = check_invariants(head, c, out)
    held = condition(node.condition, c, "the condition of 'while'")
    out.append(stmt.While(held, _body(rest, c), node.span, invariants))


def _body(block: tree.Block, c: Context) -> stmt.Block:
    c.loops += 1
    checked = check_block(block, c)
    c.loops -= 1
    return checked
