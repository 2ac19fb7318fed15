"""Our side: one robot's shared memory as an Exchange, without the agent around it (SharedMemory); and of two robots
an update's way alone (Update): encode, MAC, UDP, verify, decode, apply.

All that an agent's shared memory does in a round is done here: entry, encoding, MAC, UDP, verifying, decoding,
applying, words, clock echoes, the robot's word kept in a file, questions for what is missing, views. `SharedMemory`
does with the runtime's own objects what Rounds does, at the same moments. What belongs to a program is the agent's:
sensors, events, the robot's own variables and what leaves the robot, monitors, trace.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection

from benchmarks.peers_agents import KEY, program, settings
from benchmarks.peers_exchange import Heard, Place
from koordgen.runtime.agent.checkpoint import CheckpointFile, CheckpointStore
from koordgen.runtime.agent.output_commit import AHEAD
from koordgen.runtime.agent.persistence import Persistence, first_hard_state
from koordgen.runtime.agent.rounds import GATHER, MOST_GATHER, PUBLISH, PUNCTUAL
from koordgen.runtime.config.settings import Settings
from koordgen.runtime.net import socket_batch
from koordgen.runtime.net.fleet_clock import FleetClock
from koordgen.runtime.net.layout import Layout
from koordgen.runtime.net.link import Link
from koordgen.runtime.net.metrics import Metrics
from koordgen.runtime.net.sessions import PeerSession
from koordgen.runtime.net.transport import Transport
from koordgen.runtime.net.wire import Entry
from koordgen.runtime.ops.opening import open_transport
from koordgen.runtime.program.program import Life
from koordgen.runtime.replication.driver import Driver
from koordgen.runtime.replication.messages import HardState
from koordgen.runtime.replication.replica import REQUEST_TICK, TICKS, Replica
from koordgen.runtime.replication.state_machine import StateMachine
from koordgen.runtime.values.clock import Clock, SystemClock


def open_memory(place: Place, network: str = "multicast", native: bool = True) -> SharedMemory:
    """On real sockets of this host, and with a real file."""
    if not native:
        without_courier()
    given = settings(place.pid, place.ports, place.delta, network)
    path = place.folder / f"{place.pid}.state"
    store = CheckpointFile.open(path, program(place.size), given.robot, place.pid, len(given.peers), print)
    return SharedMemory(given, place.size, open_transport(given), store, SystemClock())


def open_update(place: Place, native: bool = True) -> Update:
    """On real sockets of this host."""
    if not native:
        without_courier()
    given = settings(place.pid, place.ports, place.delta, "unicast")
    return Update(given, place.size, open_transport(given), SystemClock())


def without_courier() -> None:
    """Do everything in Python in this process, as where there is no compiler."""
    socket_batch.COMPILED.found = "not wanted"


def open_driver(
    given: Settings, size: int, transport: Transport, clock: Clock, persist: Callable[[HardState], None]
) -> tuple[Driver, Link]:
    """Return a driver as after joining: all robots have met and ran `init`."""
    ours, pid, n = program(size), given.pid, len(given.peers)
    boots = [bytes([p] * 8) for p in range(n)]
    fleet_clock = FleetClock(pid)  # it learns; the harness goes by the host's clock, with ours and peers
    fleet_clock.lock()
    link = Link(ours, given, KEY, transport, clock, fleet_clock, boots[pid], print, Metrics(pid, n))
    for other in range(n):
        if other != pid:
            link.sessions[other] = PeerSession(boots[other])
    link.epoch = bytes(8)
    inits = [Entry(p, 0, 0, 0) for p in range(n)]
    layout, hard_state = Layout(ours.shared, n), first_hard_state(n)
    state = StateMachine.begin(layout, pid, hard_state.view, inits)
    replica = Replica(pid, layout, state, hard_state, given.safety.peer_timeout, link.speech.room)
    return Driver(replica, link, persist, lambda private: None), link


def _speak(link: Link, pids: Collection[int]) -> set[int]:
    """Return those of which a datagram has arrived."""
    return {pid for pid in pids if link.sessions[pid].sent >= 0}


def _receive(driver: Driver, link: Link) -> None:
    """Hand what has arrived to the replica."""
    driver.receive(link.receive())


class Update:
    """One of two robots that answer each other: no ticks, so no requests, no ballots, and nothing is persisted.

    An answer is sent after the update that it answers was applied, as a robot applies no round before it has closed it.
    """

    def __init__(self, given: Settings, size: int, transport: Transport, clock: Clock) -> None:
        self._other, self._rest, self._transport = 1 - given.pid, "x" * (size - 8), transport
        self._driver, self._link = open_driver(given, size, transport, clock, lambda state: None)
        self._round = self._told = 0
        self.missed: list[int] = []  # none ever: nothing is lost between two processes that take turns

    def publish(self, round_: int) -> None:
        if round_ == 0:
            self._driver.replica.send_report(0)
            self._driver.flush()
            return
        self._round = round_
        self._driver.replica.round = round_
        self._driver.replica.propose(round_, {"report": f"{round_:08}{self._rest}"}, stopped=False, acted=True)
        self._driver.run()

    def take(self, seconds: float) -> Heard:
        self._transport.wait(seconds)
        _receive(self._driver, self._link)
        state, told = self._driver.replica.state, self._told
        assert state is not None
        held = self._told = state.logs[self._other].held
        if held > told:
            return [(self._other, round_) for round_ in range(told + 1, held + 1)]
        return [] if self._round else [(pid, 0) for pid in _speak(self._link, [self._other])]


class SharedMemory:
    """One robot's shared memory. A round begins when it is published.

    If something of the last round is missing, the entry waits until the publish deadline, and then goes without an
    update. Round 0 is there to find out whether all others can be heard. The updates have no outputs, so no robot waits
    for a commit.
    """

    def __init__(self, given: Settings, size: int, transport: Transport, store: CheckpointStore, clock: Clock) -> None:
        pid, n = given.pid, len(given.peers)
        self._pid, self._delta, self._rest = pid, given.delta, "x" * (size - 8)
        self._transport, self._now = transport, clock.now
        keeping = Persistence(store, program(size), n)
        self._driver, self._link = open_driver(given, size, transport, clock, keeping.hard_state)
        keeping.mission(self._link.epoch, Life(0, {"count": 0}, {}, False))
        self._replica = self._driver.replica
        self._round, self._tick = 0, -1
        self._start = self._begun = math.inf  # round 1, at the earliest that any was published; the present round
        self._wake = math.inf
        self._open = False  # the present round is not closed yet
        self._handled = 0  # the last round whose being applied was acknowledged
        self._view = self._store_changes = 0
        self._told = {p: 0 for p in range(n) if p != pid}  # up to which round each robot's entries were found
        self._unheard = set(self._told)
        self._found: Heard = []  # and not returned yet
        self.missed: list[int] = []

    def publish(self, round_: int) -> None:
        if round_ == 0:
            self._replica.send_report(0)
            self._driver.flush()
            return
        if self._open:
            self._close(current=False)
        clock = self._now
        now, before = clock(), (round_ - 1) * self._delta
        self._start = min(self._start, now - before)
        self._begun = self._start + before
        if now >= self._begun + self._delta:  # slept through: it is closed with the next one
            self.missed.append(round_)
            return
        self._round, self._tick, self._open, self._wake = round_, -1, True, self._begun
        if not self._is_current():
            self._driver.tick((round_ - 1) * TICKS)
            self._hear()  # what is missing may be here
            if not self._is_current() and self._replica.policy.waits(round_):
                return
        self._close(self._is_current())
        self._driver.tick((round_ - 1) * TICKS)  # only now: all others wait for the entry
        if now < self._moment(PUNCTUAL) and not self._replica.is_busy:
            self._tick, self._wake = 0, self._moment(REQUEST_TICK)

    def take(self, seconds: float) -> Heard:
        """Do what is due, then wait for something to arrive, then do what follows from that. When it is time for the
        next entry, that comes first, as in an agent."""
        clock = self._now
        now = clock()
        end = now + seconds
        if now >= self._wake and self._round:
            self._poll(now)
        rest = (end if end < self._wake else self._wake) - clock()
        if rest > 0:
            self._wait(rest)
        if seconds <= 0 or not self._round or (now := clock()) < end:
            self._hear()
            self._react(now)
        found, self._found = self._found, []
        return found

    def _wait(self, seconds: float) -> None:
        """Gather as many entries as Rounds expects."""
        state, at_once = self._replica.state, self._open and not self._replica.policy.is_strained(self._round)
        lacking = 0 if state is None or at_once or state.applied >= self._round else state.lacking
        if lacking:
            self._transport.wait(seconds, lacking, min(GATHER * lacking, MOST_GATHER * self._delta))
        else:
            self._transport.wait(seconds)

    def _is_current(self) -> bool:
        """Return whether an event may run, as Rounds finds."""
        state, round_ = self._replica.state, self._round
        if state is None or state.applied != round_ - 1 or state.is_frozen:
            return False
        return round_ - AHEAD <= state.committed and not state.is_full

    def _close(self, current: bool) -> None:
        """Send the entry of the present round."""
        self._open = False
        if not current:
            self.missed.append(self._round)
        shared = {"report": f"{self._round:08}{self._rest}"} if current else {}
        self._driver.replica.propose(self._round, shared, stopped=False, acted=current)
        self._driver.run()

    def _hear(self) -> None:
        """Receive what has arrived, and note what is held without a gap since; in round 0, who can be heard."""
        _receive(self._driver, self._link)
        if self._round == 0:
            heard = _speak(self._link, self._unheard)
            self._unheard -= heard
            self._found += [(pid, 0) for pid in heard]
        state = self._replica.state
        if state is None:
            return
        logs = state.logs
        for pid, told in self._told.items():
            held = logs[pid].held
            if held > told:
                self._found += [(pid, each) for each in range(told + 1, held + 1)]
                self._told[pid] = held

    def _react(self, now: float) -> None:
        """Act on what has arrived: it may complete the round, or change who counts."""
        replica, round_ = self._replica, self._round
        if replica.store_changes != self._store_changes:
            self._store_changes = replica.store_changes
            if not self._open and replica.published < round_:
                self._driver.replica.propose(round_, {}, stopped=False)
                self._driver.run()
        state = replica.state
        if self._open:
            current = self._is_current()
            if current or now >= self._moment(PUBLISH * TICKS) - 1e-9:
                self._close(current)
        if state is None:
            return
        if state.view.number != self._view:
            self._view = state.view.number
            replica.send_report(round_)
            self._driver.flush()
        if state.applied >= round_ > self._handled:
            self._handled = round_
            replica.acknowledge(round_)
            self._driver.flush()
            if self._tick >= 0:
                self._wake = self._next_wake(state, self._tick)

    def _poll(self, now: float) -> None:
        """Do what is due at the ticks of a round. Those of the last round go on until nothing is missing."""
        replica = self._replica
        tick = math.floor((now - self._begun) / self._delta * TICKS + 1e-6)
        on_time = now < self._wake + PUNCTUAL / TICKS * self._delta
        if tick > self._tick:
            self._tick = tick
            self._driver.tick((self._round - 1) * TICKS + tick)
            replica.request(tick, on_time, None)
            self._driver.flush()
            self._react(now)  # there may be another view
        self._wake = self._next_wake(replica.state, tick)

    def _next_wake(self, state: StateMachine | None, tick: int) -> float:
        """Return when there is something to do again, at the latest."""
        replica, round_ = self._replica, self._round
        missing = state is not None and [p for p in state.missing(round_ - (tick < REQUEST_TICK)) if p != self._pid]
        if missing or self._open or state is None or replica.is_busy:
            rests = replica.policy.is_hurried(round_) and not replica.is_busy
            following = self._moment(tick + (TICKS - tick % TICKS if rests else 1))
            return min(following, self._moment(PUBLISH * TICKS)) if self._open else following
        return self._moment(max(tick + 1, REQUEST_TICK)) if state.applied < round_ else math.inf

    def _moment(self, tick: float) -> float:
        """Return the time of a tick of the present round."""
        return self._begun + tick / TICKS * self._delta
