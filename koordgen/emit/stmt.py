"""IR statements -> Python lines, each ending in the comment that names its Koord line."""

from __future__ import annotations

from collections.abc import Iterator
from typing import assert_never

from koordgen.emit import expr
from koordgen.emit.names import Names
from koordgen.ir import stmt as ir

PYTHON_TYPE = {"int": "int", "float": "float", "bool": "bool", "Point": "Point"}


def lines(block: ir.Block, names: Names, path: str, indent: str) -> Iterator[str]:
    """The statements of a block, indented; `pass` for an empty one."""
    if not block:
        yield f"{indent}pass"
    for statement in block:
        mark = f"  # {path}:{statement.span.line}"
        match statement:
            case ir.Assign(place, value):
                yield f"{indent}{_place(place, names)} = {expr.text(value, names)}{mark}"
            case ir.Let(name, type_, value):
                declared = f"{names.temp(name)}: {PYTHON_TYPE[type_.name]}"
                yield f"{indent}{declared} = {expr.text(value, names)}{mark}"
            case ir.If():
                yield from _if(statement, names, path, indent, "if")
            case ir.Stop():
                yield f"{indent}raise Stopped{mark}"
            case _:
                assert_never(statement)


def _if(statement: ir.If, names: Names, path: str, indent: str, keyword: str) -> Iterator[str]:
    yield f"{indent}{keyword} {expr.text(statement.condition, names)}:  # {path}:{statement.span.line}"
    yield from lines(statement.then, names, path, indent + "    ")
    match statement.orelse:
        case ():
            return
        case (ir.If() as chained,):
            yield from _if(chained, names, path, indent, "elif")
        case orelse:
            yield f"{indent}else:"
            yield from lines(orelse, names, path, indent + "    ")


def _place(place: ir.Place, names: Names) -> str:
    match place:
        case ir.LocalPlace(name):
            return f"s.{names.locals[name]}"
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
