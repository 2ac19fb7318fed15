"""Loop invariants: the formulas that are assumed at each loop's head, chosen from the IR alone.

Two kinds of formulas are assumed. The first kind is an invariant that the program states at the loop. The second kind
is a global invariant of the program that mentions a loop-carried variable. A formula that fails at the head is dropped.
Every assumed formula has obligations at loop entry and after each iteration (docs/reference/semantics.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import statements, walk
from koordgen.verify.prove.encode.loop import Loop, LoopEncoding, encoding_of, loop_carried
from koordgen.verify.prove.encode.state import Key
from koordgen.verify.prove.smt.obligation import HeadFormula

INIT = "init"


class LoopInvariants:
    """Loop invariants of one program.

    `dropped`: formulas that are known not to hold at a loop's head."""

    def __init__(
        self, program: decl.Program, mentions: Mapping[str, frozenset[Key]], known: Mapping[str, ir.Expr],
        robots: int | None, dropped: frozenset[HeadFormula],
    ) -> None:  # fmt: skip
        self.program, self.mentions, self.dropped = program, mentions, dropped
        self.known, self.robots = known, robots
        self.invariants = {p.name: p for p in program.properties if p.kind == "invariant"}
        self.events = frozenset(event.name for event in program.events)
        self.number: dict[int, tuple[str, int]] = {}
        for owner, block in blocks(program):
            loops = [s for s in statements(block) if isinstance(s, (stmt.For, stmt.While))]
            self.number.update({id(loop): (owner, number) for number, loop in enumerate(loops)})

    def encoding(self, loop: Loop) -> LoopEncoding:
        """Return the encoding of a loop of an event or of `init`."""
        return encoding_of(loop, self.known, self.robots)

    def stated(self, loop: Loop) -> Iterator[tuple[HeadFormula, ir.Expr]]:
        """Yield the invariants that the program states at the loop's head."""
        owner, number = self.number[id(loop)]
        for invariant in loop.invariants:
            at = HeadFormula(owner, number, f"line {invariant.span.line}")
            if at not in self.dropped:
                yield at, invariant.formula

    def candidates(self, loop: Loop) -> Iterator[tuple[HeadFormula, decl.Property]]:
        """Yield the program's global invariants that mention a loop-carried variable, as candidates.

        In `init`, a candidate is stated about the acting robot only."""
        owner, number = self.number[id(loop)]
        if owner not in self.events and owner != INIT:
            return
        kept = [key for key in loop_carried(loop) if key[0] != "temp"]
        for name, property_ in self.invariants.items():
            at = HeadFormula(owner, number, name)
            if at not in self.dropped and not self.mentions[name].isdisjoint(kept):
                yield at, property_

    def at(self, loop: Loop) -> list[HeadFormula]:
        """Return all formulas that are assumed at a loop's head."""
        return [at for at, _ in self.stated(loop)] + [at for at, _ in self.candidates(loop)]


def blocks(program: decl.Program) -> Iterator[tuple[str, stmt.Block]]:
    """Yield the blocks of a program, each with the name of its event, `init` or function."""
    yield from ((event.name, event.effect) for event in program.events)
    yield INIT, program.init
    yield from ((function.name, function.block) for function in program.functions)


def functions_with_invariants(program: decl.Program) -> list[decl.Function]:
    """Return the functions whose loops have invariants."""
    return [f for f in program.functions if any(isinstance(n, stmt.LoopInvariant) for n in walk(f.block))]
