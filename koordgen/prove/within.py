"""What a round can have changed by the time of an event: each robot runs one event in it, at most.

So what only robot j writes is as it was at the round's start, or the guard of an event that writes it held of j then.
"""

from __future__ import annotations

from koordgen.ir import decl
from koordgen.ir import expr as ir
from koordgen.prove import term as t
from koordgen.prove.encode.block import written
from koordgen.prove.encode.state import Begun, Key, State
from koordgen.prove.encode.stmt import Frame
from koordgen.prove.encode.tree import nodes
from koordgen.prove.encode.values import Val
from koordgen.prove.moment import Stage, conjuncts, mentioned
from koordgen.prove.term import Term


def changes(stage: Stage, begun: Begun, now: State) -> None:
    """Told of every robot but the acting one, of its slots and locals."""
    room, program = stage.room, stage.setting.program
    writers = {event.name: written(event.effect) for event in program.events}
    own = [key for key in stage.setting.types if key[0] in ("local", "slot")]

    def instance(robot: Term) -> Term:
        acting = room.same(robot, begun.own)
        if acting is t.TRUE:
            return t.TRUE
        held: dict[str, Term] = {}
        parts = []
        for key in own:
            same = stage.encoder.lists.same(now.of(key, robot), begun.of(key, robot))
            ran = []
            for event in program.events:
                if key in writers[event.name]:
                    if event.name not in held:
                        held[event.name] = _guard(stage, begun, event, robot)
                    ran.append(held[event.name])
            parts.append(t.or_(same, *ran))
        return t.implies(t.and_(room.within(robot), t.not_(acting)), t.all_of(parts))

    with room.about("one event a round", 0):
        room.for_all(instance, inner=True)


def _guard(stage: Stage, begun: Begun, event: decl.Event, robot: Term) -> Term:
    """What of an event's guard held at the round's start, of a robot that runs the event in the round. A transaction
    sees what others wrote since: there only what is its own counts."""
    frame = Frame(stage.encoder, robot, begun, begun, _no_port)
    parts = []
    with stage.room.aside():
        for part in conjuncts(event.guard):
            if event.lock is None or all(_own(key, part) for key in mentioned(part)):
                parts.append(stage.encoder.term(part, frame))
    return t.all_of(parts)


def _own(key: Key, part: ir.Expr) -> bool:
    if key[0] != "slot":
        return key[0] != "cell"
    reads = [n for n in nodes(part) if isinstance(n, (ir.SlotRead, ir.SlotsRead)) and n.name == key[1]]
    return all(isinstance(n, ir.SlotRead) and isinstance(n.index, ir.Pid) for n in reads)


def _no_port(node: ir.PortCall, args: tuple[Val, ...]) -> Val:
    raise AssertionError("a guard calls no port")
