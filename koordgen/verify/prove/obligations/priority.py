"""Facts from `priority:` blocks, for the obligations of an event.

An event runs only if the guard of every earlier event of its `priority:` block has a value and is false. The guards are
evaluated on the state that the robot sees at the round's start. This state consists of the robot's own variables, ports
and slots, which no other robot changes, and the shared store at the round's start.
"""

from __future__ import annotations

from collections.abc import Mapping

from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.verify.prove.encode.state import Key, SymbolicState
from koordgen.verify.prove.encode.stmt import SymbolicFrame
from koordgen.verify.prove.encode.values import Val
from koordgen.verify.prove.obligations.part_encoder import PartEncoder
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import Term


def assume_priority(
    part_encoder: PartEncoder, event: decl.Event, own: Term, now: SymbolicState, round_start: SymbolicState,
    sensed: Mapping[Key, SymbolicState],
) -> None:  # fmt: skip
    """Assume that earlier events of the event's `priority:` block cannot run in the robot `own`.

    The guards of the earlier events have values and are false.
    `now`: the state in which the robot acts.
    `round_start`: the state at the round's start.
    `sensed`: the states of ports that another application may have changed since then."""
    context = part_encoder.context
    for earlier in part_encoder.problem.program.earlier(event):
        with context.about(f"guard of {earlier.name} (earlier, by priority)", earlier.guard.span.line):
            with context.separate_demands() as demands:
                frame = SymbolicFrame(
                    part_encoder.encoder, own, now, round_start, _no_port, {}, part_encoder.assume_at_head
                )
                frame.sensed = sensed
                guard = part_encoder.encoder.term(earlier.guard, frame)
            for demand in demands:
                context.fact(demand.term)
            context.fact(t.not_(guard))


def _no_port(node: ir.PortCall, args: tuple[Val, ...]) -> Val:
    raise AssertionError("a guard calls a port")
