"""From a program to its obligations: the mission's start, each event, the environment's step.

Induction: the invariants hold when all robots have run `init`; each event of each robot keeps them, whatever others did
in the round by then; and so does each moment of the environment's step. docs/explanation/proofs.md argues that this
suffices.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Literal, NamedTuple

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.tree import walk
from koordgen.lang.node import replace
from koordgen.verify.prove.encode.loop import conjuncts, temps_of
from koordgen.verify.prove.encode.state import Begun, Free, Moved, State, Written
from koordgen.verify.prove.encode.stmt import Frame, Head
from koordgen.verify.prove.encode.values import Val
from koordgen.verify.prove.obligations.begin import Launch, Ready, Run, ended, launched
from koordgen.verify.prove.obligations.goal import goal, goal_at
from koordgen.verify.prove.obligations.loops import stating
from koordgen.verify.prove.obligations.moment import Setting, Stage, Told
from koordgen.verify.prove.obligations.priority import assume_priority
from koordgen.verify.prove.obligations.within import changes
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.obligation import AtHead, Cell, Fact, Kind, Moment, Obligation
from koordgen.verify.prove.smt.term import Term

WELL_DEFINED = "(well-defined)"
AFTERWARDS = " afterwards"
OF_TWO = "(two robots)"
CONSISTENT = ("initially", "environment")  # what is asked of the assumptions, whatever the program does


class Goal(NamedTuple):
    """One goal of an invariant, in parts. At a loop's head, `at` says which head and which formula, `place`
    is "entry" or "turn", and only what is known at that place may be used: facts up to `position`, and `demands`."""

    invariant: str
    conjuncts: tuple[Fact, ...]
    at: AtHead | None = None
    place: str = ""
    line: int = 0
    position: int = 1 << 30
    demands: tuple[Fact, ...] = ()


def obligations(
    program: Program, robots: int | None = None, params: Mapping[str, ir.Expr] | None = None, told: Told = "usual",
    dropped: frozenset[AtHead] = frozenset(), event: str | None = None,
) -> list[Obligation]:  # fmt: skip
    """Everything that is to be shown of a checked program: for `robots` robots, or for any number of them; with the
    values of `params`, the others being any. To leave an invariant out, or to add one, hand over a program without or
    with it; `dropped` are formulas that are not assumed at heads of loops. `told`: how much of what is known of
    distances and of the round; "most" is slower to solve, and what a counterexample must satisfy; with "little" there
    are no cells. `event`: only those of one event, of "init", of "(environment)" or of a function."""
    return [obligation for room in rooms(program, robots, params, told, dropped, event) for obligation in room]


def rooms(
    program: Program, robots: int | None = None, params: Mapping[str, ir.Expr] | None = None, told: Told = "usual",
    dropped: frozenset[AtHead] = frozenset(), event: str | None = None,
) -> Iterator[list[Obligation]]:  # fmt: skip
    """The same, by and by: those that share their facts together."""
    t.forget()
    setting = Setting(program, robots, params, told, dropped)
    if event is None:
        yield from ([obligation] for obligation in consistency(setting))
    for part in parts(setting):
        if event is None or part.name == event:
            yield written_down(setting, part)


class Part(NamedTuple):
    """A part of a program whose obligations share their facts. `write` encodes it. `invariants` are the names of those
    that have an obligation in it, `block` the statements with its loops."""

    kind: Kind
    name: str
    line: int
    invariants: tuple[str, ...]
    block: stmt.Block
    write: Callable[[], list[Obligation]]


def parts(setting: Setting) -> Iterator[Part]:
    """The parts of a program in the order in which they are asked."""
    program, names = setting.program, tuple([p.name for p in setting.invariants])
    for function in stating(program):
        write = partial(of_function, setting, function)
        yield Part("loop", function.name, function.span.line, (), function.block, write)
    line = program.init[0].span.line if program.init else 1
    if program.init:
        yield Part("base", "init", line, (WELL_DEFINED,), program.init, partial(of_init, setting))
    yield Part("base", "init", line, names, (), partial(base, setting))
    for event in program.events:
        touched = tuple([p.name for p in setting.touched(setting.changed(event))])
        write = partial(of_event, setting, event)
        yield Part("event", event.name, event.span.line, (*touched, WELL_DEFINED), event.effect, write)
    touched = tuple([p.name for p in setting.touched(setting.sensors)])
    line = program.modules[0].span.line if program.modules else 1
    yield Part("environment", "(environment)", line, touched, (), partial(environment, setting))


def written_down(setting: Setting, part: Part) -> list[Obligation]:
    """The obligations of a part. If its formulas are too large, its obligations are there without formulas."""
    t.count_anew()
    try:
        return part.write()
    except t.TooLarge as error:
        reason = str(error)
    found = []
    for name in part.invariants:
        kind: Kind = "well-defined" if name == WELL_DEFINED else part.kind
        found.append(_unwritten(setting, _named(name, part.kind, part.name), name, kind, part, reason))
    for loop in walk(part.block):
        if isinstance(loop, (stmt.For, stmt.While)):
            for at, _ in setting.loops.stated(loop):
                name = _named_at_head(at.invariant, part.kind, part.name, loop.span.line, "entry")
                found.append(replace(_unwritten(setting, name, at.invariant, "loop", part, reason), at=at))
    return found


def _unwritten(setting: Setting, name: str, invariant: str, kind: Kind, part: Part, reason: str) -> Obligation:
    """An obligation whose formulas are too large: its goal is false, so that no solver can prove it."""
    path, robots = setting.program.path, setting.robots
    goal = None if kind == "consistency" else Fact(invariant, t.FALSE, path, part.line)
    expected: Literal["sat", "unsat"] = "sat" if goal is None else "unsat"
    return Obligation(name, kind, invariant, part.name, path, part.line, "QF_UFLIA", (), goal, expected, (), (),
                      robots, (reason,), None, reason)  # fmt: skip


def _named(invariant: str, kind: Kind, event: str) -> str:
    where = {"base": "init", "environment": "environment"}.get(kind, event)
    return f"{'well-defined' if invariant == WELL_DEFINED else invariant}-{where}"


def _named_at_head(invariant: str, kind: Kind, event: str, line: int, place: str) -> str:
    return f"{_named(invariant.replace(' ', '-'), kind, event)}-loop-{line}-{place}"


def assumptions(
    program: Program, robots: int | None = None, params: Mapping[str, ir.Expr] | None = None
) -> list[Obligation]:
    """Those of the obligations that ask whether what is assumed can be true."""
    t.forget()
    return consistency(Setting(program, robots, params, "little"))


def consistency(setting: Setting) -> list[Obligation]:
    """All that is asked of the assumptions, whatever the program does."""
    asked = [(name, False) for name in CONSISTENT]
    assumed = [a.formula for module in setting.program.modules for a in module.assumptions]
    if setting.robots is None and any(isinstance(node, ir.Pid) for node in walk(tuple(assumed))):
        asked.append(("environment", True))
    return [_consistency(setting, name, of_two) for name, of_two in asked]


def _consistency(setting: Setting, name: str, of_two: bool) -> Obligation:
    t.count_anew()
    try:
        return consistent(setting, name, of_two)
    except t.TooLarge as error:
        part = Part("consistency", OF_TWO if of_two else "", 1, (), (), list)
        return _unwritten(setting, _named_of_assumptions(name, of_two), "", "consistency", part, str(error))


def _named_of_assumptions(name: str, of_two: bool) -> str:
    return f"consistency-{name}{'-of-two' if of_two else ''}"


def of_function(setting: Setting, function: decl.Function) -> list[Obligation]:
    """The invariants that stand at a function's loops, for arguments of which nothing is known."""
    stage = Stage(setting)
    room = stage.room
    args = tuple([room.any(parameter.name.split("@")[0], parameter.type) for parameter in function.parameters])
    frame = stage.functions.frame(function, args, setting.loops.way)
    with room.aside(), room.about(f"function {function.name}", function.span.line):
        frame.block(function.block)
    goals = at_heads(stage, frame.heads)
    out = _Output(stage, "loop", function.name, function.span.line, stage.close(), ())
    return out.all(goals, (), ())


def of_init(setting: Setting) -> list[Obligation]:
    """One robot's init: that it has a result, and what holds at the heads of its loops."""
    stage, program = Stage(setting), setting.program
    launch = Launch(stage)
    run = Run(stage, launch, stage.room.acting("pid"))
    launched(stage, launch)
    goals = at_heads(stage, run.frame.heads)
    cells = stage.cells([("before", launch)])
    out = _Output(stage, "base", "init", program.init[0].span.line, stage.close(), cells)
    return out.all(goals, run.demands, ())


def base(setting: Setting) -> list[Obligation]:
    """The invariants hold when every robot's init has ended."""
    stage, program = Stage(setting), setting.program
    ready = Ready(stage)
    launched(stage, ready.launch)
    stage.room.some_robot("pid")
    goals = [Goal(p.name, goal(stage, p, ready)) for p in setting.invariants]
    cells = stage.cells([("before", ready.launch), ("after", ready)])
    line = program.init[0].span.line if program.init else 1
    out = _Output(stage, "base", "init", line, stage.close(), cells)
    return out.all(goals, (), ())


def of_event(setting: Setting, event: decl.Event) -> list[Obligation]:
    stage, program = Stage(setting), setting.program
    room = stage.room
    own = room.acting("pid")
    now = Free(room, setting.types)
    begun = Begun(now, Free(room, setting.types, "@start"), own, setting.sensors - setting.cleared)
    seen: State = begun if event.lock is None else now

    def ask(node: ir.PortCall, args: tuple[Val, ...]) -> Val:
        answer = room.any(f"{node.module}.{node.port}", node.type)
        stage.answered(node, args, answer, own, now)
        return answer

    assume_priority(stage, event, own, now, begun)
    frame = Frame(stage.encoder, own, now, seen, ask, temps_of(event.effect), stage.know, setting.loops.way)
    frame.brief = stage.brief
    with room.aside() as demands:
        with room.about(f"guard of {event.name}", event.guard.span.line):
            guarded(stage, event.guard, frame)
            now.read.clear()
        with room.about(f"effect of {event.name}", event.span.line):
            live = frame.block(event.effect)
    ends = t.any_of([live, *[t.all_of(e.path) for e in frame.exits]])
    after = Written(room, now, own, ended(program, frame.writes(), now, own), "@after")
    stage.holds(setting.invariants, now)
    goals = at_heads(stage, frame.heads)
    goals += [Goal(p.name, goal(stage, p, after)) for p in setting.touched(setting.changed(event))]
    room.instantiate()
    moments: list[tuple[Moment, State]] = [("before", now), ("after", after)]
    if begun.used:
        stage.holds(setting.invariants, begun, when=" at the round's start")
        changes(stage, begun, now)
        moments.insert(0, ("round start", begun))
    cells = stage.cells(moments)
    out = _Output(stage, "event", event.name, event.span.line, stage.close(), cells)
    over = Fact(f"{event.name} ends", ends, program.path, event.span.line)
    found = out.all(goals, demands, (*demands, over))
    if any(stage.is_assumed_of_calls(fact) for fact in out.facts):
        found.append(out.satisfiable(f"consistency-{event.name}", (*demands, over)))
    return found


def guarded(stage: Stage, guard: ir.Expr, frame: Frame) -> None:
    """The guard holds, if all of it has a value: otherwise it would show that its own operations have one. Of the parts
    before the first such operation it is learned that they hold."""
    room = stage.room
    parts: list[Term] = []
    for part in conjuncts(guard):
        with room.under(*parts):
            parts.append(stage.encoder.term(part, frame))
        if not room.demands:
            room.learn(parts[-1])
    room.fact(t.implies(t.all_of([demand.term for demand in room.demands]), t.all_of(parts)))


def environment(setting: Setting) -> list[Obligation]:
    """Of the invariants in their order each may use that those before it hold after the step, too."""
    stage = Stage(setting)
    now = Free(stage.room, setting.types)
    after = Moved(now, Free(stage.room, setting.types, "@after"), setting.sensors)
    stage.holds(setting.invariants, now)
    stage.ports(now, after)
    goals = [Goal(p.name, goal(stage, p, after)) for p in setting.touched(setting.sensors)]
    if not goals:
        return []
    stage.holds(setting.invariants, after, when=AFTERWARDS)
    cells = stage.cells([("before", now), ("after", after)])
    lines = [m.span.line for m in setting.program.modules]
    out = _Output(stage, "environment", "(environment)", lines[0] if lines else 1, stage.close(), cells)
    return out.all(goals, (), ())


def consistent(setting: Setting, name: str, of_two: bool = False) -> Obligation:
    """Ask whether the assumptions can be true: at the mission's start (params, sensors, spec functions, contracts and
    answers of callable ports), or of a step of the environment within the invariants. `of_two`: in a fleet of at least
    two robots, since assumptions that read `pid` may contradict one another for robot 1 and not for robot 0."""
    stage = Stage(setting, thorough=True)
    room = stage.room
    room.robot(t.integer(0), known=True)
    if of_two:
        room.fact(t.at_most(t.integer(2), room.size), "there are two robots")
        room.robot(t.integer(1), known=True)
    if name == "initially":
        launch = Launch(stage)
        launched(stage, launch)
        stage.any_axioms()
        stage.any_contracts()
        stage.any_answers(Free(room, setting.types))
        cells = stage.cells([("before", launch)])
    else:
        now = Free(room, setting.types)
        after = Moved(now, Free(room, setting.types, "@after"), setting.sensors)
        stage.holds(setting.invariants, now)
        stage.ports(now, after)
        cells = stage.cells([("before", now), ("after", after)])
    event = OF_TWO if of_two else ""
    out = _Output(stage, "consistency", event, 1, stage.close(), cells)
    return out.one(_named_of_assumptions(name, of_two), Goal("", ()), None, ())


def at_heads(stage: Stage, heads: Sequence[Head]) -> list[Goal]:
    """Goals of the formulas that are assumed at heads: each holds where its loop begins, and each turn keeps it."""
    loops = stage.setting.loops
    found = []
    for head in heads:
        places = [("entry", head.entry)] + ([("turn", head.back)] if head.back is not None else [])
        for name, place in places:
            line, position, demands = head.loop.span.line, place.position, place.demands
            for at, formula in loops.stated(head.loop):
                parts = goal_at(stage, f"loop invariant of {at.owner}", formula, place.frame, place.path)
                found.append(Goal(at.invariant, parts, at, name, line, position, demands))
            for at, property_ in loops.tried(head.loop):
                formula, scope = stage.at_head(at, property_, place.frame.state())
                parts = goal_at(stage, f"invariant {property_.name}", formula, scope, place.path)
                found.append(Goal(at.invariant, parts, at, name, line, position, demands))
    return found


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
        self.names: Counter[str] = Counter()

    def all(self, goals: Sequence[Goal], demands: Sequence[Fact], ended: tuple[Fact, ...]) -> list[Obligation]:
        """One for each goal, and one that every operation has a value. Goals assume that: an event in which an
        operation has none is discarded, and changes nothing. `ended`: that the effect has come to its end, which it has
        not at a loop's head."""
        found = []
        for wanted in goals:
            if wanted.at is None:
                found.append(self.one(_named(wanted.invariant, self.kind, self.event), wanted, None, ended))
            else:
                name = _named_at_head(wanted.invariant, self.kind, self.event, wanted.line, wanted.place)
                found.append(self.one(name, wanted, "loop", wanted.demands))
        parts = tuple([d for d in demands if d.term is not t.TRUE])
        if parts:
            name = _named(WELL_DEFINED, self.kind, self.event)
            found.append(self.one(name, Goal(WELL_DEFINED, parts), "well-defined", ()))
        return found

    def one(self, name: str, wanted: Goal, kind: Kind | None, assumed: tuple[Fact, ...]) -> Obligation:
        program, conjuncts = self.stage.setting.program, wanted.conjuncts
        self.names[name] += 1
        if self.names[name] > 1:  # a loop within one that is written out
            name = f"{name}-{self.names[name]}"
        goal = None
        if self.kind != "consistency":
            line = conjuncts[0].line if conjuncts else self.line
            goal = Fact(wanted.invariant, t.all_of([c.term for c in conjuncts]), program.path, line)
        facts = self.before(wanted) + assumed
        for fact in (*assumed, *([goal] if goal else [])):
            self.traits |= fact.term.traits
        return Obligation(
            name, kind or self.kind, wanted.invariant, self.event, program.path, self.line, self.logic(), facts,
            goal, "sat" if goal is None else "unsat", conjuncts, self.cells,
            self.stage.setting.robots, self.notes, wanted.at,
        )  # fmt: skip

    def satisfiable(self, name: str, assumed: tuple[Fact, ...]) -> Obligation:
        """Ask whether the event can get to its end, with what is assumed of the calls on its way."""
        found = self.one(name, Goal("", ()), "consistency", assumed)
        return replace(found, goal=None, expected="sat")

    def before(self, wanted: Goal) -> tuple[Fact, ...]:
        """The facts that a goal may use: none of later places of the event, and none that says that this invariant, or
        one behind it, holds after a step of the environment."""
        names = [p.name for p in self.stage.setting.invariants]
        if wanted.invariant in names:
            names = names[names.index(wanted.invariant) :]
        later = {f"invariant {name}{AFTERWARDS}" for name in names}
        return tuple([f for f in self.facts if f.position <= wanted.position and f.label not in later])

    def logic(self) -> str:
        """The logic of SMT-LIB that all terms of the room are in."""
        return f"QF_UF{'N' if self.traits & t.NONLINEAR else 'L'}{'IRA' if self.traits & t.REALS else 'IA'}"
