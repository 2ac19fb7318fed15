"""Guide of a replayed counterexample: feeds the plan to the agents and compares their rounds with it.

The plan determines what sensors and planners answer, which event each instance tries, and where bodies are. An instance
is an application on a robot; see FleetProgram."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import Any

import msgspec

from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.program import Event, Port, Program, Slots, Stopped, Transaction, Variable
from koordgen.runtime.trace.schema import Cause, Violation
from koordgen.runtime.trace.writer import RoundRecord
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Finding, Sensed
from targets.sim.base.bodies import BodyState
from targets.sim.base.scenario import Robot
from targets.sim.follow.plan import FleetState, ReplayPlan, Values
from targets.sim.follow.plan import Round as Planned
from targets.sim.physics.world import STEP
from targets.sim.run.run import Run, RunResult
from targets.sim.run.run_interface import AgentHandle
from targets.sim.trace.store_names import qualified_name

IDLE = "no event enabled"
EARLY = 0.01  # share of a round by which a robot's clock may be ahead of the start of its round
BEFORE = 1e-5  # seconds by which a body is set before the time at which it must be there
HELD, VIOLATED, DIFFERS = 0, 3, 70
_encode = msgspec.json.Encoder(enc_hook=repr).encode


class ReplayGuide:
    """Companion of a run that replays a plan. `measured` names the sensors that measure bodies."""

    def __init__(
        self, plan: ReplayPlan, robots: tuple[Robot, ...], delta: float, measured: Collection[str], fleet: FleetProgram
    ) -> None:
        self.plan, self.delta = plan, delta
        self._robots, self._measured, self._fleet = robots, measured, fleet
        self._numbers = {(fleet.applications[i.application].name, i.robot): i.number for i in fleet.instances}
        self._views = [dict(fleet.views(index)) for index in range(len(fleet.applications))]
        self._zero: float | None = None  # time at which round 1 began
        self._differences: list[tuple[int, int, str]] = []  # (round, instance, difference)
        self._seen = [0] * len(fleet.instances)  # by instance: the last round that it recorded
        self._discarded = False  # true once the event without a result was discarded

    def launched(self, run: Run) -> None:
        self._run = run
        for robot, agent in enumerate(run.conduct.agents):
            agent.monitors.append(lambda record, robot=robot: self.observe(robot, record))  # type: ignore[misc]

    def _number(self, robot: int, application: str) -> int:
        """Return the number of an instance. `application`: "" if the fleet has only one."""
        return self._numbers[application or self._fleet.applications[0].name, robot]

    def _robot(self, number: int) -> Robot:
        return self._robots[self._fleet.instances[number].robot]

    def _named(self, number: int) -> str:
        """Return robot and application of an instance, for messages; with one application only the robot."""
        name = self._robot(number).name
        if not self._fleet.is_composed:
            return name
        return f"{self._fleet.applications[self._fleet.instances[number].application].name} on {name}"

    def step(self, at: float, states: list[BodyState]) -> None:
        """See Companion."""

    def heard(self, agent: AgentHandle, records: list[Any]) -> None:
        """See Companion."""

    def end(self, at: float) -> None:
        """Mark in the trace which round of the counterexample each round of the agents replays."""
        for number, each in enumerate(self.plan.rounds):
            if each.events:
                names = tuple(dict.fromkeys(self._robot(number).name for number in each.events))
                does = ", ".join(f"{event} of {self._named(number)}" for number, event in each.events.items())
                begins = (self._zero or 0.0) + number * self.delta
                detail = f"agents' round {number + 1} is of {self._place(each)}: {does}"
                self._run.mark(Cause(begins, "follow", names, detail))

    def began(self, round_: int, at: float) -> None:
        """Note that a round of a robot has begun, at a time of the run's clock."""
        if self._zero is None and round_:
            self._zero = at - (round_ - 1) * self.delta

    def _place(self, each: Planned) -> str:
        return f"the trace's round {each.of}, line {each.line}"

    def _index(self, now: float, early: float) -> int:
        """Return the index (from 0) of the round at a time; the last round does not end."""
        if self._zero is None:
            return 0
        return max(0, min(math.floor((now - self._zero + early) / self.delta), len(self.plan.rounds) - 1))

    def ports(self, robot: int, now: float) -> Values:
        """Return the values of a robot's ports at a time, in JSON."""
        return self.plan.rounds[self._index(now, EARLY * self.delta)].state.ports[robot]

    def body(self, robot: int, at: float) -> BodyState:
        """Return the state of a body at a step of the world.

        From the last step of a round on, the body is where the next round has it."""
        ports = self.plan.rounds[self._index(at, STEP + BEFORE)].state.ports[robot]
        start = self._robots[robot].start
        position, velocity, yaw = start.position, (0.0, 0.0, 0.0), start.yaw
        for name in [name for name in self._measured if name in ports]:
            match name.rpartition(".")[2]:
                case "position":
                    position = tuple(ports[name])
                case "velocity":
                    velocity = tuple(ports[name])
                case _:
                    place, yaw = ports[name]
                    position = tuple(place)
        return BodyState(position, velocity, yaw, 0.0)

    def program(self, program: Program, number: int, round_: Callable[[], int]) -> Program:
        """Return the program of an instance, restricted to the plan's event. `round_` returns the present round."""
        events = tuple([replace(event, guard=self._forced(event, number, round_)) for event in program.events])
        init = program.init if self.plan.initial else self._given(program, number)
        return replace(program, events=events, init=init)

    def _forced(self, event: Event, instance: int, round_: Callable[[], int]) -> Callable[[Any], bool]:
        def guard(state: Any) -> bool:
            number = round_()
            if number > len(self.plan.rounds):
                return False
            each = self.plan.rounds[number - 1]
            return (each.free or each.events.get(instance) == event.name) and event.guard(state)

        return guard

    def _given(self, program: Program, number: int) -> Callable[[Any], None]:
        """Return a replacement of `init` that writes the first round's state."""
        state, instance = self.plan.rounds[0].state, self._fleet.instances[number]
        pid, shared = instance.pid, self._shared(state, instance.application)
        values = {**state.locals[number], **shared, **state.ports[instance.robot]}
        slots = {v.name for v in program.shared if v.kind == "allread"}
        typed: tuple[Variable | Port, ...] = (*program.locals, *program.shared, *program.ports)
        types = {each.name: each.type for each in typed}

        def init(transaction: Transaction) -> None:
            for name, place in transaction.written.items():
                value = values[name][pid] if name in slots else values[name]
                made = msgspec.json.decode(_encode(value), type=types[name])
                if isinstance(place, Slots):
                    place.own = made
                else:
                    place.value = made
            if state.stopped[number]:
                raise Stopped

        return init

    def _shared(self, state: FleetState, application: int) -> Values:
        """Return the shared variables of a state under the names of an application's program."""
        return {name: state.shared[stored] for name, stored in self._views[application].items()}

    def answer(self, robot: int, round_: int, port: str, args: tuple[Any, ...]) -> Any:
        """Return the answer of a robot's callable port, in JSON. Raises LookupError if the plan has none."""
        calls = self.plan.calls if round_ < 1 else self.plan.rounds[min(round_, len(self.plan.rounds)) - 1].calls
        for instance in self._fleet.of_robot(robot):
            for name, asked, said in calls.get(instance.number, ()):
                if name == port and asked == _plain(args):
                    return said
        raise LookupError(f"{port} was not called with these arguments in the trace")

    def observe(self, robot: int, record: RoundRecord) -> None:
        """Compare a round of an instance, as the agent's own record has it, with the plan."""
        number = self._number(robot, record.application)
        self._seen[number] = max(self._seen[number], record.round)
        if record.round > len(self.plan.rounds):
            return
        why = self._difference(number, record, self.plan.rounds[record.round - 1])
        if why:
            self._differences.append((record.round, number, why))

    def _difference(self, number: int, record: RoundRecord, each: Planned) -> str:
        state, wanted, ending = each.state, each.events.get(number), self.plan.ending
        instance = self._fleet.instances[number]
        if state.stopped[number]:
            return "" if record.skipped == "stopped" else "it has not stopped, as it has in the trace"
        frame = record.frame
        if frame is None:
            return f"it skipped the round: {record.skipped}"
        ports = {**frame.sensors, **frame.actuators}
        shared = self._shared(state, instance.application)
        groups = ((frame.locals, state.locals[number]), (frame.shared, shared), (ports, state.ports[instance.robot]))
        for told, meant in groups:
            for name, value in told.items():
                if _plain(value) != meant[name]:
                    return f"{name} is {_plain(value)!r} when the round begins, {meant[name]!r} in the trace"
        if record.fault is not None:
            named = ending is not None and (ending.instance, record.event or wanted) == (number, ending.event)
            if named and record.round == self.plan.found:
                self._discarded = True
                return ""
            return f"{record.event or 'a guard'} has no result ({record.fault}); it has one in the trace"
        if each.free and record.event is not None:
            return f"{record.event} is enabled; in the trace no event is"
        if not each.free and record.event != wanted:
            return f"the trace executes {wanted}, but its guard is false in the agent"
        return ""

    def result(self, result: RunResult) -> tuple[int, str]:
        """Return exit status and message of a run that came to its end."""
        plan, ending = self.plan, self.plan.ending
        if ending is not None and ending.event == "init" and not result.started:
            robot = self._fleet.instances[ending.instance].robot
            self._discarded = "(in init)" in self._run.conduct.agents[robot].last_error
            return self._result(result, self._shown(result))
        late = [number for number, seen in enumerate(self._seen) if seen < len(plan.rounds)]
        if not self._differences and late:
            number = late[0]
            self._differences.append((self._seen[number] + 1, number, "the agent did not reach this round"))
        if self._differences:
            round_, number, why = min(self._differences)
            each, robot = plan.rounds[round_ - 1], self._fleet.instances[number].robot
            where = f"{plan.trace}:{each.line}: round {each.of}, robot {robot} ({self._named(number)})"
            return DIFFERS, f"{where}: {why} (round {round_} of the agents)"
        return self._result(result, self._shown(result))

    def _result(self, result: RunResult, shown: str) -> tuple[int, str]:
        plan, ending = self.plan, self.plan.ending
        rounds = sum(1 for each in plan.rounds[:-1])
        cut = f"; {plan.trace}:{plan.cut}: the trace is cut off here" if plan.cut else ""
        prefix = f"{plan.trace}: replayed in {rounds} round{'s' * (rounds != 1)} of the agents, with the same results"
        if ending is None:
            return HELD, prefix + (cut or "; it has no violation")
        if shown:
            return VIOLATED, f"{prefix}; {shown}"
        missed = f"the trace ends with {self._property()}: {ending.detail}; {self._missed(result)}"
        return DIFFERS, f"{plan.trace}: {missed}"

    def _property(self) -> str:
        """Return the name of the violated property, with that of its application if there are several."""
        ending = self.plan.ending
        return "" if ending is None else qualified_name(ending.application, ending.name)

    def _shown(self, result: RunResult) -> str:
        """Return how the run confirms the trace's violation; "" if it does not."""
        ending = self.plan.ending
        if ending is None:
            return ""
        if ending.event:
            named = self._named(ending.instance)
            return f"{ending.event} of {named} has no result, as in the trace" if self._discarded else ""
        if ending.name == "(deadlock)":
            return "no event is enabled any more, as in the trace"
        found = self._violation(result)
        due = (self.plan.found - (not self.plan.environment)) * self.delta
        early = -math.inf if not self.plan.found else -2 * STEP - BEFORE  # robots run `init` before round 1
        if found is None or not early <= found.t - max(0.0, due) <= STEP:
            return ""
        return f"{self._property()} is violated after the same round as in the trace"

    def _violation(self, result: RunResult) -> Violation | None:
        ending = self.plan.ending
        wanted = ("property", ending.name, ending.application) if ending else ()
        return next((v for v in result.violations if (v.what, v.name, v.application) == wanted), None)

    def _missed(self, result: RunResult) -> str:
        found = self._violation(result)
        return f"the run violates it at {found.t:.3f} s" if found else "the run does not violate it"


class ReplayPlatform:
    """Platform whose sensors and callable ports answer from the plan. `round_` returns the agent's round."""

    period = 0.05

    def __init__(self, guide: ReplayGuide, robot: int, program: Program, round_: Callable[[], int]) -> None:
        self._guide, self._robot, self._round = guide, robot, round_
        self._types = {p.name: p.type for p in program.ports if p.direction == "sensor"}
        self._answers = {p.name: p.type for p in program.ports if p.direction == "callable"}
        self.ready, self.stopped, self.progress, self.stall = True, False, "", ""

    def sense(self, now: float) -> Sensed:
        """See Platform."""
        ports = self._guide.ports(self._robot, now)
        return Sensed({n: msgspec.json.decode(_encode(ports[n]), type=t) for n, t in self._types.items()}, now)

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        """See Platform."""
        said = self._guide.answer(self._robot, self._round(), port, args)
        return msgspec.json.decode(_encode(said), type=self._answers[port])

    def stop(self, now: float) -> None:
        """See Platform."""
        self.stopped = True

    def diagnose(self) -> list[Finding]:
        """See Platform."""
        return []

    def start(self, now: float) -> None:
        """See Platform."""

    def poll(self, now: float) -> None:
        """See Platform."""

    def command(self, actuators: Mapping[str, Any], now: float) -> None:
        """Ignore commands: the body is where the trace has it. See Platform."""

    def others(self, paths: Mapping[int, tuple[Point, ...]]) -> None:
        """See Platform."""

    def log_lines(self) -> list[str]:
        """See Platform."""
        return []

    def hold(self, on: bool, now: float) -> None:
        """See Platform."""

    def close(self) -> None:
        """See Platform."""


def _plain(value: Any) -> Any:
    """Return a value in the JSON form of traces."""
    return json.loads(_encode(value))
