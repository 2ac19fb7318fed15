"""Leads agents through a plan: says what sensors and planners answer, which event is tried, where bodies are; and
compares what they do with what the trace says."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import msgspec

from koordgen.runtime.program.program import Event, Port, Program, Slots, Stopped, Transaction, Variable
from koordgen.runtime.trace.schema import Cause, Violation
from koordgen.runtime.trace.writer import Record
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Finding, Sensed
from targets.sim.base.bodies import BodyState
from targets.sim.base.scenario import Robot
from targets.sim.follow.plan import Plan, Values
from targets.sim.follow.plan import Round as Planned
from targets.sim.physics.world import STEP
from targets.sim.run.crew import Agent
from targets.sim.run.run import Outcome, Run

IDLE = "no event enabled"
EARLY = 0.01  # of a round: by how much a robot's clock may be ahead of where its round begins
BEFORE = 1e-5  # seconds that a body is set before the moment at which it must be there
HELD, VIOLATED, DIFFERS = 0, 3, 70
_encode = msgspec.json.Encoder(enc_hook=repr).encode


class Guide:
    """A `crew.Companion`. `measured` are the sensors that tell where bodies are."""

    def __init__(self, plan: Plan, robots: tuple[Robot, ...], delta: float, measured: tuple[str, ...]) -> None:
        self.plan, self.delta = plan, delta
        self._robots, self._measured = robots, measured
        self._zero: float | None = None  # when round 1 began
        self._differences: list[tuple[int, int, str]] = []  # round, pid, what is different
        self._seen = [0] * len(robots)  # by pid the last round that was told of
        self._discarded = False  # the event that has no result had none

    def launched(self, run: Run) -> None:
        self._run = run
        for pid, agent in enumerate(run.conduct.agents):
            agent.monitors.append(lambda record, pid=pid: self.observe(pid, record))  # type: ignore[misc]

    def step(self, at: float, states: list[BodyState]) -> None:
        """See Companion."""

    def heard(self, agent: Agent, records: list[Any]) -> None:
        """See Companion."""

    def end(self, at: float) -> None:
        """Which of the agents' rounds is what of the trace."""
        for number, each in enumerate(self.plan.rounds):
            if each.events:
                names = tuple(self._robots[pid].name for pid in each.events)
                does = ", ".join(f"{event} of {self._robots[pid].name}" for pid, event in each.events.items())
                begins = (self._zero or 0.0) + number * self.delta
                detail = f"agents' round {number + 1} is of {self._place(each)}: {does}"
                self._run.mark(Cause(begins, "follow", names, detail))

    def began(self, round_: int, at: float) -> None:
        """A robot's round has begun, at that time of the run's clock."""
        if self._zero is None and round_:
            self._zero = at - (round_ - 1) * self.delta

    def _place(self, each: Planned) -> str:
        return f"the trace's round {each.of}, line {each.line}"

    def _index(self, now: float, early: float) -> int:
        """Of the round at a time, from 0, at most of the last."""
        if self._zero is None:
            return 0
        return max(0, min(math.floor((now - self._zero + early) / self.delta), len(self.plan.rounds) - 1))

    def ports(self, pid: int, now: float) -> Values:
        """What a robot's ports are at a time, in JSON."""
        return self.plan.rounds[self._index(now, EARLY * self.delta)].state.ports[pid]

    def body(self, pid: int, at: float) -> BodyState:
        """Where a body is at a step of the world: from the last step of a round on where the next round has it."""
        ports = self.plan.rounds[self._index(at, STEP + BEFORE)].state.ports[pid]
        start = self._robots[pid].start
        position, velocity, yaw = start.position, (0.0, 0.0, 0.0), start.yaw
        for name in self._measured:
            match name.rpartition(".")[2]:
                case "position":
                    position = tuple(ports[name])
                case "velocity":
                    velocity = tuple(ports[name])
                case _:
                    place, yaw = ports[name]
                    position = tuple(place)
        return BodyState(position, velocity, yaw, 0.0)

    def program(self, program: Program, pid: int, round_: Callable[[], int]) -> Program:
        """The robot's program, which tries the event of the plan or none. `round_` tells the present round."""
        events = tuple([replace(event, guard=self._forced(event, pid, round_)) for event in program.events])
        init = program.init if self.plan.initial else self._given(program, pid)
        return replace(program, events=events, init=init)

    def _forced(self, event: Event, pid: int, round_: Callable[[], int]) -> Callable[[Any], bool]:
        def guard(state: Any) -> bool:
            number = round_()
            if number > len(self.plan.rounds):
                return False
            each = self.plan.rounds[number - 1]
            return (each.free or each.events.get(pid) == event.name) and event.guard(state)

        return guard

    def _given(self, program: Program, pid: int) -> Callable[[Any], None]:
        """Instead of `init`: writes the first round's state."""
        state = self.plan.rounds[0].state
        values = {**state.locals[pid], **state.shared, **state.ports[pid]}
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
            if state.stopped[pid]:
                raise Stopped

        return init

    def answer(self, pid: int, round_: int, port: str, args: tuple[Any, ...]) -> Any:
        """What a callable port says, in JSON. Raises LookupError."""
        calls = self.plan.calls if round_ < 1 else self.plan.rounds[min(round_, len(self.plan.rounds)) - 1].calls
        for name, asked, said in calls.get(pid, ()):
            if name == port and asked == _plain(args):
                return said
        raise LookupError(f"{port} was not asked that in the trace")

    def observe(self, pid: int, record: Record) -> None:
        """A robot's round, as the agent itself tells it."""
        self._seen[pid] = max(self._seen[pid], record.round)
        if record.round > len(self.plan.rounds):
            return
        why = self._difference(pid, record, self.plan.rounds[record.round - 1])
        if why:
            self._differences.append((record.round, pid, why))

    def _difference(self, pid: int, record: Record, each: Planned) -> str:
        state, wanted, ending = each.state, each.events.get(pid), self.plan.ending
        if state.stopped[pid]:
            return "" if record.skipped == "stopped" else "it has not stopped, as it has in the trace"
        frame = record.frame
        if frame is None:
            return f"it skipped the round: {record.skipped}"
        groups = {"locals": (frame.locals, state.locals[pid]), "shared": (frame.shared, state.shared)}
        groups["ports"] = ({**frame.sensors, **frame.actuators}, state.ports[pid])
        for told, meant in groups.values():
            for name, value in told.items():
                if _plain(value) != meant[name]:
                    return f"{name} is {_plain(value)!r} when the round begins, {meant[name]!r} in the trace"
        if record.fault is not None:
            named = ending is not None and (ending.pid, record.event or wanted) == (pid, ending.event)
            if named and record.round == self.plan.found:
                self._discarded = True
                return ""
            return f"{record.event or 'a guard'} has no result ({record.fault}); it has one in the trace"
        if each.free and record.event is not None:
            return f"{record.event} is enabled; in the trace no event is"
        if not each.free and record.event != wanted:
            return f"the trace says {wanted}, the agent's guard is false"
        return ""

    def result(self, outcome: Outcome) -> tuple[int, str]:
        """The exit status of a run that came to its end, and what to say."""
        plan, ending = self.plan, self.plan.ending
        if ending is not None and ending.event == "init" and not outcome.started:
            self._discarded = "(in init)" in self._run.conduct.agents[ending.pid].last_error
            return self._told(outcome, self._shown(outcome))
        late = [pid for pid, seen in enumerate(self._seen) if seen < len(plan.rounds)]
        if not self._differences and late:
            pid = late[0]
            self._differences.append((self._seen[pid] + 1, pid, "it did not come to this round"))
        if self._differences:
            number, pid, why = min(self._differences)
            each = plan.rounds[number - 1]
            where = f"{plan.trace}:{each.line}: round {each.of}, robot {pid} ({self._robots[pid].name})"
            return DIFFERS, f"{where}: {why} (round {number} of the agents)"
        return self._told(outcome, self._shown(outcome))

    def _told(self, outcome: Outcome, shown: str) -> tuple[int, str]:
        plan, ending = self.plan, self.plan.ending
        rounds = sum(1 for each in plan.rounds[:-1])
        cut = f"; {plan.trace}:{plan.cut}: the trace is cut off here" if plan.cut else ""
        ways = f"{plan.trace}: followed in {rounds} round{'s' * (rounds != 1)} of the agents, which did the same"
        if ending is None:
            return HELD, ways + (cut or "; it tells of no violation")
        if shown:
            return VIOLATED, f"{ways}; {shown}"
        return DIFFERS, f"{plan.trace}: the trace says {ending.name}: {ending.detail}; {self._missed(outcome)}"

    def _shown(self, outcome: Outcome) -> str:
        """How the run shows what the trace says is violated; empty where it does not."""
        ending = self.plan.ending
        if ending is None:
            return ""
        if ending.event:
            name = self._robots[ending.pid].name
            return f"{ending.event} of {name} has no result, as the trace says" if self._discarded else ""
        if ending.name == "(deadlock)":
            return "no event is enabled any more, as the trace says"
        found = self._violation(outcome)
        due = (self.plan.found - (not self.plan.environment)) * self.delta
        early = -math.inf if not self.plan.found else -2 * STEP - BEFORE  # robots run `init` before round 1
        if found is None or not early <= found.t - max(0.0, due) <= STEP:
            return ""
        return f"{ending.name} is violated after the same round, as the trace says"

    def _violation(self, outcome: Outcome) -> Violation | None:
        name = self.plan.ending.name if self.plan.ending else ""
        return next((v for v in outcome.violations if v.what == "property" and v.name == name), None)

    def _missed(self, outcome: Outcome) -> str:
        found = self._violation(outcome)
        return f"in the run that is so at {found.t:.3f} s" if found else "in the run that is not so"


class FollowedBody:
    """A koordgen.runtime.vehicle.platform.Platform whose sensors and callable ports say what the plan does. `round_`
    tells the agent's round."""

    period = 0.05

    def __init__(self, guide: Guide, pid: int, program: Program, round_: Callable[[], int]) -> None:
        self._guide, self._pid, self._round = guide, pid, round_
        self._types = {p.name: p.type for p in program.ports if p.direction == "sensor"}
        self._answers = {p.name: p.type for p in program.ports if p.direction == "callable"}
        self.ready, self.rested, self.progress, self.stall = True, False, "", ""

    def sense(self, now: float) -> Sensed:
        """See Platform."""
        ports = self._guide.ports(self._pid, now)
        return Sensed({n: msgspec.json.decode(_encode(ports[n]), type=t) for n, t in self._types.items()}, now)

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        """See Platform."""
        said = self._guide.answer(self._pid, self._round(), port, args)
        return msgspec.json.decode(_encode(said), type=self._answers[port])

    def rest(self, now: float) -> None:
        """See Platform."""
        self.rested = True

    def diagnose(self) -> list[Finding]:
        """See Platform."""
        return []

    def start(self, now: float) -> None:
        """See Platform."""

    def poll(self, now: float) -> None:
        """See Platform."""

    def command(self, actuators: Mapping[str, Any], now: float) -> None:
        """See Platform: the body is where the trace says, whatever is commanded."""

    def others(self, paths: Mapping[int, tuple[Point, ...]]) -> None:
        """See Platform."""

    def news(self) -> list[str]:
        """See Platform."""
        return []

    def hold(self, on: bool, now: float) -> None:
        """See Platform."""

    def close(self) -> None:
        """See Platform."""


def _plain(value: Any) -> Any:
    """A value as traces have it."""
    return json.loads(_encode(value))
