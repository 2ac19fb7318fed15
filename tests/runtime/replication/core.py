"""Adapter of the scenarios: the present protocol core of a few robots, with time, network and disk in a test's hands.

This is the only module of the scenarios that knows the core's classes and message classes. A core that is written anew
needs another `Fleet` with the same methods, and the scripts stay as they are.

Time comes in slots, TICKS in a round. Robots number from 0. Every message that a robot sends is checked at once against
what this robot has saved, and every store against those of the other robots.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

from koordgen.runtime.agent.instance import AgentInstance
from koordgen.runtime.agent.rounds import Lost, Rounds
from koordgen.runtime.net.layout import Layout
from koordgen.runtime.net.wire import (
    Accept,
    Accepted,
    Decided,
    Entry,
    Nack,
    Prepare,
    Promise,
    RejoinRequest,
    RoundMessage,
    SnapshotFragment,
    View,
)
from koordgen.runtime.program.program import Effects, Life, Variable
from koordgen.runtime.program.runner import EventResult
from koordgen.runtime.replication.driver import Driver
from koordgen.runtime.replication.messages import HardState, Vote
from koordgen.runtime.replication.replica import TICKS as TICKS  # the runner imports it from here
from koordgen.runtime.replication.replica import Replica
from koordgen.runtime.replication.state_machine import StateMachine
from koordgen.runtime.values.bounds import Fixed
from tests.model.lab import SENSED, Body, Flight, Kept, Wire

# Kinds of messages by role. `entries`: log entries of rounds, with a progress report; `report`: the report alone.
KINDS = (
    *("entries", "report", "nack"),
    *("prepare", "promise", "accept", "accepted", "decided"),
    *("join", "state-request", "state"),
)
VARIABLES = (
    Variable("x", "allread", int, Fixed(9), lambda: 0),  # a robot's plain events, unless the script says another value
    Variable("wins", "allread", int, Fixed(9), lambda: 0),  # a robot's transactions that counted
    Variable("count", "allwrite", int, Fixed(9), lambda: 0),  # all transactions that counted
    Variable("last", "allwrite", int, Fixed(9), lambda: -1),
)
STORE = tuple(v.name for v in VARIABLES)
FIRST = {"events": 0, "wins": 0}


class Violation(Exception):
    """An invariant of the protocol does not hold."""


@dataclass(frozen=True, slots=True)
class Event:
    """A robot's event. `lock` is -1 for a plain event; `once`: only the first round that can run it does."""

    lock: int = -1
    output: bool = True
    stop: bool = False
    once: bool = False
    writes: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Members:
    """A view: its number, the robots that count in it, and its first round."""

    number: int
    robots: frozenset[int]
    since: int


@dataclass(frozen=True, slots=True)
class Sent:
    """A message on its way; `text` says what is in it."""

    sender: int
    to: int
    kind: str
    text: str
    flight: Flight


class _Program:
    """Stands in for Runner: runs the event that the script has set."""

    def __init__(self, pid: int, locals_: Mapping[str, Any], events: list[Event | None]) -> None:
        self.locals = locals_
        self._pid, self._events = pid, events

    def frame(self, shared: Mapping[str, Any], *_: object) -> Any:
        return SimpleNamespace(shared=shared, sensors={})

    def step(self, frame: Any, deadline: float) -> EventResult:
        event = self._events[self._pid]
        if event is None:
            return EventResult()
        if event.once:
            self._events[self._pid] = None
        number, wins = self.locals["events"] + 1, self.locals["wins"]
        shared = {"x": number}
        if event.lock == 0:
            wins += 1
            shared |= {"wins": wins, "count": frame.shared["count"] + 1}
        actuators = {"out": number} if event.output else {}
        effects = Effects({"events": number, "wins": wins}, {**shared, **event.writes}, actuators, event.stop)
        return EventResult("event", effects, lock=event.lock)


class _Body(Body):
    """Remembers for which reasons the robot holds its position."""

    def __init__(self, commanded: Callable[[int], None]) -> None:
        super().__init__(commanded)
        self.reasons: set[str] = set()

    def hold(self, reason: str, on: bool, now: float) -> bool:
        (self.reasons.add if on else self.reasons.discard)(reason)
        return False


class _Link(Wire):
    """Checks each message, when it is sent, against what its sender has saved."""

    def __init__(self, pid: int, n: int, flights: list[Flight], kept: Kept, room: int) -> None:
        super().__init__(pid, n, flights)
        self.room = room
        self._kept = kept

    def send(self, to: Collection[int], kind: Callable[..., Any], *fields: Any) -> None:
        super().send(to, kind, *fields)
        self._check(len(to))

    def round(self, to: Collection[int], fields: Sequence[Any], received: object = None) -> None:
        super().round(to, fields, received)
        self._check(len(to))

    def _check(self, count: int) -> None:
        for flight in self._flights[len(self._flights) - count :]:
            if not self._saved(flight.message):
                raise Violation(f"robot {self.pid} has sent what it has not saved: {described(flight.message)}")

    def _saved(self, message: Any) -> bool:
        kept = self._kept
        match message:
            case RoundMessage(applied=applied, entries=entries):
                ran = [c.round for c in entries if c.author == self.pid and c.acted]
                return kept.applied >= applied and max(kept.lives) >= max(ran, default=0)
            case Nack(applied=applied):
                return kept.applied >= applied
            case Promise(number=number, ballot=ballot, applied=applied):
                return kept.vote.number == number and kept.vote.promised >= ballot and kept.applied >= applied
            case Accepted(number=number, ballot=ballot):
                return kept.vote.number == number and kept.vote.voted >= ballot
            case Decided(value=value):
                return kept.view.number >= value.number
        return True


def kind_of(message: Any) -> str:
    match message:
        case RoundMessage(entries=entries):
            return "entries" if entries else "report"
        case Nack():
            return "nack"
        case RejoinRequest(incarnation=incarnation):
            return "join" if incarnation < 0 else "state-request"
        case SnapshotFragment():
            return "state"
    return type(message).__name__.lower()


def described(message: Any) -> str:
    """What a message says."""
    match message:
        case RoundMessage(entries=entries, applied=applied):
            return " ".join([*map(_entry, entries), f"applied {applied}"])
        case Nack(through=through, applied=applied):
            return f"through {through} applied {applied}"
        case Prepare(view=view):
            return f"view {view.number + 1}"
        case Promise(number=number, applied=applied, has_store=state, accepted=accepted):
            voted = f" voted {_view(accepted)}" if accepted is not None else ""
            return f"view {number} applied {applied}{'' if state else ' without a store'}{voted}"
        case Accept(value=value) | Decided(value=value):
            return f"view {_view(value)}"
        case Accepted(number=number):
            return f"view {number}"
        case RejoinRequest(view=number):
            return f"view {number}"
        case SnapshotFragment(round=round_, index=index, count=count):
            return f"round {round_} part {index + 1} of {count}"
    raise AssertionError(message)


def _entry(entry: Entry) -> str:
    rounds = str(entry.round) if entry.first == entry.round else f"{entry.first}-{entry.round}"
    marks = "*" * entry.acted + f" lock {entry.lock}" * (entry.lock >= 0) + " stopped" * entry.stopped
    return f"{entry.author}@{rounds}{marks}"


def _view(view: View) -> str:
    members = ",".join(str(p) for p, m in enumerate(view.members) if m >= 0)
    return f"{view.number} {{{members}}} from {view.since}"


@dataclass(slots=True)
class _Robot:
    replica: Replica
    rounds: Rounds
    body: _Body
    flights: list[Flight]
    kept: Kept


class Fleet:
    """`timeout`: rounds without news of a member until there is another view. `room`: bytes of a message that the store
    goes in."""

    def __init__(self, n: int, timeout: int = 2, room: int = 1000) -> None:
        self.n = n
        self._timeout, self._room = timeout, room
        self._layout = Layout(VARIABLES, n)
        self._stores: dict[tuple[int, int], Mapping[str, Any]] = {}  # view number, round -> the store after it
        self._views: dict[int, View] = {}
        self._events: list[Event | None] = [None] * n
        self._commanded: list[list[int]] = [[] for _ in range(n)]
        inits = [Entry(p, 0, 0, 0) for p in range(n)]
        view = View(0, 1, (0,) * n)
        kept = [Kept(view, lives={0: Life(0, FIRST, {}, False)}) for _ in range(n)]
        states = [StateMachine.begin(self._layout, p, view, inits) for p in range(n)]
        self._robots = [self._start(p, kept[p], states[p]) for p in range(n)]

    def _start(self, pid: int, kept: Kept, state: StateMachine | None) -> _Robot:
        flights: list[Flight] = []
        link = _Link(pid, self.n, flights, kept, self._room)

        hard_state = HardState(kept.view, kept.applied, kept.vote)
        replica = Replica(pid, self._layout, state, hard_state, self._timeout, self._room)
        driver = Driver(replica, cast(Any, link), kept.persist, lambda private: kept.keep(private[0][0]))
        lives = [kept.lives[r] for r in sorted(kept.lives)]
        program, body = _Program(pid, lives[-1].locals, self._events), _Body(self._commanded[pid].append)
        clock = SimpleNamespace(read=lambda t: t, local=lambda t: t)
        instance = AgentInstance(cast(Any, program), pid, lambda: 0.0)
        instance.begin(lives)
        rounds = Rounds(
            [instance], cast(Any, body), driver, cast(Any, clock), tuple(f"r{p}" for p in range(self.n)), 0.0, 1.0,
            lambda record: None,
        )  # fmt: skip
        return _Robot(replica, rounds, body, flights, kept)

    # What a script does.

    def poll(self, pid: int, time: float) -> list[Sent]:
        """Let a robot do what is due at a time, in slots; returns what it has sent."""
        robot = self._robots[pid]
        try:
            robot.rounds.poll(time / TICKS, lambda t: SENSED, None)
        except Lost as lost:
            raise Violation(f"robot {pid} is lost: {lost}") from None
        self._check(pid)
        return self._drain(pid)

    def deliver(self, message: Sent) -> list[Sent]:
        """Hand a message to its receiver; returns what that has sent at once."""
        self._robots[message.to].rounds.receive([cast(Any, message.flight.message)])
        return self._drain(message.to)

    def restart(self, pid: int) -> None:
        """A new process of a robot, with what the last one has saved."""
        self._robots[pid] = self._start(pid, self._robots[pid].kept, None)

    def forget(self, pid: int) -> None:
        """A robot's disk loses what it has promised, voted for and said to have applied."""
        kept = self._robots[pid].kept
        kept.vote, kept.applied = Vote(), 0

    def leave(self, pid: int) -> None:
        self._robots[pid].rounds.leave()

    def set_event(self, pid: int, event: Event | None) -> None:
        self._events[pid] = event

    # What a script sees.

    def round(self, pid: int) -> int:
        return self._robots[pid].rounds.round

    def view(self, pid: int) -> Members:
        view = self._robots[pid].replica.views.view
        return Members(view.number, frozenset(p for p, m in enumerate(view.members) if m >= 0), view.since)

    def role(self, pid: int) -> str:
        """`member`: counts and has the store; `joining`: counts again, without it; `out`: does not count."""
        replica = self._robots[pid].replica
        if replica.state is not None:
            return "member"
        rejoin, view = replica.rejoin, replica.views.view
        return "joining" if rejoin is not None and rejoin.incarnation(view) >= 0 else "out"

    def is_frozen(self, pid: int) -> bool:
        """Whether a robot has promised to apply no further round until the next view is decided."""
        return self._robots[pid].replica.views.is_frozen

    def applied(self, pid: int) -> int | None:
        """The last round applied; None without a store."""
        state = self._robots[pid].replica.state
        return None if state is None else state.applied

    def settled(self, pid: int) -> int | None:
        """The last round that every member holds, as far as a robot knows; None without a store."""
        state = self._robots[pid].replica.state
        return None if state is None else state.settled

    def kept_rounds(self, pid: int) -> list[int]:
        """The rounds of the own entries that a robot keeps for others, without gaps between."""
        state = self._robots[pid].replica.state
        return [] if state is None else [c.round for c in state.own(1)]

    def store(self, pid: int) -> Mapping[str, Any] | None:
        state = self._robots[pid].replica.state
        return None if state is None else state.shared

    def is_stopped(self, pid: int) -> bool:
        return self._robots[pid].rounds.stopped

    def is_over(self, pid: int) -> bool:
        """Whether a robot's mission is over: all have stopped, and it has served on for long enough."""
        return self._robots[pid].rounds.over

    def outputs(self, pid: int) -> list[int]:
        """What a robot has commanded so far."""
        return self._commanded[pid]

    def skipped(self, pid: int) -> str | None:
        """Why the last round that a robot closed had no event; None: it had one, or none was enabled."""
        return self._robots[pid].rounds.reason

    def holding(self, pid: int) -> Collection[str]:
        """The reasons for which a robot holds its position."""
        return self._robots[pid].body.reasons

    def lost_contention(self, pid: int) -> int:
        """How many transactions of a robot another one's was preferred to."""
        return self._robots[pid].rounds.counters.lost_contention

    def _drain(self, pid: int) -> list[Sent]:
        flights = self._robots[pid].flights
        sent = [Sent(pid, f.to, kind_of(f.message), described(f.message), f) for f in flights]
        flights.clear()
        return sent

    def _check(self, pid: int) -> None:
        """Check the agreement on views, on stores and on transactions."""
        replica = self._robots[pid].replica
        view = replica.views.view
        if self._views.setdefault(view.number, view) != view:
            raise Violation(f"two views {view.number}: {_view(self._views[view.number])} and {_view(view)}")
        state = replica.state
        if state is None:
            return
        store, key = state.shared, (state.view.number, state.applied)
        if self._stores.setdefault(key, store) != store:
            raise Violation(f"two stores after round {state.applied}: {self._stores[key]} and {store} (robot {pid})")
        if store["count"] != sum(store["wins"]):
            raise Violation(f"robot {pid}: {store['count']} transactions counted of {store['wins']}")
