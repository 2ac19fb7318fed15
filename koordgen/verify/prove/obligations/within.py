"""Interference: changes by other robots in a round before an event.

Each robot runs at most one event a round. So what only robot j writes is as it was at the round's start, or the guard of
an event that writes it held for j then. For a plain event and detail "most", it is also the value that the event
computes from the round's start.
"""

from __future__ import annotations

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.verify.prove.encode.loop import conjuncts, temps_of, written
from koordgen.verify.prove.encode.state import Begun, Key, State
from koordgen.verify.prove.encode.stmt import Env, Frame
from koordgen.verify.prove.encode.values import Val, truth
from koordgen.verify.prove.obligations.moment import Stage, mentioned
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import Term


def changes(stage: Stage, begun: Begun, now: State) -> None:
    """Assume for every robot but the acting one how its slots and locals may differ from the round's start."""
    room, program = stage.room, stage.setting.program
    writers = {event.name: written(event.effect) for event in program.events}
    own = [key for key in stage.setting.types if key[0] in ("local", "slot")]
    followed = {e.name for e in program.events if stage.setting.told == "most" and _followed(e, program)}

    def instance(robot: Term) -> Term:
        acting = room.same(robot, begun.own)
        if acting is t.TRUE:
            return t.TRUE
        held: dict[str, Term] = {}
        wrote: dict[str, Env] = {}
        parts = [
            t.implies(truth(now.of(key, robot)), truth(begun.of(key, robot))) for key in stage.setting.cleared
        ]  # a command clears a sensor such as `reached`; nothing else within a round sets it
        for key in own:
            same = stage.encoder.lists.same(now.of(key, robot), begun.of(key, robot))
            ran = []
            for event in program.events:
                if key in writers[event.name]:
                    if event.name not in held:
                        held[event.name] = _guard(stage, begun, event, robot)
                        wrote[event.name] = _wrote(stage, begun, event, robot) if event.name in followed else {}
                    computed = wrote[event.name].get(key)
                    as_computed = t.TRUE if computed is None else stage.encoder.lists.same(now.of(key, robot), computed)
                    ran.append(t.and_(held[event.name], as_computed))
            parts.append(t.or_(same, *ran))
        return t.implies(t.and_(room.within(robot), t.not_(acting)), t.all_of(parts))

    with room.about("one event a round", 0):
        room.for_all(instance, inner=True)


def _guard(stage: Stage, begun: Begun, event: decl.Event, robot: Term) -> Term:
    """Return the parts of an event's guard that held at the round's start for a robot that runs the event in the round.
    A transaction sees what others wrote since, so only the parts about the robot's own variables count. The guards of
    events with priority over it were false."""
    frame = Frame(stage.encoder, robot, begun, begun, _no_port, {}, stage.know)
    parts = []
    with stage.room.aside():
        for part in conjuncts(event.guard):
            if event.lock is None or all(_own(key, part) for key in mentioned(part)):
                parts.append(stage.encoder.term(part, frame))
        for earlier in stage.setting.program.earlier(event):
            parts.append(t.not_(stage.encoder.term(earlier.guard, frame)))
    return t.all_of(parts)


def _followed(event: decl.Event, program: decl.Program) -> bool:
    """Return whether an event's writes are a function of what the robot saw at the round's start. Not so for a
    transaction, a port's answer, or a loop; nor with extern functions, even within functions, since their contracts
    hold only where the call is made."""
    unknown = (ir.PortCall, ir.ExternCall, stmt.For, stmt.While)
    bodies = tuple([f.block for f in program.functions])
    calls = any(isinstance(n, ir.ExternCall) for n in walk(bodies))
    return event.lock is None and not calls and not any(isinstance(n, unknown) for n in walk(event.effect))


def _wrote(stage: Stage, begun: Begun, event: decl.Event, robot: Term) -> Env:
    frame = Frame(stage.encoder, robot, begun, begun, _no_port, temps_of(event.effect), stage.know)
    with stage.room.aside():
        frame.block(event.effect)
    return frame.writes()


def _own(key: Key, part: ir.Expr) -> bool:
    if key[0] != "slot":
        return key[0] != "cell"
    reads = [n for n in walk(part) if isinstance(n, (ir.SlotRead, ir.SlotsRead)) and n.name == key[1]]
    return all(isinstance(n, ir.SlotRead) and isinstance(n.index, ir.Pid) for n in reads)


def _no_port(node: ir.PortCall, args: tuple[Val, ...]) -> Val:
    raise AssertionError("a guard calls no port")
