"""IR -> readable text, types shown, for `koordgen dump --after check`. The same program gives the same text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import assert_never

from koordgen.ir import decl, expr, stmt


def show(program: decl.Program) -> str:
    """The whole program, one declaration or statement a line. `?` after an index or an operator marks a check at
    run time; `int -> float` stands where a value is widened."""
    lines = [f"program {program.name} ({program.path})"]
    for param in program.params:
        lines.append(f"param {param.name}: {param.type} = {_expr(param.default)}")
    for module in program.modules:
        lines.append(f"module {module.name}")
        lines += [f"  {port.direction} {port.name}: {port.type}" for port in module.ports]
    for shared in program.shared:
        size = "[N_SYS]" if shared.kind == "allread" else ""
        lines.append(f"{shared.kind} {shared.name}: {shared.type}{size} = {_expr(shared.initial)}")
    for local in program.locals:
        lines.append(f"local {local.name}: {local.type} = {_expr(local.initial)}")
    if program.init:
        lines.append("init")
        lines += _block(program.init, "  ")
    for event in program.events:
        lines += [f"event {event.name}", f"  when {_expr(event.guard)}", *_block(event.effect, "  ")]
    return "\n".join(lines) + "\n"


def _block(block: stmt.Block, indent: str) -> Iterator[str]:
    for statement in block:
        match statement:
            case stmt.Assign(place, value):
                yield f"{indent}{_place(place)} := {_expr(value)}"
            case stmt.Let(name, type_, value):
                yield f"{indent}let {name}: {type_} = {_expr(value)}"
            case stmt.Stop():
                yield f"{indent}stop"
            case stmt.If():
                yield from _if(statement, indent)
            case _:
                assert_never(statement)


def _if(statement: stmt.If, indent: str) -> Iterator[str]:
    word = "if"
    while True:
        yield f"{indent}{word} {_expr(statement.condition)}"
        yield from _block(statement.then, indent + "  ")
        if len(statement.orelse) == 1 and isinstance(statement.orelse[0], stmt.If):
            statement, word = statement.orelse[0], "elif"
            continue
        if statement.orelse:
            yield f"{indent}else"
            yield from _block(statement.orelse, indent + "  ")
        return


def _place(place: stmt.Place) -> str:
    match place:
        case stmt.OwnSlot(name):
            return f"{name}[pid]"
        case stmt.PortPlace(module, port):
            return f"{module}.{port}"
        case stmt.LocalPlace(name) | stmt.SharedPlace(name) | stmt.TempPlace(name):
            return name
        case _:
            assert_never(place)


def _expr(node: expr.Expr) -> str:
    """Every operator in its own parentheses: the tree as it is."""
    match node:
        case expr.Const(value):
            return repr(value)
        case expr.Pid():
            return "pid"
        case expr.NSys():
            return "N_SYS"
        case expr.ParamRead(name) | expr.LocalRead(name) | expr.TempRead(name) | expr.SharedRead(name):
            return name
        case expr.SlotRead(name, index, proved):
            return f"{name}[{_expr(index)}]{'' if proved else '?'}"
        case expr.PortRead(module, port):
            return f"{module}.{port}"
        case expr.Widen(operand):
            return f"(int -> float {_expr(operand)})"
        case expr.Unary(op, operand):
            return f"({op}{' ' if op == 'not' else ''}{_expr(operand)})"
        case expr.Binary(op, left, right, proved):
            return f"({_expr(left)} {op}{'' if proved else '?'} {_expr(right)}: {node.type})"
        case expr.Compare(op, left, right) | expr.Logic(op, left, right):
            return f"({_expr(left)} {op} {_expr(right)})"
        case expr.Conditional(condition, then, orelse):
            return f"({_expr(then)} if {_expr(condition)} else {_expr(orelse)}: {node.type})"
        case expr.Coordinate(operand, axis):
            return f"{_expr(operand)}.{axis}"
        case expr.Builtin(name, args):
            call = f"{name}({', '.join(_expr(a) for a in args)})"
            return f"({call}: {node.type})" if name in ("abs", "min", "max") else call  # those keep ints
        case _:
            assert_never(node)
