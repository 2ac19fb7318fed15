"""Facts from `priority:` blocks for the obligations of an event.

An event runs only if the guard of every earlier event of its block has a value and is false, evaluated on what the
robot sees at the round's start: its own variables, ports and slots, which only this robot changes, and the store then.
"""

from __future__ import annotations

from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.verify.prove.encode.state import State
from koordgen.verify.prove.encode.stmt import Frame
from koordgen.verify.prove.encode.values import Val
from koordgen.verify.prove.obligations.moment import Stage
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import Term


def assume_priority(stage: Stage, event: decl.Event, own: Term, now: State, begun: State) -> None:
    """Assume that the earlier guards of the event's block have values and are false for the robot `own`.

    `now` is the state in which the robot acts, `begun` the state at the round's start."""
    room = stage.room
    for earlier in stage.setting.program.earlier(event):
        with room.about(f"guard of {earlier.name} (earlier, by priority)", earlier.guard.span.line):
            with room.aside() as demands:
                frame = Frame(stage.encoder, own, now, begun, _no_port, {}, stage.know)
                guard = stage.encoder.term(earlier.guard, frame)
            for demand in demands:
                room.fact(demand.term)
            room.fact(t.not_(guard))


def _no_port(node: ir.PortCall, args: tuple[Val, ...]) -> Val:
    raise AssertionError("a guard calls no port")
