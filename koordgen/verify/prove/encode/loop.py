"""Analysis of loops from the IR alone: encodings, written variables, writes with a known effect.

This module does not use the encoder. So the obligations of a program can be counted without encoding the program
(`koordgen/verify/prove/obligations/count.py`). Facts about the iterations of a loop follow from the semantics of loops
(docs/reference/semantics.md, "Loops"), so these facts need no proof obligation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Literal, NamedTuple, assert_never

from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt
from koordgen.lang.ir.tree import statements, walk
from koordgen.lang.ir.types import MapOf, Sequence, Type
from koordgen.lang.node import Node
from koordgen.verify.prove.encode.state import Key

MAX_UNROLLED = 8  # largest number of iterations for which a loop is unrolled

Loop = stmt.For | stmt.While
LoopEncoding = Literal["unrolled", "search", "cut"]
EncodingOf = Callable[[Loop], LoopEncoding]


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


def key_read(node: Node) -> Key | None:
    """Return the variable that an expression reads directly; None for any other expression."""
    match node:
        case ir.LocalRead(name):
            return "local", name
        case ir.TempRead(name):
            return "temp", name
        case ir.SharedRead(name):
            return "cell", name
        case ir.PortRead(module, port, False):
            return "port", f"{module}.{port}"
        case ir.SlotRead(name, ir.Pid()):
            return "slot", name
        case _:
            return None


# Choice of a loop's encoding


def encoding_of(loop: Loop, known: Mapping[str, ir.Expr], robots: int | None) -> LoopEncoding:
    """Return the encoding of a loop of an event or of `init`.

    `known`: the params with fixed values.
    `robots`: the number of robots if each robot is named by its number; None otherwise.

    The encodings are:

    - "unrolled": a `for` without invariants over at most MAX_UNROLLED elements. The program fixes the number of
      elements.
    - "search": a `for` in which no iteration writes a variable that a later iteration can read. The first element at
      which the loop is left decides the result.
    - "cut": any other loop. The variables that the loop writes get arbitrary values, constrained by the loop's
      invariants and the facts about its iterations."""
    if isinstance(loop, stmt.For) and not loop.invariants:
        many = length(loop.values, known, robots)
        if many is not None and many <= MAX_UNROLLED:
            return "unrolled"
        inner = [s for s in statements(loop.block) if isinstance(s, (stmt.For, stmt.While))]
        if is_search(loop) and all(encoding_of(n, known, robots) != "cut" for n in inner):
            return "search"
    return "cut"


def has_loop(block: stmt.Block) -> bool:
    """Return whether a block contains a loop.

    A block with a loop is encoded even if it is unreachable. Otherwise the number of obligations would depend on the
    code that the encoder finds unreachable, and `count.py` could not predict the number."""
    return any(isinstance(s, (stmt.For, stmt.While)) for s in statements(block))


def is_search(loop: stmt.For) -> bool:
    """Return whether a loop can be a search: no loop-carried variable, no stated invariant."""
    return not loop_carried(loop) and not loop.invariants


def length(values: ir.Expr, known: Mapping[str, ir.Expr], robots: int | None) -> int | None:
    """Return the number of elements of a `for`; None if the program does not fix this number."""
    match values:
        case ir.Range(start, stop, step):
            low, high = (whole(bound, known, robots) for bound in (start, stop))
            return len(range(low, high, step)) if low is not None and high is not None else None
        case ir.ParamRead(name) if name in known:
            return length(known[name], {}, None)
        case ir.Make(items) if isinstance(values.type, (Sequence, MapOf)):
            return len(items) if len(items) < 2 or not is_unordered(values.type) else None
        case _:
            return None


def whole(node: ir.Expr, known: Mapping[str, ir.Expr], robots: int | None) -> int | None:
    """Return the value of a constant int expression; None for any other expression."""
    match node:
        case ir.Const(int() as value):
            return value
        case ir.Unary("-", operand):
            inner = whole(operand, known, robots)
            return None if inner is None else -inner
        case ir.Binary("+" | "-" as op, left, right):
            a, b = whole(left, known, robots), whole(right, known, robots)
            return None if a is None or b is None else a + b if op == "+" else a - b
        case ir.NSys():
            return robots
        case ir.ParamRead(name) if name in known:
            return whole(known[name], {}, None)
        case _:
            return None


def is_unordered(type_: Type) -> bool:
    return isinstance(type_, MapOf) or (isinstance(type_, Sequence) and type_.name == "Set")


# Variables that a loop writes, and loop-carried variables (one iteration passes their values on to the next iteration)


def written(block: stmt.Block) -> dict[Key, None]:
    """Return the variables that a block may write on any path."""
    return {key_of(statement.place): None for statement in statements(block) if isinstance(statement, stmt.Assign)}


def loop_carried(loop: Loop) -> dict[Key, None]:
    """Return the variables that an iteration may write on a path to the next iteration (loop-carried).

    A variable that is written only on paths out of the loop is not loop-carried. The loop's own variable is not
    loop-carried."""
    own = set(temps_of(loop.block))
    if isinstance(loop, stmt.For):
        own.update(loop.names)
    return {key: None for key in _kept(loop.block)[0] if key[0] != "temp" or key[1] not in own}


def has_next_turn(loop: Loop) -> bool:
    """Return whether a path through the loop's block leads back to the loop's head."""
    _, ends, continues = _kept(loop.block)
    return ends or continues


def _kept(block: stmt.Block) -> tuple[dict[Key, None], bool, bool]:
    """Return the variables written on paths to the end of a block or to a `continue`, and two flags.

    The first flag is true if a path reaches the end of the block. The second flag is true if a path reaches a
    `continue`."""
    so_far: dict[Key, None] = {}  # variables written on the paths to the current statement
    continued: dict[Key, None] = {}  # variables written on the paths to a `continue`
    continues = False
    for statement in block:
        match statement:
            case stmt.Assign(place):
                so_far[key_of(place)] = None
            case stmt.If(_, then, orelse):
                ways = [_kept(then), _kept(orelse)]
                if any(on for _, _, on in ways):
                    continues = True
                    continued.update(so_far)
                for inner, _, _ in ways:
                    so_far.update(inner)
                    continued.update(inner if continues else {})
                if not any(ends for _, ends, _ in ways):
                    return continued, False, continues
            case stmt.For() | stmt.While():
                so_far.update(written(statement.block))
            case stmt.Continue():
                return {**continued, **so_far}, False, True
            case stmt.Break() | stmt.Return() | stmt.Stop():
                return continued, False, continues
            case stmt.Let() | stmt.Emit():
                pass
            case _:
                assert_never(statement)
    return {**continued, **so_far}, True, continues


def temps_of(block: stmt.Block) -> dict[str, Type]:
    """Return the types of the local variables that a block declares."""
    found: dict[str, Type] = {}
    for statement in statements(block):
        if isinstance(statement, stmt.Let):
            found[statement.name] = statement.type
        elif isinstance(statement, stmt.For):
            found.update(zip(statement.names, statement.types, strict=True))
    return found


def exposes_element(block: stmt.Block, names: tuple[str, ...]) -> bool:
    """Return whether a value that is used after the loop may depend on the loop's last element."""
    for statement in block:
        match statement:
            case stmt.Assign(_, value) | stmt.Return(value):
                if any(isinstance(n, ir.TempRead) and n.name in names for n in walk(value)):
                    return True
            case stmt.If(_, then, orelse):
                if exposes_element(then, names) or exposes_element(orelse, names):
                    return True
            case stmt.For() | stmt.While() | stmt.Let():
                return True
            case stmt.Emit() | stmt.Break() | stmt.Continue() | stmt.Stop():
                pass
            case _:
                assert_never(statement)
    return False


# Statements that write variables inside a loop


class LoopWrite(NamedTuple):
    """Statement in a loop's block, outside of inner loops, that writes a variable.

    `key`: the variable.
    `value`: the expression that is assigned.
    `guards`: the `if` conditions around the statement, each with the value that it must have.
    `lets`: the declarations of local variables that precede the statement.
    `group`: statements of the same group run in the same iterations.
    `sure`: no earlier statement can leave the iteration, so the statement runs in every iteration in which `guards`
    hold."""

    key: Key
    value: ir.Expr
    guards: tuple[tuple[ir.Expr, bool], ...]
    lets: tuple[stmt.Let, ...]
    group: tuple[int, int]
    sure: bool


class LoopWrites:
    """Statements in a loop's block that write variables, found by the syntax of the block."""

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        self.changed = written(loop.block)
        self.opaque: set[Key] = set()  # variables written in inner loops
        self.all: list[LoopWrite] = []
        self._walk(loop.block, (), (), True)

    def _walk(
        self, block: stmt.Block, guards: tuple[tuple[ir.Expr, bool], ...], lets: tuple[stmt.Let, ...], sure: bool
    ) -> None:
        segment = 0
        for statement in block:
            match statement:
                case stmt.Assign(place, value):
                    write = LoopWrite(key_of(place), value, guards, lets, (id(block), segment), sure)
                    self.all.append(write)
                case stmt.Let():
                    lets = (*lets, statement)
                case stmt.If(condition, then, orelse):
                    self._walk(then, (*guards, (condition, True)), lets, sure)
                    self._walk(orelse, (*guards, (condition, False)), lets, sure)
                    if leaves(statement):
                        segment, sure = segment + 1, False
                case stmt.For() | stmt.While():
                    self.opaque.update(written(statement.block))
                    if leaves(statement):
                        segment, sure = segment + 1, False
                case stmt.Emit() | stmt.Break() | stmt.Continue() | stmt.Return() | stmt.Stop():
                    pass
                case _:
                    assert_never(statement)

    def of(self, key: Key) -> list[LoopWrite]:
        """Return the statements that write a variable; an empty list if an inner loop also writes it."""
        return [] if key in self.opaque else [write for write in self.all if write.key == key]

    def only(self, key: Key) -> LoopWrite | None:
        """Return the only statement that writes a variable; None if no statement or several statements do."""
        found = self.of(key)
        return found[0] if len(found) == 1 else None

    def is_fixed(self, node: Node, lets: tuple[stmt.Let, ...], element: bool = True) -> bool:
        """Return whether an expression's value is independent of all variables that the loop writes.

        If `element`, the value may still depend on the loop's own variable, the element of the iteration."""
        own = self.loop.names if isinstance(self.loop, stmt.For) else ()
        local = {let.name: let for let in lets}
        for part in walk(node):
            if isinstance(part, (ir.PortCall, ir.ExternCall, ir.SlotsRead)):
                return False
            if isinstance(part, ir.SlotRead) and ("slot", part.name) in self.changed:
                return False
            key = key_read(part)
            if key is None:
                continue
            if key in self.changed:
                return False
            if key[0] == "temp" and key[1] in own and not element:
                return False
            if key[0] == "temp" and key[1] in local:
                before = lets[: lets.index(local[key[1]])]
                if not self.is_fixed(local[key[1]].value, before, element):
                    return False
        return True


def leaves(part: stmt.Stmt) -> bool:
    """Return whether a statement may end the iteration, the loop or the event."""
    return any(isinstance(s, (stmt.Break, stmt.Continue, stmt.Return, stmt.Stop)) for s in statements((part,)))


def step_of(write: LoopWrite) -> int | None:
    """Return the constant that an assignment adds to its own variable; None for any other assignment."""
    match write.value:
        case ir.Binary("+" | "-" as op, left, right):
            if key_read(left) == write.key:
                by = whole(right, {}, None)
                return None if by is None else by if op == "+" else -by
            if op == "+" and key_read(right) == write.key:
                return whole(left, {}, None)
    return None


class RunningExtreme(NamedTuple):
    """Assignment that keeps the least or greatest `value` of all iterations in which `guards` hold.

    `least`: True for the least value, False for the greatest value."""

    write: LoopWrite
    value: ir.Expr
    guards: tuple[tuple[ir.Expr, bool], ...]
    least: bool


def running_extreme_of(write: LoopWrite) -> RunningExtreme | None:
    """Return the running minimum or maximum that an assignment computes; None for other assignments.

    For the least value, two forms are recognised: `if value < v: v = value` and `v = min(v, value)`. The forms for the
    greatest value use `>` and `max`."""
    match write.value:
        case ir.Builtin("min" | "max" as name, (left, right)):
            for own, other in ((left, right), (right, left)):
                if key_read(own) == write.key:
                    return RunningExtreme(write, other, write.guards, name == "min")
    for place, (condition, held) in enumerate(write.guards):
        if not held or not isinstance(condition, ir.Compare) or condition.op not in ("<", "<=", ">", ">="):
            continue
        less = condition.op in ("<", "<=")
        rest = write.guards[:place] + write.guards[place + 1 :]
        if condition.left == write.value and key_read(condition.right) == write.key:
            return RunningExtreme(write, write.value, rest, less)
        if condition.right == write.value and key_read(condition.left) == write.key:
            return RunningExtreme(write, write.value, rest, not less)
    return None


def conjuncts(formula: ir.Expr) -> Iterator[ir.Expr]:
    """Yield the conjuncts of a formula, from left to right."""
    if isinstance(formula, ir.Logic) and formula.op == "and":
        yield from conjuncts(formula.left)
        yield from conjuncts(formula.right)
    else:
        yield formula
