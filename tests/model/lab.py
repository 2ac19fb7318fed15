"""The real shared memory of a few robots (Rounds, Driver, Replica, Outbox) under a schedule that a test chooses.

No clock, no network, no disk: time is what the test says, messages lie in flight until the test delivers, repeats or
drops them, and what a robot keeps is a Kept. Every event of robot p sets its slot `mine[p]` to the number of its events
so far; every atomic one adds 1 to `count` and to its slot `wins[p]`. So what must hold can be read off every store.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

from koordgen.runtime.agent.instance import AgentInstance
from koordgen.runtime.agent.records import KEPT
from koordgen.runtime.agent.rounds import Lost, Rounds
from koordgen.runtime.net.layout import Layout
from koordgen.runtime.net.metrics import Metrics
from koordgen.runtime.net.wire import Decided, Entry, Head, Message, RoundMessage, View
from koordgen.runtime.program.program import Effects, Life, Variable
from koordgen.runtime.program.runner import EventResult
from koordgen.runtime.replication.driver import Driver
from koordgen.runtime.replication.messages import HardState, Vote
from koordgen.runtime.replication.replica import Replica
from koordgen.runtime.replication.state_machine import StateMachine
from koordgen.runtime.trace.writer import RoundRecord
from koordgen.runtime.values.bounds import Fixed
from koordgen.runtime.vehicle.platform import Sensed

TOKEN = bytes(8)
SENSED = Sensed({}, None)
TIMEOUT = 2  # rounds without news of a member, then there is another view
FIRST = {"events": 0, "wins": 0}  # locals
VARIABLES = (
    Variable("count", "allwrite", int, Fixed(9), lambda: 0),
    Variable("mine", "allread", int, Fixed(9), lambda: 0),
    Variable("wins", "allread", int, Fixed(9), lambda: 0),
)


_round: Callable[..., Message] = RoundMessage


class Violation(Exception):
    """A property does not hold; the message says which and how."""


@dataclass
class Kept:
    """What a robot finds again after a restart."""

    view: View
    applied: int = 0
    vote: Vote = field(default_factory=Vote)
    lives: dict[int, Life] = field(default_factory=dict)

    def keep(self, life: Life) -> None:
        """As in the file, the lives written last stay, not those of the last rounds: a robot that loses contention
        writes the one of its last event again."""
        self.lives.pop(life.round, None)
        self.lives[life.round] = life
        for old in list(self.lives)[:-KEPT]:
            del self.lives[old]

    def persist(self, state: HardState) -> None:
        self.view, self.applied, self.vote = state.view, state.applied, state.vote


@dataclass
class Flight:
    to: int
    message: Message


class Wire:
    """Stands in for Link: every message is in flight until the test takes it."""

    room = 1000

    def __init__(self, pid: int, n: int, flights: list[Flight]) -> None:
        self.pid = pid
        self.metrics = Metrics(pid, n)
        self._flights = flights
        self.head = Head(0, TOKEN, TOKEN, pid, TOKEN, TOKEN, 0, 0, None, ())
        self.rejected: list[str] = []
        self.sender = self

    def send(self, to: Collection[int], kind: Callable[..., Message], *fields: Any) -> None:
        self._flights.extend(Flight(p, kind(self.head, *fields)) for p in to)

    def round(self, to: Collection[int], fields: Sequence[Any], received: object = None) -> None:
        self._flights.extend(Flight(p, _round(self.head, *fields)) for p in to)

    def reject(self, reason: str) -> None:
        self.rejected.append(reason)


class Program:
    """Stands in for Runner. `wish` is the next event: "" (none), "plain", "quiet" (without output) or "atomic"."""

    def __init__(self, pid: int, wish: Callable[[], str]) -> None:
        self.locals: Mapping[str, int] = FIRST
        self._pid = pid
        self._wish = wish

    def frame(self, shared: Mapping[str, Any], *_: object) -> Any:
        return SimpleNamespace(shared=shared, sensors={})

    def step(self, frame: Any, deadline: float) -> EventResult:
        wish = self._wish()
        if not wish:
            return EventResult()
        number, wins, atomic = self.locals["events"] + 1, self.locals["wins"], wish == "atomic"
        shared = {"mine": number}
        if atomic:
            wins += 1
            shared |= {"wins": wins, "count": frame.shared["count"] + 1}
        actuators = {} if wish == "quiet" else {"out": number}
        effects = Effects({"events": number, "wins": wins}, shared, actuators, False)
        return EventResult(wish, effects, lock=0 if atomic else -1)


class Body:
    """`command` is where the robot would move."""

    def __init__(self, commanded: Callable[[int], None]) -> None:
        self.actuators: dict[str, int] = {}
        self._commanded = commanded

    def others(self, shared: Mapping[str, Any]) -> None:
        """No planner here."""

    def command(self, written: Mapping[str, int], now: float) -> None:
        self.actuators = {**self.actuators, **written}
        if "out" in written:
            self._commanded(written["out"])

    def restore(self, actuators: Mapping[str, int], now: float) -> None:
        self.actuators = dict(actuators)

    def hold(self, reason: str, on: bool, now: float) -> bool:
        return False

    def sensors(self, sensed: object) -> dict[str, Any]:
        return {}

    def calls(self) -> tuple[Any, ...]:
        return ()

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        raise AssertionError


@dataclass
class Robot:
    replica: Replica
    driver: Driver
    rounds: Rounds
    program: Program
    wire: Wire
    kept: Kept

    @property
    def state(self) -> StateMachine | None:
        return self.replica.state

    def adopt(self, view: View) -> None:
        """Let the robot know a decided view."""
        self.replica.views.adopt(view)
        self.driver.flush()


@dataclass
class Final:
    """An event of robot `pid` that has taken effect outside: the fleet must count it for ever."""

    pid: int
    number: int
    round: int


class Fleet:
    """`wish(pid)` is what a robot's next event is. Each `poll` checks P1 to P5 (see tests/model/README or the docs)."""

    def __init__(self, n: int = 3, wish: Callable[[int], str] = lambda pid: "") -> None:
        self.n = n
        self.flights: list[Flight] = []
        self.layout = Layout(VARIABLES, n)
        self.views: dict[int, View] = {0: View(0, 1, (0,) * n)}  # decided, as far as any robot knows
        self.finals: list[Final] = []
        self.stores: dict[tuple[int, int], Mapping[str, Any]] = {}  # view number, round -> the store after it
        self._wish = wish
        self._outputs: list[list[int]] = [[] for _ in range(n)]
        kept = [Kept(self.views[0], lives={0: Life(0, FIRST, {}, False)}) for _ in range(n)]
        inits = [Entry(p, 0, 0, 0) for p in range(n)]
        self.robots = [
            self._start(p, kept[p], StateMachine.begin(self.layout, p, self.views[0], inits)) for p in range(n)
        ]

    def _start(self, pid: int, kept: Kept, state: StateMachine | None) -> Robot:
        wire = Wire(pid, self.n, self.flights)

        hard_state = HardState(kept.view, kept.applied, kept.vote)
        replica = Replica(pid, self.layout, state, hard_state, TIMEOUT, wire.room)
        driver = Driver(replica, cast(Any, wire), kept.persist, lambda private: kept.keep(private[0][0]))
        program = Program(pid, lambda: self._wish(pid))
        lives = [kept.lives[r] for r in sorted(kept.lives)]
        program.locals = cast(Mapping[str, int], lives[-1].locals)
        body = Body(self._outputs[pid].append)
        clock = SimpleNamespace(read=lambda t: t, local=lambda t: t)
        instance = AgentInstance(cast(Any, program), pid, lambda: 0.0)
        instance.begin(lives)
        rounds = Rounds(
            [instance], cast(Any, body), driver, cast(Any, clock), tuple(f"r{p}" for p in range(self.n)), 0.0, 1.0,
            lambda record: self._final(pid, record),
        )  # fmt: skip
        return Robot(replica, driver, rounds, program, wire, kept)

    def restart(self, pid: int) -> None:
        """The robot's process dies and there is another."""
        self.robots[pid] = self._start(pid, self.robots[pid].kept, None)

    def poll(self, pid: int, now: float) -> None:
        """What robot `pid` does at time `now`, in rounds from the beginning of round 1."""
        try:
            self.robots[pid].rounds.poll(now, lambda t: SENSED, None)
        except Lost as lost:
            raise Violation(f"P4: robot {pid}: {lost}") from None
        self._check(pid)

    def deliver(self, flight: Flight) -> None:
        self.robots[flight.to].rounds.receive([cast(Any, flight.message)])
        if isinstance(flight.message, Decided):
            self._know(flight.message.value)

    def take(self, wanted: Callable[[Flight], bool]) -> list[Flight]:
        """Take from what is in flight."""
        found = [f for f in self.flights if wanted(f)]
        self.flights[:] = [f for f in self.flights if not wanted(f)]
        return found

    def to(self, pid: int, but: Collection[int] = ()) -> list[Flight]:
        """Take what is on its way to a robot, from all but these."""
        return self.take(lambda f: f.to == pid and f.message.head.pid not in but)

    def official(self, view: int, round_: int) -> bool:
        """Whether the store after a round, of a robot that went by this view, is what every later view goes on from."""
        return all(v.since > round_ for v in self.views.values() if v.number > view)

    def _know(self, view: View) -> None:
        known = self.views.get(view.number)
        if known is not None:
            if known != view:
                raise Violation(f"P5: two views {view.number}: {known} and {view}")
            return
        self.views[view.number] = view
        for (number, round_), store in self.stores.items():
            if self.official(number, round_):
                self._covered(store, round_, f"the store after round {round_}")
        for final in self.finals:
            self._counted(final)

    def _final(self, pid: int, record: RoundRecord) -> None:
        if record.effects is not None:
            final = Final(pid, cast(int, record.effects.locals["events"]), record.round)
            twice = [f for f in self.finals if (f.pid, f.number) == (pid, final.number) and f.round != record.round]
            if twice:
                raise Violation(
                    f"P4: event {final.number} of robot {pid} took effect in rounds {twice[0].round} and {record.round}"
                )
            self.finals.append(final)
            self._counted(final)

    def _counted(self, final: Final) -> None:
        for (number, round_), store in self.stores.items():
            if round_ >= final.round and self.official(number, round_) and store["mine"][final.pid] < final.number:
                raise Violation(f"P3: {final} is not in the store after round {round_} (view {number})")

    def _covered(self, store: Mapping[str, Any], round_: int, where: str) -> None:
        for final in self.finals:
            if round_ >= final.round and store["mine"][final.pid] < final.number:
                raise Violation(f"P3: {final} is not in {where}")

    def _check(self, pid: int) -> None:
        state = self.robots[pid].state
        self._know(self.robots[pid].replica.views.view)
        if state is None:
            return
        store, round_, number = state.shared, state.applied, state.view.number
        if not self.official(number, round_):
            return  # a robot that has not heard of a view may mix entries of both; nothing of that is ever committed
        if store["count"] != sum(store["wins"]):
            raise Violation(f"P1: {store['count']} commits counted of {store['wins']}, robot {pid}, round {round_}")
        for (other, at), known in self.stores.items():
            if at == round_ and self.official(other, at) and known != store:
                raise Violation(f"P2: round {round_}: robot {pid} has {store}, view {other} had {known}")
        if (number, round_) not in self.stores:
            self.stores[number, round_] = store
            self._covered(store, round_, f"robot {pid}'s store after round {round_}")
