"""Agent of one robot: a polled state machine from start through joining and rounds to the safe stop.

Clock, transport, platform, trace and log are injected, so a simulator can run many agents on a simulated clock."""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from koordgen.runtime.agent.checkpoint import CheckpointStore
from koordgen.runtime.agent.instance import AgentInstance
from koordgen.runtime.agent.joining import Joining
from koordgen.runtime.agent.persistence import Persistence, first_hard_state
from koordgen.runtime.agent.rounds import Lost, Rounds
from koordgen.runtime.config.settings import Settings
from koordgen.runtime.monitor.monitor import Cpu
from koordgen.runtime.monitor.of_robot import RobotMonitors
from koordgen.runtime.net.codec import encoder
from koordgen.runtime.net.fleet_clock import FleetClock
from koordgen.runtime.net.layout import Layout
from koordgen.runtime.net.link import Link
from koordgen.runtime.net.metrics import Metrics, tally
from koordgen.runtime.net.sender import Sending
from koordgen.runtime.net.transport import Transport
from koordgen.runtime.net.wire import Entry, EntryPart
from koordgen.runtime.ops.journal import Emit, Journal
from koordgen.runtime.ops.recent import goal
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.program import Calls, Effects, Fault, Frame, Life, Program
from koordgen.runtime.program.property import Properties
from koordgen.runtime.program.runner import NO_POSITION, STOPPED, Limit, unlimited
from koordgen.runtime.replication.driver import Driver
from koordgen.runtime.replication.replica import Replica
from koordgen.runtime.replication.state_machine import StateMachine
from koordgen.runtime.trace.writer import Observe, Trace
from koordgen.runtime.values.clock import Clock
from koordgen.runtime.values.points import transmissible
from koordgen.runtime.vehicle.drivers import modules_of_drivers
from koordgen.runtime.vehicle.interface import VehicleInterface
from koordgen.runtime.vehicle.platform import Platform, Unready, vitals
from koordgen.runtime.vehicle.safety import SafetyGuard, own_position
from koordgen.runtime.vehicle.stall import Stalls

OK, WRONG_PROGRAM, VIOLATED, SURROUNDINGS, INTERNAL = 0, 1, 3, 5, 70
LOST_BODY = 10.0  # seconds for which the agent commands a failed vehicle to stop before the agent gives up
MOST_FAILURES = 100  # consecutive exceptions of the platform after which the agent gives up


class Agent:
    """Agent of one robot. Raises TooLarge if the shared variables do not fit into messages.

    Call `poll` at or before the time that its last call returned. `done` becomes true once the vehicle has stopped and
    no other robot needs this robot's messages.

    program: the program that all robots run, or the applications of the fleet.
    boot: id of this start of the process; 8 random bytes.
    properties: properties of the program, or of each application by its name.
    outlet: see Link.
    """

    def __init__(
        self,
        program: Program | FleetProgram,
        settings: Settings,
        key: bytes | None,
        platform: Platform,
        clock: Clock,
        transport: Transport,
        trace: Trace,
        emit: Emit,
        boot: bytes,
        store: CheckpointStore,
        monitors: Sequence[Observe] = (),
        limit: Limit = unlimited,
        properties: Mapping[str, Properties] | Properties | None = None,
        cpu: Cpu | None = None,
        outlet: Callable[[Sending], Sending] | None = None,
    ) -> None:
        self._settings = settings
        self._platform = platform
        self._clock = clock
        self._transport = transport
        self._names = tuple(p.name for p in settings.peers)
        self.metrics = Metrics(settings.pid, len(self._names))
        if isinstance(program, Program):
            program = FleetProgram.alone(program, len(self._names))
        self._fleet, own = program, program.of(settings.pid)
        self._layout = Layout.of(self._fleet)
        self._fleet_clock = FleetClock(settings.pid)
        self._journal = Journal(settings.robot, trace, emit, clock, self._fleet_clock, self.metrics, monitors)
        driven = modules_of_drivers(platform)
        numbers = self._fleet.of_robot(settings.pid)
        self._instances = tuple([AgentInstance.of(self._fleet, i, clock, limit, driven) for i in numbers])
        self.monitors = RobotMonitors(self._fleet, properties, settings, self._journal.monitor, limit, cpu)
        self._journal.watch(self.monitors.hear)
        self._stalls = Stalls(self._journal.stall)
        self._link = Link(
            own, settings, key, transport, clock, self._fleet_clock, boot, self._journal.error, self.metrics, outlet
        )
        self._joining = Joining(self._link, self._layout, self._names)
        programs = [instance.runner.program for instance in self._instances]
        self._persistence = Persistence(store, programs, len(self._names))
        if self._persistence.interrupted:
            self._joining.come_back(self._persistence.interrupted)
            self._fleet_clock.forget()
        fence, budget = settings.geofence, settings.planner_budget
        self._body = VehicleInterface(
            own, platform, fence, budget, self._journal.warn, settings.avoid, settings.pid, clock.now,
            self._fleet.members_of(settings.avoid),
        )  # fmt: skip
        self._positions = tuple(p.name for p in own.ports if p.is_position)
        self._guard = SafetyGuard(settings.safety, settings.geofence, self._positions)
        self._kinds = {variable.name: variable.kind for variable in own.shared}
        self._journal.recent.stored = self._fleet.names()
        trace.header(self._fleet, settings.robot, settings.pid, len(self._names), settings.delta)
        self._reset()

    def _reset(self) -> None:
        """Set the state of an agent that has not started."""
        self._unready: str | None = None  # reason why the vehicle does not allow an event
        self._rounds: Rounds | None = None
        self._driver: Driver | None = None
        self._view = -1
        self._next_body = 0.0
        self._missed = self._failures = 0
        self._init: tuple[Life, ...] | None = None
        self._watched: list[tuple[Callable[[Any], None], AgentInstance]] = []  # instances whose monitors need rounds
        self._stop_began = 0.0
        self._served = 0.0  # time of the platform's last successful `poll`
        self._asked_to_end = False
        self._started = self._lost = self._broken = False
        self.phase = ""
        self.status = OK
        self.done = False

    @property
    def round(self) -> int:
        """The present round; 0 before round 1."""
        return self._rounds.round if self._rounds is not None else 0

    @property
    def state(self) -> StateMachine | None:
        """This robot's copy of the shared store; None before round 1, and during a rejoin after a restart."""
        return None if self._driver is None or self._rounds is None else self._driver.replica.state

    @property
    def incarnation(self) -> int | None:
        """This robot's incarnation in the newest view that it knows: -1 if it is no member, None before round 1."""
        return None if self._driver is None else self._driver.replica.views.view.members[self._settings.pid]

    @property
    def has_emergency(self) -> bool:
        """True once this robot knows of an emergency stop of its fleet."""
        return self._driver is not None and self._driver.replica.emergency

    def began(self, round_: int) -> float:
        """Return the local time (s) at which a round began or will begin. Call this only after round 1 began."""
        return math.inf if self._rounds is None else self._rounds.began(round_)

    @property
    def hindrance(self) -> str:
        """Reason why no event ran in the last closed round; "" if an event ran."""
        return "" if self._rounds is None else self._rounds.reason or ""

    @property
    def expects(self) -> tuple[int, float]:
        """Number of missing entries, and seconds to wait for all of them; see Rounds.expects."""
        return self._rounds.expects if self._rounds is not None else (1, 0.0)

    def counters(self) -> dict[str, int]:
        """Return name -> count of all counters: of rounds, dropped datagrams and network failures."""
        counters = None if self._rounds is None else self._rounds.counters
        counted = tally(self._link.rejected, self._transport.troubles, self._body.slow_calls, counters)
        if self._fleet.is_composed:
            counted |= {f"{i.application}: {name}": count for i in self._instances for name, count in i.counts.items()}
        return counted

    def clock_error(self, now: float) -> float | None:
        """Return the largest possible error (s) of this robot's fleet time; None if unknown.

        now: local time (s).
        """
        bound = self._fleet_clock.bound(now)
        return bound if bound < math.inf else None

    def snapshot(self, now: float) -> dict[str, Any]:
        """Return values for the status report at local time `now`.

        pose: position (m, ENU), yaw (rad) and age (s); None if unknown.
        battery: charge from 0 to 1; None if unknown.
        goal: commanded points.
        applications: only with several, the state of each that this robot runs; see `_applications`.
        Further keys: recent history, see koordgen/runtime/ops/recent.py.
        """
        sensed, found = self._platform.sense(now), vitals(self._platform)
        position = own_position(sensed, self._positions)
        pose: dict[str, Any] | None = None
        if position is not None and transmissible(position) and sensed.time is not None:
            place = [round(c, 3) for c in (position.x, position.y, position.z)]
            yaw = None if found.yaw is None else round(found.yaw, 4)
            pose = {"position": place, "yaw": yaw, "age": round(max(0.0, now - sensed.time), 3)}
        return {
            "pose": pose,
            "battery": None if found.battery is None else round(found.battery, 3),
            "goal": goal(self._body.actuators, transmissible),
            **({"applications": self._applications()} if self._fleet.is_composed else {}),
            **self._journal.recent.report(now, self._kinds),
        }

    def _applications(self) -> list[dict[str, Any]]:
        """Return the state of each instance for the status report.

        pid: its place among `members`, the robots that run the application.
        stopped: its program has stopped.
        counts: its number of faults and of lost contentions, as far as there are any.
        Further keys: see ApplicationResult.
        """
        numbers, recent = self._fleet.of_robot(self._settings.pid), self._journal.recent
        return [
            {
                "name": instance.application,
                "pid": number.pid,
                "members": self._fleet.applications[number.application].members,
                "stopped": instance.stopped,
                **msgspec.structs.asdict(recent.of(instance.application)),
                "counts": dict(instance.counts),
            }
            for instance, number in zip(self._instances, numbers, strict=True)
        ]

    def end(self, why: str) -> None:
        """Stop the robot safely; `done` becomes true when it has stopped."""
        self._asked_to_end = True
        self._stop_safely(why, OK)
        self.done = self.done or not self._started

    def stop_all(self, why: str) -> None:
        """Emergency stop: begin this robot's safe stop now, and announce the emergency to all other robots."""
        if self._driver is not None:
            self._driver.replica.declare_emergency()
            self._driver.flush()
        self._journal.error(why)
        self.end(why)

    def poll(self, now: float) -> float:
        """Do all work that is due at local time `now`. Return the latest local time for the next call.

        Call `poll` earlier if a datagram arrives. Never raises: an error leads to a safe stop and sets `status`."""
        try:
            wake = self._poll(now)
            if self.done and self._journal.untold:
                self._write_records()
            return wake
        except Unready as lost:
            if not self._lost:
                self._lost = True
                self._journal.error(lost.message + (f" ({lost.hint})" if lost.hint else ""))
                self._stop_safely("the vehicle has failed", SURROUNDINGS)
            self._give_up(now)
        except Exception:
            self._failures += 1
            if not self._broken:
                self._journal.error("internal error, please report it:\n" + traceback.format_exc())
                self._broken = True
                self._stop_safely("internal error", INTERNAL)
            self.done = self.done or self._failures > MOST_FAILURES
        self._transport.receive()  # if datagrams stayed unread, `wait` would return at once
        return now + self._platform.period

    def _poll(self, now: float) -> float:
        if not self.phase:
            self._enter("starting", "")
            self._body.hold("alone", bool(self._joining.alone), now)
            self._platform.start(now)
            self._started = True
        self._journal.round = self.round
        wake = self._poll_body(now) if now >= self._next_body - 1e-9 else self._next_body
        if self._broken:
            self._transport.receive()
            return wake
        rounds = self._rounds
        if rounds is None:
            return min(wake, self._join(now))
        # If the event of the next round can run at once, run it before messages are received, because other robots wait
        # for this robot's entry.
        if not rounds.ripe(now):
            self._receive(None)
        due = self._poll_rounds(rounds, now)
        calm = rounds.calm
        if calm:
            self._monitor(rounds, now)
        if self._journal.full or (calm and self._journal.untold):
            self._write_records()
        if rounds.over and self.phase == "running":
            self._asked_to_end = True
            self._stop_safely("all robots have stopped", OK)
        return min(wake, due, self._joining.meet(now))

    def _join(self, now: float) -> float:
        """Take part in the joining protocol. Begin the rounds once all robots have agreed on the mission."""
        fleet = self._fleet_clock.read(now) if self._fleet_clock.known else None
        self._receive(fleet)
        if inside := self._joining.inside:
            self._link.keep_time(min(inside), now)  # provisional reference, because the present view is unknown
        if self.phase not in ("starting", "joining"):
            return math.inf
        if self._init is not None:
            self._persistence.mission(self._link.epoch, self._init)
        wake = self._joining.poll(now, fleet)
        if self._joining.lost and self.phase == "joining":
            self._journal.warn("no other robot is in the mission that this robot was in: a new mission begins")
            self._link.keep_time(0, now)
            self._run_init(now)
        self._begin_rounds(now)
        return wake

    def _receive(self, fleet: float | None) -> None:
        """Handle all received messages.

        `fleet`: fleet time in seconds, used only before the rounds have begun.
        """
        messages = self._link.receive()
        for hello in self._link.pop_hellos():
            self._joining.receive(hello, fleet)
        if messages and self._rounds is not None:
            self._rounds.receive(messages)
        if names := self._joining.began_anew():
            self._journal.error(
                f"{names} restarted without state during the mission and cannot rejoin: end all robots and start again"
            )

    def _poll_rounds(self, rounds: Rounds, now: float) -> float:
        assert self._driver is not None
        replica = self._driver.replica
        try:
            wake = rounds.poll(now, self._platform.sense, self._unready)
        except Lost as lost:
            self._journal.error(str(lost))
            self._stop_safely("cannot rejoin", SURROUNDINGS)
            self._rounds = None
            return now + self._platform.period
        if rounds.counters.in_a_row != self._missed:
            self._judge_missed(rounds)
        if replica.emergency and self.phase == "running":
            self._journal.error("emergency stop, received from another robot")
            self.end("emergency stop")
        self._joining.met = self._joining.met or not replica.is_out
        view = replica.views.view
        if view.number != self._view:
            self._view = view.number
            self._journal.view(view, self._names, over=self.phase in ("stopping", "stopped"))
            self._link.keep_time(next(p for p, m in enumerate(view.members) if m >= 0), now)
        return wake

    def _judge_missed(self, rounds: Rounds) -> None:
        """Warn after `missed_rounds` consecutive missed rounds, and stop safely if `missed_action` is `stop`.

        A round is missed if no event ran in it because the store was not current or the robot woke late. The counter is
        used rather than records of rounds, because records may wait for a commit.
        """
        safety, before = self._settings.safety, self._missed
        self._missed = rounds.counters.in_a_row
        if before < safety.missed_rounds <= self._missed:
            self._journal.warn(f"{self._missed} rounds in a row {rounds.reason}")
            if safety.missed_action == "stop":
                self._stop_safely("the shared memory was not current for too many rounds", SURROUNDINGS)

    def _poll_body(self, now: float) -> float:
        self._next_body = max(self._next_body + self._platform.period, now)
        if self.phase in ("stopping", "stopped"):
            self._platform.stop(now)
        self._platform.poll(now)
        self._served, self._failures = now, 0
        for line in self._platform.log_lines():
            self._journal.warn(line)
        match self.phase:
            case "starting":
                self._body.hold("alone", bool(self._joining.alone), now)
                self._journal.progress("; ".join(filter(None, (self._platform.progress, self._joining.alone))))
                if self._platform.ready:
                    self._begin_joining(now)
            case "joining" | "running":
                if self.phase == "joining":
                    self._body.hold("alone", bool(self._joining.alone), now)
                    self._journal.progress(self._joining.waiting())
                self._judge(now)
                self._stalls.see(self._platform.stall, now)
            case "stopping" if self._platform.stopped:
                self._enter("stopped", "")
        self._end_when_stopped()
        return self._next_body

    def _end_when_stopped(self) -> None:
        if self.phase == "stopped":
            over = self._rounds is None or self._rounds.over
            self.done = self._asked_to_end or over or self._broken
            if self.done and not self._broken:
                self._persistence.forget()  # the mission is over, so there is no mission to rejoin

    def _begin_joining(self, now: float) -> None:
        """Begin to join, because the vehicle is ready. Hold position, and run `init` unless the robot rejoins."""
        self._enter("joining", "")
        self._body.hold("joining", True, now)
        sensed = self._platform.sense(now)
        self._body.begin(sensed)
        if not self._persistence.interrupted:
            self._run_init(now)

    def _run_init(self, now: float) -> None:
        """Erase the state of earlier missions, run `init` of each instance, and join with the results."""
        self._persistence.forget()
        sensors, shared, body = self._body.sensors(self._platform.sense(now)), self._layout.initial(), self._body
        ran: list[tuple[AgentInstance, Frame, Effects, Calls]] = []
        for instance in self._instances:
            frame = instance.frame(shared, sensors, body.actuators, body.call)
            done = instance.runner.init(frame)
            calls = body.calls()
            if isinstance(done, Fault):
                self._journal.error(f"{done} (in init)")
                self._stop_safely("init failed", WRONG_PROGRAM)
                return
            ran.append((instance, frame, done, calls))
        result = self._init_entry([done for _, _, done, _ in ran])
        length = len(encoder.encode(result))
        if length > self._link.sender.room:  # a Hello must fit into one datagram
            most = self._link.sender.room
            self._journal.error(f"init writes {length} bytes of shared variables; at most {most} can be sent")
            self._stop_safely("init failed", WRONG_PROGRAM)
            return
        lives = []
        for place, (instance, frame, done, calls) in enumerate(ran):
            body.command(done.actuators, now)
            life = Life(0, done.locals, instance.actuators(body.actuators), done.stopped)
            lives.append(life)
            # The time of the record is read here: `now`, when the poll began, may be earlier than the phase `starting`.
            self._journal.init(frame.sensors, done, life, calls, self._clock.now(), instance.application)
            self.monitors.ran(place, done, None, 0, now)
        self._init = tuple(lives)
        self._joining.ready(result)

    def _init_entry(self, done: Sequence[Effects]) -> Entry:
        """Return the entry of round 0 from the results of `init` of each instance."""
        pid, stopped = self._settings.pid, all(effects.stopped for effects in done)
        writes = [self._layout.written(effects.shared, None, pid, place)[0] for place, effects in enumerate(done)]
        if len(done) < 2:
            return Entry(pid, 0, 0, 0, stopped, writes=writes[0] if writes else ())
        numbers = [author.application for author in self._layout.authors[pid]]
        parts = zip(numbers, done, writes, strict=True)
        used = {number: EntryPart(e.stopped, False, -1, w) for number, e, w in parts if w or e.stopped}
        return Entry(pid, 0, 0, 0, stopped, writes=used or ())

    def _begin_rounds(self, now: float) -> None:
        if self.phase != "joining":
            return
        mission, returned = self._joining.mission, self._joining.returned
        n = len(self._names)
        if mission is not None and self._init is not None:
            start, epoch, lives = mission.start, mission.epoch, [[life] for life in self._init]
            hard_state = first_hard_state(n)
            state = StateMachine.begin(self._layout, self._settings.pid, hard_state.view, mission.inits)
        elif returned is not None:
            start, epoch, state = returned, self._link.epoch, None
            hard_state = self._persistence.last_hard_state()
            if self._init is None:
                lives = self._persistence.past_lives() or [[self._unknown_life(i)] for i in self._instances]
            else:
                lives = [[life] for life in self._init]
                self._persistence.mission(epoch, self._init)
        else:
            return
        for instance, states in zip(self._instances, lives, strict=True):
            instance.begin(states)
        timeout = self._settings.safety.peer_timeout
        self._fleet_clock.lock()
        room = self._link.sender.room
        replica = Replica(self._settings.pid, self._layout, state, hard_state, timeout, room)
        self._driver = Driver(
            replica, self._link, self._persistence.hard_state, lambda private: self._persistence.lives(*private)
        )  # fmt: skip
        self._rounds = Rounds(
            self._instances, self._body, self._driver, self._fleet_clock, self._names, start, self._settings.delta,
            self._journal.untold.append,
        )  # fmt: skip
        for instance, wanted in zip(self._instances, self.monitors.wanted, strict=True):
            instance.watched = wanted
        looks = zip(self.monitors.looks, self._instances, strict=True)
        self._watched = [(look, instance) for look, instance in looks if instance.watched]
        self._enter("running", f"mission {epoch.hex()}, round 1 at {start:.3f} s of fleet time")
        if self._rounds.is_vehicle_stopped:
            self._body.hold(STOPPED, True, now)
        self._next_body = now

    def _unknown_life(self, instance: AgentInstance) -> Life:
        """Return the private state of an instance whose last event is unknown; no event of it may run."""
        return Life(-1, instance.runner.locals, instance.actuators(self._body.actuators), False)

    def _judge(self, now: float) -> None:
        verdict = self._guard.judge(self._platform.sense(now), now)
        detail = "" if verdict.action == "go" else f"{verdict.reason} ({self._platform.progress})"
        if verdict.action == "stop":
            self._stop_safely(detail, SURROUNDINGS)
        elif self._body.hold("position", verdict.action == "hold", now):
            self._journal.warn(detail if verdict.action == "hold" else "own position is fresh again")
        self._unready = f"{NO_POSITION}: {verdict.reason}" if verdict.action != "go" else None
        if self.phase == "running" and self.round > 0:
            self._body.hold("joining", False, now)
            self._body.hold("alone", False, now)  # the last robot may have been heard since the last poll while joining

    def _stop_safely(self, why: str, status: int) -> None:
        self.status = self.status or status
        if self.phase in ("stopping", "stopped"):
            return
        self._stop_began = self._next_body = self._clock.now()  # the next poll calls the platform's `stop`
        if self._rounds is not None:
            self._rounds.leave()
        self._body.retire()
        self._enter("stopping", why)
        self._journal.measure(self._link.rejected, self._stop_began, at_once=True)
        self._journal.judged(*self.monitors.summary())

    def _give_up(self, now: float) -> None:
        """Decide whether to end the agent after its vehicle has failed.

        The agent commands the vehicle to stop until LOST_BODY seconds have passed since the stop began and since the
        vehicle last worked. A vehicle that never started need not stop."""
        self._end_when_stopped()
        if not self._started:
            self.done = True
        elif self.phase == "stopping" and now - max(self._stop_began, self._served) > LOST_BODY:
            self._journal.error(f"the vehicle did not stop within {LOST_BODY:.0f} s")
            self.done = True

    def _write_records(self) -> None:
        """Write the records of committed rounds to the trace. Called while no urgent work is expected."""
        self._journal.write_pending(self.counters() if self._journal.traces else {}, self._link.rejected)
        if self._driver is not None and (state := self._driver.replica.state) is not None:
            self.metrics.held(state.held)

    def _monitor(self, rounds: Rounds, now: float) -> None:
        """Evaluate the monitors, and hold or stop the robot if their verdict demands it."""
        for look, instance in self._watched:
            if instance.observation is not None:
                self._journal.attempt(look, instance.observation)
        verdict = self.monitors.verdict
        self._body.hold("monitor", verdict.action == "hold", now)
        if verdict.action == "stop" and self.phase == "running":
            self._stop_safely(verdict.reason, VIOLATED)

    def _enter(self, phase: str, detail: str) -> None:
        self.phase = phase
        self._journal.phase(phase, detail)
