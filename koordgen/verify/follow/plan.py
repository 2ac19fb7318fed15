"""Plan of a counterexample for agents: the event that each robot runs in each of the agents' rounds.

In a round of the semantics, atomic events run one after another. Each atomic event reads the store that the previous
event left. In a round of agents, only one robot commits per lock, and all events read the store of the round's start.
So one round of the trace is split into agents' rounds. The plan uses the fewest rounds that lead to the state in the
trace. Sensors keep their values between these rounds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import combinations
from typing import Any, NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir.ports import clearable, clears
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import Writes, declared
from koordgen.lang.semantics.state import Robot, State, Store, World
from koordgen.lang.semantics.step import Step as Done
from koordgen.lang.semantics.step import applied, enabled, execute, has_priority, initial, run_init, sense
from koordgen.lang.semantics.values import Value
from koordgen.verify.follow.exact import agree, fraction, nearest
from koordgen.verify.follow.read import BEGINNING, ENVIRONMENT, INIT, CounterexampleTrace, RobotRecord, TraceStep
from koordgen.verify.replay.values import BadValue, from_trace, plain

# Largest number of events in a round for which every split is tried. With more events, fewer splits are tried.
MOST = 5
# Number of agents' rounds at the end of a deadlock's plan in which every robot may choose its events itself.
LATEST = 3

SHORT = "a proof uses exact numbers: choose params (--param) or values in the program that are short decimals"

Events = Mapping[int, str]  # pid -> name of the robot's event


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
    `events`: the event that each robot must run.
    `free`: whether robots choose their events themselves.
    `state`: the state at the start of the agents' round.
    `calls`: pid -> the recorded calls of callable ports."""

    of: int
    line: int
    events: Events
    free: bool
    state: State
    calls: Mapping[int, tuple[Any, ...]]


class ExecutionPlan(NamedTuple):
    """Plan of a run that executes a counterexample.

    `rounds`: the agents' rounds. The last round has no events. Its start shows the state after the round before.
    `found`: the number of the agents' round whose events must cause the trace's violation; 0 for `init`.
    `environment`: whether the violation must occur after the environment's step that follows these events."""

    given: CounterexampleTrace
    rounds: tuple[AgentRound, ...]
    calls: Mapping[int, tuple[Any, ...]]  # pid -> the recorded calls of callable ports in `init`
    found: int
    environment: bool


def document(plan: ExecutionPlan, program_hash: str) -> dict[str, Any]:
    """Return the plan in the format of the simulation bundle (targets/sim/follow/plan.py)."""
    given = plan.given
    return {
        "trace": str(given.path),
        "program_hash": program_hash,
        "initial": given.initial,
        "cut": given.cut,
        "ending": given.ending._asdict() if given.ending else None,
        "found": plan.found,
        "environment": plan.environment,
        "calls": plan.calls,
        "rounds": [{**each._asdict(), "state": _shown(each.state)} for each in plan.rounds],
    }


def _shown(state: State) -> dict[str, Any]:
    cells = {name: plain(value) for name, value in state.store.cells.items()}
    return {
        "locals": [_plain(robot.locals) for robot in state.robots],
        "ports": [_plain(robot.ports) for robot in state.robots],
        "stopped": [robot.stopped for robot in state.robots],
        "shared": {**{name: plain(held) for name, held in state.store.slots.items()}, **cells},
    }


def _plain(values: Mapping[str, Value]) -> dict[str, Any]:
    return {name: plain(value) for name, value in values.items()}


def make_plan(
    program: decl.Program, given: CounterexampleTrace, externs: Mapping[str, Callable[..., Value]]
) -> ExecutionPlan:
    """Return the plan for a counterexample. Raises CannotExecute."""
    return _Planner(program, given, externs).plan()


class _Planner:
    def __init__(
        self, program: decl.Program, given: CounterexampleTrace, externs: Mapping[str, Callable[..., Value]]
    ) -> None:
        self.program, self.given, self.externs = program, given, externs
        self.types = declared(program)
        self.events = {event.name: event for event in program.events}
        self.sensors = {f"{m.name}.{p.name}" for m in program.modules for p in m.ports if p.direction == "sensor"}
        self.actuators = {f"{m.name}.{p.name}" for m in program.modules for p in m.ports if p.direction == "actuator"}
        self.cleared: set[tuple[int, str]] = set()  # (pid, sensor) of each sensor that a command has cleared
        self.rounds: list[AgentRound] = []
        self.rounded = fraction([given.params, *[recorded for step in given.steps for recorded in step.robots]])

    def plan(self) -> ExecutionPlan:
        first, *steps = self.given.steps
        if first.event != BEGINNING:
            raise self.broken(first, f"the trace begins with {first.event}")
        state = self.begun(first)
        calls: Mapping[int, tuple[Any, ...]] = {}
        if self.given.initial and steps:
            if steps[0].event != INIT:
                raise self.broken(steps[0], f"{steps[0].event} comes before init")
            calls = _calls([steps[0]])
            state, done = run_init(self.program, state, self.world(calls))
            self.note(done)
            self.compare(steps.pop(0), state)
        number = last = 0
        for of, group in _by_round(steps):
            state = self.round(of, group, state)
            number, last = len(self.rounds), of
        environment = bool(steps) and steps[-1].event == ENVIRONMENT
        ending, line = self.given.ending, self.given.steps[-1].line
        if ending is not None and ending.event and ending.event != INIT:
            if ending.event not in self.events:
                raise CannotExecute(f"{self.given.path}: the program has no event {ending.event}")
            self.rounds.append(AgentRound(last + environment, line, {ending.pid: ending.event}, False, state, {}))
            number, environment = len(self.rounds), False
        free = ending is not None and ending.name == "(deadlock)"
        for _ in range(LATEST if free else 1):
            self.rounds.append(AgentRound(last + 1, line, {}, free, state, {}))
        return ExecutionPlan(self.given, tuple(self.rounds), calls, number, environment)

    def round(self, of: int, group: list[TraceStep], state: State) -> State:
        """Plan one round of the trace. Return the state after the round."""
        acts = [step for step in group if step.event != ENVIRONMENT]
        moved = [step for step in group if step.event == ENVIRONMENT]
        if len(moved) > 1 or (moved and group[-1] is not moved[0]):
            raise self.broken(moved[0], "the environment's step is not the last step of its round")
        if unknown := next((step for step in acts if step.event not in self.events), None):
            raise self.broken(unknown, f"the program has no event {unknown.event}")
        if len({step.pid for step in acts}) < len(acts):
            raise self.broken(acts[-1], f"a robot takes two steps in round {of}")
        calls = _calls(acts)
        blocks = self.split(acts, state, self.world(calls)) if acts else [(acts, state)]
        for block, after in blocks:
            events = {step.pid: step.event for step in block}
            line = block[0].line if block else group[0].line
            self.rounds.append(AgentRound(of, line, events, False, state, {pid: calls.get(pid, ()) for pid in events}))
            self.note(self.done(block, state, self.world(calls)) or ())
            state = after
        if moved:
            state = sense(state, [self.sensed(moved[0], recorded, pid) for pid, recorded in enumerate(moved[0].robots)])
            self.compare(moved[0], state)
        return state

    def split(self, acts: list[TraceStep], state: State, world: World) -> list[tuple[list[TraceStep], State]]:
        """Return the fewest agents' rounds that lead to the state in the trace.

        Each agents' round is returned as its steps and the state after the round. Raises CannotExecute if no agents'
        rounds lead to the state in the trace."""
        off = ""
        for blocks in self.splits(acts):
            at, found = state, []
            for block in blocks:
                done = self.done(block, at, world)
                if done is None:
                    break
                for step in done:
                    at = applied(self.program, at, step)
                found.append((block, at))
            else:
                off = self.differs(acts[-1], at)
                if not off:
                    return found
        names = ", ".join(f"{step.event} of robot {step.pid}" for step in acts)
        place = f"{self.given.path}:{acts[0].line}: round {acts[0].round}"
        if self.rounded:
            raise ModelOnly(
                f"{place}: with floats for exact numbers, as {self.rounded}, {names} does not lead to the state in "
                "the trace" + (f" ({off})" if off else ""),
                SHORT,
            )
        if not self.given.initial and self.events[acts[0].event].lock is None:
            raise ModelOnly(
                f"{place}: {names} does not lead to the state in the trace ({off})" if off
                else f"{place}: {names} has no result in the trace's first state",
                "an event without a lock reads the store of its round's start: a proof's step may begin later in a "
                "round, after writes of other robots, but agents always begin with a round's start",
            )  # fmt: skip
        after = self.stepped(acts, state, world)
        kind = CannotExecute if after is None or self.differs(acts[-1], after) else ModelOnly
        raise kind(
            f"{place}: {names}, in this order: no rounds of agents lead to the state in the trace"
            + (f" ({off})" if off else ""),
            "agents apply the commits of a round first, one for each lock, then plain events by ascending pid: steps "
            "that need another order happen in the model only",
        )

    def stepped(self, acts: list[TraceStep], state: State, world: World) -> State | None:
        """Return the state after a round of the semantics in which the steps run in the given order.

        Returns None if a step has no result."""
        at = state
        for step in acts:
            seen = at if self.events[step.event].lock is not None else at._replace(store=state.store)
            done = self.done([step], seen, world, begun=state)
            if done is None:
                return None
            at = applied(self.program, at, done[0])
        return at

    def splits(self, acts: list[TraceStep]) -> Iterator[list[list[TraceStep]]]:
        """Yield possible distributions of a round's events over agents' rounds, few rounds first.

        The first distribution has all events in one round. The next distributions have one round for each atomic event,
        in the trace's order, and one round for all plain events, which may share it with an atomic event. For at most
        MOST events, all partitions follow."""
        plain_ones = [step for step in acts if self.events[step.event].lock is None]
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

    def done(self, block: list[TraceStep], state: State, world: World, begun: State | None = None) -> list[Done] | None:
        """Return the steps of one agents' round, all of which read the store of the round's start.

        Returns None if a step is impossible, or if two steps need the same lock.
        `begun`: the state at the start of the trace's round, in which the guards of events with priority are evaluated;
            None if this state equals `state`."""
        locks = [lock for step in block if (lock := self.events[step.event].lock) is not None]
        if len(set(locks)) < len(locks):
            return None
        found = []
        for step in sorted(block, key=lambda step: (self.events[step.event].lock is None, step.pid)):
            event = self.events[step.event]
            try:
                first = has_priority(self.program, event, begun or state, step.pid, world)
                if state.robots[step.pid].stopped or not first:
                    return None
                if not enabled(self.program, event, state, step.pid, world):
                    return None
            except Discarded:
                return None
            outcome = execute(self.program, event.effect, state, step.pid, world)
            if isinstance(outcome, Discarded):
                return None
            found.append(Done(step.pid, event.name, outcome))
        return found

    def begun(self, first: TraceStep) -> State:
        """Return the first state of the trace."""
        sensors = [self.sensed(first, recorded, pid) for pid, recorded in enumerate(first.robots)]
        state = initial(self.program, self.given.n_sys, sensors)
        if self.given.initial:
            self.compare(first, state)
            return state
        robots, slots = [], {name: list(held) for name, held in state.store.slots.items()}
        cells = dict(state.store.cells)
        for pid, recorded in enumerate(first.robots):
            values = self.values(
                first, {**recorded.locals, **recorded.actuators, **recorded.sensors, **recorded.shared}
            )
            own = {name: values[name] for name in state.robots[pid].locals}
            ports = {name: values[name] for name in state.robots[pid].ports}
            robots.append(Robot(own, ports, recorded.stopped))
            for name, held in slots.items():
                held[pid] = values[name]
            cells = {name: values[name] for name in cells}
        store = Store({name: tuple(held) for name, held in slots.items()}, cells)
        state = state._replace(robots=tuple(robots), store=store, round=1)
        self.compare(first, state)
        return state

    def sensed(self, step: TraceStep, recorded: RobotRecord, pid: int) -> dict[str, Value]:
        if set(recorded.sensors) != self.sensors:
            raise self.broken(step, f"the trace's sensors are {', '.join(recorded.sensors) or 'none'}")
        known: dict[str, Value] = dict.fromkeys(self.unset(pid), True) if self.given.initial else {}
        return {**self.values(step, recorded.sensors), **known}

    def values(self, step: TraceStep, recorded: Mapping[str, Any]) -> dict[str, Value]:
        try:
            return {name: from_trace(value, self.types[name], nearest) for name, value in recorded.items()}
        except BadValue as error:
            raise CannotExecute(
                f"{self.given.path}:{step.line}: {error} within the precision of robots' numbers", SHORT
            ) from None
        except KeyError as error:
            raise self.broken(step, f"the program has no variable {error}") from None

    def world(self, calls: Mapping[int, tuple[Any, ...]]) -> World:
        """Return a world in which callable ports give the answers that the trace contains."""

        def answer(pid: int, port: str, args: tuple[Value, ...]) -> Value:
            given = [plain(arg) for arg in args]
            for name, asked, said in calls.get(pid, ()):
                if name == port and self.agree(asked, given):
                    return from_trace(said, self.types[port], nearest)
            raise LookupError(f"no call of {port} in the trace has these arguments")

        return World(self.externs, answer)

    def note(self, done: Iterable[Done]) -> None:
        for step in done:
            if isinstance(step.outcome, Writes):
                cleared = clears(self.program)
                self.cleared |= {(step.pid, s) for name in step.outcome.ports for s in cleared.get(name, ())}

    def unset(self, pid: int) -> set[str]:
        """Return the clearable sensors of a robot that no command has cleared yet.

        On robots these sensors are true, even if a counterexample to induction contains another value."""
        return {sensor for sensor in clearable(self.program) if (pid, sensor) not in self.cleared}

    def compare(self, step: TraceStep, state: State) -> None:
        if difference := self.differs(step, state):
            raise CannotExecute(f"{self.given.path}:{step.line}: after {step.event}, {difference}")

    def differs(self, step: TraceStep, state: State) -> str:
        """Return a description of a difference between a state and the trace; empty if they are equal."""
        for pid, recorded in enumerate(step.robots):
            robot = state.robots[pid]
            computed = {**robot.locals, **robot.ports, **state.store.cells}
            computed |= {name: held[pid] for name, held in state.store.slots.items()}
            said = {**recorded.locals, **recorded.actuators, **recorded.sensors, **recorded.shared}
            said |= {name: robot.ports[name] for name in self.unset(pid)}
            for name in [*computed, *[n for n in said if n not in computed]]:
                if name not in computed or name not in said or not self.agree(said[name], plain(computed[name])):
                    values = f"{said.get(name)!r} in the trace and {plain(computed.get(name))!r} by the program"
                    return f"{name} of robot {pid} is {values}"
            if recorded.stopped != robot.stopped:
                return f"robot {pid} has{'' if recorded.stopped else ' not'} stopped in the trace"
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
        for pid, recorded in enumerate(step.robots):
            if recorded.calls:
                found[pid] = (*found.get(pid, ()), *recorded.calls)
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
