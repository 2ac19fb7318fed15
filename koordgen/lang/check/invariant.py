"""Checks of loop invariants: their position, the names that they read, and `old(x)`, the value before the loop."""

from __future__ import annotations

from collections.abc import Iterator

from koordgen.lang.check.base import check_expr, condition
from koordgen.lang.check.context import STATEMENTS, Context, LoopEntry, Out
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import BOOL, POISON, PerRobot
from koordgen.lang.syntax import expr as ast
from koordgen.lang.syntax import stmt as tree

Invariants = tuple[stmt.LoopInvariant, ...]

_HEAD = "write the invariant first in the block of 'for' or 'while'"
_LEAST = "an invariant is also evaluated after the last iteration, when there is no element: loop over range(len(...))"


def split_invariants(block: tree.Block) -> tuple[tuple[tree.Invariant, ...], tree.Block]:
    """Split a loop's block into the invariants at its head and the other statements.

    The head of a block is its first lines, as long as they are invariants. A line that could not be parsed does not end
    the head, because the line may be an invariant.
    """
    head = (tree.Invariant, tree.BrokenStmt)
    count = next((i for i, statement in enumerate(block) if not isinstance(statement, head)), len(block))
    invariants = tuple([s for s in block[:count] if isinstance(s, tree.Invariant)])
    return invariants, tuple([s for s in block[:count] if isinstance(s, tree.BrokenStmt)]) + block[count:]


def check_invariants(
    written: tuple[tree.Invariant, ...], c: Context, out: Out, hidden: tuple[str, ...] = (), own: tuple[str, ...] = ()
) -> Invariants:
    """Return the typed invariants of a loop.

    For each `old(x)`, appends to `out` a `Let` that saves the value of `x` before the loop. `hidden` lists the loop's
    temps that no invariant may read. `own` lists the temps that the loop declares; they have no value before the loop.
    """
    if not written:
        return ()
    around = c.entry
    temps_before = frozenset(temp.unique for scope in c.scopes for temp in scope.values()) - {*hidden, *own}
    c.entry = LoopEntry(temps_before)
    found = [stmt.LoopInvariant(condition(node.condition, c, "a loop invariant"), node.span) for node in written]
    out.extend(c.entry.values.values())
    c.entry = around
    right = [invariant for invariant in found if invariant.formula.type is BOOL]
    wrong = [node for invariant in right for node in _elements(invariant.formula, hidden)]
    for node in wrong:
        text = c.text(node.span)
        c.error("K058", f"a loop invariant cannot read {text}, the loop's element", node.span, _LEAST)
    return tuple([invariant for invariant in right if not any(_elements(invariant.formula, hidden))])


def _elements(formula: ir.Expr, hidden: tuple[str, ...]) -> Iterator[ir.TempRead]:
    for node in walk(formula):
        if isinstance(node, ir.TempRead) and node.name in hidden:
            yield node


def check_old(node: ast.Call, c: Context) -> ir.Expr:
    """Check `old(x)` in a loop invariant.

    Returns a read of the temp that saves the value of `x` before the loop.
    """
    if c.entry is None:
        help = "outside of loop invariants, save the value in a variable: int before = x"
        return c.error("K058", "'old' can only be used in loop invariants", node.span, help)
    if len(node.args) != 1 or isinstance(node.args[0], ast.Keyword):
        return c.error("K014", f"'old' takes 1 argument, not {len(node.args)}", node.span, "old(variable)")
    read = check_expr(node.args[0], c)
    if read.type is POISON:
        return c.poison(node.span)
    text = c.text(read.span)
    if isinstance(read, ir.TempRead) and read.name not in c.entry.temps_before:
        help = "'old' takes a variable that is declared before the loop"
        return c.error("K058", f"{text} has no value where the loop begins", node.span, help)
    match read:
        case ir.LocalRead(name) | ir.TempRead(name) | ir.SharedRead(name) | ir.SlotRead(name, ir.Pid()):
            pass
        case ir.PortRead(_, name):
            pass
        case _:
            name = ""
    if not name or isinstance(read.type, PerRobot):
        help = "to read a part of a variable, write its index or field after the brackets: old(xs)[i], old(p).x"
        return c.error("K058", f"'old' takes a variable of this robot or a shared one, not {text}", node.span, help)
    let = c.entry.values.get(read)
    if let is None:
        let = c.entry.values[read] = stmt.Let(c.mint(f"old_{name}"), read.type, read, node.span)
    return ir.TempRead(let.name, read.type, node.span)


def report_port_call(name: str, node: ast.Call, c: Context) -> ir.Expr:
    """Report a call of a port in a loop invariant."""
    help = f"call {name} before the loop and save the answer: ... = {name}(...)"
    return c.error(
        "K058", f"a loop invariant cannot call {name}: the answer of a port is an input of the event", node.span, help
    )


def _misplaced(node: tree.Invariant, c: Context, out: Out) -> None:
    c.error("K058", "a loop invariant must stand at the head of a loop's block", node.span, _HEAD)


STATEMENTS[tree.Invariant] = _misplaced
