"""What a robot's rounds came to, until it is certain that they count.

An event's locals are there at once, or when its commit has won. What leaves the robot, its commands, lines and trace,
waits until the round is stable: nothing that the fleet does not count ever moves a robot.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from msgspec.structs import replace

from koordgen.runtime.program.program import Effects, Life
from koordgen.runtime.program.runner import LOST_CONTENTION, NOT_COUNTED
from koordgen.runtime.replication.state_machine import StateMachine
from koordgen.runtime.trace.writer import Record

MOST_WAITING = 64  # records; behind so many that of a round in which nothing was done is not told
AHEAD = 3  # rounds beyond the last stable one in which events without outputs may still run


@dataclass(slots=True)
class _Waiting:
    record: Record
    lock: int  # -1: a plain event, or none
    life: Life | None


class Outbox:
    """In order of the rounds. `lives` are those that may have to be gone back to; the first is certain. `first` is the
    first round whose outputs wait, None: none do."""

    def __init__(self, life: Life) -> None:
        self._waiting: deque[_Waiting] = deque()
        self._commit: _Waiting | None = None  # of which it is not known whether it has won
        self.lives = [life]
        self.first: int | None = None

    @property
    def life(self) -> Life:
        """The latest one, of which it is not yet certain that it counts."""
        return self.lives[-1]

    @property
    def undecided(self) -> bool:
        """Whether an atomic event waits to hear whether its commit has won."""
        return self._commit is not None

    @property
    def pressing(self) -> bool:
        """Whether what waits must be looked at before the next event: it may change this robot's variables, or what it
        commands, or there is no room for more. All else has time until that event's entry has left."""
        return self.first is not None or self._commit is not None or len(self._waiting) >= MOST_WAITING

    def add(self, record: Record, lock: int = -1, life: Life | None = None) -> None:
        """A round's record; with the life that its event leads to, if it had one."""
        waiting = _Waiting(record, lock, life)
        if len(self._waiting) < MOST_WAITING or life is not None:
            self._waiting.append(waiting)
        if self.first is None and has_outputs(record.effects):
            self.first = record.round
        if lock >= 0:
            self._commit = waiting
        elif life is not None:
            self.lives.append(life)

    def decide(self, state: StateMachine) -> bool | None:
        """Whether the commit that was waited for has won; None when there is none, or no news of it."""
        waiting = self._commit
        if waiting is None or state.applied < waiting.record.round:
            return None
        self._commit = None
        waiting.lock = -1
        if state.won == waiting.record.round:
            if waiting.life is not None:
                self.lives.append(waiting.life)
            return True
        why = f"{LOST_CONTENTION}: {waiting.record.event}, to another robot's transaction"
        waiting.record = replace(waiting.record, event=None, effects=None, frame=None, skipped=why)
        waiting.life = None
        self._look()
        return False

    def can_settle(self, state: StateMachine) -> bool:
        """Whether there is news of what waits."""
        if not self._waiting:
            return False
        first, commit = self._waiting[0], self._commit
        if commit is not None and state.applied >= commit.record.round:
            return True
        return first.lock < 0 and _is_certain(first.record, state)

    def ready(self, state: StateMachine | None) -> list[Record]:
        """The records that are certain now, in order; without a store those before the first that did something."""
        found = []
        while self._waiting and self._waiting[0].lock < 0:
            waiting = self._waiting[0]
            if not _is_certain(waiting.record, state):
                break
            self._waiting.popleft()
            found.append(waiting.record)
            if waiting.record.round == self.first:
                self._look()
            while waiting.life is not None and self.lives[0] is not waiting.life:
                del self.lives[0]
        return found

    def settle(self, acted: int) -> tuple[Life | None, list[Record]]:
        """After coming back, when the last event of ours that counts is that of round `acted`: the life to go on with,
        None when it is not known any more, and all records, now that they are certain."""
        proposed = [w.life for w in self._waiting if w.lock >= 0 and w.life is not None]  # it may have won after all
        life = next((life for life in (*self.lives, *proposed) if life.round == acted), None)
        found = []
        for waiting in self._waiting:
            record = waiting.record
            if (record.effects is not None or record.frame is not None) and record.round > acted:
                record = replace(
                    record, event=None, effects=None, frame=None, skipped=f"{NOT_COUNTED}: the others went on"
                )
            found.append(record)
        self._waiting.clear()
        self._commit = self.first = None
        if life is not None:
            self.lives = [life]
        return life, found

    def _look(self) -> None:
        self.first = next((w.record.round for w in self._waiting if has_outputs(w.record.effects)), None)


def _is_certain(record: Record, state: StateMachine | None) -> bool:
    """Whether no view can leave out what was done in a round, or what was seen in it by one who did nothing."""
    if record.effects is None and record.frame is None:
        return True
    last = record.round if record.effects is not None else record.round - 1
    return state is not None and last <= state.committed


def has_outputs(effects: Effects | None) -> bool:
    """Whether an event did something that leaves the robot."""
    return effects is not None and bool(effects.actuators or effects.streams or effects.stopped)
