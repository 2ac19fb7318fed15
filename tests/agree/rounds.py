"""Whole rounds of a random program, by agents on a network in memory and by the executable semantics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from random import Random
from typing import Any

import msgspec

from benchmarks.fixtures.fleet import FakePlatform, Fleet
from koordgen.build.bundle.budget import check_budget
from koordgen.build.emit.program import program_text
from koordgen.lang.ir import decl as d
from koordgen.lang.ir.ports import clearable
from koordgen.lang.ir.types import MapOf, RecordType, Sequence, Sized, TupleOf, Type
from koordgen.lang.node import replace
from koordgen.lang.semantics import step
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import Writes, declared
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.values import RecordValue, Value
from koordgen.runtime.program.program import Frame
from koordgen.runtime.program.runner import LOST_CONTENTION, name_of
from koordgen.runtime.replication.apply import winner
from koordgen.runtime.trace.writer import RoundRecord
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Sensed
from tests.agree.both import Difference, Generated, Meant, answer, key
from tests.agree.kinds import random_value
from tests.agree.programs import N_SYS, random_program

ROUNDS = 10
Winner = Callable[[list[int], int, int, int], int]  # those who try, lock, round, robots -> pid


class Body(FakePlatform):
    """Vehicle whose sensors have new values after each command."""

    def __init__(self, pid: int, generated: Generated, rng: Random) -> None:
        super().__init__(Point())
        self.pid, self.generated, self.rng = pid, generated, rng
        self.look()
        self.first = self.values

    def look(self) -> None:
        ports = [(f"{m.name}.{p.name}", p) for m in self.generated.ir.modules for p in m.ports]
        self.values = {
            name: self.generated.python(random_value(self.rng, p.type, wild=False), p.type)
            for name, p in ports
            if p.direction == "sensor"
        }
        self.values["Motion.position"] = Point(*[self.rng.choice((0.0, 0.5, 1.5)) for _ in "xyz"])  # within the fence

    def sense(self, now: float) -> Sensed:
        return Sensed(self.values, now)

    def command(self, actuators: Mapping[str, Any], now: float) -> None:
        self.look()

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        return answer(self.pid, port, args)


def small(seed: int) -> d.Program | None:
    """Return a random program whose shared variables fit into a datagram, or None."""
    program = random_program(seed)
    program = replace(program, shared=tuple([replace(v, type=_small(v.type)) for v in program.shared]))
    return None if check_budget(program, N_SYS) else program


def _small(type_: Type) -> Type:
    match type_:
        case Sized(name):
            return Sized(name, {"string": 16, "GridMap": 24}.get(name, 2))
        case Sequence(name, element):
            return Sequence(name, _small(element), 3)
        case MapOf(k, v):
            return MapOf(_small(k), _small(v), 3)
        case TupleOf(items):
            return TupleOf(tuple(map(_small, items)))
        case RecordType(name, fields):
            return RecordType(name, tuple([(field, _small(held)) for field, held in fields]))
        case _:
            return type_


def agree(program: d.Program, seed: int, seen: Counter[str], wins: Winner = winner) -> None:
    """Check that rounds of every robot are those of the semantics. `wins` seeds faults."""
    both = _Both(program, seed)
    state = both.begin()
    if state is None:
        seen["init failed"] += 1
        return
    for round_ in range(1, ROUNDS + 1):
        state = both.round(state, round_, seen, wins)


class _Both:
    def __init__(self, program: d.Program, seed: int) -> None:
        self.program, self.seed, self.types = program, seed, declared(program)
        self.generated, self.semantics = Generated(program, program_text(program)), Meant(program)
        self.fleet = Fleet(n=N_SYS, seed=seed, program=self.generated.program)
        self.atomic = {e.name for e in program.events if e.lock is not None}
        rng = Random(seed)
        self.bodies = [Body(pid, self.generated, rng) for pid in range(N_SYS)]
        for pid, body in enumerate(self.bodies):
            self.fleet.boot(pid, body)
        self.fleet.run(60, until=lambda: bool(self.failed()) or all(len(r.records) >= ROUNDS for r in self.robots))

    @property
    def robots(self) -> list[Any]:
        return [self.fleet.robots[pid] for pid in range(N_SYS)]

    def failed(self) -> list[int]:
        return [pid for pid, robot in enumerate(self.robots) if robot.agent.phase in ("stopping", "stopped")]

    def begin(self) -> State | None:
        """Return the state before round 1; None if an init fails, which must happen on both sides."""
        uncommanded = dict.fromkeys(clearable(self.program), True)
        given = [{**self.meant(b.first), **uncommanded} for b in self.bodies]
        first = step.initial(self.program, N_SYS, given)
        state, steps = step.run_init(self.program, first, self.semantics.world)
        wrong = any(not isinstance(s.outcome, Writes) for s in steps)
        self.same(bool(self.failed()), wrong, "an init fails")
        return None if wrong else state

    def round(self, state: State, number: int, seen: Counter[str], wins: Winner) -> State:
        records: list[RoundRecord] = [robot.records[number - 1] for robot in self.robots]
        self.same([r.round for r in records], [number] * N_SYS, "rounds")
        state = step.sense(state, [self.meant(r.sensors) for r in records])
        trying = self.trying(state)
        for pid, record in enumerate(records):
            if record.frame is None:
                may = "stopped" if state.robots[pid].stopped else "runs"
                gave_way = may == "runs" and pid in trying and name_of(record.skipped or "") == LOST_CONTENTION
                self.same(may if gave_way else record.skipped, may, f"{number}, {pid}")
            else:
                expected = self.keys(self.generated.frame(state, pid))
                self.same(self.keys(record.frame), expected, f"what robot {pid} sees in round {number}")
        grants = {}
        for lock in range(len(self.program.locks)):
            able = [pid for pid, (wanted, outcome) in trying.items() if wanted == lock and isinstance(outcome, Writes)]
            if able:
                grants[lock] = wins(able, lock, number, N_SYS)
        state, steps = step.round_(self.program, state, grants=grants, world=self.semantics.world)
        for taken in steps:
            record = records[taken.pid]
            found = record.effects or record.fault
            did = "skipped" if found is None else self.generated.done(found)
            outcome = taken.outcome
            if outcome is None and taken.pid in trying and isinstance(trying[taken.pid][1], Discarded):
                outcome = trying[taken.pid][1]  # a robot finds that before it could give way
            wanted = "skipped" if outcome is None else self.semantics.done(outcome)
            self.same(did, wanted, f"what robot {taken.pid} does in round {number}")
            word = wanted if isinstance(wanted, str) else "ran"
            seen[word] += 1
            seen["committed"] += word == "ran" and taken.event in self.atomic
        return state

    def trying(self, state: State) -> dict[int, tuple[int, Writes | Discarded]]:
        """Return the robots that run an atomic event in this round: its lock, and its effect."""
        found = {}
        for pid, robot in enumerate(state.robots):
            event = None if robot.stopped else step.select(self.program, state, pid, self.semantics.world)
            if isinstance(event, d.Event) and event.lock is not None:
                outcome = step.execute(self.program, event.effect, state, pid, self.semantics.world)
                found[pid] = event.lock, outcome
        return found

    def keys(self, frame: Frame) -> Any:
        actuators = [f"{m.name}.{p.name}" for m in self.program.modules for p in m.ports if p.direction == "actuator"]
        slots = {v.name for v in self.program.shared if v.kind == "allread"}
        return (
            {name: key(value, self.types[name]) for name, value in frame.locals.items()},
            {
                name: [key(v, self.types[name]) for v in value] if name in slots else key(value, self.types[name])
                for name, value in frame.shared.items()
            },
            {name: key(frame.actuators[name], self.types[name]) for name in actuators},
        )

    def meant(self, values: Mapping[str, Any]) -> dict[str, Value]:
        return {name: _meant(value, self.types[name]) for name, value in values.items()}

    def same(self, found: Any, expected: Any, what: str) -> None:
        if found != expected:
            raise Difference(f"small({self.seed}), {what}: agents say {found}, the semantics {expected}")


def _meant(value: Any, type_: Type) -> Any:
    """Return a robot's value in the form of the semantics."""
    match type_:
        case RecordType(name, fields):
            parts = zip(msgspec.structs.astuple(value), fields, strict=True)
            return RecordValue(name, tuple([_meant(part, t) for part, (_, t) in parts]))
        case Sequence(_, element):
            return tuple([_meant(part, element) for part in value])
        case MapOf(k, v):
            return tuple([(_meant(a, k), _meant(b, v)) for a, b in value])
        case TupleOf(items):
            return tuple([_meant(part, t) for part, t in zip(value, items, strict=True)])
        case _:
            return value
