"""Plan of a counterexample for agents: the event that each instance runs in each of the agents' rounds.

An instance is an application on a robot. With one application, its number is the pid of the robot.

In a round of the semantics, atomic events run one after another. Each atomic event reads the store that the previous
event left. In a round of agents, only one instance commits per lock, and all events read the store of the round's
start. So one round of the trace is split into agents' rounds. The plan uses the fewest rounds that lead to the state in
the trace. Sensors keep their values between these rounds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir.ports import clearable, clears
from koordgen.lang.semantics.composition import Application, System
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import Writes, declared
from koordgen.lang.semantics.state import Robot, State, Store, World
from koordgen.lang.semantics.step import Step, enabled, execute, has_priority
from koordgen.lang.semantics.system import (
    InstanceStep,
    SystemState,
    applied_to_system,
    initial_system,
    joined,
    run_inits,
    view,
)
from koordgen.lang.semantics.values import Value
from koordgen.verify.follow.exact import agree, fraction, nearest
from koordgen.verify.follow.read import BEGINNING, ENVIRONMENT, INIT, CounterexampleTrace, TraceStep
from koordgen.verify.replay.values import BadValue, from_trace, plain

# Largest number of events in a round for which every split is tried. With more events, fewer splits are tried.
MOST = 5
# A plan for a deadlock ends with this number of agents' rounds, in which each robot chooses its own event.
LATEST = 3

SHORT = (
    "the proof uses exact numbers, which robots round: choose params (--param) or values in the program with few "
    "decimals"
)

Events = Mapping[int, str]  # instance -> name of its event
Calls = Mapping[int, tuple[Any, ...]]  # instance -> its recorded calls of callable ports
Functions = Mapping[str, Callable[..., Value]]  # extern functions by name


class CannotExecute(Exception):
    """Raised if the trace does not belong to the program, or robots cannot execute the trace.

    The message gives the reason, `help` a remedy."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.help = help


class ModelOnly(CannotExecute):
    """Raised if the language allows the trace, or may allow it, but agents never act as in the trace."""


class AgentRound(NamedTuple):
    """Round of the agents.

    `of`: the round of the trace to which the agents' round belongs.
    `line`: the line of the trace at which the agents' round begins.
    `events`: the event that each instance must run.
    `free`: whether instances choose their events themselves.
    `state`: the state at the start of the agents' round."""

    of: int
    line: int
    events: Events
    free: bool
    state: SystemState
    calls: Calls


class ExecutionPlan(NamedTuple):
    """Plan of a run that executes a counterexample.

    `rounds`: the agents' rounds. The last round has no events. Its start shows the state after the round before.
    `found`: the number of the agents' round whose events must cause the trace's violation; 0 for `init`.
    `environment`: whether the violation must occur after the environment's step that follows these events.
    `calls`: the calls of `init`."""

    system: System
    given: CounterexampleTrace
    rounds: tuple[AgentRound, ...]
    calls: Calls
    found: int
    environment: bool


def alone(program: decl.Program, robots: int) -> System:
    """Return the system of one program on all robots."""
    return System((Application(program.name, program, tuple(range(robots))),), robots)


def document(plan: ExecutionPlan, program_hash: str) -> dict[str, Any]:
    """Return the plan in the format of the simulation bundle (targets/sim/follow/plan.py)."""
    given, ending = plan.given, plan.given.ending
    if ending is not None and len(plan.system.applications) == 1:
        ending = ending._replace(application="")
    return {
        "trace": str(given.path),
        "program_hash": program_hash,
        "initial": given.initial,
        "cut": given.cut,
        "ending": ending._asdict() if ending else None,
        "found": plan.found,
        "environment": plan.environment,
        "calls": plan.calls,
        "rounds": [{**each._asdict(), "state": _shown(plan.system, each.state)} for each in plan.rounds],
    }


def _shown(system: System, state: SystemState) -> dict[str, Any]:
    """Return a state with variables named as in the store: `application.variable` if there are several applications."""
    views = [view(system, state, index) for index in range(len(system.applications))]
    robots = [views[instance.application].robots[instance.pid] for instance in system.instances()]
    shared = dict[str, Any]()
    for application, store in zip(system.applications, state.stores, strict=True):
        prefix = f"{application.name}." if len(system.applications) > 1 else ""
        shared |= {f"{prefix}{name}": plain(held) for name, held in {**store.slots, **store.cells}.items()}
    return {
        "locals": [_plain(robot.locals) for robot in robots],
        "ports": list(map(_plain, state.ports)),
        "stopped": [robot.stopped for robot in robots],
        "shared": shared,
    }


def _plain(values: Mapping[str, Value]) -> dict[str, Any]:
    return {name: plain(value) for name, value in values.items()}


def make_plan(system: System, given: CounterexampleTrace, externs: Sequence[Functions]) -> ExecutionPlan:
    """Return the plan for a counterexample. Raises CannotExecute.

    `system`: the applications of the trace, in its order; see `alone` for a single program.
    `externs`: the extern functions of each application."""
    return _Planner(system, given, externs).plan()


class _Planner:
    def __init__(self, system: System, given: CounterexampleTrace, externs: Sequence[Functions]) -> None:
        self.system, self.given, self.externs = system, given, externs
        self.instances, self.locks = system.instances(), system.locks()
        self.programs = [application.program for application in system.applications]
        self.types = [declared(program) for program in self.programs]
        self.events = [{event.name: event for event in program.events} for program in self.programs]
        self.sensors = [
            {f"{m.name}.{p.name}" for m in program.modules for p in m.ports if p.direction == "sensor"}
            for program in self.programs
        ]
        self.cleared: set[tuple[int, str]] = set()  # (robot, sensor) of each sensor that a command has cleared
        self.rounds: list[AgentRound] = []
        self.rounded = fraction([given.params, *[recorded for step in given.steps for recorded in step.records]])

    def plan(self) -> ExecutionPlan:
        first, *steps = self.given.steps
        if first.event != BEGINNING:
            raise self.broken(first, f"the trace begins with {first.event}")
        state = self.begun(first)
        calls: Calls = {}
        if self.given.initial and steps:
            if steps[0].event != INIT:
                raise self.broken(steps[0], f"{steps[0].event} comes before init")
            calls = _calls([steps[0]])
            state, done = run_inits(self.system, state, self.worlds(calls))
            self.note(done)
            self.compare(steps.pop(0), state)
        number = last = 0
        for of, group in _by_round(steps):
            state = self.round(of, group, state)
            number, last = len(self.rounds), of
        environment = bool(steps) and steps[-1].event == ENVIRONMENT
        ending, line = self.given.ending, self.given.steps[-1].line
        if ending is not None and ending.event and ending.event != INIT:
            if ending.instance < 0 or ending.event not in self.events[self.instances[ending.instance].application]:
                raise CannotExecute(f"{self.given.path}: the program has no event {ending.event}")
            self.rounds.append(AgentRound(last + environment, line, {ending.instance: ending.event}, False, state, {}))
            number, environment = len(self.rounds), False
        free = ending is not None and ending.name == "(deadlock)"
        for _ in range(LATEST if free else 1):
            self.rounds.append(AgentRound(last + 1, line, {}, free, state, {}))
        return ExecutionPlan(self.system, self.given, tuple(self.rounds), calls, number, environment)

    def event(self, step: TraceStep) -> decl.Event:
        """Return the event of a step."""
        return self.events[self.instances[step.instance].application][step.event]

    def lock(self, step: TraceStep) -> int | None:
        """Return the lock of the system that a step needs; None if it needs none."""
        own = self.event(step).lock
        return None if own is None else self.locks[self.instances[step.instance].application, own]

    def acts(self, step: TraceStep) -> str:
        """Return event and instance of a step, for messages."""
        return f"{step.event} of {self.named(step.instance)}"

    def named(self, number: int) -> str:
        """Return an instance's application and robot as text; the robot alone if the fleet has one application."""
        instance = self.instances[number]
        robot = f"robot {instance.robot}"
        return robot if len(self.programs) == 1 else f"{self.system.applications[instance.application].name} on {robot}"

    def round(self, of: int, group: list[TraceStep], state: SystemState) -> SystemState:
        """Plan one round of the trace. Return the state after the round."""
        acts = [step for step in group if step.event != ENVIRONMENT]
        moved = [step for step in group if step.event == ENVIRONMENT]
        if len(moved) > 1 or (moved and group[-1] is not moved[0]):
            raise self.broken(moved[0], "the environment's step is not the last step of its round")
        for step in acts:
            if step.event not in self.events[self.instances[step.instance].application]:
                raise self.broken(step, f"the program has no event {step.event}")
        if len({step.instance for step in acts}) < len(acts):
            raise self.broken(acts[-1], f"a robot takes two steps in round {of}")
        calls = _calls(acts)
        worlds = self.worlds(calls)
        blocks = self.split(acts, state, worlds) if acts else [(acts, state)]
        for block, after in blocks:
            events = {step.instance: step.event for step in block}
            line = block[0].line if block else group[0].line
            asked = {number: calls.get(number, ()) for number in events}
            self.rounds.append(AgentRound(of, line, events, False, state, asked))
            self.note(self.done(block, state, worlds) or ())
            state = after
        if moved:
            state = state._replace(ports=self.sensed(moved[0], state.ports))
            self.compare(moved[0], state)
        return state

    def split(
        self, acts: list[TraceStep], state: SystemState, worlds: Mapping[int, World]
    ) -> list[tuple[list[TraceStep], SystemState]]:
        """Return the shortest sequence of agents' rounds that leads to the state in the trace.

        Each agents' round is returned as its steps and the state after the round. Raises CannotExecute if no agents'
        rounds lead to the state in the trace."""
        off = ""
        for blocks in self.splits(acts):
            at, found = state, []
            for block in blocks:
                done = self.done(block, at, worlds)
                if done is None:
                    break
                for step in done:
                    at = applied_to_system(self.system, at, step)
                found.append((block, at))
            else:
                off = self.differs(acts[-1], at) or self.differs_before(acts, state, found, worlds)
                if not off:
                    return found
        raise self.impossible(acts, state, worlds, off)

    def differs_before(
        self, acts: list[TraceStep], state: SystemState, blocks: list[tuple[list[TraceStep], SystemState]],
        worlds: Mapping[int, World],
    ) -> str:  # fmt: skip
        """Return a description of a difference before the trace's last step, if this step breaks a step guarantee.

        Such a step must be the last one of the agents as well, and begin in the same state. The result is empty if
        there is no difference, or if the trace ends otherwise. `blocks`: the agents' rounds of the events `acts`."""
        if acts[-1] is not self.given.steps[-1] or not self.ends_with_step():
            return ""
        before = blocks[-2][1] if len(blocks) > 1 else state
        done = self.done(blocks[-1][0], before, worlds) or []
        for step in done[:-1]:
            before = applied_to_system(self.system, before, step)
        if not done or done[-1].instance != acts[-1].instance:
            return f"the agents' last step is not that of {self.named(acts[-1].instance)}"
        return self.differs(self.given.steps[-2], before)

    def ends_with_step(self) -> bool:
        """Return whether the trace ends with the violation of a step guarantee."""
        ending = self.given.ending
        return ending is not None and any(
            guarantee.name == ending.name and decl.is_step(guarantee)
            for application in self.system.applications
            if ending.application in (application.name, application.program.name)
            for export in application.program.exports
            for guarantee in export.guarantees
        )

    def impossible(
        self, acts: list[TraceStep], state: SystemState, worlds: Mapping[int, World], off: str
    ) -> CannotExecute:
        """Return the error that no rounds of agents lead to the state in the trace.

        `off`: a difference between the state in the trace and the state that rounds of agents lead to."""
        names = ", ".join(map(self.acts, acts))
        place = f"{self.given.path}:{acts[0].line}: round {acts[0].round}"
        if self.rounded:
            return ModelOnly(
                f"{place}: with floats for exact numbers, as {self.rounded}, {names} does not lead to the state in "
                "the trace" + (f" ({off})" if off else ""),
                SHORT,
            )
        if not self.given.initial and self.lock(acts[0]) is None:
            return ModelOnly(
                f"{place}: {names} does not lead to the state in the trace ({off})" if off
                else f"{place}: {names} has no result in the trace's first state",
                "the proof's step begins after writes of other robots in its round, but an agent's event without a "
                "lock reads the store of the round's start",
            )  # fmt: skip
        after = self.stepped(acts, state, worlds)
        kind = CannotExecute if after is None or self.differs(acts[-1], after) else ModelOnly
        plain_order = "ascending pid" if len(self.programs) == 1 else "application and ascending pid"
        return kind(
            f"{place}: {names}, in this order: no rounds of agents lead to the state in the trace"
            + (f" ({off})" if off else ""),
            f"in a round agents first apply one transaction for each lock, then events without a lock by "
            f"{plain_order}: steps that need another order happen in the model only",
        )

    def stepped(self, acts: list[TraceStep], state: SystemState, worlds: Mapping[int, World]) -> SystemState | None:
        """Return the state after a round of the semantics in which the steps run in the given order.

        All steps read the ports of the round's start. Returns None if a step has no result."""
        at = state
        for step in acts:
            seen = (at if self.lock(step) is not None else at._replace(stores=state.stores))._replace(ports=state.ports)
            done = self.done([step], seen, worlds, begun=state)
            if done is None:
                return None
            at = applied_to_system(self.system, at, done[0])
        return at

    def splits(self, acts: list[TraceStep]) -> Iterator[list[list[TraceStep]]]:
        """Yield possible distributions of a round's events over agents' rounds, few rounds first.

        The first distribution has all events in one round. Then follow distributions with one round for each atomic
        event, in the trace's order. All plain events stand together, in a round of their own or in that of one atomic
        event. For at most
        MOST events, all partitions follow."""
        plain_ones = [step for step in acts if self.lock(step) is None]
        atomic = [step for step in acts if step not in plain_ones]
        yield [acts]
        singles = [[step] for step in atomic]
        for before in range(len(atomic) + 1 if plain_ones else 0):
            if before < len(atomic):
                yield [*singles[:before], [atomic[before], *plain_ones], *singles[before + 1 :]]
            yield [*singles[:before], plain_ones, *singles[before:]]
        if not plain_ones:
            yield singles
        if len(acts) <= MOST:
            yield from sorted(_partitions(acts), key=len)

    def done(
        self, block: list[TraceStep], state: SystemState, worlds: Mapping[int, World], begun: SystemState | None = None
    ) -> list[InstanceStep] | None:
        """Return the steps of one agents' round, all of which read the store of the round's start.

        Returns None if a step is impossible, or if two steps need the same lock.
        `begun`: the state at the start of the trace's round, in which the guards of events with priority are evaluated;
            None if this state equals `state`."""
        locks = [lock for step in block if (lock := self.lock(step)) is not None]
        if len(set(locks)) < len(locks):
            return None
        found = []
        for step in sorted(block, key=lambda step: (self.lock(step) is None, step.instance)):
            event, (application, pid, _) = self.event(step), self.place(step.instance)
            program, world = self.programs[application], worlds[application]
            seen = view(self.system, state, application)
            first = seen if begun is None else view(self.system, begun, application)
            try:
                if seen.robots[pid].stopped or not has_priority(program, event, first, pid, world):
                    return None
                if not enabled(program, event, seen, pid, world):
                    return None
            except Discarded:
                return None
            outcome = execute(program, event.effect, seen, pid, world)
            if isinstance(outcome, Discarded):
                return None
            found.append(InstanceStep(step.instance, Step(pid, event.name, outcome)))
        return found

    def place(self, number: int) -> tuple[int, int, int]:
        """Return the application of an instance, its pid there, and its robot."""
        instance = self.instances[number]
        return instance.application, instance.pid, instance.robot

    def begun(self, first: TraceStep) -> SystemState:
        """Return the first state of the trace."""
        state = initial_system(self.system, self.sensed(first, [{} for _ in range(self.system.robots)]))
        if not self.given.initial:
            views = [self.recorded(first, view(self.system, state, a), a) for a in range(len(self.programs))]
            state = joined(self.system, views)._replace(round=1)
        self.compare(first, state)
        return state

    def recorded(self, first: TraceStep, seen: State, application: int) -> State:
        """Return the state of an application with the values that the trace has in its first step."""
        robots, slots = [], {name: list(held) for name, held in seen.store.slots.items()}
        cells = dict(seen.store.cells)
        for number, recorded in enumerate(first.records):
            of, pid, _ = self.place(number)
            if of != application:
                continue
            given = {**recorded.locals, **recorded.actuators, **recorded.sensors, **recorded.shared}
            values = self.values(first, number, given)
            own = {name: values[name] for name in seen.robots[pid].locals}
            ports = {name: values[name] for name in seen.robots[pid].ports}
            robots.append(Robot(own, ports, recorded.stopped))
            for name, held in slots.items():
                held[pid] = values[name]
            cells = {name: values[name] for name in cells}
        store = Store({name: tuple(held) for name, held in slots.items()}, cells)
        return seen._replace(robots=tuple(robots), store=store)

    def sensed(self, step: TraceStep, ports: Sequence[Mapping[str, Value]]) -> tuple[Mapping[str, Value], ...]:
        """Return the ports of each robot with the sensor values of a step."""
        found = [dict(held) for held in ports]
        for number, recorded in enumerate(step.records):
            application, _, robot = self.place(number)
            if set(recorded.sensors) != self.sensors[application]:
                raise self.broken(step, f"the trace's sensors are {', '.join(recorded.sensors) or 'none'}")
            found[robot] |= self.values(step, number, recorded.sensors)
        if self.given.initial:
            for robot, held in enumerate(found):
                held |= dict.fromkeys(self.unset(robot), True)
        return tuple(found)

    def values(self, step: TraceStep, number: int, recorded: Mapping[str, Any]) -> dict[str, Value]:
        types = self.types[self.instances[number].application]
        try:
            return {name: from_trace(value, types[name], nearest) for name, value in recorded.items()}
        except BadValue as error:
            raise CannotExecute(
                f"{self.given.path}:{step.line}: {error} within the precision of robots' numbers", SHORT
            ) from None
        except KeyError as error:
            raise self.broken(step, f"the program has no variable {error}") from None

    def worlds(self, calls: Calls) -> dict[int, World]:
        """Return for each application a world in which callable ports give the answers that the trace contains."""
        return {application: self.world(application, calls) for application in range(len(self.programs))}

    def world(self, application: int, calls: Calls) -> World:
        numbers = {each.pid: n for n, each in enumerate(self.instances) if each.application == application}

        def answer(pid: int, port: str, args: tuple[Value, ...]) -> Value:
            given = [plain(arg) for arg in args]
            for name, asked, said in calls.get(numbers[pid], ()):
                if name == port and self.agree(asked, given):
                    return from_trace(said, self.types[application][port], nearest)
            raise LookupError(f"no call of {port} in the trace has these arguments")

        return World(self.externs[application], answer)

    def note(self, done: Iterable[InstanceStep]) -> None:
        """Note the sensors that the commands of steps clear."""
        for number, step in done:
            application, _, robot = self.place(number)
            if isinstance(step.outcome, Writes):
                cleared = clears(self.programs[application])
                self.cleared |= {(robot, s) for name in step.outcome.ports for s in cleared.get(name, ())}

    def unset(self, robot: int) -> set[str]:
        """Return the clearable sensors of a robot that no command has cleared yet.

        On robots these sensors are true, even if a counterexample to induction contains another value."""
        programs = [self.programs[each.application] for each in self.instances if each.robot == robot]
        return {s for program in programs for s in clearable(program) if (robot, s) not in self.cleared}

    def compare(self, step: TraceStep, state: SystemState) -> None:
        if difference := self.differs(step, state):
            raise CannotExecute(f"{self.given.path}:{step.line}: after {step.event}, {difference}")

    def differs(self, step: TraceStep, state: SystemState) -> str:
        """Return a description of a difference between a state and the trace; empty if they are equal."""
        views = [view(self.system, state, application) for application in range(len(self.programs))]
        for number, recorded in enumerate(step.records):
            application, pid, place = self.place(number)
            seen = views[application]
            robot = seen.robots[pid]
            computed = {**robot.locals, **robot.ports, **seen.store.cells}
            computed |= {name: held[pid] for name, held in seen.store.slots.items()}
            said = {**recorded.locals, **recorded.actuators, **recorded.sensors, **recorded.shared}
            said |= {name: robot.ports[name] for name in self.unset(place) if name in robot.ports}
            for name in [*computed, *[n for n in said if n not in computed]]:
                if name not in computed or name not in said or not self.agree(said[name], plain(computed[name])):
                    values = f"{said.get(name)!r} in the trace and {plain(computed.get(name))!r} by the program"
                    return f"{name} of {self.named(number)} is {values}"
            if recorded.stopped != robot.stopped:
                return f"{self.named(number)} has{'' if recorded.stopped else ' not'} stopped in the trace"
        return ""

    def agree(self, recorded: Any, computed: Any) -> bool:
        return agree(recorded, computed, bool(self.rounded))

    def broken(self, step: TraceStep, why: str) -> CannotExecute:
        return CannotExecute(
            f"{self.given.path}:{step.line}: {why}", "the trace is not a counterexample of this program"
        )


def _by_round(steps: list[TraceStep]) -> Iterator[tuple[int, list[TraceStep]]]:
    group: list[TraceStep] = []
    for step in steps:
        if group and (step.round != group[0].round or group[-1].event == ENVIRONMENT):
            yield group[0].round, group
            group = []
        group.append(step)
    if group:
        yield group[0].round, group


def _calls(steps: list[TraceStep]) -> dict[int, tuple[Any, ...]]:
    found: dict[int, tuple[Any, ...]] = {}
    for step in steps:
        for number, recorded in enumerate(step.records):
            if recorded.calls:
                found[number] = (*found.get(number, ()), *recorded.calls)
    return found


def _partitions(acts: list[TraceStep]) -> Iterator[list[list[TraceStep]]]:
    """Yield every partition of a round's events into a sequence of agents' rounds."""
    if not acts:
        yield []
        return
    for size in range(len(acts), 0, -1):
        for chosen in combinations(acts, size):
            for rest in _partitions([step for step in acts if step not in chosen]):
                yield [list(chosen), *rest]
