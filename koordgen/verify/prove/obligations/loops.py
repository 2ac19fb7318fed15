"""The invariants of loops: which are assumed at which loop's head. Decided from the IR alone.

An invariant that a program states at a loop's head is always among them, unless it was found not to hold. Of the
program's own invariants those are among them that speak of what the loop writes: they may hold there, which is tried.
What is assumed at a head is shown where the loop begins and for each turn (docs/reference/semantics.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import statements, walk
from koordgen.verify.prove.encode.loop import Loop, Way, kept_by, way_of
from koordgen.verify.prove.encode.state import Key
from koordgen.verify.prove.smt.obligation import AtHead

INIT = "init"


class LoopInvariants:
    """Of one program. `dropped` are those that do not hold where they were tried."""

    def __init__(
        self, program: decl.Program, mentions: Mapping[str, frozenset[Key]], known: Mapping[str, ir.Expr],
        robots: int | None, dropped: frozenset[AtHead],
    ) -> None:  # fmt: skip
        self.program, self.mentions, self.dropped = program, mentions, dropped
        self.known, self.robots = known, robots
        self.invariants = {p.name: p for p in program.properties if p.kind == "invariant"}
        self.events = frozenset(event.name for event in program.events)
        self.number: dict[int, tuple[str, int]] = {}
        for owner, block in blocks(program):
            loops = [s for s in statements(block) if isinstance(s, (stmt.For, stmt.While))]
            self.number.update({id(loop): (owner, number) for number, loop in enumerate(loops)})

    def way(self, loop: Loop) -> Way:
        """How a loop of an event or of `init` is encoded."""
        return way_of(loop, self.known, self.robots)

    def stated(self, loop: Loop) -> Iterator[tuple[AtHead, ir.Expr]]:
        """The invariants that stand at the loop's head."""
        owner, number = self.number[id(loop)]
        for invariant in loop.invariants:
            at = AtHead(owner, number, f"line {invariant.span.line}")
            if at not in self.dropped:
                yield at, invariant.formula

    def tried(self, loop: Loop) -> Iterator[tuple[AtHead, decl.Property]]:
        """The program's invariants that speak of what the loop writes; in `init`, what they say of the robot itself."""
        owner, number = self.number[id(loop)]
        if owner not in self.events and owner != INIT:
            return
        kept = [key for key in kept_by(loop) if key[0] != "temp"]
        for name, property_ in self.invariants.items():
            at = AtHead(owner, number, name)
            if at not in self.dropped and not self.mentions[name].isdisjoint(kept):
                yield at, property_

    def at(self, loop: Loop) -> list[AtHead]:
        """All that is assumed at a loop's head."""
        return [at for at, _ in self.stated(loop)] + [at for at, _ in self.tried(loop)]


def blocks(program: decl.Program) -> Iterator[tuple[str, stmt.Block]]:
    """Yield the blocks of a program by their owners: events, `init`, functions."""
    yield from ((event.name, event.effect) for event in program.events)
    yield INIT, program.init
    yield from ((function.name, function.block) for function in program.functions)


def stating(program: decl.Program) -> list[decl.Function]:
    """The functions in which loops have invariants."""
    return [f for f in program.functions if any(isinstance(n, stmt.LoopInvariant) for n in walk(f.block))]
