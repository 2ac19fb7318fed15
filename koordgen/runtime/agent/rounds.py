"""Rounds of a mission on one robot: in each round, each instance runs at most one event, and one entry is sent.

A robot has one instance for each application that it runs, mostly one.

Round r begins at start + (r-1) * delta of fleet time. The event of round r needs the entries of round r-1 of all
members. Entries that are missing at the beginning of the round may still arrive until the publish deadline. The robot
requests missing entries, and skips its event if they do not arrive. Rounds follow the clock: a robot that wakes late
continues with the present round, and closes the missed rounds without events."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from koordgen.runtime.agent.instance import AgentInstance, InstanceRun
from koordgen.runtime.agent.output_commit import AHEAD, has_outputs
from koordgen.runtime.net.fleet_clock import FleetClock
from koordgen.runtime.net.metrics import RoundCounters
from koordgen.runtime.net.wire import ReplicaMessage
from koordgen.runtime.program.runner import (
    FAULT,
    LATE,
    LEFT,
    NO_EVENT,
    NOT_CONFIRMED,
    NOT_CURRENT,
    STOPPED,
    WOKE_LATE,
)
from koordgen.runtime.replication.driver import Driver
from koordgen.runtime.replication.replica import REQUEST_TICK, TICKS
from koordgen.runtime.replication.state_machine import InstanceEvent, StateMachine
from koordgen.runtime.trace.monitored import OWN, SENSED, SHARED, Observation
from koordgen.runtime.trace.writer import Observe, RoundRecord
from koordgen.runtime.vehicle.interface import VehicleInterface
from koordgen.runtime.vehicle.platform import Sensed

PUBLISH = 0.5  # publish deadline as a fraction of the round; the round's entry must be sent before the deadline
PUNCTUAL = 0.5  # fraction of a tick; a robot counts as late if it wakes later than this after the time it was due
GATHER = 300e-6  # seconds to wait per missing entry, so that several received entries are handled together
MOST_GATHER = 0.2  # longest wait for all missing entries together, as a fraction of the round (one tick)
LINGER = 20  # number of rounds for which a robot still answers other robots after all robots have stopped


@dataclass(slots=True)
class _Present:
    """Progress of the present round. `open`: the robot has not sent the round's entry yet."""

    open: bool = False
    sensed: Sensed | None = None
    tick: int = -1  # last handled tick of the round
    acknowledged: bool = False  # the robots that wait know that this robot has applied the round


class Lost(Exception):
    """Raised if the robot cannot continue in the mission. The message says why."""


class Rounds:
    """Rounds of one robot.

    instances: the robot's instances by their numbers.
    driver: drives the replica of the shared store. The private state that it persists is a pair: the Life of each
        instance (private variables and actuator values after its last event), and the robot's incarnation.
    start: fleet time of round 1, in seconds.
    delta: duration of a round, in seconds.
    observe: function that is called with the record of each round once the round is committed.
    """

    def __init__(
        self,
        instances: Sequence[AgentInstance],
        body: VehicleInterface,
        driver: Driver,
        clock: FleetClock,
        names: tuple[str, ...],
        start: float,
        delta: float,
        observe: Observe,
    ) -> None:
        self._instances = tuple(instances)
        self._outputs = tuple([i.outputs for i in instances])
        self._awaited: int | None = None  # first round whose outputs wait for a commit; None if no outputs wait
        self._body = body
        self._driver = driver
        self._replica, self._pid = driver.replica, driver.replica.pid
        self._clock = clock
        self._names = names
        self._start = start
        self._delta = delta
        self._observe = observe
        self.round = 0  # the present round; 0 before round 1
        self._present = _Present()
        self._wake = math.inf  # local time at which `poll` must be called next
        self._policy = self._replica.policy
        self._left = False
        self._handled = 0  # last applied round whose outputs were handled and whose application was reported
        self._store_changes = self._replica.store_changes
        self._view = self._replica.views.view.number  # number of the latest view in which this robot has sent a report
        self._note_stopped()  # sets `stopped`
        self.counters = RoundCounters()
        self.reason: str | None = None  # reason why no event ran in the last closed round; None if an event ran

    @property
    def lacking(self) -> list[str]:
        """Names of the robots whose entries are missing for the present round."""
        state = self._replica.state
        return [] if state is None else [self._names[p] for p in state.missing(self.round - 1)]

    @property
    def observation(self) -> Observation | None:
        """Observation of the first instance at the beginning of the last closed round; see AgentInstance."""
        return self._instances[0].observation if self._instances else None

    @property
    def over(self) -> bool:
        """True if LINGER rounds have passed since all members stopped."""
        state = self._replica.state
        since = None if state is None or not (self.stopped or self._left) else state.all_stopped
        return since is not None and self.round > since + LINGER

    def ripe(self, now: float) -> bool:
        """Return whether the next round has begun and all entries that its event needs have arrived."""
        state, present = self._replica.state, self._present
        if state is None or present.open or state.applied != self.round or not self.round:
            return False
        return self._clock.read(now) >= self._start + self.round * self._delta

    @property
    def calm(self) -> bool:
        """True if no more entries are expected in this round, so that less urgent work may be done."""
        state, present = self._replica.state, self._present
        return not present.open and (state is None or state.applied >= self.round or present.tick >= REQUEST_TICK)

    @property
    def expects(self) -> tuple[int, float]:
        """Number of entries to wait for before waking, and seconds to wait for all of them.

        Waking for each single entry would cost more than all other work. If no entry is missing, the result is
        (1, 0.0): wake at the next message.
        """
        state, at_once = self._replica.state, self._present.open and not self._policy.is_strained(self.round)
        if state is None or at_once or state.applied >= self.round or not state.lacking:
            return 1, 0.0
        return state.lacking, min(GATHER * state.lacking, MOST_GATHER * self._delta)

    def leave(self) -> None:
        """Run no more events. All further rounds are closed without an event."""
        self._left = True

    def receive(self, messages: Sequence[ReplicaMessage]) -> None:
        """Handle received messages of this mission."""
        self._driver.receive(messages)

    def poll(self, now: float, sense: Callable[[float], Sensed], unready: str | None) -> float:
        """Do all work that is due at local time `now`, in seconds. Return the local time at which the next call is due.

        Raises Lost.

        sense: function that samples the sensors at a local time.
        unready: reason why the vehicle does not allow an event; None if it does.
        """
        elapsed = self._clock.read(now) - self._start
        round_ = math.floor(elapsed / self._delta + 1e-6) + 1
        if round_ < 1:
            self._wake = self._clock.local(self._start)
            return self._wake
        if round_ > self.round:
            self._begin(round_, sense(now))
        present = self._present
        into = elapsed - (self.round - 1) * self._delta
        tick = max(0, min(TICKS - 1, math.floor(into / self._delta * TICKS + 1e-6)))  # rounding may begin a round early
        fresh = tick > present.tick
        on_time = fresh and now < self._wake + PUNCTUAL * self._delta / TICKS
        state = self._replica.state
        ripe = fresh and present.open and state is not None and state.applied == self.round - 1
        if fresh:
            present.tick = tick
            if not ripe:  # an event that is ripe runs first, because all other robots wait for its entry
                self._driver.tick((self.round - 1) * TICKS + tick)
                state = self._replica.state
        if state is not None and not present.open and self._is_calm(state):
            if fresh:
                self._wake = self._request(tick, fresh, on_time)
            return self._wake
        self._run(now, into, unready)
        if ripe:
            self._driver.tick((self.round - 1) * TICKS + tick)
        self._wake = self._request(tick, fresh, on_time)
        return self._wake

    def _run(self, now: float, into: float, unready: str | None) -> None:
        """Handle a changed store or view. Then run the event or close the round, if it is time."""
        state = self._replica.state
        if state is None:
            for instance in self._instances:
                for record in instance.outputs.ready(None):
                    self._observe(record)
            self._note_awaited()
            if self._present.open:
                self._decide(now, into, False, unready)
            return
        if self._store_changes != self._replica.store_changes:
            self._come_back(state, now)
        if state.view.number != self._view:  # without reports in the new view, no round is committed
            self._view = state.view.number
            self._replica.send_report(self.round)
            self._driver.flush()
        for outputs in self._outputs:
            if outputs.pressing:
                self._settle(now)
                break
        if self._present.open:
            is_member = state.view.members[self._pid] >= 0
            self._decide(now, into, state.applied == self.round - 1 and not state.is_frozen and is_member, unready)
        self._settle(now)
        if not self._present.open:
            self._acknowledge(state.applied)
        self._handled = state.applied

    def _is_calm(self, state: StateMachine) -> bool:
        """Return whether the store, the view and the waiting records are unchanged since the last poll."""
        same = self._store_changes == self._replica.store_changes and state.view.number == self._view
        if not same or state.applied != self._handled:
            return False
        for outputs in self._outputs:  # noqa: SIM110 (`all` costs twice as much)
            if outputs.can_settle(state):
                return False
        return True

    def began(self, round_: int) -> float:
        """Return the local time at which a round began or will begin."""
        return self._clock.local(self._start + (round_ - 1) * self._delta)

    def _local_time_at(self, part: float) -> float:
        """Return the local time at which the fraction `part` of the present round has passed."""
        return self._clock.local(self._start + (self.round - 1 + part) * self._delta)

    def _begin(self, round_: int, sensed: Sensed) -> None:
        present = self._present
        slept = round_ - self.round - (0 if present.open else 1)
        if slept > 0 and self._replica.state is not None:
            self._replica.skip_rounds(round_ - 1, self.stopped)
            self.counters.missed += slept
        self.round, self._present = round_, _Present(True, sensed)
        self.counters.rounds += 1

    def _come_back(self, state: StateMachine, now: float) -> None:
        """Continue after a rejoin, with the private state after each instance's last event that the fleet counts."""
        self._store_changes = self._replica.store_changes
        actuators: dict[str, Any] = {}
        records: list[RoundRecord] = []
        for instance in self._instances:
            acted = state.acted[instance.number]
            life, found = instance.outputs.settle(acted)
            if life is None:
                raise Lost(
                    f"the last event of this robot that counts was in round {acted}, and the robot's private variables "
                    "after that round are no longer stored: it cannot rejoin this mission; end all robots and start "
                    "again"
                )
            instance.runner.locals, instance.stopped, instance.restored = life.locals, life.stopped, life
            actuators.update(life.actuators)
            records += found
        self._note_awaited()
        self._note_stopped()
        self._body.restore(actuators, now)
        self._body.hold(STOPPED, self.is_vehicle_stopped, now)
        for record in sorted(records, key=_round_of):
            self._observe(record)
        # The other robots have no entry of this round with the robot's new incarnation, so a silent entry is sent.
        if not self._present.open and self._replica.published < self.round:
            self._replica.propose(self.round, {}, stopped=self.stopped)
            self._driver.run()

    @property
    def is_vehicle_stopped(self) -> bool:
        """True if an instance that commands the vehicle has stopped, or the robot has no instance."""
        driving = [i.stopped for i in self._instances if i.drives]
        return any(driving) if self._instances else True

    def _settle(self, now: float) -> None:
        """Carry out the outputs of committed events, and handle transactions whose result is known."""
        state = self._replica.state
        assert state is not None
        for outputs in self._outputs:
            if outputs.can_settle(state):
                self._settle_all(state, now)
                break
        if self._awaited is None:
            self._body.hold(NOT_CONFIRMED, False, now)

    def _settle_all(self, state: StateMachine, now: float) -> None:
        """Handle all records whose result is known, by ascending round."""
        lost = False
        records: list[tuple[AgentInstance, RoundRecord]] = []
        for instance in self._instances:
            outputs = instance.outputs
            won = outputs.decide(state)
            if won:
                instance.runner.locals = outputs.life.locals
                instance.stopped = instance.stopped or outputs.life.stopped
                self._note_stopped()
            elif won is False:
                lost = True
                self.counters.lost_contention += 1
                instance.count("lost_contention")
            for record in outputs.ready(state):
                records.append((instance, record))
        if lost:
            # The checkpoint holds few private states. Overwrite the state after the lost transaction, so that repeated
            # losses never push a valid state out of the checkpoint.
            self._driver.persist_private(([outputs.life for outputs in self._outputs], state.view.members[self._pid]))
        if len(records) > 1 and len(self._outputs) > 1:
            records.sort(key=_round_of_pair)
        for instance, record in records:
            effects = record.effects
            if effects is not None:
                self._body.command(effects.actuators, now)
                if instance.drives:
                    self._body.hold(STOPPED, effects.stopped or self.is_vehicle_stopped, now)
            self._observe(record)
        self._note_awaited()

    def _decide(self, now: float, into: float, current: bool, unready: str | None) -> None:
        """Run events, or close the round without an event, or keep the round open for missing entries.

        into: seconds since the beginning of the round.
        current: the store contains all earlier rounds, and this robot is a member.
        unready: reason why the vehicle does not allow an event; None if it does.
        """
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
            if lagging and not overdue and (current or self._policy.waits(self.round)):
                return
            if reason is None and overdue:
                reason = WOKE_LATE
        late = lagging or reason == WOKE_LATE
        hindrances = [reason or instance.hindrance(sensors, unready) for instance in self._instances]
        is_hindered = None not in hindrances
        self.counters.current += current
        self.counters.in_a_row = self.counters.in_a_row + 1 if late else 0
        self.reason = hindrances[0] if is_hindered and hindrances else reason
        for instance in self._instances:
            if instance.watched:
                instance.observation = (
                    None if self._left else self._observation(instance, now, sensed.time, sensors, current)
                )
        self._body.hold(NOT_CURRENT, lagging and not current, now)
        self._body.hold(NOT_CONFIRMED, self._awaited is not None, now)
        runs: list[InstanceRun] = []
        if is_hindered:
            self.counters.skipped += 1
            self._close(runs)
        else:
            runs = self._run_events(sensors, hindrances, now)
            self._close(runs)
        self._record(runs, hindrances, sensors, now, into)

    def _run_events(
        self, sensors: Mapping[str, Any], hindrances: Sequence[str | None], now: float
    ) -> list[InstanceRun]:
        """Run an event of each instance without a hindrance. Return the runs by instance."""
        state, instances = self._replica.state, self._instances
        assert state is not None
        self._body.others(state.shared)
        deadline = self._local_time_at(PUBLISH)
        if len(instances) == 1:
            runs = [self._run_event(0, state.shared, sensors, deadline)]
        else:
            runs = self._divide_time(state.shared, sensors, hindrances, deadline)
        is_faulty = False
        for instance in instances:
            if instance.is_faulty and instance.drives:
                is_faulty = True
        self._body.hold(FAULT, is_faulty, now)
        return runs

    def _divide_time(
        self, shared: Mapping[str, Any], sensors: Mapping[str, Any], hindrances: Sequence[str | None], deadline: float
    ) -> list[InstanceRun]:
        """Run the events of several instances, which divide the time up to the deadline by their shares.

        Time that one leaves goes to the next ones. The first place rotates with the round, so that no instance always
        comes last."""
        count = len(self._instances)
        first = self.round % count
        waiting = [place for place in (*range(first, count), *range(first)) if hindrances[place] is None]
        runs: list[InstanceRun] = []
        for index, place in enumerate(waiting):
            began = self._instances[place].now()
            shares = [self._instances[p].share for p in waiting[index:]]
            until = began + (deadline - began) * shares[0] / sum(shares) if len(shares) > 1 else deadline
            runs.append(self._run_event(place, shared, sensors, until))
        return sorted(runs, key=_place_of)

    def _run_event(
        self, place: int, shared: Mapping[str, Any], sensors: Mapping[str, Any], until: float
    ) -> InstanceRun:
        """Run an event of one instance, up to a local time."""
        instance, body = self._instances[place], self._body
        frame = instance.frame(shared, sensors, body.actuators, body.call)
        result = instance.runner.step(frame, until)
        instance.is_faulty = result.fault is not None
        return InstanceRun(place, instance, frame, result, body.calls())

    def _observation(
        self, instance: AgentInstance, now: float, sensed: float | None, sensors: Mapping[str, Any], current: bool
    ) -> Observation:
        """Return the observation for monitors: sensors, variables and actuators before this round's event."""
        state, own, body = self._replica.state, instance.runner.locals, instance.actuators(self._body.actuators)
        seen = instance.sensors(sensors)
        if state is None or instance.outputs.first is not None or instance.outputs.undecided:
            return Observation(self.round, now, SENSED, sensed, seen, own, {}, body)
        shared = instance.shared(state.shared)
        return Observation(self.round, now, SHARED if current else OWN, sensed, seen, own, shared, body)

    def _note_awaited(self) -> None:
        """Update `_awaited` after a change of the outputs that wait."""
        found: int | None = None
        for outputs in self._outputs:
            first = outputs.first
            if first is not None and (found is None or first < found):
                found = first
        self._awaited = found

    def _unsettled(self, current: bool) -> str | None:
        """Return the reason why the shared memory does not allow an event; None if it does."""
        state, round_ = self._replica.state, self.round
        if state is None:
            return self._replica.status
        if not current:
            if state.is_frozen:
                return f"{NOT_CURRENT}: the fleet decides which robots count"
            return f"{NOT_CURRENT}: lacks {', '.join(self.lacking)}"
        if self._awaited is not None or any(outputs.undecided for outputs in self._outputs):
            unaware = self._replica.unaware(self._awaited or round_ - 1)
            return (
                f"{NOT_CONFIRMED}: waits for the acknowledgement of a majority, not heard from {self._named(unaware)}"
            )
        if round_ - AHEAD > state.committed:
            return f"{NOT_CONFIRMED}: not heard from {self._named(self._replica.unaware(round_ - AHEAD))}"
        if state.is_full:
            return f"{NOT_CURRENT}: {self._names[self._replica.laggard]} lags behind"
        return None

    def _named(self, pids: list[int]) -> str:
        return ", ".join(self._names[p] for p in pids)

    def _close(self, runs: Sequence[InstanceRun]) -> None:
        """Persist the private states after the events, and send the round's entry."""
        state, body = self._replica.state, self._body
        self._present.open = False
        private = None
        awaits_commit = False
        acted = [run for run in runs if run.result.effects is not None]
        if acted:
            assert state is not None
            lives = [outputs.life for outputs in self._outputs]
            for run in acted:
                instance, effects = run.instance, run.result.effects
                assert effects is not None
                life = run.life = lives[run.place] = instance.life(self.round, effects, body.actuators)
                awaits_commit = awaits_commit or has_outputs(effects)
                if run.result.lock < 0:
                    instance.runner.locals, instance.stopped = life.locals, life.stopped
            self._note_stopped()
            private = lives, state.view.members[self._pid]
        self.counters.out += state is None
        stopped = self.stopped or self._left
        if len(self._instances) > 1:
            self._replica.propose(
                self.round, {}, stopped=stopped, awaits_commit=awaits_commit, private=private,
                parts=[_event(run) for run in acted],
            )  # fmt: skip
        elif acted:
            result, effects = acted[0].result, acted[0].result.effects
            assert effects is not None
            self._replica.propose(
                self.round, effects.shared, stopped=stopped or effects.stopped, acted=True,
                awaits_commit=awaits_commit, lock=result.lock, private=private,
            )  # fmt: skip
        else:
            self._replica.propose(self.round, {}, stopped=stopped)
        self._driver.run()

    def _note_stopped(self) -> None:
        """Update `stopped`: the robot has stopped when all its instances have."""
        self.stopped = True
        for instance in self._instances:
            if not instance.stopped:
                self.stopped = False

    def _record(
        self,
        runs: Sequence[InstanceRun],
        hindrances: Sequence[str | None],
        sensors: Mapping[str, Any],
        now: float,
        into: float,
    ) -> None:
        """Queue the records of a closed round until it is committed. The entry is urgent, so it was sent before."""
        for run in runs:
            instance, result, frame = run.instance, run.result, run.frame
            fault, effects = result.fault, result.effects
            if fault is not None:
                self.counters.faults += 1
                self.counters.discarded += fault.reason == LATE
                instance.count("faults")
            skipped = None if effects is not None else NO_EVENT if fault is None else FAULT
            record = RoundRecord(
                self.round, now, into, frame.sensors, frame, result.event, effects, skipped, fault, run.calls,
                instance.restored, instance.application,
            )  # fmt: skip
            instance.restored = None
            instance.outputs.add(record, result.lock, run.life)
        for instance, reason in zip(self._instances, hindrances, strict=True):
            if reason is not None:
                record = RoundRecord(
                    self.round, now, into, instance.sensors(sensors), None, skipped=reason, restored=instance.restored,
                    application=instance.application,
                )  # fmt: skip
                instance.restored = None
                instance.outputs.add(record)
        self._note_awaited()

    def _acknowledge(self, applied: int) -> None:
        """Report that this robot has applied the present round, to the robots that wait for this report."""
        if applied >= self.round and not self._present.acknowledged:
            self._present.acknowledged = True
            self._replica.acknowledge(self.round)
            self._driver.flush()

    def _request(self, tick: int, fresh: bool, on_time: bool) -> float:
        """Request overdue entries and reports. Return the local time at which `poll` must be called next."""
        present, state = self._present, self._replica.state
        if state is None:
            return self._next_tick(tick)
        waited = self._awaited
        if fresh and self._replica.request(tick, on_time, waited):
            self.counters.asked += 1
            self._driver.flush()
        missing = [p for p in state.missing(self.round if tick >= REQUEST_TICK else self.round - 1) if p != self._pid]
        if present.open or missing or waited is not None or self._replica.is_busy:
            return self._next_tick(tick)
        if tick < REQUEST_TICK and (state.applied < self.round or self._replica.emergency):
            return self._local_time_at(REQUEST_TICK / TICKS)
        return self._local_time_at(1.0)

    def _next_tick(self, tick: int) -> float:
        next_ = TICKS if self._policy.is_hurried(self.round) and not self._replica.is_busy else tick + 1
        return self._local_time_at(min(next_ / TICKS, PUBLISH if self._present.open else 1.0))


def _event(run: InstanceRun) -> InstanceEvent:
    effects, life = run.result.effects, run.life
    assert effects is not None and life is not None
    return InstanceEvent(run.place, effects.shared, life.stopped, run.result.lock)


def _place_of(run: InstanceRun) -> int:
    return run.place


def _round_of(record: RoundRecord) -> int:
    return record.round


def _round_of_pair(pair: tuple[AgentInstance, RoundRecord]) -> int:
    return pair[1].round
