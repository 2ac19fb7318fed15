"""Agents of a random program over a network in memory, and the shared stores that they see."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from random import Random
from typing import Any

from benchmarks.fixtures.fleet import FakePlatform, Fleet, Robot
from koordgen.build.emit.program import program_text
from koordgen.lang.ir import decl
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.property import holds_assumption
from koordgen.lang.semantics.state import State, Store
from koordgen.lang.semantics.step import execute, initial, round_, run_init, select, sense
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.replication.apply import winner
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Sensed
from tests.agree.both import Generated
from tests.verify.explore.random_programs import LEVELS

QUIET = Conditions(delay=0.001, jitter=0.004)
ROUGH = Conditions(loss=0.25, delay=0.001, jitter=0.03, duplication=0.1)
LEVEL = "Dev.level"


class Body(FakePlatform):
    """Its level changes at most once from one look at it to the next, as is assumed."""

    def __init__(self, dice: Random, follows: Callable[[int, int], bool]) -> None:
        super().__init__(Point())
        self.dice, self.follows = dice, follows
        self.level = dice.choice(LEVELS)
        self.robot: Robot | None = None

    def sense(self, now: float) -> Sensed:
        return Sensed({"Motion.position": Point(), LEVEL: self.level}, self.seen)

    def command(self, actuators: Mapping[str, Any], now: float) -> None:
        if self.robot is not None and self.robot.records:  # not between init and the first round
            self.level = self.dice.choice([level for level in LEVELS if self.follows(self.level, level)])


class Agents:
    """What they did in their first rounds."""

    def __init__(self, program: decl.Program, n_sys: int, seed: int, rounds: int, conditions: Conditions) -> None:
        self.program, self.n_sys = program, n_sys
        assumption, params = program.modules[0].assumptions[0], initial(program, n_sys).params

        def follows(now: int, then: int) -> bool:
            return holds_assumption(assumption, program, {LEVEL: now}, {LEVEL: then}, 0, n_sys, params)

        made = Generated(program, program_text(program))
        self.fleet = Fleet(n=n_sys, seed=seed, program=made.program, conditions=conditions)
        dice = Random(seed)
        for pid in range(n_sys):
            body = Body(dice, follows)
            body.robot = self.fleet.boot(pid, body)
        self.fleet.run_told(rounds)
        self.records = [self.fleet.robots[pid].records for pid in range(n_sys)]

    def stores(self, rounds: int) -> set[Hashable]:
        """The stores that events saw, in so many rounds."""
        frames = [r.frame for records in self.records for r in records if r.round <= rounds and r.frame is not None]
        return {tuple(sorted(frame.shared.items())) for frame in frames}

    def predicted(self, rounds: int) -> list[tuple[Hashable, Hashable]]:
        """The store before each round by the semantics, of what agents take where nothing is lost; and as each robot
        that ran an event saw it."""
        levels = [{r.round: r.sensors[LEVEL] for r in records} for records in self.records]
        state = initial(self.program, self.n_sys, [{LEVEL: own[1]} for own in levels])
        state, _ = run_init(self.program, state)
        found: list[tuple[Hashable, Hashable]] = []
        for number in range(1, rounds + 1):
            state = sense(state, [{LEVEL: own[number]} for own in levels])
            frames = [r.frame for records in self.records for r in records if r.round == number]
            found += [(stored(state.store), tuple(sorted(f.shared.items()))) for f in frames if f is not None]
            state, _ = round_(self.program, state, grants=self._grants(state, number))
        return found

    def _grants(self, state: State, number: int) -> dict[int, int]:
        trying: dict[int, list[int]] = {}
        for pid, robot in enumerate(state.robots):
            event = None if robot.stopped else select(self.program, state, pid)
            if not isinstance(event, decl.Event) or event.lock is None:
                continue
            if isinstance(execute(self.program, event.effect, state, pid), Writes):
                trying.setdefault(event.lock, []).append(pid)
        return {lock: winner(pids, lock, number, self.n_sys) for lock, pids in trying.items()}


def stored(store: Store) -> Hashable:
    return tuple(sorted({**store.slots, **store.cells}.items()))
