"""Output commit: outputs of a round wait until the round is committed.

A plain event changes its robot's private variables at once. A transaction (an event with a lock) changes them when it
has won the lock. Outputs (actuator commands, lines of streams, trace records) wait until the round is committed, so an
event that a view change discards never moves a robot."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from msgspec.structs import replace

from koordgen.runtime.program.program import Effects, Life
from koordgen.runtime.program.runner import LOST_CONTENTION, NOT_COUNTED
from koordgen.runtime.replication.state_machine import StateMachine
from koordgen.runtime.trace.writer import RoundRecord

MOST_WAITING = 64  # number of waiting records from which on records of rounds without an event are dropped
AHEAD = 3  # number of rounds after the last committed round in which events may run if no output waits


@dataclass(slots=True)
class _Waiting:
    record: RoundRecord
    lock: int  # lock of a transaction whose result is unknown; -1: any other record
    life: Life | None


class OutputCommit:
    """Queue of the records of one instance's rounds that are not committed yet.

    lives: private states to which the robot may have to roll back, by ascending round; the first state is committed.
    first: first round whose outputs wait; None if no outputs wait.
    rival: text for users about the transaction that wins a lock that this instance wants.
    """

    def __init__(self, life: Life, instance: int) -> None:
        self._instance = instance
        self.rival = "another robot's transaction"
        self._waiting: deque[_Waiting] = deque()
        self._commit: _Waiting | None = None  # transaction whose result is unknown
        self.lives = [life]
        self.first: int | None = None

    @property
    def life(self) -> Life:
        """Latest private state of the robot, whether or not its round is committed."""
        return self.lives[-1]

    @property
    def undecided(self) -> bool:
        """True if the result of a transaction is not known yet."""
        return self._commit is not None

    @property
    def pressing(self) -> bool:
        """True if waiting records must be handled before the next event.

        The reason is that outputs wait, that a transaction is undecided, or that MOST_WAITING records wait. Otherwise
        the records are handled after the event's entry was sent, because other robots wait for the entry.
        """
        return self.first is not None or self._commit is not None or len(self._waiting) >= MOST_WAITING

    def add(self, record: RoundRecord, lock: int = -1, life: Life | None = None) -> None:
        """Add the record of a round. `life`: private state after the round's event; None without an event."""
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
        """Return whether the pending transaction has won its lock.

        Return None without a pending transaction, or while its round is not applied.
        """
        waiting = self._commit
        if waiting is None or state.applied < waiting.record.round:
            return None
        self._commit = None
        waiting.lock = -1
        if state.won.get(self._instance) == waiting.record.round:
            if waiting.life is not None:
                self.lives.append(waiting.life)
            return True
        why = f"{LOST_CONTENTION}: {waiting.record.event}, to {self.rival}"
        waiting.record = replace(waiting.record, event=None, effects=None, frame=None, skipped=why)
        waiting.life = None
        self._look()
        return False

    def can_settle(self, state: StateMachine) -> bool:
        """Return whether `decide` has a result or `ready` has a record to return."""
        if not self._waiting:
            return False
        first, commit = self._waiting[0], self._commit
        if commit is not None and state.applied >= commit.record.round:
            return True
        return first.lock < 0 and _is_committed(first.record, state)

    def ready(self, state: StateMachine | None) -> list[RoundRecord]:
        """Remove and return the committed records, by ascending round.

        If `state` is None (no store), only records before the first record with an event are returned."""
        found = []
        while self._waiting and self._waiting[0].lock < 0:
            waiting = self._waiting[0]
            if not _is_committed(waiting.record, state):
                break
            self._waiting.popleft()
            found.append(waiting.record)
            if waiting.record.round == self.first:
                self._look()
            while waiting.life is not None and self.lives[0] is not waiting.life:
                del self.lives[0]
        return found

    def settle(self, acted: int) -> tuple[Life | None, list[RoundRecord]]:
        """Decide all waiting records after a rejoin.

        acted: round of this robot's last event that counts for the fleet.
        Return the private state after that event (None if the state is no longer stored), and all records.
        """
        # An undecided transaction may have won while this robot was out. The robot then continues with the private
        # state after that transaction.
        proposed = [w.life for w in self._waiting if w.lock >= 0 and w.life is not None]
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


def _is_committed(record: RoundRecord, state: StateMachine | None) -> bool:
    """Return whether the round of a record is committed, so that no later view can discard it.

    For an event without effects, the round before must be committed, because the event has read the store after that
    round. A record without an event counts as committed.
    """
    if record.effects is None and record.frame is None:
        return True
    last = record.round if record.effects is not None else record.round - 1
    return state is not None and last <= state.committed


def has_outputs(effects: Effects | None) -> bool:
    """Return whether an event has outputs: actuator commands, lines of streams, or a stop of the robot."""
    return effects is not None and bool(effects.actuators or effects.streams or effects.stopped)
