"""Our side: one robot's shared memory as an Exchange, without the agent around it (SharedMemory); and of two robots
an update's way alone (Update): encode, MAC, UDP, verify, decode, apply.

All that an agent's shared memory does in a round is done here: closing, encoding, MAC, UDP, verifying, decoding,
applying, words, clock echoes, the robot's word kept in a file, questions for what is missing, views. `SharedMemory`
does with the runtime's own objects what Rounds does, at the same moments. What belongs to a program is the agent's:
sensors, events, the robot's own variables and what leaves the robot, monitors, trace.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from itertools import repeat

from benchmarks.peers_agents import KEY, program, settings
from benchmarks.peers_exchange import Heard, Place
from koordgen.runtime.agent.keeping import Keeping
from koordgen.runtime.agent.outbox import AHEAD
from koordgen.runtime.agent.rounds import FIRST_SLOT, GATHER, MOST_GATHER, PUBLISH, PUNCTUAL
from koordgen.runtime.agent.store import Keeper, Store
from koordgen.runtime.config.settings import Settings
from koordgen.runtime.net import courier
from koordgen.runtime.net.fleet_clock import FleetClock
from koordgen.runtime.net.layout import Layout
from koordgen.runtime.net.link import Link
from koordgen.runtime.net.metrics import Metrics
from koordgen.runtime.net.sessions import PeerSession
from koordgen.runtime.net.transport import Transport
from koordgen.runtime.net.wire import Closing, Hello, Round, View
from koordgen.runtime.ops.opening import open_transport
from koordgen.runtime.program.program import Life
from koordgen.runtime.replication.memory import Memory
from koordgen.runtime.replication.patience import Patience, many
from koordgen.runtime.replication.replica import SLOTS, Replica
from koordgen.runtime.replication.views import Vote
from koordgen.runtime.values.clock import Clock, SystemClock

FULL = 0  # the number of the view in which all robots count


def open_memory(place: Place, network: str = "multicast", native: bool = True) -> SharedMemory:
    """On real sockets of this host, and with a real file."""
    if not native:
        without_courier()
    given = settings(place.pid, place.ports, place.delta, network)
    path = place.folder / f"{place.pid}.state"
    store = Store.open(path, program(place.size), given.robot, place.pid, len(given.peers), print)
    return SharedMemory(given, place.size, open_transport(given), store, SystemClock())


def open_update(place: Place, native: bool = True) -> Update:
    """On real sockets of this host."""
    if not native:
        without_courier()
    given = settings(place.pid, place.ports, place.delta, "unicast")
    return Update(given, place.size, open_transport(given), SystemClock())


def without_courier() -> None:
    """Do everything in Python in this process, as where there is no compiler."""
    courier.COMPILED.found = "not wanted"


def open_link(given: Settings, size: int, transport: Transport, clock: Clock) -> tuple[Link, Memory]:
    """As after joining: all have met, and ran `init`."""
    ours, pid, n = program(size), given.pid, len(given.peers)
    boots = [bytes([p] * 8) for p in range(n)]
    fleet_clock = FleetClock(pid)  # it learns; the harness goes by the host's clock, with ours and peers
    fleet_clock.lock()
    link = Link(ours, given, KEY, transport, clock, fleet_clock, boots[pid], print, Metrics(pid, n))
    for other in range(n):
        if other != pid:
            link.sessions[other] = PeerSession(boots[other])
    link.epoch = bytes(8)
    inits = [Closing(p, 0, 0, 0) for p in range(n)]
    return link, Memory.begin(Layout(ours.shared, n), pid, View(0, 1, (0,) * n), inits)


def _speak(link: Link, pids: Collection[int]) -> set[int]:
    """Return those robots from which a datagram has come."""
    return {pid for pid in pids if link.sessions[pid].sent >= 0}


class Update:
    """Link and memory of one of two robots without what else a round may need: questions, ballots, the word on disk.
    Who answers has applied what it answers to, as its memory applies no round before it has closed it too: an agent
    would send its closing first."""

    def __init__(self, given: Settings, size: int, transport: Transport, clock: Clock) -> None:
        self._other, self._rest, self._transport = 1 - given.pid, "x" * (size - 8), transport
        self._to = [self._other]
        self._link, self._memory = open_link(given, size, transport, clock)
        self._round = self._told = 0
        self.missed: list[int] = []  # none ever: nothing is lost between two processes that take turns

    def publish(self, round_: int) -> None:
        memory, to, speech = self._memory, self._to, self._link.speech
        if round_ == 0:
            speech.round(to, (0, 0, 0, 0, False, ()), ())
            return
        self._round = round_
        memory.close(round_, {"report": f"{round_:08}{self._rest}"}, stopped=False, acted=True)
        memory.advance(round_ + 1)
        word = (0, round_, memory.applied, memory.settled(), False, memory.held if memory.applied < round_ - 1 else ())
        speech.round(to, word, memory.own(round_))

    def take(self, seconds: float) -> Heard:
        self._transport.wait(seconds)
        memory, told = self._memory, self._told
        for message in self._link.receive():
            if isinstance(message, Round):
                memory.receive(message, max(self._round, 1))
        memory.advance(self._round + 1)
        held = self._told = memory.ledger.held[self._other]
        if held > told:
            return [(self._other, round_) for round_ in range(told + 1, held + 1)]
        return [] if self._round else [(pid, 0) for pid in _speak(self._link, self._to)]


class SharedMemory:
    """A round begins when it is published. Where something of the last one is not here yet, its closing waits until
    the publish deadline, and then goes without an update. Round 0 is there to find out whether all others can be heard.
    The updates have no outputs, so nobody waits for their being confirmed."""

    def __init__(self, given: Settings, size: int, transport: Transport, store: Keeper, clock: Clock) -> None:
        pid, n = given.pid, len(given.peers)
        self._pid, self._delta, self._rest = pid, given.delta, "x" * (size - 8)
        self._transport, self._now = transport, clock.now
        ours, view = program(size), View(FULL, 1, (0,) * n)
        self._link, memory = open_link(given, size, transport, clock)
        keeping = Keeping(store, ours, n)
        keeping.mission(self._link.epoch, Life(0, {"count": 0}, {}, False))
        layout = Layout(ours.shared, n)
        timeout = given.safety.peer_timeout
        self._replica = Replica(self._link, layout, memory, view, Vote(), 0, timeout, keeping.announce)
        self._round, self._slot, self._published = 0, -1, 0
        self._patience = Patience(pid, n)
        self._start = self._begun = math.inf  # round 1, at the earliest that any was published; the present round
        self._wake = math.inf
        self._open = False  # the present round is not closed yet
        self._complete = True  # all of the present round is applied
        self._looked = False  # what has come was taken, and not applied yet
        self._view = self._returns = 0
        self._others = [p for p in range(n) if p != pid]
        self._told = [0] * n  # up to which each robot's rounds were found, or up to `_all`
        self._all = 0  # up to which all others' rounds were found, and none beyond; -1: not alike
        self._unheard = set(self._others)
        self._found: Heard = []  # and not returned yet
        self.missed: list[int] = []

    def publish(self, round_: int) -> None:
        if round_ == 0:
            self._replica.tell(0)
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
        self._round, self._slot, self._open, self._complete, self._wake = round_, -1, True, False, self._begun
        if not (current := self._current()):
            self._replica.begin(round_)
            self._looked = True
            self._hear()  # what is lacking may be here
            current = self._current()
        if not current and self._patience.waits(round_):
            return
        self._close(current)
        calm = self._replica.begin(round_)  # only now: all others wait for the closing
        if self._replica.memory is not None and not self._replica.memory.lacking():  # they were before us
            self._looked = True
            self._hear()
        if calm and now < self._moment(PUNCTUAL):  # there is nothing to do at the first slot
            self._slot, self._wake = 0, self._moment(FIRST_SLOT)

    def take(self, seconds: float) -> Heard:
        """Do what is due, then wait for something to arrive, then do what follows from that; but when it is time for
        the next closing, that comes first, as in an agent."""
        clock = self._now
        now = clock()
        end = now + seconds
        if self._looked:  # publishing has, for what the last round lacked, or as all of this one were here
            self._looked = False
            self._apply(now)
            if self._found:
                found, self._found = self._found, []
                return found
        if now >= self._wake and self._round:
            self._poll(now)
        rest = (end if end < self._wake else self._wake) - clock()
        if rest > 0:
            self._wait(rest)
        if seconds <= 0 or not self._round or (now := clock()) < end:
            self._hear()
            if not self._calm():
                self._apply(now)
        found, self._found = self._found, []
        return found

    def _wait(self, seconds: float) -> None:
        """Gathers as many closings as Rounds expects."""
        memory, at_once = self._replica.memory, self._open and not self._patience.strained(self._round)
        lacking = 0 if memory is None or at_once or memory.applied >= self._round else memory.lacking()
        if lacking:
            self._transport.wait(seconds, lacking, min(GATHER * lacking, MOST_GATHER * self._delta))
        else:
            self._transport.wait(seconds)

    def _calm(self) -> bool:
        """Whether nothing that has come makes a difference to this round, as Rounds finds."""
        replica, memory = self._replica, self._replica.memory
        if memory is None or self._open or replica.returns != self._returns or memory.view.number != self._view:
            return False
        return self._complete or (memory.lacking() > 0 and memory.applied < self._round)

    def _current(self) -> bool:
        """Whether an event may run, as Rounds finds."""
        memory, round_ = self._replica.memory, self._round
        if memory is None or not memory.advance(round_):
            return False
        return (round_ <= AHEAD or memory.stable(round_ - AHEAD)) and not memory.crowded()

    def _close(self, current: bool) -> None:
        """The closing leaves."""
        memory, round_ = self._replica.memory, self._round
        self._open = False
        if not current:
            self.missed.append(round_)
        if memory is not None:
            shared = {"report": f"{round_:08}{self._rest}"} if current else {}
            memory.close(round_, shared, stopped=False, acted=current)
        self._replica.publish(self._published + 1, round_, self._patience.strained(round_))
        self._published = round_

    def _hear(self) -> None:
        """Take what has come, and find what is held without a gap since; in round 0 who can be heard."""
        for message in self._link.receive():
            if not isinstance(message, Hello):
                self._replica.take(message, max(self._round, 1))
        memory, round_ = self._replica.memory, self._round
        if round_ == 0:
            heard = _speak(self._link, self._unheard)
            self._unheard -= heard
            self._found += [(pid, 0) for pid in heard]
        if memory is None:
            return
        if memory.applied == self._all == round_ - 1 and not memory.lacking() and memory.view.number == FULL:
            self._all = round_  # nearly always: all of this round are here
            self._found += zip(self._others, repeat(round_))
            return
        for pid in self._others:
            last, held = max(self._told[pid], self._all), memory.ledger.held[pid]
            self._found += [(pid, each) for each in range(last + 1, held + 1)]
            self._told[pid] = held
        told = [self._told[pid] for pid in self._others]
        self._all = told[0] if min(told) == max(told) else -1

    def _apply(self, now: float) -> None:
        """What has come may complete the round, or change who counts."""
        replica, round_ = self._replica, self._round
        if replica.returns != self._returns:
            self._come_back()
        memory = replica.memory
        if self._open:
            current = self._current()
            if current or now >= self._moment(PUBLISH * SLOTS) - 1e-9:
                self._close(current)
        if memory is None:
            return
        if not self._open:
            memory.advance(round_ + 1)
        if memory.view.number != self._view:
            self._view = memory.view.number
            replica.tell(round_)
        if memory.applied >= round_ and not self._complete:
            self._complete = True
            replica.keep()  # the next closing says so, and should not have to wait for it
            replica.confirm(round_)
            if self._slot >= 0:
                self._ask(memory, self._slot)

    def _come_back(self) -> None:
        """Go on where the others say that this robot was."""
        self._returns, memory = self._replica.returns, self._replica.memory
        if memory is None:
            return
        self._published = memory.held[self._pid]
        if not self._open and self._published < self._round:
            memory.close(self._round, {}, stopped=False)
            self._replica.publish(self._published + 1, self._round, self._patience.strained(self._round))
            self._published = self._round

    def _poll(self, now: float) -> None:
        """What is due at the slots of a round; the last round's go on until nothing is missing."""
        replica, slots = self._replica, (now - self._begun) / self._delta * SLOTS
        slot = math.floor(slots + 1e-6)
        fresh = slot > self._slot
        if fresh:
            self._slot = slot
            replica.poll((self._round - 1) * SLOTS + slot, self._round)
        memory = replica.memory
        if memory is None:
            self._wake = self._following(slot)
            return
        self._ask(memory, slot, fresh, timely=now < self._wake + PUNCTUAL / SLOTS * self._delta)
        if fresh and not self._calm():  # there may be another view
            self._apply(now)

    def _ask(self, memory: Memory, slot: int, fresh: bool = False, timely: bool = False) -> None:
        """Ask for what should have come by now, and find when there is something to do again."""
        replica, round_ = self._replica, self._round
        through = round_ if slot >= FIRST_SLOT else round_ - 1
        missing = memory.missing(through)
        if fresh:
            self._patience.wakes(round_, timely and not many(len(missing), len(self._told)))
        if missing:
            missing = [p for p in missing if p != self._pid]
            if fresh and missing and self._patience.asks(round_, timely, memory.ledger.lost(missing)):
                replica.ask(missing, [], through)
        if missing or self._open or replica.busy():
            self._wake = self._following(slot)
        elif not self._complete:
            self._wake = self._moment(max(slot + 1, FIRST_SLOT))
        else:
            replica.complete(round_)
            self._wake = math.inf

    def _following(self, slot: int) -> float:
        """The next moment at which there is something to do while something is outstanding."""
        rests = self._patience.hurried(self._round) and not self._replica.busy()
        following = self._moment(slot + (SLOTS - slot % SLOTS if rests else 1))
        return min(following, self._moment(PUBLISH * SLOTS)) if self._open else following

    def _moment(self, slot: float) -> float:
        """The time of a slot of the present round."""
        return self._begun + slot / SLOTS * self._delta
