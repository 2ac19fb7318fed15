"""From a program to its obligations: the mission's start, each event, the environment's step.

Induction: the invariants hold when all robots have run `init`; each event of each robot keeps them, whatever others did
in the round by then; and so does each moment of the environment's step. docs/proofs.md argues that this suffices.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from koordgen.ir import decl
from koordgen.ir import expr as ir
from koordgen.ir.decl import Program
from koordgen.prove import term as t
from koordgen.prove.begin import Ready, ended, launched
from koordgen.prove.encode.state import Begun, Free, Moved, State, Written
from koordgen.prove.encode.stmt import Cut, Frame
from koordgen.prove.encode.values import Val
from koordgen.prove.goal import goal
from koordgen.prove.moment import Setting, Stage, Told, temps_of
from koordgen.prove.obligation import Cell, Fact, Kind, Moment, Obligation
from koordgen.prove.priority import assume_priority
from koordgen.prove.within import changes

WELL_DEFINED = "(well-defined)"
AFTERWARDS = " afterwards"
Goal = tuple[decl.Property, str, tuple[Fact, ...]]  # an invariant, at which place within an event, in parts


def obligations(
    program: Program, robots: int | None = None, params: Mapping[str, ir.Expr] | None = None, told: Told = "usual"
) -> list[Obligation]:
    """Everything that is to be shown of a checked program: for `robots` robots, or for any number of them; with the
    values of `params`, the others being any. To leave an invariant out, or to add one, hand over a program without or
    with it. `told`: how much of what is known of distances and of the round; "most" is slower to solve, and what a
    counterexample must satisfy; with "little" there are no cells."""
    return [obligation for room in rooms(program, robots, params, told) for obligation in room]


def rooms(
    program: Program, robots: int | None = None, params: Mapping[str, ir.Expr] | None = None, told: Told = "usual"
) -> Iterator[list[Obligation]]:
    """The same, by and by: those that share their facts together."""
    t.forget()
    setting = Setting(program, robots, params, told)
    for single in consistent(setting):
        yield [single]
    yield base(setting)
    for event in program.events:
        yield of_event(setting, event)
    yield environment(setting)


def assumptions(
    program: Program, robots: int | None = None, params: Mapping[str, ir.Expr] | None = None
) -> list[Obligation]:
    """Those of the obligations that ask whether what is assumed can be true."""
    t.forget()
    return consistent(Setting(program, robots, params, "little"))


def base(setting: Setting) -> list[Obligation]:
    stage, program = Stage(setting), setting.program
    ready = Ready(stage)
    launched(stage, ready.launch)
    goals: list[Goal] = []
    own = stage.room.some_robot("pid")
    demands: Sequence[Fact] = ()
    if program.init:
        ready.shown = own
        run = ready.run(own)
        demands = run.demands
        goals += _at_cuts(stage, run.cuts)
    if setting.invariants:
        goals += [(p, "", goal(stage, p, ready)) for p in setting.invariants]
    cells = stage.cells([("before", ready.launch), ("after", ready)])
    facts = stage.close()
    line = program.init[0].span.line if program.init else 1
    out = _Output(stage, "base", "init", line, facts, cells)
    return out.all(goals, demands, ())


def of_event(setting: Setting, event: decl.Event) -> list[Obligation]:
    stage, program = Stage(setting), setting.program
    room = stage.room
    room.temps = temps_of(event.effect)
    own = room.acting("pid")
    now = Free(room, setting.types)
    begun = Begun(now, Free(room, setting.types, "@start"), own, setting.sensors)
    seen: State = begun if event.lock is None else now

    def ask(node: ir.PortCall, args: tuple[Val, ...]) -> Val:
        answer = room.any(f"{node.module}.{node.port}", node.type)
        stage.answered(node, args, answer, own, now)
        return answer

    assume_priority(stage, event, own, now, begun)
    frame = Frame(stage.encoder, own, now, seen, ask)
    with room.aside() as demands:
        with room.about(f"guard of {event.name}", event.guard.span.line):
            guard = stage.encoder.term(event.guard, frame)
            room.fact(guard)
            room.learn(guard)
            now.read.clear()
        with room.about(f"effect of {event.name}", event.span.line):
            live = frame.block(event.effect)
    ends = t.any_of([live, *[t.all_of(e.path) for e in frame.exits]])
    after = Written(room, now, own, ended(program, frame.writes(), now, own), "@after")
    stage.holds(setting.invariants, now)
    for cut in frame.cuts:
        stage.known_at(cut)
    goals = _at_cuts(stage, frame.cuts)
    goals += [(p, "", goal(stage, p, after)) for p in setting.touched(after.writes)]
    room.instantiate()
    moments: list[tuple[Moment, State]] = [("before", now), ("after", after)]
    if begun.used:
        stage.holds(setting.invariants, begun, when=" at the round's start")
        changes(stage, begun, now)
        moments.insert(0, ("round start", begun))
    cells = stage.cells(moments)
    out = _Output(stage, "event", event.name, event.span.line, stage.close(), cells)
    over = Fact(f"{event.name} ends", ends, program.path, event.span.line)
    return out.all(goals, demands, (*demands, over))


def environment(setting: Setting) -> list[Obligation]:
    """Of the invariants in their order each may use that those before it hold after the step, too."""
    stage = Stage(setting)
    now = Free(stage.room, setting.types)
    after = Moved(now, Free(stage.room, setting.types, "@after"), setting.sensors)
    stage.holds(setting.invariants, now)
    stage.ports(now, after)
    goals = [(p, "", goal(stage, p, after)) for p in setting.touched(setting.sensors)]
    if not goals:
        return []
    stage.holds(setting.invariants, after, when=AFTERWARDS)
    cells = stage.cells([("before", now), ("after", after)])
    lines = [m.span.line for m in setting.program.modules]
    out = _Output(stage, "environment", "(environment)", lines[0] if lines else 1, stage.close(), cells)
    return out.all(goals, (), ())


def consistent(setting: Setting) -> list[Obligation]:
    """What is assumed can be true: the mission's start, and a step of the environment within the invariants."""
    found = []
    for name in ("initially", "environment"):
        stage = Stage(setting, thorough=True)
        room = stage.room
        room.robot(t.integer(0), known=True)
        if name == "initially":
            launch = Ready(stage).launch
            launched(stage, launch)
            cells = stage.cells([("before", launch)])
        else:
            now = Free(room, setting.types)
            after = Moved(now, Free(room, setting.types, "@after"), setting.sensors)
            stage.holds(setting.invariants, now)
            stage.ports(now, after)
            cells = stage.cells([("before", now), ("after", after)])
        facts = stage.close()
        out = _Output(stage, "consistency", "", 1, facts, cells)
        found.append(out.one(f"consistency-{name}", "", None, (), ()))
    return found


def _at_cuts(stage: Stage, cuts: Sequence[Cut]) -> list[Goal]:
    """The invariants where a loop begins, and where a run of it ends."""
    return [
        (p, f"loop-{cut.line}-{cut.kind.replace(' ', '-')}", goal(stage, p, cut.state, t.all_of(cut.path)))
        for cut in cuts
        if cut.kind != "run"
        for p in stage.setting.touched(cut.state.writes)
    ]


class _Output:
    """The obligations of one room, which share its facts."""

    def __init__(
        self, stage: Stage, kind: Kind, event: str, line: int, facts: tuple[Fact, ...], cells: tuple[Cell, ...]
    ) -> None:
        self.stage, self.kind, self.event, self.line = stage, kind, event, line
        self.facts, self.cells = facts, cells
        self.notes = tuple(stage.room.notes)
        self.traits = 0
        for fact in facts:
            self.traits |= fact.term.traits
        self.complete = stage.setting.complete and not stage.room.partial

    def all(
        self,
        goals: list[Goal],
        demands: Sequence[Fact],
        ended: tuple[Fact, ...],
    ) -> list[Obligation]:
        """One for each invariant, and one that every operation has a value; the others assume it: what has none is
        discarded, and changes nothing. `ended`: that the effect has come to its end, which it has not in a loop."""
        where = {"base": "init", "environment": "environment"}.get(self.kind, self.event)
        found = []
        for property_, place, conjuncts in goals:
            name = "-".join(filter(None, (property_.name, where, place)))
            assumed = tuple(demands) if place else ended
            found.append(self.one(name, property_.name, None, assumed, conjuncts))
        wanted = tuple([d for d in demands if d.term is not t.TRUE])
        if wanted:
            found.append(self.one(f"well-defined-{where}", WELL_DEFINED, "well-defined", (), wanted))
        return found

    def one(
        self, name: str, invariant: str, kind: Kind | None, assumed: tuple[Fact, ...], conjuncts: tuple[Fact, ...]
    ) -> Obligation:
        program = self.stage.setting.program
        goal = None
        if self.kind != "consistency":
            line = conjuncts[0].line if conjuncts else self.line
            goal = Fact(invariant, t.all_of([c.term for c in conjuncts]), program.path, line)
        facts = self.before(invariant) + assumed
        for fact in (*assumed, *([goal] if goal else [])):
            self.traits |= fact.term.traits
        return Obligation(
            name, kind or self.kind, invariant, self.event, program.path, self.line, self.logic(), facts,
            goal, "sat" if goal is None else "unsat", conjuncts, self.cells, self.complete,
            self.stage.setting.robots, self.notes,
        )  # fmt: skip

    def before(self, invariant: str) -> tuple[Fact, ...]:
        """The facts, without that this invariant, or one behind it, holds afterwards."""
        names = [p.name for p in self.stage.setting.invariants]
        if invariant in names:
            names = names[names.index(invariant) :]
        later = {f"invariant {name}{AFTERWARDS}" for name in names}
        return tuple([fact for fact in self.facts if fact.label not in later])

    def logic(self) -> str:
        """The logic of SMT-LIB that all terms of the room are in."""
        return f"QF_UF{'N' if self.traits & t.NONLINEAR else 'L'}{'IRA' if self.traits & t.REALS else 'IA'}"
