"""Expected obligations of a program, counted from the IR alone.

The encoder must produce exactly these obligations: a missing obligation would leave a hole in the proof. The count is
an independent check, so it uses no result of the encoder. Both share only decisions that depend on the IR alone
(`loops.py`, `encode/loop.py`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import assert_never

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.verify.prove.encode.loop import has_next_turn, length, written
from koordgen.verify.prove.obligations.interface import ALONE, Interface
from koordgen.verify.prove.obligations.loops import INIT, functions_with_invariants
from koordgen.verify.prove.obligations.part_encoder import ProofProblem
from koordgen.verify.prove.smt.obligation import HeadFormula


def expected(
    program: decl.Program, robots: int | None = None, params: Mapping[str, ir.Expr] | None = None,
    dropped: frozenset[HeadFormula] = frozenset(), interface: Interface = ALONE,
) -> Counter[str]:  # fmt: skip
    """Return the names of the expected obligations, each with the number of its occurrences.

    An invariant has obligations at the mission's start, for each event, for the environment's step, and for each loop
    that is encoded by its invariants. With several applications, an invariant has one for the steps of the others. A
    guarantee has obligations for the first values and `init`, or for two steps, and for each event. Obligations of
    `(well-defined)` and of consistency are not counted, because only the encoder finds the operations that can fail."""
    problem = ProofProblem(program, robots, params, "little", dropped, interface)
    names = Counter(f"{p.name}-init" for p in problem.invariants)
    for event in program.events:
        names.update(f"{p.name}-{event.name}" for p in problem.touched(problem.changed(event)))
    names.update(f"{p.name}-environment" for p in problem.touched(problem.sensors))
    names.update(_of_interface(problem))
    blocks = [(event.name, event.effect) for event in program.events] + [(INIT, program.init)]
    for owner, block in [*blocks, *((f.name, f.block) for f in functions_with_invariants(program))]:
        names.update(_at_heads(problem, owner, block))
    return names


def _of_interface(problem: ProofProblem) -> Iterator[str]:
    """Yield the names of the obligations that the program has because of its exports and imports."""
    interface = problem.interface
    for guarantee in interface.guarantees:
        if guarantee.is_own:
            places = ("reflexive", "transitive") if guarantee.is_step else ("first-values",)
            yield from (f"{guarantee.label}-{place}" for place in places)
        if not guarantee.is_step and guarantee.key in written(problem.program.init):
            yield f"{guarantee.label}-init"
        for event in problem.program.events:
            if guarantee.key in written(event.effect):
                yield f"{guarantee.label}-{event.name}"
    foreign = interface.foreign | interface.cleared | interface.commanded
    place = interface.others.strip("()").replace(" ", "-")
    yield from (f"{p.name}-{place}" for p in problem.invariants if problem.mentions[p.name] & foreign)


def _at_heads(problem: ProofProblem, owner: str, block: stmt.Block) -> Iterator[str]:
    """Yield the names of a block's loop obligations.

    Each formula assumed at a loop's head has one obligation at loop entry. It has another obligation if an iteration
    can lead back to the head. A loop inside an unrolled loop has its obligations once per iteration of the unrolled
    loop."""
    for statement in block:
        match statement:
            case stmt.If(_, then, orelse):
                yield from _at_heads(problem, owner, then)
                yield from _at_heads(problem, owner, orelse)
            case stmt.For() | stmt.While() as loop:
                inner = list(_at_heads(problem, owner, loop.block))
                if isinstance(loop, stmt.For) and problem.loops.encoding(loop) == "unrolled":
                    yield from inner * (length(loop.values, problem.loops.known, problem.loops.robots) or 0)
                    continue
                yield from inner
                for at in problem.loops.at(loop) if problem.loops.encoding(loop) == "cut" else ():
                    name = f"{at.invariant.replace(' ', '-')}-{owner}-loop-{loop.span.line}"
                    yield f"{name}-entry"
                    if has_next_turn(loop):
                        yield f"{name}-turn"
            case (
                stmt.Assign() | stmt.Let() | stmt.Emit() | stmt.Break() | stmt.Continue() | stmt.Return() | stmt.Stop()
            ):
                pass
            case _:
                assert_never(statement)
