"""Judge of an attack: runs steps of a program, and evaluates PROVED invariants after each step.

The executable semantics (`koordgen.lang.semantics`) decides which events may run, which values they write, and how
sensors may change. Sometimes an invariant cannot be evaluated in a state, because of an irrational root or a
`spec fun`. Such a state is no contradiction, and the report does not count it for this invariant.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import NamedTuple

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import Part, walk
from koordgen.lang.ir.types import BOOL
from koordgen.lang.node import replace
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exact import NotExact
from koordgen.lang.semantics.exec import UNFINISHED, NoMeaning, Writes
from koordgen.lang.semantics.property import holds_property
from koordgen.lang.semantics.relations import choices
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.step import Step, applied, enabled, execute, run_init, sense
from koordgen.lang.semantics.values import Value
from koordgen.lang.source import Span
from koordgen.verify.attack.ports import TURNS, AttackPorts, Draw, PortAnswer
from koordgen.verify.prove.report.model import is_allowed
from koordgen.verify.prove.report.model_reader import Unshowable

WELL_DEFINED = "(well-defined)"
INIT, ENVIRONMENT, COMMANDS = "init", "(environment)", "(commands from outside)"
# Beginning of the semantics' message about a fault that the compiler proved to be impossible.
PROVED_RIGHT = "proved to have a value, but: "
# Beginnings of the semantics' messages about faults that the invariant `(well-defined)` excludes. The invariant does
# not exclude that an event exceeds a capacity, the range of 64-bit ints or the number of loop iterations, or that an
# `ensures` or a port discards the event.
COVERED = (
    "index ", "a slice from", "what is looked for is not there", "the map has no such key",
    "math domain error", "an int to the power of a negative one",
)  # fmt: skip
COVERED_WITHIN = (" by zero", " is no place in a list of ", " requires what does not hold")
NO_VALUES: Mapping[str, Value] = {}
TRUE = ir.Const(True, BOOL, Span(1, 1, 1, 1))
FALLIBLE = frozenset(
    ("first", "last", "index", "map_at", "sqrt", "updated", "without", "inserted", "popped", "removed", "set_without",
     "map_without")
)  # fmt: skip


class Act(NamedTuple):
    """One step of a run: an event of a robot, `init` of all robots, a step of the environment, or commands.

    `event`: name of the event, INIT, ENVIRONMENT or COMMANDS.
    `pid`: robot that runs the event; None for INIT and ENVIRONMENT, which are steps of all robots, and for COMMANDS.
    `sensors`: new sensor values of each robot after a step of the environment.
    `commands`: new values of the variables that another fleet commands; see decl.Provides.
    `answers`: results of the port calls in this step."""

    event: str
    pid: int | None = None
    sensors: tuple[Mapping[str, Value], ...] = ()
    answers: tuple[PortAnswer, ...] = ()
    commands: Mapping[str, Value] = NO_VALUES


class Trial(NamedTuple):
    """Trial: a run of the program that may contradict a verdict, given as a first state and the steps from this state.

    The first state is a state before `init` or at the start of a round. In a round, each robot runs at most one event.
    A step of the environment ends the round."""

    state: State
    acts: tuple[Act, ...]


class VerdictBreach(NamedTuple):
    """Name of an invariant whose verdict PROVED is contradicted, and the reason."""

    invariant: str
    why: str


class Contradiction(NamedTuple):
    """Contradiction: a trial whose last step contradicts a PROVED invariant.

    `before`, `after`: states before and after the last step."""

    trial: Trial
    breach: VerdictBreach
    before: State
    after: State


class ReadyEvents(NamedTuple):
    """Events that a robot may run in a state.

    `fault`: step of an event whose guard has no value, which contradicts the verdict on `(well-defined)`; None if all
        guards have values."""

    events: list[decl.Event]
    fault: tuple[Act, VerdictBreach] | None


class ReplayedTrial(NamedTuple):
    """Result of running all steps of a trial.

    `states`: state before the first step, and state after each step.
    `contradiction`: contradiction of a verdict by the last step; None if no verdict is contradicted."""

    states: tuple[State, ...]
    contradiction: Contradiction | None


class UnusableStep(Exception):
    """Raised if an attack cannot use a step, for example because a value is unknown. The message gives the reason."""


class TrialNotCovered(Exception):
    """Raised if the prover's verdicts make no claim about a trial. The message gives the reason."""


class TrialJudge:
    """Judge of the verdicts PROVED on one program: runs steps, and evaluates the PROVED invariants after each step.

    `program`: the program with exact numbers.
    `proved`: names of the PROVED invariants.
    `draw`: proposes results of port calls.
    `counts`: (step, invariant) -> number of states in which the invariant was evaluated after the step.
    `reasons`: (step, invariant) -> reason why the invariant could not be evaluated after the step."""

    def __init__(self, program: decl.Program, proved: Collection[str], draw: Draw) -> None:
        self.program = program
        self.defined = WELL_DEFINED in proved
        self.invariants = [p for p in program.properties if p.kind == "invariant" and p.name in proved]
        self.initially = [p for p in program.properties if p.kind == "initially"]
        self.rigid = [p for property_ in self.initially for p in _conjuncts(property_.formula) if not _of_fleet(p)]
        self.events = {event.name: event for event in program.events}
        # step -> PROVED loop invariants in the step and in the functions that the step calls, each as (name of the step
        # or function, name of the invariant)
        self.at_heads: dict[str, list[tuple[str, str]]] = {}
        for step, block in ((INIT, program.init), *((e.name, e.effect) for e in program.events)):
            self.at_heads[step] = [found for found in _at_heads(program, step, block) if found[1] in proved]
        self.guards = replace(program, events=tuple([replace(event, effect=()) for event in program.events]))
        functions: set[str] = set()
        for function in program.functions:
            functions |= {function.name} if _is_fallible(function.block, functions) else set()
        self.fallible = {event.name for event in program.events if _is_fallible(event.guard, functions)}
        self.ports = AttackPorts(program, draw)
        self.counts: Counter[tuple[str, str]] = Counter()
        self.reasons: dict[tuple[str, str], str] = {}
        self.known: set[tuple[object, ...]] = set()  # keys of all states in which invariants were evaluated

    # Evaluation of invariants in states

    def judged(self, state: State, event: str) -> VerdictBreach | None:
        """Evaluate the PROVED invariants in the state after `event`. Return the first contradiction, or None.

        A state that was already judged after the same event is not judged again."""
        if not self._new(event, key_of(state)):
            return None
        for property_ in self.invariants:
            breach = self._judged(property_, state, event)
            if breach is not None:
                return breach
        return None

    def _judged(self, property_: decl.Property, state: State, event: str) -> VerdictBreach | None:
        key = event, property_.name
        self.ports.lacking = ""
        try:
            if not holds_property(property_, self.program, state, self.ports.world):
                return VerdictBreach(property_.name, "it is false")
        except Discarded as fault:
            if self.ports.lacking or not is_covered(fault.reason):
                self.reasons[key] = self.ports.lacking or fault.reason
                return None
            return VerdictBreach(property_.name, f"the invariant has no value: {fault}")
        except (NotExact, NoMeaning, InternalError) as error:
            self.reasons[key] = str(error)
            return None
        self.counts[key] += 1
        return None

    def _new(self, *what: object) -> bool:
        before = len(self.known)
        self.known.add(what)
        return len(self.known) > before

    def is_start(self, state: State) -> bool:
        """Return whether a mission may begin in a state: whether all formulas of `initially` hold in the state.

        Raises UnusableStep if a formula cannot be evaluated."""
        return all(self._true(property_, state) for property_ in self.initially)

    def violated_hypothesis(self, state: State) -> str:
        """Return the name of the first hypothesis that a state violates; "" if the state satisfies all hypotheses.

        Hypotheses are the PROVED invariants and all formulas of `initially` that read only params. Params never change,
        so such a formula must hold in every state. Raises UnusableStep if a hypothesis cannot be evaluated."""
        for part in self.rigid:
            if not self._true(decl.Property("initially", "", part, part.span), state):
                return f"the formula of `initially` about params in line {part.span.line}"
        return next((p.name for p in self.invariants if not self._true(p, state)), "")

    def _true(self, property_: decl.Property, state: State) -> bool:
        self.ports.begin(state)
        try:
            held = holds_property(property_, self.program, state, self.ports.world)
        except Discarded:
            held = False
        except (NotExact, NoMeaning, InternalError) as error:
            raise UnusableStep(f"{property_.kind} {property_.name} cannot be evaluated: {error}") from None
        if self.ports.lacking:
            raise UnusableStep(self.ports.lacking)
        return held

    # Execution of single steps

    def init(self, state: State, given: Iterable[PortAnswer] | None = None) -> tuple[State, Act, VerdictBreach | None]:
        """Run `init` of all robots, and judge the state after `init`.

        If `init` of a robot is discarded, no mission begins, and most verdicts make no claim. Only `(well-defined)`
        claims that `init` is not discarded. Raises UnusableStep."""
        self.ports.begin(state, given)
        try:
            after, steps = run_init(self.program, state, self.ports.world)
        except (NotExact, NoMeaning) as error:
            raise self._unusable(INIT, str(error)) from None
        except InternalError as error:
            breach = self._fault(INIT, str(error))
            if breach is None:
                raise self._unusable(INIT, str(error)) from None
            return state, self._act(INIT), breach
        if self.ports.lacking:
            raise self._unusable(INIT, self.ports.lacking)
        faults = [step.outcome for step in steps if isinstance(step.outcome, Discarded)]
        ended = [step.outcome for step in steps if isinstance(step.outcome, Writes)]
        breach = next(filter(None, [self._fault(INIT, str(f), f.reason) for f in faults]), None)
        if breach is not None:
            return after, self._act(INIT), breach
        if faults:
            raise self._unusable(INIT, f"no mission begins, because `init` is discarded: {faults[0].reason}")
        if self.defined and self._new(WELL_DEFINED, INIT, key_of(state)):
            self.counts[INIT, WELL_DEFINED] += 1
        broken = next(filter(None, [self._at_head(INIT, None, state, writes) for writes in ended]), None)
        return after, self._act(INIT), broken or self.judged(after, INIT)

    def ready(self, start: State, now: State, pid: int, given: Iterable[PortAnswer] | None = None) -> ReadyEvents:
        """Return the events that robot `pid` may run in state `now` of a round that began in state `start`.

        Raises UnusableStep if a guard cannot be evaluated."""
        self.ports.begin(now, given)
        try:
            steps = choices(self.guards, now, pid, start.store, self.ports.world)
            found = [self.events[step.event] for step in steps if step.event is not None]
            stopped = now.robots[pid].stopped or not self.defined
            return ReadyEvents(found, None if stopped else self._guard_fault(start, now, pid, found))
        except (NotExact, NoMeaning, InternalError) as error:
            raise UnusableStep(f"the guards of robot {pid}'s events cannot be evaluated: {error}") from None

    def _guard_fault(
        self, start: State, now: State, pid: int, found: list[decl.Event]
    ) -> tuple[Act, VerdictBreach] | None:
        """Return the step of the first event whose guard has no value, if this contradicts `(well-defined)`."""
        for event in self.program.events:
            if event.name not in self.fallible or event in found:
                continue
            self.ports.lacking = ""
            try:
                enabled(self.program, event, _seen(event, start, now), pid, self.ports.world)
            except Discarded as fault:
                breach = None if self.ports.lacking else self._fault(event.name, str(fault), fault.reason)
                if breach is not None and self._comes_to(event, start, now, pid):
                    return self._act(event.name, pid), breach
        return None

    def _comes_to(self, event: decl.Event, start: State, now: State, pid: int) -> bool:
        """Return whether a robot may run `event` if the guard of `event` is true.

        The result is False if an event of higher priority runs in place of `event`."""
        events = [replace(e, guard=TRUE) if e.name == event.name else e for e in self.guards.events]
        steps = choices(replace(self.guards, events=tuple(events)), now, pid, start.store, self.ports.world)
        return any(step.event == event.name for step in steps)

    def event(
        self, start: State, now: State, pid: int, event: decl.Event, given: Iterable[PortAnswer] | None = None
    ) -> tuple[State, Act, VerdictBreach | None] | None:
        """Run an event of robot `pid` that `ready` returned, and judge the state after the event.

        Returns None if the event is discarded for a reason that no verdict excludes. Raises UnusableStep."""
        self.ports.begin(now, given)  # again: after `ready`, `ports` may have served another state
        name = event.name
        try:
            outcome = execute(self.program, event.effect, _seen(event, start, now), pid, self.ports.world)
        except (NotExact, NoMeaning) as error:
            raise self._unusable(name, str(error)) from None
        except InternalError as error:
            return now, self._act(name, pid), self._fault(name, str(error))
        if self.ports.lacking:
            raise self._unusable(name, self.ports.lacking)
        if not isinstance(outcome, Writes):
            breach = self._fault(name, str(outcome), outcome.reason)
            if breach is None:
                given_up = outcome.reason == UNFINISHED  # the attack allows far fewer turns than a robot
                why = f"abandoned after {TURNS:,} turns of loops" if given_up else f"discarded: {outcome.reason}"
                self.reasons.setdefault((name, ""), f"each run of the event was {why}")
            return (now, self._act(name, pid), breach) if breach else None
        if self.defined and self._new(WELL_DEFINED, name, pid, key_of(_seen(event, start, now))):
            self.counts[name, WELL_DEFINED] += 1
        broken = self._at_head(name, pid, _seen(event, start, now), outcome)
        after = applied(self.program, now, Step(pid, name, outcome))
        return after, self._act(name, pid), broken or self.judged(after, name)

    def _at_head(self, step: str, pid: int | None, seen: State, writes: Writes) -> VerdictBreach | None:
        """Return the contradiction if a PROVED loop invariant was false at the head of its loop during a step."""
        violated = {f"line {span.line}" for span in writes.violated}
        new = self._new("at heads", step, pid, key_of(seen)) if self.at_heads[step] else False
        for owner, name in self.at_heads[step]:
            if name in violated:
                return VerdictBreach(name, f"the loop invariant is false at its loop's head in {step}")
            self.counts[owner, name] += new
        return None

    def environment(
        self, now: State, sensors: tuple[Mapping[str, Value], ...]
    ) -> tuple[State, Act, VerdictBreach | None]:
        """Run a step of the environment, which sets new sensor values, and judge the state after the step.

        Raises UnusableStep if the program's assumptions do not allow the new values."""
        for pid, (robot, new) in enumerate(zip(now.robots, sensors, strict=True)):
            if not self.may_move(now, pid, {**robot.ports, **new}):
                raise UnusableStep("the assumptions do not allow the new sensor values of this step")
        return self.moved(now, sensors)

    def moved(self, now: State, sensors: tuple[Mapping[str, Value], ...]) -> tuple[State, Act, VerdictBreach | None]:
        """Run a step of the environment without a check of assumptions, and judge the state after the step.

        The caller has checked that the program's assumptions allow the new sensor values."""
        after = sense(now, sensors)._replace(round=now.round + 1)
        return after, Act(ENVIRONMENT, sensors=sensors), self.judged(after, ENVIRONMENT)

    def commanded(self, now: State, commands: Mapping[str, Value]) -> tuple[State, Act, VerdictBreach | None]:
        """Write commands of another fleet into their variables, and judge the state afterwards."""
        after = now._replace(store=now.store._replace(cells={**now.store.cells, **commands}))
        return after, Act(COMMANDS, commands=commands), self.judged(after, COMMANDS)

    def may_move(self, now: State, pid: int, ports: Mapping[str, Value]) -> bool:
        """Return whether the program's assumptions allow that a robot's ports change to the values `ports`.

        Raises UnusableStep if an assumption cannot be evaluated."""
        try:
            return is_allowed(self.program, now.robots[pid].ports, ports, pid, now)
        except (Unshowable, NotExact, NoMeaning, InternalError) as error:
            raise self._unusable(ENVIRONMENT, str(error)) from None

    def _act(self, event: str, pid: int | None = None) -> Act:
        return Act(event, pid, (), self.ports.answers())

    def _unusable(self, event: str, why: str) -> UnusableStep:
        self.reasons[event, ""] = why
        return UnusableStep(why)

    def _fault(self, event: str, message: str, reason: str = "") -> VerdictBreach | None:
        """Return a contradiction if `(well-defined)` is PROVED and claims that the given fault cannot occur.

        `message`: text of the fault.
        `reason`: reason why the event was discarded, or "" for an internal error of the semantics."""
        where = "init" if event == INIT else f"event {event}"
        _, claimed, within = message.partition(PROVED_RIGHT)
        if not is_covered(within if claimed else reason):
            if not reason:
                raise self._unusable(event, message)
            return None
        return VerdictBreach(WELL_DEFINED, f"{where} has no result: {message}") if self.defined else None

    # Execution of whole trials

    def replay(self, trial: Trial) -> ReplayedTrial:
        """Run all steps of a trial from its first state, and check each step.

        Raises TrialNotCovered if the verdicts make no claim about the trial, UnusableStep if a step cannot be used."""
        state, acts = trial.state, trial.acts
        if state.round == 0:
            if not self.is_start(state):
                raise TrialNotCovered("the first state of the trial violates a formula of `initially`")
        elif broken := self.violated_hypothesis(state):
            raise TrialNotCovered(f"the first state of the trial violates {broken}")
        states, start = [state], state
        turns: set[int] = set()  # pids of the robots that have run an event in the present round
        breach: VerdictBreach | None = None
        for act in acts:
            if breach is not None:
                raise TrialNotCovered("the trial has further steps after a step that contradicts a verdict")
            if act.pid in turns:
                raise TrialNotCovered(f"robot {act.pid} runs two events in one round")
            now, breach = self._replayed(start, states[-1], act)
            states.append(now)
            if act.pid is not None:
                turns.add(act.pid)
            elif act.event != COMMANDS:
                start, turns = now, set()
        return ReplayedTrial(tuple(states), Contradiction(trial, breach, *states[-2:]) if breach else None)

    def _replayed(self, start: State, now: State, act: Act) -> tuple[State, VerdictBreach | None]:
        """Run one step of a trial in state `now` of a round that began in state `start`.

        Return the state after the step, and a contradiction or None."""
        if (act.event == INIT) != (now.round == 0):
            raise TrialNotCovered(
                "a trial that begins before round 1 must begin with `init`, and no other step may be `init`"
            )
        if act.event == INIT:
            after, _, breach = self.init(now, act.answers)
            return after, breach
        if act.event == ENVIRONMENT:
            after, _, breach = self.environment(now, act.sensors)
            return after, breach
        if act.event == COMMANDS:
            after, _, breach = self.commanded(now, act.commands)
            return after, breach
        assert act.pid is not None
        ready = self.ready(start, now, act.pid, act.answers)
        for event in ready.events:
            if event.name == act.event:
                step = self.event(start, now, act.pid, event, act.answers)
                if step is None:
                    raise TrialNotCovered(f"event {act.event} of robot {act.pid} is discarded")
                return step[0], step[2]
        if ready.fault is not None and ready.fault[0].event == act.event:
            return now, ready.fault[1]
        raise TrialNotCovered(f"robot {act.pid} may not run event {act.event} at this step of the trial")


def _conjuncts(formula: ir.Expr) -> Iterator[ir.Expr]:
    if isinstance(formula, ir.Logic) and formula.op == "and":
        yield from _conjuncts(formula.left)
        yield from _conjuncts(formula.right)
    else:
        yield formula


def _of_fleet(formula: ir.Expr) -> bool:
    """Return whether a formula reads variables, ports or pids of the fleet, and not only params."""
    return any(isinstance(n, (ir.LocalOf, ir.PortOf, ir.SlotRead, ir.SlotsRead, ir.SharedRead, ir.Ids))
               for n in walk(formula))  # fmt: skip


def _at_heads(program: decl.Program, owner: str, block: Part) -> Iterator[tuple[str, str]]:
    """Yield the loop invariants of a block and of all functions that the block calls, as (owner, name).

    `owner`: name of the event or function that contains the loop. A loop invariant's name is its line."""
    functions = {function.name: function for function in program.functions}
    called: dict[str, Part] = {owner: block}
    for _ in functions:
        names = [n.name for part in called.values() for n in walk(part) if isinstance(n, ir.Call)]
        called.update({name: functions[name].block for name in names if name in functions})
    for name, part in called.items():
        yield from ((name, f"line {n.span.line}") for n in walk(part) if isinstance(n, stmt.LoopInvariant))


def names_of(program: decl.Program) -> list[str]:
    """Return the names of all invariants of a program on which the prover gives a verdict.

    These are `(well-defined)`, the program's invariants, and its loop invariants, which are named by their lines."""
    blocks = (program.init, program.events, program.functions)
    loops = [f"line {n.span.line}" for n in walk(blocks) if isinstance(n, stmt.LoopInvariant)]
    return [WELL_DEFINED, *[p.name for p in program.properties if p.kind == "invariant"], *loops]


def _is_fallible(part: Part, functions: Collection[str]) -> bool:
    """Return whether a part of a program contains an operation that may have no value, such as a division.

    Only operations count that `(well-defined)` promises to have a value.
    `functions`: names of the functions that contain such an operation; a call of these functions counts, too."""
    for node in walk(part):
        match node:
            case ir.SlotRead(_, index):
                found = not isinstance(index, ir.Pid)
            case ir.Binary(op):
                found = op in ("/", "//", "%", "**")
            case ir.Builtin(name):
                found = name in FALLIBLE
            case ir.Call(name):
                found = name in functions
            case _:
                found = isinstance(node, (ir.At, ir.Slice, ir.ExternCall))
        if found:
            return True
    return False


def is_covered(reason: str) -> bool:
    """Return whether the invariant `(well-defined)` excludes faults with the given reason."""
    return reason.startswith(COVERED) or any(part in reason for part in COVERED_WITHIN)


def _seen(event: decl.Event, start: State, now: State) -> State:
    """Return the state that an event reads.

    A transaction reads the present shared variables. Any other event reads the shared variables as they were at the
    start of the round."""
    return now if event.lock is not None else now._replace(store=start.store)


def key_of(state: State) -> tuple[object, ...]:
    """Return a hashable key of a state. States have equal keys if they differ at most in the number of the round."""
    robots = [(*r.locals.values(), None, *r.ports.values(), r.stopped) for r in state.robots]
    store = (*state.store.slots.values(), None, *state.store.cells.values())
    return (*state.params.values(), None, *robots, *store)
