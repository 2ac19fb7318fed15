"""A mission's rounds on one robot: ticks on the fleet's clock, one event or a skip each, one closing to everyone.

Round r begins at start + (r-1) delta. What a robot lacks then it may still receive until the publish deadline; it
asks for it, and skips the round when it did not come. Ticks are absolute: a robot that wakes late goes on with the
present round, and closes those it missed as empty.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from koordgen.runtime.body import Body, unusable
from koordgen.runtime.clock import FleetClock
from koordgen.runtime.link import Link
from koordgen.runtime.memory import Memory
from koordgen.runtime.platform import Sensed
from koordgen.runtime.program import Frame
from koordgen.runtime.runner import LATE, Outcome, Runner
from koordgen.runtime.trace import Observe, Record
from koordgen.runtime.wire import Need, Round

PUBLISH = 0.5  # of delta: when a round's closing leaves at the latest
SLOTS = 5  # moments in a round at which what is missing is asked for
FIRST_SLOT = 3  # ... from this one on the present round's closings, before it the last round's
LINGER = 20  # rounds after all have stopped
WOKE_LATE = "woke after the publish deadline"


@dataclass(slots=True)
class _Present:
    """The round that is going on."""

    round: int = 0
    open: bool = False
    sensed: Sensed | None = None
    asked: int = -1  # the last slot in which missing closings were asked for


@dataclass(slots=True)
class Counters:
    rounds: int = 0
    skipped: int = 0
    missed: int = 0  # slept through
    faults: int = 0
    discarded: int = 0  # faults by the publish deadline
    waited: int = 0  # rounds in which an atomic event had to wait for its turn
    asked: int = 0  # times that missing closings were asked for
    in_a_row: int = 0  # rounds until now without current state or time for an event


class Rounds:
    """`observe` gets each round's record. `leave` makes the robot close its rounds without events from then on."""

    def __init__(
        self,
        runner: Runner,
        body: Body,
        memory: Memory,
        link: Link,
        clock: FleetClock,
        names: tuple[str, ...],
        start: float,
        delta: float,
        observe: Observe,
    ) -> None:
        self._runner = runner
        self._body = body
        self._memory = memory
        self._link = link
        self._clock = clock
        self._names = names
        self._start = start
        self._delta = delta
        self._observe = observe
        self._peers = tuple(p for p in range(len(names)) if p != link.pid)
        self._present = _Present()
        self._published = 0
        self._turn = link.pid
        self._left = False
        self.stopped = link.pid in memory.stopped
        self.counters = Counters()

    @property
    def round(self) -> int:
        """The present round; 0 before the first."""
        return self._present.round

    @property
    def lacking(self) -> list[str]:
        """The names of those whose closings are missing for the present round."""
        return [self._names[p] for p in self._memory.missing(self._present.round - 1)]

    @property
    def over(self) -> bool:
        """Whether all robots have stopped and the linger has passed."""
        since = self._memory.all_stopped
        return since is not None and self._present.round > since + LINGER

    def leave(self) -> None:
        self._left = True

    def take(self, message: Round | Need) -> None:
        """A message of this mission."""
        present, sender = max(self._present.round, 1), message.head.pid
        through, settled = (message.through, 0) if isinstance(message, Need) else (message.round - 1, message.settled)
        if isinstance(message, Round):
            for closing in message.closings:
                refused = self._memory.take(closing, present)
                if refused is not None:
                    self._link.reject(refused)
        refused = self._memory.heard(sender, message.held, max(0, through), settled, present)
        if refused is not None:
            self._link.reject(refused)
        elif isinstance(message, Need):
            closings = self._memory.repeat(sender)
            if closings:
                self._link.round([sender], self._present.round, self._memory.settled, self._memory.held, closings)

    def poll(self, now: float, sense: Callable[[float], Sensed], unready: str | None) -> float:
        """Do what is due at local time `now`; returns when to be called again at the latest. `sense` samples the
        sensors, `unready` says why no event may run."""
        elapsed = self._clock.read(now) - self._start
        round_ = math.floor(elapsed / self._delta + 1e-6) + 1
        if round_ < 1:
            return self._clock.local(self._start)
        if round_ > self._present.round:
            self._begin(round_, sense(now))
        present = self._present
        into = elapsed - (present.round - 1) * self._delta
        current = self._memory.advance(present.round)
        if present.open:
            self._decide(now, into, current, unready)
        return self._ask(into)

    def _tick(self, part: float) -> float:
        return self._clock.local(self._start + (self._present.round - 1 + part) * self._delta)

    def _begin(self, round_: int, sensed: Sensed) -> None:
        present = self._present
        slept = round_ - present.round - (0 if present.open else 1)
        if slept > 0:
            self._memory.close(round_ - 1, {}, self.stopped)
            self.counters.missed += slept
        self._present = _Present(round_, True, sensed)
        self.counters.rounds += 1

    def _decide(self, now: float, into: float, current: bool, unready: str | None) -> None:
        """Run an event, or find that there will be none; or leave the round open for what may still arrive."""
        sensed = self._present.sensed
        assert sensed is not None
        sensors = self._body.sensors(sensed)
        overdue = into >= PUBLISH * self._delta - 1e-9
        if self._left:
            reason: str | None = "left the mission"
        elif self.stopped:
            reason = "stopped"
        elif not current:
            if not overdue:
                return
            reason = f"not current: lacks {', '.join(self.lacking)}"
        elif overdue:
            reason = WOKE_LATE
        elif self._memory.crowded:
            reason = f"not current: {self._names[self._memory.laggard]} lags behind"
        elif (bad := unusable(sensors)) is not None:
            reason = bad
        else:
            reason = unready
        lagging = reason is not None and reason.startswith("not current")
        self.counters.in_a_row = self.counters.in_a_row + 1 if lagging or reason == WOKE_LATE else 0
        self._body.hold("not current", lagging, now)
        if reason is not None:
            self.counters.skipped += 1
            self._close(Record(self.round, now, into, sensors, None, skipped=reason), now)
            return
        frame = self._runner.frame(self._memory.shared, sensors, self._body.actuators, self._body.call)
        outcome = self._runner.step(frame, self.round, self._tick(PUBLISH))
        self._finish(outcome, frame, now, into)

    def _finish(self, outcome: Outcome, frame: Frame, now: float, into: float) -> None:
        self._body.hold("fault", outcome.fault is not None, now)
        skipped = None
        if outcome.fault is not None:
            skipped = "fault"
            self.counters.faults += 1
            self.counters.discarded += outcome.fault.reason == LATE
        elif outcome.effects is None:
            skipped = outcome.waiting or "no event enabled"
        self.counters.waited += outcome.waiting is not None
        calls = self._body.calls()
        record = Record(
            self.round, now, into, frame.sensors, frame, outcome.event, outcome.effects, skipped, outcome.fault, calls
        )
        self._close(record, now, outcome.commit)

    def _close(self, record: Record, now: float, commit: bool = False) -> None:
        """The closing leaves, then the actuators are commanded: what others never hear of must not move a robot."""
        effects = record.effects
        if effects is not None and effects.stopped:
            self.stopped = True
        memory, present = self._memory, self._present
        memory.close(present.round, effects.shared if effects else {}, self.stopped or self._left, commit)
        present.open = False
        own = memory.own(self._published + 1)
        self._published = present.round
        content = present.round, memory.settled, memory.held
        plain: list[int] = []
        for pid in self._peers:
            repeats = memory.repeat(pid)
            if repeats:
                self._link.round([pid], *content, [*own, *(c for c in repeats if c not in own)])
            else:
                plain.append(pid)
        self._link.round(plain, *content, own)
        if effects is not None:
            self._body.command(effects.actuators, now)
            if self.stopped:
                self._body.hold("stopped", True, now)
        self._observe(record)

    def _ask(self, into: float) -> float:
        """Ask for what should have come by now; returns the next moment at which there may be something to do."""
        present = self._present
        slot = min(SLOTS - 1, math.floor(into / self._delta * SLOTS + 1e-6))
        through = present.round if slot >= FIRST_SLOT else present.round - 1
        missing = [p for p in self._memory.missing(through) if p != self._link.pid]
        if missing and slot > present.asked:
            present.asked = slot
            others = [p for p in self._peers if p not in missing]
            self._turn += 1
            helper = [others[self._turn % len(others)]] if others else []
            self._link.need([*missing, *helper], through, self._memory.held)
            self.counters.asked += 1
        if present.open:
            deadline = self._tick(PUBLISH)
            return min(deadline, self._tick((slot + 1) / SLOTS))
        if missing:
            return self._tick((slot + 1) / SLOTS)
        return self._tick(FIRST_SLOT / SLOTS if slot < FIRST_SLOT else 1.0)
