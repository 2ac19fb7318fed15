"""What a block writes, as it stands: what loops leave behind."""

from __future__ import annotations

from typing import assert_never

from koordgen.ir import expr as ir
from koordgen.ir import stmt
from koordgen.prove.encode.state import Key
from koordgen.prove.encode.tree import nodes


def key_of(place: stmt.Place) -> Key:
    match place:
        case stmt.LocalPlace(name):
            return "local", name
        case stmt.OwnSlot(name):
            return "slot", name
        case stmt.SharedPlace(name):
            return "cell", name
        case stmt.PortPlace(module, port):
            return "port", f"{module}.{port}"
        case stmt.TempPlace(name):
            return "temp", name
        case _:
            assert_never(place)


def kept_by(block: stmt.Block, temps: frozenset[str]) -> dict[Key, None]:
    """What a loop's block writes on some way that leads to its next run: not what it writes and then leaves. Temps of
    its own are not counted."""
    found, _ = _kept(block)
    return {key: None for key in found if key[0] != "temp" or key[1] in temps}


def _kept(block: stmt.Block) -> tuple[dict[Key, None], bool]:
    """What is written on the ways that reach the block's end or a `continue`; whether the end is reached at all."""
    found: dict[Key, None] = {}
    on: dict[Key, None] = {}  # on ways that ended in a `continue`
    for statement in block:
        match statement:
            case stmt.Assign(place):
                found[key_of(place)] = None
            case stmt.If(_, then, orelse):
                ways = [_kept(then), _kept(orelse)]
                for inner, _ in ways:
                    found.update(inner)
                if not any(reached for _, reached in ways):
                    return {**found, **on}, False
            case stmt.For() | stmt.While():
                found.update(written(statement.block))
            case stmt.Continue():
                return {**found, **on}, False
            case stmt.Break() | stmt.Return() | stmt.Stop():
                return on, False
            case stmt.Let() | stmt.Emit():
                pass
            case _:
                assert_never(statement)
    return {**found, **on}, True


def tells(block: stmt.Block, names: tuple[str, ...]) -> bool:
    """Whether the element that leaves a loop tells anything behind it, but that it did."""
    for statement in block:
        match statement:
            case stmt.Assign(_, value) | stmt.Return(value):
                if any(isinstance(n, ir.TempRead) and n.name in names for n in nodes(value)):
                    return True
            case stmt.If(_, then, orelse):
                if tells(then, names) or tells(orelse, names):
                    return True
            case stmt.For() | stmt.While() | stmt.Let():
                return True
            case _:
                pass
    return False


def written(block: stmt.Block) -> dict[Key, None]:
    """What a block may write, on any way."""
    found: dict[Key, None] = {}
    for statement in block:
        match statement:
            case stmt.Assign(place):
                found[key_of(place)] = None
            case stmt.If(_, then, orelse):
                found.update(written(then))
                found.update(written(orelse))
            case stmt.For() | stmt.While():
                found.update(written(statement.block))
            case _:
                pass
    return found
