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

from peers_agents import KEY, program, settings
from peers_exchange import Heard, Place

from koordgen.runtime import courier, gate
from koordgen.runtime.clock import Clock, FleetClock, SystemClock
from koordgen.runtime.keeping import Keeping
from koordgen.runtime.layout import Layout
from koordgen.runtime.link import Link, Usuals, as_usual
from koordgen.runtime.memory import Memory
from koordgen.runtime.metrics import Metrics
from koordgen.runtime.opening import open_transport
from koordgen.runtime.outbox import AHEAD
from koordgen.runtime.patience import Patience
from koordgen.runtime.program import Life
from koordgen.runtime.replica import SLOTS, Replica
from koordgen.runtime.rounds import FIRST_SLOT, GATHER, MOST_GATHER, PUBLISH, PUNCTUAL
from koordgen.runtime.settings import Settings
from koordgen.runtime.store import Keeper, Store
from koordgen.runtime.transport import Transport
from koordgen.runtime.views import Vote
from koordgen.runtime.wire import Closing, Hello, Round, View


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
    """From now on this process does everything in plain Python, as where there is no compiler."""
    courier.COMPILED.found = gate.COMPILED.found = "not wanted"


def open_link(given: Settings, size: int, transport: Transport, clock: Clock) -> tuple[Link, Memory]:
    """As after joining: all have met, and ran `init`."""
    ours, pid, n = program(size), given.pid, len(given.peers)
    boots = [bytes([p] * 8) for p in range(n)]
    fleet_clock = FleetClock(pid)  # it learns; the harness goes by the host's clock, with ours and peers
    fleet_clock.lock()
    link = Link(ours, given, KEY, transport, clock, fleet_clock, boots[pid], print, Metrics(pid, n))
    for other in range(n):
        if other != pid:
            link.sessions.adopt(other, boots[other])
    link.epoch = bytes(8)
    inits = [Closing(p, 0, 0, 0) for p in range(n)]
    return link, Memory.begin(Layout(ours.shared, n), pid, View(0, 1, (0,) * n), inits)


def _speak(link: Link, pids: Collection[int]) -> set[int]:
    """Those of whom a datagram has come; of most no message tells."""
    return {pid for pid in pids if link.sessions.sent[pid] >= 0}


class Update:
    """Link and memory of one of two robots without what else a round may need: questions, ballots, the word on disk."""

    def __init__(self, given: Settings, size: int, transport: Transport, clock: Clock) -> None:
        self._other, self._size, self._transport = 1 - given.pid, size, transport
        self._link, self._memory = open_link(given, size, transport, clock)
        self._link.follow(self._memory.view)
        self._round = self._told = 0
        self._unheard = {self._other}
        self.missed: list[int] = []  # none ever: nothing is lost between two processes that take turns

    def publish(self, round_: int) -> None:
        memory = self._memory
        if round_ > 0:
            self._round = round_
            memory.close(round_, {"report": f"{round_:0{self._size}}"}, stopped=False, acted=True)
        held = memory.held if memory.applied < round_ - 1 else ()
        word = (0, round_, memory.applied, memory.settled, False, held)
        self._link.speech.round([self._other], word, memory.own(round_) if round_ > 0 else ())
        memory.advance(round_ + 1)

    def take(self, seconds: float) -> Heard:
        self._transport.wait(seconds)
        memory, other, told = self._memory, self._other, self._told
        for message in self._link.receive():
            said = as_usual(message) if isinstance(message, Round) else message
            if isinstance(said, Usuals):
                memory.usual(said.rows, said.view, max(self._round, 1))
        memory.advance(self._round + 1)
        heard = _speak(self._link, self._unheard) if self._round == 0 else ()
        self._unheard.difference_update(heard)
        self._told = memory.held[other]
        return [(pid, 0) for pid in heard] + [(other, round_) for round_ in range(told + 1, self._told + 1)]


class SharedMemory:
    """A round begins when it is published. Where something of the last one is not here yet, its closing waits until
    the publish deadline, and then goes without an update. Round 0 is there to find out whether all others can be heard.
    The updates have no outputs, so nobody waits for their being confirmed."""

    def __init__(self, given: Settings, size: int, transport: Transport, store: Keeper, clock: Clock) -> None:
        pid, n = given.pid, len(given.peers)
        self._pid, self._delta, self._size = pid, given.delta, size
        self._transport, self._clock = transport, clock
        ours, view = program(size), View(0, 1, (0,) * n)
        self._link, memory = open_link(given, size, transport, clock)
        keeping = Keeping(store, ours, n)
        keeping.mission(self._link.epoch, Life(0, {"count": 0}, {}, False))
        layout = Layout(ours.shared, n)
        timeout = given.safety.peer_timeout
        self._replica = Replica(self._link, layout, memory, view, Vote(), 0, timeout, keeping.announce)
        self._round, self._slot, self._published = 0, -1, 0
        self._patience = Patience()
        self._start = math.inf  # of round 1: no round was published before its beginning
        self._wake = math.inf
        self._open = False  # the present round is not closed yet
        self._complete = True  # all of the present round is applied
        self._view = self._returns = 0
        self._told = [0] * n  # up to which each robot's rounds were found
        self._unheard = set(range(n)) - {pid}
        self._found: Heard = []  # and not returned yet
        self.missed: list[int] = []

    def publish(self, round_: int) -> None:
        if round_ == 0:
            self._replica.tell(0)
            return
        if self._open:
            self._close(current=False)
        now = self._clock.now()
        self._start = min(self._start, now - (round_ - 1) * self._delta)
        if now >= self._start + round_ * self._delta:  # slept through: it is closed with the next one
            self.missed.append(round_)
            return
        self._round, self._slot, self._open, self._complete, self._wake = round_, -1, True, False, -math.inf
        self._replica.begin(round_)
        if not self._current():
            self._hear()  # what is lacking may be here, not yet looked at
        if self._current():
            self._close(current=True)

    def take(self, seconds: float) -> Heard:
        self._step(seconds)
        found, self._found = self._found, []
        return found

    def _step(self, seconds: float) -> None:
        """Do what is due, then wait for something to arrive, then do what follows from that; but when it is time for
        the next closing, that comes first, as in an agent."""
        end = self._clock.now() + seconds
        self._apply()
        self._poll()
        rest = min(end, self._wake) - self._clock.now()
        if rest > 0:
            self._transport.wait(rest, *self._expects)
        if seconds <= 0 or self._clock.now() < end:
            self._hear()
            self._apply()

    def _current(self) -> bool:
        """Whether an event may run, as Rounds finds."""
        memory, round_ = self._replica.memory, self._round
        if memory is None or not memory.advance(round_):
            return False
        return (round_ <= AHEAD or memory.stable(round_ - AHEAD)) and not memory.crowded

    def _close(self, current: bool) -> None:
        """The closing leaves."""
        memory, round_ = self._replica.memory, self._round
        self._open = False
        if not current:
            self.missed.append(round_)
        if memory is not None:
            shared = {"report": f"{round_:0{self._size}}"} if current else {}
            memory.close(round_, shared, stopped=False, acted=current)
        self._replica.publish(self._published + 1, round_, self._patience.strained(round_))
        self._published = round_

    @property
    def _expects(self) -> tuple[int, float]:
        """As Rounds says."""
        memory = self._replica.memory
        if memory is None or self._open or memory.applied >= self._round or not memory.lacking:
            return 1, 0.0
        return memory.lacking, min(GATHER * memory.lacking, MOST_GATHER * self._delta)

    def _hear(self) -> None:
        """Take what has come, and find what is held without a gap since; in round 0 who can be heard."""
        take, present = self._replica.take, max(self._round, 1)
        for message in self._link.receive():
            if not isinstance(message, Hello):
                take(message, present)
        memory, told = self._replica.memory, self._told
        if self._round == 0:
            heard = _speak(self._link, self._unheard)
            self._unheard -= heard
            self._found += [(pid, 0) for pid in heard]
        if memory is not None:
            for pid, held in enumerate(memory.held):
                if held > told[pid]:
                    if pid != self._pid:
                        self._found += [(pid, round_) for round_ in range(told[pid] + 1, held + 1)]
                    told[pid] = held

    def _apply(self) -> None:
        """What has come may complete the round, or change who counts."""
        replica, round_ = self._replica, self._round
        if replica.returns != self._returns:
            self._come_back()
        memory = replica.memory
        if self._open:
            current = self._current()
            if current or self._clock.now() >= self._moment(PUBLISH * SLOTS) - 1e-9:
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
            self._wake = -math.inf  # to be found anew
            replica.confirm(round_)

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

    def _poll(self) -> None:
        """What is due at the slots of a round; the last round's go on until nothing is missing."""
        now = self._clock.now()
        if now < self._wake or self._round == 0:
            return
        slots = (now - self._start - (self._round - 1) * self._delta) / self._delta * SLOTS
        slot = math.floor(slots + 1e-6)
        fresh = slot > self._slot
        if fresh:
            self._slot = slot
            self._replica.poll((self._round - 1) * SLOTS + slot, self._round)
        self._ask(slot, fresh, timely=slots < slot + PUNCTUAL)

    def _ask(self, slot: int, fresh: bool, timely: bool) -> None:
        """Ask for what should have come by now, and find when there is something to do again."""
        replica, memory, round_ = self._replica, self._replica.memory, self._round
        following = self._moment(slot + 1)
        if self._open:
            following = min(following, self._moment(PUBLISH * SLOTS))
        if memory is None:
            self._wake = following
            return
        through = round_ if slot >= FIRST_SLOT else round_ - 1
        missing = [p for p in memory.missing(through) if p != self._pid]
        if fresh:
            self._patience.wakes(round_, timely)
        if fresh and missing and self._patience.asks(round_, timely):
            replica.ask(missing, [], through)
        if missing or replica.busy or self._open:
            self._wake = following
        elif not self._complete:
            self._wake = max(following, self._moment(FIRST_SLOT))
        else:
            replica.complete(round_)
            self._wake = math.inf

    def _moment(self, slot: float) -> float:
        """The time of a slot of the present round."""
        return self._start + (self._round - 1 + slot / SLOTS) * self._delta
