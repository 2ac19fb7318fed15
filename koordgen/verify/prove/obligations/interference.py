"""Interference: changes that other robots made in the same round before an event.

Each robot runs at most one event per round. So for a variable that only robot j writes, there are two cases. Either the
variable has its value at the round's start, or robot j ran an event that writes the variable. In the second case, the
event's guard held for j. With detail "most", the variable then also has the value that the event computes from the
state at the round's start. This value is known only for events without a lock, a loop, a port's answer or an extern
function.
"""

from __future__ import annotations

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import Part, walk
from koordgen.verify.prove.encode.loop import conjuncts, temps_of, written
from koordgen.verify.prove.encode.state import Key, RoundStart, SymbolicState
from koordgen.verify.prove.encode.stmt import Env, SymbolicFrame
from koordgen.verify.prove.encode.values import Val, as_term
from koordgen.verify.prove.obligations.part_encoder import PartEncoder, mentioned
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import Term


def assume_interference(part_encoder: PartEncoder, round_start: RoundStart, now: SymbolicState) -> None:
    """Assume how other robots' slots, locals and cleared sensors may differ from the round's start."""
    context, program = part_encoder.context, part_encoder.problem.program
    writers = {event.name: written(event.effect) for event in program.events}
    own = [key for key in part_encoder.problem.types if key[0] in ("local", "slot")]
    functional = {
        e.name
        for e in program.events
        if part_encoder.problem.detail == "most" and _is_functional(e, program) and not _reads(part_encoder, e.effect)
    }

    def instance(robot: Term) -> Term:
        acting = context.same(robot, round_start.own)
        if acting is t.TRUE:
            return t.TRUE
        held: dict[str, Term] = {}
        wrote: dict[str, Env] = {}
        parts = [
            t.implies(as_term(now.of(key, robot)), as_term(round_start.of(key, robot)))
            for key in part_encoder.problem.cleared
        ]  # Within a round, a command may clear a sensor such as `reached`, and nothing sets the sensor.
        for key in own:
            same = part_encoder.encoder.lists.same(now.of(key, robot), round_start.of(key, robot))
            ran = []
            for event in program.events:
                if key in writers[event.name]:
                    if event.name not in held:
                        held[event.name] = _guard(part_encoder, round_start, event, robot)
                        wrote[event.name] = (
                            _wrote(part_encoder, round_start, event, robot) if event.name in functional else {}
                        )
                    computed = wrote[event.name].get(key)
                    as_computed = (
                        t.TRUE if computed is None else part_encoder.encoder.lists.same(now.of(key, robot), computed)
                    )
                    ran.append(t.and_(held[event.name], as_computed))
            parts.append(t.or_(same, *ran))
        return t.implies(t.and_(context.within(robot), t.not_(acting)), t.all_of(parts))

    with context.about("each robot runs at most one event per round", 0):
        context.for_all(instance, inner=True)


def _guard(part_encoder: PartEncoder, round_start: RoundStart, event: decl.Event, robot: Term) -> Term:
    """Return the condition at the round's start under which `robot` may run the event in the round.

    The condition includes that the guards of events with higher priority are false. A transaction (an event with a
    lock) also reads values that other robots wrote since the round's start. Therefore only the conjuncts of its guard
    that read the robot's own variables are used. A port that another application may change has no known value."""
    frame = SymbolicFrame(
        part_encoder.encoder, robot, round_start, round_start, _no_port, {}, part_encoder.assume_at_head
    )
    parts = []
    with part_encoder.context.separate_demands():
        for part in conjuncts(event.guard):
            if _reads(part_encoder, part):
                continue
            if event.lock is None or all(_own(key, part) for key in mentioned(part)):
                parts.append(part_encoder.encoder.term(part, frame))
        for earlier in part_encoder.problem.program.earlier(event):
            if _reads(part_encoder, earlier.guard):
                continue
            parts.append(t.not_(part_encoder.encoder.term(earlier.guard, frame)))
    return t.all_of(parts)


def _reads(part_encoder: PartEncoder, part: Part) -> bool:
    """Return whether a part of the program reads a port that another application may change."""
    ports = part_encoder.problem.interface.ports
    return bool(ports) and not ports.isdisjoint(mentioned(part))


def _is_functional(event: decl.Event, program: decl.Program) -> bool:
    """Return whether an event's writes depend only on the values that the robot read at the round's start.

    The answer is False for a transaction, for an event that uses a port's answer, and for an event with a loop. It is
    also False if the event or any function calls an extern function: contracts are known only at the place of the call.
    """
    unknown = (ir.PortCall, ir.ExternCall, stmt.For, stmt.While)
    bodies = tuple([f.block for f in program.functions])
    calls = any(isinstance(n, ir.ExternCall) for n in walk(bodies))
    return event.lock is None and not calls and not any(isinstance(n, unknown) for n in walk(event.effect))


def _wrote(part_encoder: PartEncoder, round_start: RoundStart, event: decl.Event, robot: Term) -> Env:
    frame = SymbolicFrame(
        part_encoder.encoder,
        robot,
        round_start,
        round_start,
        _no_port,
        temps_of(event.effect),
        part_encoder.assume_at_head,
    )
    with part_encoder.context.separate_demands():
        frame.block(event.effect)
    return frame.writes()


def _own(key: Key, part: ir.Expr) -> bool:
    if key[0] != "slot":
        return key[0] != "cell"
    reads = [n for n in walk(part) if isinstance(n, (ir.SlotRead, ir.SlotsRead)) and n.name == key[1]]
    return all(isinstance(n, ir.SlotRead) and isinstance(n.index, ir.Pid) for n in reads)


def _no_port(node: ir.PortCall, args: tuple[Val, ...]) -> Val:
    raise AssertionError("a guard calls a port")
