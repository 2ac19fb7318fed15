"""Joining protocol: from process start to round 1.

Every period, each robot sends a Hello to each other robot. A Hello contains the sender's boot id, the result of its
`init`, and the pids of the robots whose results it holds. A boot is adopted only if its Hello answers a challenge that
was issued after the last adoption. So a replayed Hello of an earlier boot is never accepted. A robot that holds all
results announces the epoch, a digest of all boot ids. Once all robots announce the same epoch, robot 0 proposes the
start of round 1, and every robot passes the start on.

A robot whose process died during a mission rejoins with the persisted epoch and without an `init`. Robots in that
mission adopt its new boot and send it the start of round 1. If all robots are present and none is in that mission, the
mission is lost, and a new mission begins."""

from __future__ import annotations

import random
from collections import deque
from dataclasses import dataclass
from hashlib import blake2s

from koordgen.runtime.net.codec import epoch_of
from koordgen.runtime.net.layout import Layout
from koordgen.runtime.net.link import Link
from koordgen.runtime.net.wire import Entry, Hello

PERIOD = 0.2  # seconds between two Hellos to the same robot
FEW = 32  # largest fleet with this period; the period of a larger fleet is longer in proportion, to limit the load
LEAD = 5  # periods from the proposal of the start to round 1; meanwhile Hellos of several robots spread the proposal

# Reason why datagrams are dropped -> explanation for users why a robot is not heard although its datagrams arrive.
_UNHEARD = {
    "not authentic": "datagrams arrive that were sealed with another key than this robot's",
    "another application": "datagrams arrive with another application_id than this robot's",
    "another format version": "datagrams arrive from the bundle of another koordgen version",
    "another interface": "a robot runs another program",
    "another program": "a robot runs another program",
    "another release": "a robot runs another release of this program",
}
LONGEST_LEAD = 60.0  # seconds; a start of round 1 that is further in the future is not accepted


@dataclass(slots=True)
class _Other:
    """Facts that this robot knows about another robot's present boot."""

    adoptions: int = 0
    challenge: bytes = b""  # challenge of the other robot, which this robot must answer
    init: Entry | None = None
    epoch: bytes = b""
    holds: tuple[int, ...] = ()
    idle: bool = False  # the other robot is in no mission
    inside: bool = False  # the other robot is in this robot's mission
    elsewhere: bool = False  # the other robot is in a mission without this robot's boot


@dataclass(frozen=True, slots=True)
class AgreedMission:
    """Agreed mission: epoch, fleet time of round 1 (s), and the round-0 entries of all robots by pid."""

    epoch: bytes
    start: float
    inits: tuple[Entry, ...]


class Joining:
    """Joining protocol of one robot. It stays active during the mission, and answers robots that restart."""

    def __init__(self, link: Link, layout: Layout, names: tuple[str, ...]) -> None:
        self._link = link
        self._layout = layout
        self._names = names
        self._pid = link.pid
        self._others = {p: _Other() for p in range(len(names)) if p != link.pid}
        self._init: Entry | None = None
        self._start: float | None = None
        self._next = 0.0
        self._period = PERIOD * max(1.0, len(names) / FEW)
        self._returning = False
        # Epochs of the missions that other robots may have begun with this robot's present boot.
        self._announced: deque[bytes] = deque(maxlen=8)
        self.met = True  # True if every robot knows this robot's boot
        self._restarted: set[int] = set()  # robots that restarted without their state during the mission
        self._untold = False  # True if `began_anew` has yet to report some of the restarted robots

        # Hellos that may be replays: the robots that were answered in this period, and for each robot the number of its
        # further Hellos in this period and the challenge of one of these Hellos.
        self._answered: set[int] = set()
        self._unanswered: dict[int, tuple[int, bytes]] = {}
        self._random = random.Random(link.boot)  # seeded by the boot id, so that simulations are repeatable

    def come_back(self, epoch: bytes) -> None:
        """Rejoin the mission with this epoch, during which this robot's process died."""
        self._returning = True
        self.met = False
        self._link.epoch = epoch

    def began_anew(self) -> str:
        """Return the names of the robots that restarted without state during the mission.

        Return "" if no such robot was found since the last call.
        """
        untold, self._untold = self._untold, False
        return ", ".join(self._names[p] for p in sorted(self._restarted)) if untold else ""

    @property
    def lost(self) -> bool:
        """True if no robot is in the mission that this robot wants to rejoin."""
        return self._returning and self._start is None and all(o.idle for o in self._others.values())

    @property
    def inside(self) -> list[int]:
        """Pids of the robots in the mission that this robot rejoins."""
        return [p for p, o in self._others.items() if o.inside] if self._returning else []

    @property
    def returned(self) -> float | None:
        """Fleet time (s) of round 1 in the mission that this robot rejoins; None if unknown or no rejoin."""
        return self._start if self._returning else None

    def ready(self, init: Entry) -> None:
        """Record the result of this robot's `init`. The robot joins a new mission with this result."""
        self._init = init
        if self._returning:
            self._returning = False
            self._link.epoch = b""
        self._agree()

    @property
    def mission(self) -> AgreedMission | None:
        """Mission that all robots have agreed on; None while the start is unknown or this robot rejoins."""
        inits = self._inits()
        if self._start is None or inits is None or self._returning:
            return None
        return AgreedMission(self._link.epoch, self._start, inits)

    def poll(self, now: float, fleet: float | None) -> float:
        """Send the Hellos that are due at local time `now`. Return the local time at which to call again.

        fleet: present fleet time in seconds; None if unknown.
        """
        if self._start is not None:
            return self.meet(now)
        agreed = self._link.epoch and all(o.epoch == self._link.epoch for o in self._others.values())
        if agreed and self._pid == 0 and fleet is not None:
            self._start = round((fleet + LEAD * self._period) * 1e6) / 1e6
            self._next = now
        if now >= self._next:
            self._next = now + self._period
            self._answer_more()
            self.send_hellos()
        return self._next

    def meet(self, now: float) -> float:
        """Send the Hellos that are due during the mission. Return the local time at which to call again.

        Receivers are robots whose boot is unknown, or all robots while some may not know this robot's boot."""
        if now >= self._next:
            self._next = now + self._period
            self._answer_more()
            for pid in self._link.strangers if self.met else self._others:
                self._hello(pid, self._others[pid].challenge)
            self._link.strangers.clear()
        return self._next

    def send_hellos(self) -> None:
        """Send a Hello to every other robot."""
        for pid, other in self._others.items():
            self._hello(pid, other.challenge)

    def receive(self, hello: Hello, fleet: float | None) -> None:
        """Handle a Hello that the link has accepted. `fleet`: present fleet time (s); None if unknown."""
        pid = hello.head.pid
        other = self._others[pid]
        if not self._link.is_adopted(hello):
            if hello.answer != self._challenge(pid):
                self._answer(pid, hello.challenge)  # the sender must first prove that it is live
                return
            same_mission = hello.head.epoch == self._link.epoch
            if self._start is not None and not same_mission:
                self._untold = self._untold or pid not in self._restarted
                self._restarted.add(pid)
                self._answer(pid, hello.challenge)
                return
            self._link.adopt(hello)
            other = self._others[pid] = _Other(adoptions=other.adoptions + 1)
            if self._start is None and not self._returning:
                self._link.epoch = b""
        other.challenge = hello.challenge
        if self._start is not None:
            # Answer a sender that does not know the start yet, or does not know this robot's boot.
            if hello.start is None or hello.answer != self._challenge(pid):
                self._hello(pid, other.challenge)
            return
        if self._returning:
            self._learn(other, hello, fleet)
            return
        init = hello.init
        if init is not None and (init.author != pid or init.round != 0 or self._layout.read(init) is None):
            self._link.reject("init result does not fit")
            return
        other.init = init
        other.epoch = hello.head.epoch
        other.holds = hello.holds
        self._agree()
        self._learn(other, hello, fleet)

    def _learn(self, other: _Other, hello: Hello, fleet: float | None) -> None:
        """Record from a Hello whether its sender is in this robot's mission, and when the mission starts."""
        epoch = hello.head.epoch
        if hello.start is not None and epoch != self._link.epoch and epoch in self._announced:
            self.come_back(epoch)  # the mission had begun before another robot restarted
        other.idle = hello.start is None
        other.elsewhere = hello.start is not None and epoch != self._link.epoch
        other.inside = hello.start is not None and not other.elsewhere
        if hello.start is not None and self._link.epoch and not other.elsewhere:
            start = hello.start / 1e6
            if fleet is not None and start - fleet <= LONGEST_LEAD:
                self._start = start
                self.send_hellos()

    @property
    def alone(self) -> str:
        """Reason why this robot must not move yet; "" if it may move.

        A robot that joins a new mission may move once it has heard all robots and none of them is in another mission. A
        robot that rejoins may move once it has heard one robot of its mission."""
        return "" if self.inside else "; ".join(self._absent())

    def _absent(self) -> list[str]:
        silent = [self._names[p] for p in self._others if p not in self._link.sessions]
        elsewhere = [self._names[p] for p, o in self._others.items() if o.elsewhere]
        parts = []
        if elsewhere:
            parts.append(f"{', '.join(elsewhere)} in a mission that began before this start: end that mission first")
        if silent:
            reasons = dict.fromkeys(text for reason, text in _UNHEARD.items() if self._link.rejected.get(reason))
            why = f" ({'; '.join(reasons)})" if reasons else ""
            parts.append(f"waiting for {', '.join(silent)}, not heard yet{why}")
        return parts

    def waiting(self) -> str:
        """Return the reason why this robot waits, as text; "" once the start of the mission is known."""
        if self._start is not None:
            return ""
        absent = self._absent()
        unready = [self._names[p] for p, o in self._others.items() if p in self._link.sessions and o.init is None]
        deaf = [self._names[p] for p, o in self._others.items() if o.init is not None and not o.epoch]
        parts = ["rejoining the mission"] if self._returning else []
        parts += absent
        if unready and not self._returning:
            parts.append(f"waiting for {', '.join(unready)} to get ready")
        if deaf and not self._returning and not absent and not unready:
            parts.append(f"waiting until {', '.join(deaf)} have heard all robots")
        return "; ".join(parts) or "waiting for the start of round 1"

    def _answer(self, pid: int, challenge: bytes) -> None:
        """Answer a Hello that may be a replay: at most once per period and robot.

        If more Hellos arrive in the period, a random one of them is answered in the next period. So an attacker who
        replays many Hellos cannot prevent forever that the robot's own Hello is answered."""
        if pid not in self._answered:
            self._answered.add(pid)
            self._hello(pid, challenge)
            return
        count, drawn = self._unanswered.get(pid, (0, challenge))
        if challenge != drawn:
            count += 1
            drawn = challenge if self._random.randrange(count + 1) == 0 else drawn
        self._unanswered[pid] = count, drawn

    def _answer_more(self) -> None:
        """Answer the Hellos that were chosen at random in the last period. Called once in each period."""
        self._answered = set(self._unanswered)
        for pid, (_, challenge) in self._unanswered.items():
            self._hello(pid, challenge)
        self._unanswered = {}

    def _hello(self, to: int, answer: bytes) -> None:
        holds = tuple(p for p, o in sorted(self._others.items()) if o.init is not None)
        start = None if self._start is None else round(self._start * 1e6)
        self._link.sender.hello(to, self._challenge(to), answer, holds, self._init, start)

    def _challenge(self, pid: int) -> bytes:
        """Return the challenge that robot `pid` must answer.

        The challenge changes with each adopted boot of that robot and with each boot of this robot, so a replayed
        answer is always wrong."""
        text = self._link.boot + bytes([pid]) + self._others[pid].adoptions.to_bytes(4, "big")
        return blake2s(text, digest_size=8, person=b"k-hello").digest()

    def _inits(self) -> tuple[Entry, ...] | None:
        inits = {p: o.init for p, o in self._others.items()} | {self._pid: self._init}
        held = tuple(init for _, init in sorted(inits.items()) if init is not None)
        return held if len(held) == len(inits) else None

    def _agree(self) -> None:
        if self._start is None and self._inits() is not None:
            boots = {p: s.boot for p, s in self._link.sessions.items()} | {self._pid: self._link.boot}
            self._link.epoch = epoch_of([boots[p] for p in sorted(boots)])
            if self._link.epoch not in self._announced:
                self._announced.append(self._link.epoch)
