"""IR statements -> Python lines, each ending in the comment that names its Koord line."""

from __future__ import annotations

from collections.abc import Iterator
from typing import assert_never

from koordgen.build.emit import expr
from koordgen.build.emit.names import Names
from koordgen.build.emit.types import annotation
from koordgen.lang.ir import stmt as ir
from koordgen.lang.ir.expr import Const, Expr, Ids, Range
from koordgen.lang.ir.types import BOOL

STEP = "    "


def lines(block: ir.Block, names: Names, path: str, indent: str) -> Iterator[str]:
    """The statements of a block, indented; `pass` for an empty one."""
    if not block:
        yield f"{indent}pass"
    for statement in block:
        mark = f"  # {path}:{statement.span.line}"
        match statement:
            case ir.If():
                yield from _if(statement, names, path, indent, "if")
            case ir.For():
                yield from _for(statement, names, path, indent)
            case ir.While():
                yield from _while(statement, names, path, indent)
            case _:
                yield f"{indent}{_simple(statement, names)}{mark}"


def _for(loop: ir.For, names: Names, path: str, indent: str) -> Iterator[str]:
    """Yield a `for` loop. Invariants of a loop that counts are evaluated with the next value: its range gets a name."""
    mark = f"  # {path}:{loop.span.line}"
    taken, over = ", ".join([names.temp(name) for name in loop.names]), expr.domain(loop.values, names)
    claims = [f"{claim}  # {path}:{line}" for claim, line in _claims(loop, names)]
    counts = bool(claims) and isinstance(loop.values, (Range, Ids))
    if counts:
        turns = names.turns(loop.names[0])
        yield f"{indent}{turns} = {over}{mark}"
        over = turns
    yield f"{indent}for {taken} in turns({over}):{mark}"
    yield from (f"{indent}{STEP}{claim}" for claim in claims)
    if loop.block or not claims:
        yield from lines(loop.block, names, path, indent + STEP)
    if claims:
        yield f"{indent}else:"
    if counts:
        yield f"{indent}{STEP}{taken} = behind({over}){mark}"
    yield from (f"{indent}{STEP}{claim}" for claim in claims)


def _while(loop: ir.While, names: Names, path: str, indent: str) -> Iterator[str]:
    """Yield a `while` loop. Its invariants are evaluated before its condition, or, where that is True, in the block."""
    mark = f"  # {path}:{loop.span.line}"
    claims = _claims(loop, names)
    endless = loop.condition == Const(True, BOOL, loop.span)
    if not claims or endless:
        yield f"{indent}while {_each_turn(loop.condition, names)}:{mark}"
        yield from (f"{indent}{STEP}{claim}  # {path}:{line}" for claim, line in claims)
    else:
        heads = " and ".join([claim for claim, _ in claims])
        yield f"{indent}while {heads} and {_each_turn(loop.condition, names)}:{mark}"
    if loop.block or not (claims and endless):
        yield from lines(loop.block, names, path, indent + STEP)


def _claims(loop: ir.For | ir.While, names: Names) -> list[tuple[str, int]]:
    """Return the calls that evaluate a loop's invariants, each with its line; a call is always true."""
    lines = [invariant.span.line for invariant in loop.invariants]
    held = [expr.text(invariant.formula, names) for invariant in loop.invariants]
    return [(f"claim({line}, lambda: {text})", line) for line, text in zip(lines, held, strict=True)]


def _each_turn(condition: Expr, names: Names) -> str:
    """The condition of a `while`, which takes a turn where it holds."""
    forever = isinstance(condition, Const) and condition.value is True
    return "turn()" if forever else f"{expr.operand_of_and(condition, names)} and turn()"


def _simple(statement: ir.Stmt, names: Names) -> str:
    match statement:
        case ir.Assign(place, value):
            return f"{_place(place, names)} = {expr.text(value, names)}"
        case ir.Let(name, type_, value):
            return f"{names.temp(name)}: {annotation(type_, names)} = {expr.text(value, names)}"
        case ir.Break():
            return "break"
        case ir.Continue():
            return "continue"
        case ir.Return(value):
            return f"return {expr.text(value, names)}"
        case ir.Emit(module, port, items):
            parts = [expr.literal(f"{module}.{port}"), *[expr.text(item, names) for item in items]]
            return f"s.emit({', '.join(parts)})"
        case ir.Stop():
            return "raise Stopped"
        case ir.If() | ir.For() | ir.While():
            raise AssertionError("these have blocks")
        case _:
            assert_never(statement)


def _if(statement: ir.If, names: Names, path: str, indent: str, keyword: str) -> Iterator[str]:
    yield f"{indent}{keyword} {expr.text(statement.condition, names)}:  # {path}:{statement.span.line}"
    yield from lines(statement.then, names, path, indent + STEP)
    match statement.orelse:
        case ():
            return
        case (ir.If() as chained,):
            yield from _if(chained, names, path, indent, "elif")
        case orelse:
            yield f"{indent}else:"
            yield from lines(orelse, names, path, indent + STEP)


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
