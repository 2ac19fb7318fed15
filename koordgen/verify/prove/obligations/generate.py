"""Generator of proof obligations for the mission's start, each event, and the environment's step.

The proof is by induction. Base case: the invariants hold after all robots have run `init`. Induction steps: each event
of each robot preserves the invariants, whatever other robots did earlier in the round. The environment's step also
preserves the invariants, at each instant of the step. docs/explanation/proofs.md argues why these steps suffice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Literal, NamedTuple

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.tree import walk
from koordgen.lang.node import replace
from koordgen.verify.prove.encode.loop import conjuncts, temps_of
from koordgen.verify.prove.encode.state import ArbitraryState, HavockedState, RoundStart, SymbolicState, UpdatedState
from koordgen.verify.prove.encode.stmt import LoopHead, SymbolicFrame
from koordgen.verify.prove.encode.values import Val
from koordgen.verify.prove.obligations.goal import goal, goal_at
from koordgen.verify.prove.obligations.guarantees import (
    FIRST_VALUES,
    REFLEXIVE,
    TRANSITIVE,
    assume_imports,
    assume_launch,
    assume_since_start,
    assume_state,
    goals_of_step,
    init_guarantees,
    of_first_values,
    of_init_guarantees,
    of_others,
    of_reflexivity,
    of_transitivity,
    own_state_guarantees,
    own_step_guarantees,
    sensed_ports,
)
from koordgen.verify.prove.obligations.interface import ALONE, Interface
from koordgen.verify.prove.obligations.interference import assume_interference
from koordgen.verify.prove.obligations.loops import functions_with_invariants
from koordgen.verify.prove.obligations.mission_start import (
    InitRun,
    LaunchState,
    StartState,
    assume_initially,
    cleared_sensors,
)
from koordgen.verify.prove.obligations.output import (
    AFTERWARDS,
    OF_TWO,
    WELL_DEFINED,
    Goal,
    PartOutput,
    named,
    named_at_head,
)
from koordgen.verify.prove.obligations.part_encoder import Detail, PartEncoder, ProofProblem
from koordgen.verify.prove.obligations.priority import assume_priority
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.obligation import HeadFormula, Kind, LabelledFormula, Obligation, StateName
from koordgen.verify.prove.smt.term import Term

# Names of the consistency obligations. Every program has them: they ask whether its assumptions are satisfiable.
CONSISTENT = ("initially", "environment")


def obligations(
    program: Program, robots: int | None = None, params: Mapping[str, ir.Expr] | None = None, detail: Detail = "usual",
    dropped: frozenset[HeadFormula] = frozenset(), event: str | None = None, interface: Interface = ALONE,
) -> list[Obligation]:  # fmt: skip
    """Return all obligations of a checked program.

    `robots`: the number of robots; None for any number.
    `params`: the values of fixed params. All other params are arbitrary.
    `detail`: the amount of facts that are added about distances and the round. "most" is slower to solve, but its
        counterexamples satisfy more facts. "little" omits the names of state values, which counterexamples need.
    `dropped`: formulas that are not assumed at heads of loops.
    `event`: return only the obligations of this event, of "init", "(environment)" or a function.
    `interface`: the interface to the other applications of the fleet.

    To drop or add an invariant, pass a program without or with this invariant."""
    return [
        obligation
        for group in obligation_groups(program, robots, params, detail, dropped, event, interface)
        for obligation in group
    ]


def obligation_groups(
    program: Program, robots: int | None = None, params: Mapping[str, ir.Expr] | None = None, detail: Detail = "usual",
    dropped: frozenset[HeadFormula] = frozenset(), event: str | None = None, interface: Interface = ALONE,
) -> Iterator[list[Obligation]]:  # fmt: skip
    """Yield the obligations of a checked program in groups. The obligations of a group share their facts.

    The parameters are those of `obligations`."""
    t.forget()
    problem = ProofProblem(program, robots, params, detail, dropped, interface)
    if event is None:
        yield from ([obligation] for obligation in consistency(problem))
    for part in parts(problem):
        if event is None or part.name == event:
            yield obligations_of(problem, part)


class Part(NamedTuple):
    """Part of a program whose obligations share their facts.

    `write`: encodes the part and returns its obligations.
    `invariants`: names of the invariants that have an obligation in the part.
    `block`: the statements that contain the part's loops."""

    kind: Kind
    name: str
    line: int
    invariants: tuple[str, ...]
    block: stmt.Block
    write: Callable[[], list[Obligation]]


def parts(problem: ProofProblem) -> Iterator[Part]:
    """Yield the parts of a program, in the order in which the solver receives their obligations."""
    program, names = problem.program, tuple([p.name for p in problem.invariants])
    for function in functions_with_invariants(program):
        write = partial(of_function, problem, function)
        yield Part("loop", function.name, function.span.line, (), function.block, write)
    line = program.init[0].span.line if program.init else 1
    if program.init:
        yield Part("base", "init", line, (WELL_DEFINED,), program.init, partial(of_init, problem))
    yield Part("base", "init", line, names, (), partial(base, problem))
    for event in program.events:
        changed = problem.changed(event)
        touched = tuple([p.name for p in problem.touched(changed)] + [g.label for g in problem.interface.of(changed)])
        write = partial(of_event, problem, event)
        yield Part("event", event.name, event.span.line, (*touched, WELL_DEFINED), event.effect, write)
    touched = tuple([p.name for p in problem.touched(problem.sensors)])
    line = program.modules[0].span.line if program.modules else 1
    yield Part("environment", "(environment)", line, touched, (), partial(environment, problem))
    if problem.interface is not ALONE:
        yield from interface_parts(problem, line)


def interface_parts(problem: ProofProblem, line: int) -> Iterator[Part]:
    """Yield the parts that a program has because of its exports and imports."""
    first = own_state_guarantees(problem)
    if first:
        names = tuple([g.label for g in first])
        yield Part("guarantee", FIRST_VALUES, first[0].line, names, (), partial(of_first_values, problem))
    after_init = init_guarantees(problem)
    if after_init:
        names = tuple([g.label for g in after_init])
        yield Part("guarantee", "init", line, names, (), partial(of_init_guarantees, problem))
    touched = tuple([p.name for p in problem.touched(problem.interface.moved)])
    if touched:
        yield Part("interference", problem.interface.others, line, touched, (), partial(of_others, problem))
    for g in own_step_guarantees(problem):
        for event, write in ((REFLEXIVE, of_reflexivity), (TRANSITIVE, of_transitivity)):
            yield Part("guarantee", event, g.line, (g.label,), (), partial(write, problem, g))


def obligations_of(problem: ProofProblem, part: Part) -> list[Obligation]:
    """Return the obligations of a part.

    If the part's formulas are too large, return each obligation without formulas, so that the obligation stays
    unproved."""
    t.count_anew()
    try:
        return part.write()
    except t.EncodingTooLarge as error:
        reason = str(error)
    found = []
    for name in part.invariants:
        kind: Kind = "well-defined" if name == WELL_DEFINED else part.kind
        found.append(_too_large(problem, named(name, part.kind, part.name), name, kind, part, reason))
    for loop in walk(part.block):
        if isinstance(loop, (stmt.For, stmt.While)):
            for at, _ in problem.loops.stated(loop):
                name = named_at_head(at.invariant, part.kind, part.name, loop.span.line, "entry")
                found.append(replace(_too_large(problem, name, at.invariant, "loop", part, reason), at=at))
    return found


def _too_large(problem: ProofProblem, name: str, invariant: str, kind: Kind, part: Part, reason: str) -> Obligation:
    """Return an obligation of a part whose formulas are too large.

    The goal of the obligation is false, so no solver can prove it."""
    path, robots = problem.program.path, problem.robots
    goal = None if kind == "consistency" else LabelledFormula(invariant, t.FALSE, path, part.line)
    expected: Literal["sat", "unsat"] = "sat" if goal is None else "unsat"
    return Obligation(name, kind, invariant, part.name, path, part.line, "QF_UFLIA", (), goal, expected, (), (),
                      robots, (reason,), None, reason)  # fmt: skip


def assumptions(
    program: Program, robots: int | None = None, params: Mapping[str, ir.Expr] | None = None,
    interface: Interface = ALONE,
) -> list[Obligation]:  # fmt: skip
    """Return the obligations that ask whether a program's assumptions are satisfiable."""
    t.forget()
    return consistency(ProofProblem(program, robots, params, "little", frozenset(), interface))


def consistency(problem: ProofProblem) -> list[Obligation]:
    """Return the consistency obligations of a program, which ask whether its assumptions are satisfiable."""
    asked = [(name, False) for name in CONSISTENT]
    assumed = [a.formula for module in problem.program.modules for a in module.assumptions]
    if problem.robots is None and any(isinstance(node, ir.Pid) for node in walk(tuple(assumed))):
        asked.append(("environment", True))
    return [_consistency(problem, name, of_two) for name, of_two in asked]


def _consistency(problem: ProofProblem, name: str, of_two: bool) -> Obligation:
    t.count_anew()
    try:
        return consistent(problem, name, of_two)
    except t.EncodingTooLarge as error:
        part = Part("consistency", OF_TWO if of_two else "", 1, (), (), list)
        return _too_large(problem, _named_of_assumptions(name, of_two), "", "consistency", part, str(error))


def _named_of_assumptions(name: str, of_two: bool) -> str:
    return f"consistency-{name}{'-of-two' if of_two else ''}"


def of_function(problem: ProofProblem, function: decl.Function) -> list[Obligation]:
    """Return the obligations of the loop invariants in a function, for arbitrary arguments."""
    part_encoder = PartEncoder(problem)
    context = part_encoder.context
    args = tuple([context.any(parameter.name.split("@")[0], parameter.type) for parameter in function.parameters])
    frame = part_encoder.functions.frame(function, args, problem.loops.encoding)
    with context.separate_demands(), context.about(f"function {function.name}", function.span.line):
        frame.block(function.block)
    goals = at_heads(part_encoder, frame.heads)
    out = PartOutput(part_encoder, "loop", function.name, function.span.line, part_encoder.close(), ())
    return out.all(goals, (), ())


def of_init(problem: ProofProblem) -> list[Obligation]:
    """Return the obligations of one robot's `init`.

    All operations of `init` must have values. The loop invariants of `init` must hold."""
    part_encoder, program = PartEncoder(problem), problem.program
    launch = LaunchState(part_encoder)
    run = InitRun(part_encoder, launch, part_encoder.context.acting("pid"))
    assume_initially(part_encoder, launch)
    assume_launch(part_encoder, launch)
    goals = at_heads(part_encoder, run.frame.heads)
    cells = part_encoder.cells([("before", launch)])
    out = PartOutput(part_encoder, "base", "init", program.init[0].span.line, part_encoder.close(), cells)
    return out.all(goals, run.demands, ())


def base(problem: ProofProblem) -> list[Obligation]:
    """Return the base case: the invariants hold after every robot's `init` has ended."""
    part_encoder, program = PartEncoder(problem), problem.program
    ready = StartState(part_encoder, problem.interface.moved - problem.interface.commands)
    assume_initially(part_encoder, ready.launch)
    assume_launch(part_encoder, ready.launch)
    assume_state(part_encoder, ready, problem.interface.foreign, " after init")
    part_encoder.context.some_robot("pid")
    goals = [Goal(p.name, goal(part_encoder, p, ready)) for p in problem.invariants]
    cells = part_encoder.cells([("before", ready.launch), ("after", ready)])
    line = program.init[0].span.line if program.init else 1
    out = PartOutput(part_encoder, "base", "init", line, part_encoder.close(), cells)
    return out.all(goals, (), ())


def of_event(problem: ProofProblem, event: decl.Event) -> list[Obligation]:
    part_encoder, program = PartEncoder(problem), problem.program
    context = part_encoder.context
    own = context.acting("pid")
    now = ArbitraryState(context, problem.types)
    interface, unchanged = problem.interface, problem.sensors - problem.cleared
    if interface is not ALONE:
        unchanged = (unchanged | interface.pids) - interface.ports
    other = ArbitraryState(context, problem.types, "@start")
    round_start = RoundStart(now, other, own, unchanged, interface.ports)
    sensed = sensed_ports(part_encoder, own, now, round_start)
    seen: SymbolicState = round_start if event.lock is None else now

    def ask(node: ir.PortCall, args: tuple[Val, ...]) -> Val:
        answer = context.any(f"{node.module}.{node.port}", node.type)
        part_encoder.answered(node, args, answer, own, now)
        return answer

    assume_priority(part_encoder, event, own, now, round_start, sensed)
    frame = SymbolicFrame(
        part_encoder.encoder,
        own,
        now,
        seen,
        ask,
        temps_of(event.effect),
        part_encoder.assume_at_head,
        problem.loops.encoding,
    )
    frame.brief, frame.sensed = part_encoder.brief, sensed
    with context.separate_demands() as demands:
        with context.about(f"guard of {event.name}", event.guard.span.line):
            assume_guard(part_encoder, event.guard, frame)
            now.read.clear()
        with context.about(f"effect of {event.name}", event.span.line):
            live = frame.block(event.effect)
    ends = t.any_of([live, *[t.all_of(e.path) for e in frame.exits]])
    writes = frame.writes()
    changes = {**frame.changes(writes), **cleared_sensors(program, writes, now, own)}
    after = UpdatedState(context, now, own, changes, "@after")
    part_encoder.holds(problem.invariants, now)
    goals = at_heads(part_encoder, frame.heads)
    goals += [Goal(p.name, goal(part_encoder, p, after)) for p in problem.touched(problem.changed(event))]
    goals += goals_of_step(part_encoder, problem.changed(event), now, after)
    assume_imports(part_encoder, now)
    assume_state(part_encoder, now)
    context.instantiate()
    states: list[tuple[StateName, SymbolicState]] = [("before", now), ("after", after)]
    if round_start.used:
        part_encoder.holds(problem.invariants, round_start, when=" at the round's start")
        assume_interference(part_encoder, round_start, now)
        assume_since_start(part_encoder, round_start, now)
        states.insert(0, ("round start", round_start))
    cells = part_encoder.cells(states)
    out = PartOutput(part_encoder, "event", event.name, event.span.line, part_encoder.close(), cells)
    over = LabelledFormula(f"{event.name} ends", ends, program.path, event.span.line)
    found = out.all(goals, demands, (*demands, over))
    if any(part_encoder.is_assumed_of_calls(fact) for fact in out.facts):
        found.append(out.satisfiable(f"consistency-{event.name}", (*demands, over)))
    return found


def assume_guard(part_encoder: PartEncoder, guard: ir.Expr, frame: SymbolicFrame) -> None:
    """Assume that an event's guard is true, on the condition that all operations of the guard have values.

    Without the condition, the guard could prove that its own operations have values. Such a proof would be circular.
    The conjuncts before the first operation that may lack a value need no condition. They may fix values of variables;
    terms that are built later use these values.
    """
    context = part_encoder.context
    parts: list[Term] = []
    for part in conjuncts(guard):
        with context.under(*parts):
            parts.append(part_encoder.encoder.term(part, frame))
        if not context.demands:
            context.learn(parts[-1])
    context.fact(t.implies(t.all_of([demand.term for demand in context.demands]), t.all_of(parts)))


def environment(problem: ProofProblem) -> list[Obligation]:
    """Return the obligations of the environment's step.

    The obligation of an invariant may assume that earlier invariants hold after the step."""
    part_encoder = PartEncoder(problem)
    now = ArbitraryState(part_encoder.context, problem.types)
    after = HavockedState(now, ArbitraryState(part_encoder.context, problem.types, "@after"), problem.sensors)
    part_encoder.holds(problem.invariants, now)
    part_encoder.ports(now, after)
    assume_imports(part_encoder, now)
    assume_state(part_encoder, now)
    goals = [Goal(p.name, goal(part_encoder, p, after)) for p in problem.touched(problem.sensors)]
    if not goals:
        return []
    part_encoder.holds(problem.invariants, after, when=AFTERWARDS)
    cells = part_encoder.cells([("before", now), ("after", after)])
    lines = [m.span.line for m in problem.program.modules]
    line = lines[0] if lines else 1
    out = PartOutput(part_encoder, "environment", "(environment)", line, part_encoder.close(), cells)
    return out.all(goals, (), ())


def consistent(problem: ProofProblem, name: str, of_two: bool = False, robot: int = 0) -> Obligation:
    """Return an obligation that asks whether assumptions are satisfiable.

    `name`: selects the assumptions. "initially": those at the mission's start, about params, sensors, spec functions,
        contracts and answers of callable ports. "environment": those about a step of the environment from a state in
        which the invariants hold.
    `of_two`: ask about fleets of at least two robots. Assumptions that read `pid` may contradict one another for robot
        1 although they agree for robot 0.
    `robot`: the robot about which is asked first."""
    part_encoder = PartEncoder(problem, thorough=True)
    context = part_encoder.context
    context.robot(t.integer(robot), known=True)
    if of_two:
        context.fact(t.at_most(t.integer(2), context.size), "the fleet has at least two robots")
        context.robot(t.integer(1), known=True)
    if name == "initially":
        launch = LaunchState(part_encoder)
        assume_initially(part_encoder, launch)
        assume_launch(part_encoder, launch)
        part_encoder.any_axioms()
        part_encoder.any_contracts()
        part_encoder.any_answers(ArbitraryState(context, problem.types))
        cells = part_encoder.cells([("before", launch)])
    else:
        now = ArbitraryState(context, problem.types)
        after = HavockedState(now, ArbitraryState(context, problem.types, "@after"), problem.sensors)
        part_encoder.holds(problem.invariants, now)
        part_encoder.ports(now, after)
        assume_imports(part_encoder, now)
        assume_state(part_encoder, now)
        cells = part_encoder.cells([("before", now), ("after", after)])
    event = OF_TWO if of_two else ""
    out = PartOutput(part_encoder, "consistency", event, 1, part_encoder.close(), cells)
    return out.one(_named_of_assumptions(name, of_two), Goal("", ()), None, ())


def at_heads(part_encoder: PartEncoder, heads: Sequence[LoopHead]) -> list[Goal]:
    """Return the goals of the formulas that are assumed at loop heads.

    Each formula must hold at loop entry, and each iteration must preserve the formula."""
    loops = part_encoder.problem.loops
    found = []
    for head in heads:
        places = [("entry", head.entry)] + ([("turn", head.back)] if head.back is not None else [])
        for name, place in places:
            line, position, demands = head.loop.span.line, place.position, place.demands
            for at, formula in loops.stated(head.loop):
                parts = goal_at(part_encoder, f"loop invariant of {at.owner}", formula, place.frame, place.path)
                found.append(Goal(at.invariant, parts, at, name, line, position, demands))
            for at, property_ in loops.candidates(head.loop):
                formula, scope = part_encoder.at_head(at, property_, place.frame.state())
                parts = goal_at(part_encoder, f"invariant {property_.name}", formula, scope, place.path)
                found.append(Goal(at.invariant, parts, at, name, line, position, demands))
    return found
