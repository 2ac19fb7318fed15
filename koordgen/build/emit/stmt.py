"""IR statements -> Python lines, each with the line number of its Koord statement."""

from __future__ import annotations

from typing import assert_never

from koordgen.build.emit import expr
from koordgen.build.emit.layout import STEP, Page, brackets, chain, joined
from koordgen.build.emit.names import Names
from koordgen.build.emit.types import annotation
from koordgen.lang.ir import stmt as ir
from koordgen.lang.ir.expr import (
    Binary,
    Const,
    Expr,
    Ids,
    LocalRead,
    Pid,
    PortRead,
    Range,
    SharedRead,
    SlotRead,
    TempRead,
)
from koordgen.lang.ir.types import BOOL


def add_block(page: Page, block: ir.Block, names: Names, indent: str) -> None:
    """Add the statements of a block, indented; `pass` for an empty one."""
    if not block:
        page.add("pass", indent)
    for statement in block:
        match statement:
            case ir.If():
                _add_if(page, statement, names, indent, "if")
            case ir.For():
                _add_for(page, statement, names, indent)
            case ir.While():
                _add_while(page, statement, names, indent)
            case _:
                page.add(_simple(statement, names), indent, statement.span.line)


def _add_for(page: Page, loop: ir.For, names: Names, indent: str) -> None:
    """Add a `for` loop.

    A loop over a range or `ID` that has invariants gets a name for its range: after the loop, its invariants are
    evaluated with the value that would come next.
    """
    line = loop.span.line
    taken, over = ", ".join([names.temp(name) for name in loop.names]), expr.domain(loop.values, names)
    claims = _claims(loop, names)
    counts = bool(claims) and isinstance(loop.values, (Range, Ids))
    if counts:
        turns = names.turns(loop.names[0])
        page.add(joined(f"{turns} = ", over), indent, line)
        over = turns
    page.add(joined(f"for {taken} in ", brackets(f"{names.use('turns')}(", [over], ")"), ":"), indent, line)
    _add_claims(page, claims, indent)
    if loop.block or not claims:
        add_block(page, loop.block, names, indent + STEP)
    if claims:
        page.add("else:", indent)
    if counts:
        page.add(f"{taken} = {names.use('behind')}({over})", indent + STEP, line)
    _add_claims(page, claims, indent)


def _add_while(page: Page, loop: ir.While, names: Names, indent: str) -> None:
    """Add a `while` loop. Invariants are evaluated before the condition; for `while True`, in the block."""
    claims = _claims(loop, names)
    endless = loop.condition == Const(True, BOOL, loop.span)
    condition = _each_turn(loop.condition, names)
    if not claims or endless:
        page.add(joined("while ", condition, ":"), indent, loop.span.line)
        _add_claims(page, claims, indent)
    else:
        first, *others = [claim for claim, _ in claims]
        heads = chain(first, *[joined("and ", claim) for claim in others], joined("and ", condition))
        page.add(joined("while ", heads, ":"), indent, loop.span.line)
    if loop.block or not (claims and endless):
        add_block(page, loop.block, names, indent + STEP)


def _add_claims(page: Page, claims: list[tuple[str, int]], indent: str) -> None:
    for claim, line in claims:
        page.add(claim, indent + STEP, line)


def _claims(loop: ir.For | ir.While, names: Names) -> list[tuple[str, int]]:
    """Return the calls that evaluate a loop's invariants, each with its line. Each call returns True."""
    return [(_claim(invariant, names), invariant.span.line) for invariant in loop.invariants]


def _claim(invariant: ir.LoopInvariant, names: Names) -> str:
    holds = joined("lambda: ", expr.text(invariant.formula, names))
    return brackets(f"{names.use('claim')}(", [str(invariant.span.line), holds], ")")


def _each_turn(condition: Expr, names: Names) -> str:
    """Return the condition of a `while`, which counts a turn each time that it is true."""
    turn = f"{names.use('turn')}()"
    forever = isinstance(condition, Const) and condition.value is True
    return turn if forever else expr.and_also(condition, f"and {turn}", names)


def _simple(statement: ir.Stmt, names: Names) -> str:
    match statement:
        case ir.Assign(place, value):
            changed = expr.change(value, names) if _changes(place, value) else ""
            return joined(_place(place, names), changed or joined(" = ", expr.text(value, names)))
        case ir.Let(name, type_, value):
            return joined(f"{names.temp(name)}: ", annotation(type_, names), " = ", expr.text(value, names))
        case ir.Break():
            return "break"
        case ir.Continue():
            return "continue"
        case ir.Return(value):
            return joined("return ", expr.text(value, names))
        case ir.Emit(module, port, items):
            parts = [expr.literal(f"{module}.{port}"), *[expr.text(item, names) for item in items]]
            return brackets("s.emit(", parts, ")")
        case ir.Stop():
            return f"raise {names.use('Stopped')}"
        case ir.If() | ir.For() | ir.While():
            raise AssertionError("these have blocks")
        case _:
            assert_never(statement)


def _changes(place: ir.Place, value: Expr) -> bool:
    """Return whether the assignment has the form `x = x op y`, so that it can be written as `x op= y`."""
    if not isinstance(value, Binary):
        return False
    match place, value.left:
        case (ir.LocalPlace(name), LocalRead(read)) | (ir.SharedPlace(name), SharedRead(read)):
            return name == read
        case (ir.TempPlace(name), TempRead(read)) | (ir.OwnSlot(name), SlotRead(read, Pid())):
            return name == read
        case ir.PortPlace(module, port), PortRead(owner, read, False):
            return (module, port) == (owner, read)
        case _:
            return False


def _add_if(page: Page, statement: ir.If, names: Names, indent: str, keyword: str) -> None:
    page.add(joined(f"{keyword} ", expr.text(statement.condition, names), ":"), indent, statement.span.line)
    add_block(page, statement.then, names, indent + STEP)
    match statement.orelse:
        case ():
            return
        case (ir.If() as chained,):
            _add_if(page, chained, names, indent, "elif")
        case orelse:
            page.add("else:", indent)
            add_block(page, orelse, names, indent + STEP)


def _place(place: ir.Place, names: Names) -> str:
    match place:
        case ir.LocalPlace(name):
            return f"s.{names.locals[name]}.value"
        case ir.OwnSlot(name):
            return f"s.{names.shared[name]}.own"
        case ir.SharedPlace(name):
            return f"s.{names.shared[name]}.value"
        case ir.PortPlace(module, port):
            return f"s.{names.ports[module, port]}.value"
        case ir.TempPlace(name):
            return names.temp(name)
        case _:
            assert_never(place)
