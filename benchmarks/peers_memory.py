"""Our shared memory of one robot as an Exchange, without an agent (SharedMemory), and an update's path alone (Update).

`Update`: encode, MAC, UDP, verify, decode, apply, between two robots. `SharedMemory` does all the work of an agent's
shared memory in a round: entry, encoding, MAC, UDP, verifying, decoding, applying, progress reports, clock echoes,
persistence of its progress report in a file, requests for missing entries, views. It uses the runtime's own objects, at
the same times as Rounds does. The work for the program remains with the agent: sensors, events, the robot's own
variables and outputs, monitors, trace.
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
from koordgen.runtime.ops.set_up import open_transport
from koordgen.runtime.program.program import Life
from koordgen.runtime.replication.driver import Driver
from koordgen.runtime.replication.messages import HardState
from koordgen.runtime.replication.replica import REQUEST_TICK, TICKS, Replica
from koordgen.runtime.replication.state_machine import StateMachine
from koordgen.runtime.values.clock import Clock, SystemClock


def open_memory(place: Place, network: str = "multicast", native: bool = True) -> SharedMemory:
    """Return a SharedMemory on real sockets of this host, with a real file."""
    if not native:
        without_courier()
    given = settings(place.pid, place.ports, place.delta, network)
    path = place.folder / f"{place.pid}.state"
    store = CheckpointFile.open(path, program(place.size), given.robot, place.pid, len(given.peers), print)
    return SharedMemory(given, place.size, open_transport(given), store, SystemClock())


def open_update(place: Place, native: bool = True) -> Update:
    """Return an Update on real sockets of this host."""
    if not native:
        without_courier()
    given = settings(place.pid, place.ports, place.delta, "unicast")
    return Update(given, place.size, open_transport(given), SystemClock())


def without_courier() -> None:
    """Do the socket I/O in Python in this process, as on a computer without a C compiler."""
    socket_batch.COMPILED.found = "not wanted"


def open_driver(
    given: Settings, size: int, transport: Transport, clock: Clock, persist: Callable[[HardState], None]
) -> tuple[Driver, Link]:
    """Return a driver in the state after joining: all robots have met and ran `init`."""
    ours, pid, n = program(size), given.pid, len(given.peers)
    boots = [bytes([p] * 8) for p in range(n)]
    fleet_clock = FleetClock(pid)  # kept running as in an agent; the harness measures with the host's clock
    fleet_clock.lock()
    link = Link(ours, given, KEY, transport, clock, fleet_clock, boots[pid], print, Metrics(pid, n))
    for other in range(n):
        if other != pid:
            link.sessions[other] = PeerSession(boots[other])
    link.epoch = bytes(8)
    inits = [Entry(p, 0, 0, 0) for p in range(n)]
    layout, hard_state = Layout(ours.shared, n), first_hard_state(n)
    state = StateMachine.begin(layout, pid, hard_state.view, inits)
    replica = Replica(pid, layout, state, hard_state, given.safety.peer_timeout, link.sender.room)
    return Driver(replica, link, persist, lambda private: None), link


def _speak(link: Link, pids: Collection[int]) -> set[int]:
    """Return the robots from which a datagram has arrived."""
    return {pid for pid in pids if link.sessions[pid].sent >= 0}


def _receive(driver: Driver, link: Link) -> None:
    """Pass the received datagrams to the replica."""
    driver.receive(link.receive())


class Update:
    """One of two robots that answer each other: without ticks, requests or ballots, and without persistence.

    An answer is sent after the update that it answers was applied: a robot applies no round before it has sent its own
    entry.
    """

    def __init__(self, given: Settings, size: int, transport: Transport, clock: Clock) -> None:
        self._other, self._rest, self._transport = 1 - given.pid, "x" * (size - 8), transport
        self._driver, self._link = open_driver(given, size, transport, clock, lambda state: None)
        self._round = self._told = 0
        self.missed: list[int] = []  # always empty: no datagram is lost between two processes that take turns

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
    """Shared memory of one robot. A round begins when its update is published.

    If data of the last round are missing, the entry waits until the publish deadline, and is then sent without an
    update. Round 0 shows whether all others can be received. The updates have no outputs, so no robot waits for a
    commit.
    """

    def __init__(self, given: Settings, size: int, transport: Transport, store: CheckpointStore, clock: Clock) -> None:
        pid, n = given.pid, len(given.peers)
        self._pid, self._delta, self._rest = pid, given.delta, "x" * (size - 8)
        self._transport, self._now = transport, clock.now
        keeping = Persistence(store, [program(size)], n)
        self._driver, self._link = open_driver(given, size, transport, clock, keeping.hard_state)
        keeping.mission(self._link.epoch, [Life(0, {"count": 0}, {}, False)])
        self._replica = self._driver.replica
        self._round, self._tick = 0, -1
        self._start = self._begun = math.inf  # start of round 1, from the earliest publish; start of the present round
        self._wake = math.inf
        self._open = False  # the entry of the present round was not sent yet
        self._handled = 0  # last applied round that was acknowledged
        self._view = self._store_changes = 0
        self._told = {p: 0 for p in range(n) if p != pid}  # last round of each robot whose entries have arrived
        self._unheard = set(self._told)
        self._found: Heard = []  # entries that `take` has not returned yet
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
        if now >= self._begun + self._delta:  # overslept: its entry is sent with the next one
            self.missed.append(round_)
            return
        self._round, self._tick, self._open, self._wake = round_, -1, True, self._begun
        if not self._is_current():
            self._driver.tick((round_ - 1) * TICKS)
            self._hear()  # missing entries may have arrived
            if not self._is_current() and self._replica.policy.waits(round_):
                return
        self._close(self._is_current())
        self._driver.tick((round_ - 1) * TICKS)  # after sending, because all others wait for the entry
        if now < self._moment(PUNCTUAL) and not self._replica.is_busy:
            self._tick, self._wake = 0, self._moment(REQUEST_TICK)

    def take(self, seconds: float) -> Heard:
        """Do the due work, wait for a datagram, then process it.

        When the next entry is due, it is sent first, as in an agent.
        """
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
        """Receive as many entries as Rounds expects."""
        state, at_once = self._replica.state, self._open and not self._replica.policy.is_strained(self._round)
        lacking = 0 if state is None or at_once or state.applied >= self._round else state.lacking
        if lacking:
            self._transport.wait(seconds, lacking, min(GATHER * lacking, MOST_GATHER * self._delta))
        else:
            self._transport.wait(seconds)

    def _is_current(self) -> bool:
        """Return whether an event may run, as Rounds decides."""
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
        """Receive datagrams. Record up to which round entries are complete; in round 0, which robots were received."""
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
        """Process received datagrams: they may complete the round, or change the view."""
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
        """Do the work that is due at the ticks of a round. Ticks of the last round go on until no data are missing."""
        replica = self._replica
        tick = math.floor((now - self._begun) / self._delta * TICKS + 1e-6)
        on_time = now < self._wake + PUNCTUAL / TICKS * self._delta
        if tick > self._tick:
            self._tick = tick
            self._driver.tick((self._round - 1) * TICKS + tick)
            replica.request(tick, on_time, None)
            self._driver.flush()
            self._react(now)  # the view may have changed
        self._wake = self._next_wake(replica.state, tick)

    def _next_wake(self, state: StateMachine | None, tick: int) -> float:
        """Return the latest time at which there is work again."""
        replica, round_ = self._replica, self._round
        missing = state is not None and [p for p in state.missing(round_ - (tick < REQUEST_TICK)) if p != self._pid]
        if missing or self._open or state is None or replica.is_busy:
            rests = replica.policy.is_hurried(round_) and not replica.is_busy
            following = self._moment(tick + (TICKS - tick % TICKS if rests else 1))
            return min(following, self._moment(PUBLISH * TICKS)) if self._open else following
        return self._moment(max(tick + 1, REQUEST_TICK)) if state.applied < round_ else math.inf

    def _moment(self, tick: float) -> float:
        """Return the time of a tick in the present round."""
        return self._begun + tick / TICKS * self._delta
