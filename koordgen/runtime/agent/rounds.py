"""A mission's rounds on one robot: ticks on the fleet's clock, one event or a skip each, one closing to everyone.

Round r begins at start + (r-1) delta. What a robot lacks then it may still receive until the publish deadline; it
asks for it, and skips the round when it did not come. Ticks are absolute: a robot that wakes late goes on with the
present round, and closes those it missed as empty.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from msgspec.structs import replace

from koordgen.runtime.agent.outbox import AHEAD, Outbox, has_outputs
from koordgen.runtime.net.fleet_clock import FleetClock
from koordgen.runtime.net.metrics import Counters
from koordgen.runtime.program.program import Effects, Frame, Life
from koordgen.runtime.program.runner import (
    FAULT,
    LATE,
    LEFT,
    NO_EVENT,
    NOT_CONFIRMED,
    NOT_CURRENT,
    STOPPED,
    WOKE_LATE,
    Outcome,
    Runner,
)
from koordgen.runtime.replication.memory import Memory
from koordgen.runtime.replication.patience import Patience, many
from koordgen.runtime.replication.replica import SLOTS, Replica, Talk
from koordgen.runtime.trace.watched import OWN, SENSED, SHARED, Moment
from koordgen.runtime.trace.writer import Observe, Record
from koordgen.runtime.vehicle.body import Body, unusable
from koordgen.runtime.vehicle.platform import Sensed

PUBLISH = 0.5  # of delta: when a round's closing leaves at the latest
FIRST_SLOT = 3  # the first of a round's SLOTS in which its own closings are asked for, before it the last round's
PUNCTUAL = 0.5  # of a slot: who wakes so much later than something was due is late
GATHER = 300e-6  # seconds that the closing of one more robot may take to come after another's
MOST_GATHER = 0.2  # of a round, for all of them: one of its SLOTS
LINGER = 20  # rounds after all have stopped


@dataclass(slots=True)
class _Present:
    """How far this robot is in the round that is going on."""

    open: bool = False
    sensed: Sensed | None = None
    slot: int = -1  # the last slot that was looked at
    confirmed: bool = False  # those who wait for it were told that the round is applied


class Lost(Exception):
    """This robot cannot go on in the mission; the message says why."""


class Rounds:
    """`observe` gets the record of each round once it is certain. `keep` must have kept a life, which the given
    incarnation of this robot leads, before its closing leaves. `leave` makes the robot close its rounds without events
    from then on."""

    def __init__(
        self,
        runner: Runner,
        body: Body,
        replica: Replica,
        clock: FleetClock,
        names: tuple[str, ...],
        start: float,
        delta: float,
        lives: list[Life],
        observe: Observe,
        keep: Callable[[Life, int], None],
    ) -> None:
        self._runner = runner
        self._body = body
        self._replica, self._pid = replica, replica.pid
        self._clock = clock
        self._names = names
        self._start = start
        self._delta = delta
        self._observe = observe
        self._keep = keep
        self.round = 0  # the present one; 0 before the first
        self._present = _Present()
        self._published = 0
        self._wake = math.inf  # when there is something to do
        self._patience = Patience(self._pid, len(names))
        self._left = False
        self._sure = 0  # the last round that is known to be stable
        self._restored: Life | None = None  # to be told with the next record
        self._outbox = Outbox(lives[0])
        self._outbox.lives = list(lives)
        self._returns = replica.returns
        self._view = replica.views.view.number  # the latest in which this robot has given its word
        self.stopped = self._outbox.life.stopped
        self.counters = Counters()
        self.reason: str | None = None  # why the last round that was closed had no event
        self.watched = False  # by monitors
        self.moment: Moment | None = None  # at the start of that round, when it is watched

    @property
    def lacking(self) -> list[str]:
        """The names of those whose closings are missing for the present round."""
        memory = self._replica.memory
        return [] if memory is None else [self._names[p] for p in memory.missing(self.round - 1)]

    @property
    def over(self) -> bool:
        """Whether all robots that count have stopped and the linger has passed."""
        memory = self._replica.memory
        since = None if memory is None or not (self.stopped or self._left) else memory.all_stopped
        return since is not None and self.round > since + LINGER

    def ripe(self, now: float) -> bool:
        """Whether another round has begun for which everything is there: its event may run before anything else."""
        memory, present = self._replica.memory, self._present
        if memory is None or present.open or memory.applied != self.round or not self.round:
            return False
        return self._clock.read(now) >= self._start + self.round * self._delta

    @property
    def calm(self) -> bool:
        """Whether nothing more is expected in this round: there is time for what can wait."""
        memory, present = self._replica.memory, self._present
        return not present.open and (memory is None or memory.applied >= self.round or present.slot >= FIRST_SLOT)

    @property
    def expects(self) -> tuple[int, float]:
        """How many closings the round that this robot has closed still lacks, and seconds that it pays to gather them:
        to wake for each of many alone costs more than all else. Nothing outstanding: 1, and no time."""
        memory, at_once = self._replica.memory, self._present.open and not self._patience.strained(self.round)
        if memory is None or at_once or memory.applied >= self.round or not (lacking := memory.lacking()):
            return 1, 0.0
        return lacking, min(GATHER * lacking, MOST_GATHER * self._delta)

    def leave(self) -> None:
        self._left = True

    def take(self, messages: Sequence[Talk]) -> None:
        """Messages of this mission."""
        take, present = self._replica.take, max(self.round, 1)
        for message in messages:
            take(message, present)

    def poll(self, now: float, sense: Callable[[float], Sensed], unready: str | None) -> float:
        """Do what is due at local time `now`; returns when to be called again at the latest. `sense` samples the
        sensors, `unready` says why no event may run. Raises Lost."""
        elapsed = self._clock.read(now) - self._start
        round_ = math.floor(elapsed / self._delta + 1e-6) + 1
        if round_ < 1:
            self._wake = self._clock.local(self._start)
            return self._wake
        if round_ > self.round:
            self._begin(round_, sense(now))
        present = self._present
        into = elapsed - (self.round - 1) * self._delta
        slot = max(0, min(SLOTS - 1, math.floor(into / self._delta * SLOTS + 1e-6)))  # it may have begun by rounding
        fresh = slot > present.slot
        timely = fresh and now < self._wake + PUNCTUAL * self._delta / SLOTS
        memory = self._replica.memory
        ripe = fresh and present.open and memory is not None and memory.applied == self.round - 1
        if fresh:
            present.slot = slot
            if not ripe:
                self._replica.poll((self.round - 1) * SLOTS + slot, self.round)
                memory = self._replica.memory
        if memory is not None and not present.open and self._calm(memory):
            if not fresh:
                return self._wake
            if memory.view.number == self._view:
                self._wake = self._ask(slot, fresh, timely)
                return self._wake
        current = False
        if memory is not None:
            if self._returns != self._replica.returns:
                self._come_back(memory, now)
            current = memory.advance(self.round)
            if memory.view.number != self._view:  # words in the new view are wanted before events can go on
                self._view = memory.view.number
                self._replica.tell(self.round)
            if self._outbox.pressing:
                self._settle(now)
        else:
            for record in self._outbox.ready(None):
                self._observe(record)
        if present.open:
            self._decide(now, into, current, unready)
        if memory is not None:
            if not present.open:
                memory.advance(self.round + 1)
            self._settle(now)
            if not present.open:
                self._replica.keep()  # the next closing says so, and should not have to wait for it
                self._confirm(memory.applied)
        if ripe and not (self._replica.begin(self.round) and slot == 0):  # only now: all others wait for the closing
            self._replica.poll((self.round - 1) * SLOTS + slot, self.round)
        self._wake = self._ask(slot, fresh, timely)
        return self._wake

    def _calm(self, memory: Memory) -> bool:
        """Whether nothing that has come since the last poll of this round makes a difference to it."""
        stays = self._returns == self._replica.returns and (memory.applied >= self.round or memory.lacking() > 0)
        return stays and not self._outbox.can_settle(memory)

    def _tick(self, part: float) -> float:
        return self._clock.local(self._start + (self.round - 1 + part) * self._delta)

    def _begin(self, round_: int, sensed: Sensed) -> None:
        present, memory = self._present, self._replica.memory
        slept = round_ - self.round - (0 if present.open else 1)
        if slept > 0 and memory is not None:
            if memory.held[self._pid] < round_ - 1:
                memory.close(round_ - 1, {}, stopped=self.stopped)
            self.counters.missed += slept
        self.round, self._present = round_, _Present(True, sensed)
        self.counters.rounds += 1

    def _come_back(self, memory: Memory, now: float) -> None:
        """Go on where the others say that this robot was, which was out until now."""
        self._returns = self._replica.returns
        acted = memory.acted[self._pid]
        life, records = self._outbox.settle(acted)
        if life is None:
            raise Lost(
                f"the last event of this robot that the others count is that of round {acted}, and its own variables "
                "of that round are not kept any more: it cannot come back to this mission"
            )
        self._runner.locals, self.stopped = life.locals, life.stopped
        self._restored = life
        self._body.restore(life.actuators, now)
        self._body.hold(STOPPED, self.stopped, now)
        for record in records:
            self._observe(record)
        self._published = memory.held[self._pid]
        round_ = self.round
        if not self._present.open and self._published < round_:  # of this round the others have an older life's closing
            memory.close(round_, {}, stopped=self.stopped)
            self._replica.publish(self._published + 1, round_, self._patience.strained(round_))
            self._published = round_

    def _settle(self, now: float) -> None:
        """Do what has become certain."""
        memory, outbox = self._replica.memory, self._outbox
        assert memory is not None
        won = outbox.decide(memory)
        if won:
            self._runner.locals = outbox.life.locals
            self.stopped = self.stopped or outbox.life.stopped
        elif won is False:
            self.counters.gave_way += 1
            # What was kept for the case that it wins must not, again and again, take the room of what has counted.
            self._keep(outbox.life, memory.view.members[self._pid])
        for record in outbox.ready(memory):
            effects = record.effects
            if effects is not None:
                self._replica.keep()  # our own word is one of the majority's
                self._body.command(effects.actuators, now)
                self._body.hold(STOPPED, effects.stopped or self.stopped, now)
                self._sure = record.round
            self._observe(record)
        if outbox.first is None:
            self._body.hold(NOT_CONFIRMED, False, now)

    def _decide(self, now: float, into: float, current: bool, unready: str | None) -> None:
        """Run an event, or find that there will be none; or leave the round open for what may still arrive."""
        sensed = self._present.sensed
        assert sensed is not None
        sensors = self._body.sensors(sensed)
        overdue = into >= PUBLISH * self._delta - 1e-9
        lagging = False
        if self._left:
            reason: str | None = LEFT
        elif self.stopped and current:
            reason = STOPPED
        else:
            reason = self._unsettled(current)
            lagging = reason is not None
            if lagging and not overdue and (current or self._patience.waits(self.round)):
                return
            if reason is None and overdue:
                reason = WOKE_LATE
        if reason is None:
            reason = unusable(sensors) or unready
        late = lagging or reason == WOKE_LATE
        self.counters.current += current
        self.counters.in_a_row = self.counters.in_a_row + 1 if late else 0
        self.reason = reason
        self.moment = self._moment(now, sensed.time, sensors, current) if self.watched and not self._left else None
        self._body.hold(NOT_CURRENT, lagging and not current, now)
        self._body.hold(NOT_CONFIRMED, self._outbox.first is not None, now)
        if reason is not None:
            self.counters.skipped += 1
            self._close()
            self._wait(Record(self.round, now, into, sensors, None, skipped=reason))
            return
        memory = self._replica.memory
        assert memory is not None
        self._body.others(memory.shared)
        frame = self._runner.frame(memory.shared, sensors, self._body.actuators, self._body.call)
        self._finish(self._runner.step(frame, self._tick(PUBLISH)), frame, now, into)

    def _moment(self, now: float, sensed: float | None, sensors: Mapping[str, Any], current: bool) -> Moment:
        """What this robot knows before its event."""
        memory, own, body = self._replica.memory, self._runner.locals, self._body.actuators
        if memory is None or self._outbox.first is not None or self._outbox.undecided:
            return Moment(self.round, now, SENSED, sensed, sensors, own, {}, body)
        return Moment(self.round, now, SHARED if current else OWN, sensed, sensors, own, memory.shared, body)

    def _unsettled(self, current: bool) -> str | None:
        """Why no event may run as far as the shared memory goes."""
        memory, round_ = self._replica.memory, self.round
        if memory is None:
            return self._replica.status
        if not current:
            if memory.frozen:
                return f"{NOT_CURRENT}: the fleet decides who counts"
            return f"{NOT_CURRENT}: lacks {', '.join(self.lacking)}"
        if self._outbox.first is not None or self._outbox.undecided:
            unaware = memory.unaware(self._outbox.first or round_ - 1)
            return (
                f"{NOT_CONFIRMED}: waits for the acknowledgement of a majority, not heard from {self._named(unaware)}"
            )
        if round_ - AHEAD > self._sure and not memory.stable(round_ - AHEAD):
            return f"{NOT_CONFIRMED}: not heard from {self._named(memory.unaware(round_ - AHEAD))}"
        if memory.crowded():
            return f"{NOT_CURRENT}: {self._names[memory.laggard]} lags behind"
        return None

    def _named(self, pids: list[int]) -> str:
        return ", ".join(self._names[p] for p in pids)

    def _finish(self, outcome: Outcome, frame: Frame, now: float, into: float) -> None:
        """Close a round in which an event could run; its record is made when all others have their closing."""
        fault, effects = outcome.fault, outcome.effects
        self._body.hold(FAULT, fault is not None, now)
        life = self._close(effects, outcome.lock)
        if fault is not None:
            self.counters.faults += 1
            self.counters.discarded += fault.reason == LATE
        skipped = None if effects is not None else NO_EVENT if fault is None else FAULT
        calls = self._body.calls()
        record = Record(self.round, now, into, frame.sensors, frame, outcome.event, effects, skipped, fault, calls)
        self._wait(record, outcome.lock, life)

    def _close(self, effects: Effects | None = None, lock: int = -1) -> Life | None:
        """The closing leaves; the life that the event led to, which was kept before."""
        memory, round_ = self._replica.memory, self.round
        self._present.open = False
        life = None
        if effects is not None:
            assert memory is not None
            actuators = {**self._body.actuators, **effects.actuators}
            life = Life(round_, effects.locals, actuators, effects.stopped or self.stopped)
            if lock < 0:
                self._runner.locals, self.stopped = life.locals, life.stopped
            self._keep(life, memory.view.members[self._pid])
        if memory is not None:
            stopped = self.stopped or self._left or (life is not None and life.stopped)
            shared, prompt = effects.shared if effects else {}, has_outputs(effects)
            memory.close(round_, shared, stopped=stopped, acted=life is not None, prompt=prompt, lock=lock)
        else:
            self.counters.out += 1
        self._replica.publish(self._published + 1, round_, self._patience.strained(round_))
        self._published = round_
        return life

    def _wait(self, record: Record, lock: int = -1, life: Life | None = None) -> None:
        """What a round came to waits until it is certain that it counts."""
        if self._restored is not None:
            record, self._restored = replace(record, restored=self._restored), None
        self._outbox.add(record, lock, life)

    def _confirm(self, applied: int) -> None:
        """Tell those who wait for it that this robot has applied the round they closed."""
        if applied >= self.round and not self._present.confirmed:
            self._present.confirmed = True
            self._replica.confirm(self.round)

    def _ask(self, slot: int, fresh: bool, timely: bool) -> float:
        """Ask for what should have come by now; returns the next moment at which there may be something to do."""
        present, memory = self._present, self._replica.memory
        if memory is None:
            return self._following(slot)
        through = self.round if slot >= FIRST_SLOT else self.round - 1
        missing = [p for p in memory.missing(through) if p != self._pid]
        waited = self._outbox.first
        unaware = memory.unaware(waited) if waited is not None and (waited < through or slot >= 1) else []
        if fresh:
            self._patience.wakes(self.round, timely and not many(len(missing), len(self._names)))
        if fresh and (missing or unaware) and self._patience.asks(self.round, timely, memory.ledger.lost(missing)):
            self._replica.ask(missing, unaware, through)
            self.counters.asked += 1
        if present.open or missing or waited is not None or self._replica.busy():
            return self._following(slot)
        if slot < FIRST_SLOT:
            if memory.applied < self.round or self._replica.emergency:
                return self._tick(FIRST_SLOT / SLOTS)
            self._replica.complete(self.round)
        return self._tick(1.0)

    def _following(self, slot: int) -> float:
        next_ = SLOTS if self._patience.hurried(self.round) and not self._replica.busy() else slot + 1
        return self._tick(min(next_ / SLOTS, PUBLISH if self._present.open else 1.0))
