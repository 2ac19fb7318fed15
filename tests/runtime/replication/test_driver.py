"""Driver: a robot persists before it sends, and before anything counts as committed, under any schedule."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from koordgen.runtime.net.wire import Accepted, Decided, Nack, Promise, RoundMessage
from koordgen.runtime.replication.driver import Driver
from koordgen.runtime.replication.messages import HardState, Vote
from koordgen.runtime.replication.replica import TICKS, Replica
from koordgen.runtime.replication.state_machine import StateMachine
from tests.runtime.replication.states import fleet, head, layout, silent, view

N, PEER_TIMEOUT = 3, 2
START = HardState(view(N), 0, Vote())


class Disk:
    """Everything that a robot has persisted. `delay`: calls after which a hard state is on disk; a fault if not 0."""

    def __init__(self, delay: int = 0) -> None:
        self.hard_state, self.events = START, [0]
        self.calls: list[str] = []
        self._delay, self._waiting = delay, list[HardState]()

    def persist(self, state: HardState) -> None:
        self.calls.append("persist")
        self._waiting.append(state)
        if len(self._waiting) > self._delay:
            self.hard_state = self._waiting.pop(0)

    def persist_private(self, round_: int) -> None:
        self.calls.append("persist private")
        self.events.append(round_)


class FakeLink:
    """Checks each message, when it is sent, against the disk of its sender."""

    def __init__(self, pid: int, disk: Disk, sent: list[tuple[int, Any]]) -> None:
        self.pid, self._disk, self._sent = pid, disk, sent
        self.sender = self
        self.metrics = SimpleNamespace(repeated=lambda pid: None)
        self.rejected: list[str] = []

    def reject(self, reason: str) -> None:
        self.rejected.append(reason)

    def send(self, to: Collection[int], kind: Callable[..., Any], *fields: Any) -> None:
        self._send(to, kind(head(self.pid), *fields))

    def round(self, to: Collection[int], fields: Sequence[Any], received: object) -> None:
        self._send(to, cast(Any, RoundMessage)(head(self.pid), *fields))

    def _send(self, to: Collection[int], message: Any) -> None:
        assert self.is_persisted(message), f"robot {self.pid} sends what a restart could make untrue: {message}"
        self._disk.calls.append("send")
        self._sent += [(pid, message) for pid in to]

    def is_persisted(self, message: Any) -> bool:
        kept = self._disk.hard_state
        known_view, applied, vote = kept.view, kept.applied, kept.vote
        match message:
            case RoundMessage():
                ran = [e.round for e in message.entries if e.author == self.pid and e.acted]
                return (
                    known_view.number >= message.view and applied >= message.applied and {*ran} <= {*self._disk.events}
                )
            case Nack():
                return known_view.number >= message.view and applied >= message.applied
            case Promise():
                return (vote.number, vote.promised) >= (message.number, message.ballot) and applied >= message.applied
            case Accepted():
                return vote.number == message.number and vote.voted >= message.ballot
            case Decided():
                return known_view.number >= message.value.number
        return True


class Robots:
    """Robots under a random schedule: messages are lost, repeated and reordered, and processes die."""

    def __init__(self, seed: int, delay: int = 0) -> None:
        self.rng = Random(seed)
        self.disks = [Disk(delay) for _ in range(N)]
        self.sent: list[tuple[int, Any]] = []
        self.drivers = [self.driver(pid, state) for pid, state in enumerate(fleet(N))]
        self.tick, self.proposed, self.committed = 0, [0] * N, 0

    def driver(self, pid: int, state: StateMachine | None) -> Driver:
        disk = self.disks[pid]
        replica = Replica(pid, layout(N), state, disk.hard_state, PEER_TIMEOUT, 1000)
        link = FakeLink(pid, disk, self.sent)
        return Driver(replica, cast(Any, link), disk.persist, disk.persist_private)

    def run(self, steps: int) -> None:
        for _ in range(steps):
            pid = self.rng.randrange(N)
            match self.rng.randrange(20):
                case 0:
                    self.tick += 1
                case 1 | 2 | 3:
                    self.drivers[pid].tick(self.tick)
                case 4 | 5 | 6:
                    self.propose(pid)
                case 7:
                    replica = self.drivers[pid].replica
                    replica.request(self.tick % TICKS, True, None)
                    replica.acknowledge(self.tick // TICKS + 1)
                    self.drivers[pid].flush()
                case 8 if self.rng.random() < 0.05:
                    self.drivers[pid] = self.driver(pid, None)
                case _:
                    self.deliver()
            self.check()

    def propose(self, pid: int) -> None:
        round_, driver = self.tick // TICKS + 1, self.drivers[pid]
        if round_ <= max(self.proposed[pid], driver.replica.published):
            return
        self.proposed[pid] = round_
        state = driver.replica.state
        acts = state is not None and state.applied == round_ - 1 and not state.is_frozen and self.rng.random() < 0.7
        shared: Mapping[str, Any] = {"x": round_} if acts else {}
        driver.replica.propose(round_, shared, stopped=False, acted=acts, private=round_ if acts else None)
        driver.run()

    def deliver(self) -> None:
        if self.sent:
            pid, message = self.sent.pop(self.rng.randrange(min(5, len(self.sent))))
            for _ in range(self.rng.choice((0, 1, 1, 1, 1, 1, 1, 1, 1, 2))):
                self.drivers[pid].receive([message])

    def check(self) -> None:
        """Nothing counts as committed on a robot that could not tell after a restart that it had applied it."""
        for driver, disk in zip(self.drivers, self.disks, strict=True):
            state = driver.replica.state
            if state is not None:
                assert state.committed <= disk.hard_state.applied, "committed before it was persisted"
                self.committed = max(self.committed, state.committed)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32))
def test_a_robot_persists_before_it_sends_and_before_a_round_is_committed(seed: int) -> None:
    Robots(seed).run(800)


def test_these_schedules_get_somewhere() -> None:
    """Show that rounds are committed, that views change, and that robots come back in them."""
    committed, views, returns = 0, 0, 0
    for seed in range(20):
        robots = Robots(seed)
        robots.run(3000)
        committed += robots.committed
        views += max(d.replica.views.view.number for d in robots.drivers)
        returns += sum(d.replica.store_changes for d in robots.drivers)
    assert committed > 200 and views > 20 and returns > 20, (committed, views, returns)


def test_a_driver_that_persists_too_late_is_noticed() -> None:
    """Show that the test above sees such a fault."""
    with pytest.raises(AssertionError, match=r"a restart could make untrue|before it was persisted"):
        for seed in range(20):
            Robots(seed, delay=1).run(800)


def test_private_variables_are_persisted_first_then_the_hard_state_then_messages_leave() -> None:
    robots = Robots(0)
    driver, disk = robots.drivers[0], robots.disks[0]
    driver.replica.propose(1, {"x": 1}, stopped=False, acted=True, private=1)
    driver.run()
    assert disk.calls == ["persist private", "send"]
    disk.calls.clear()
    driver.receive([RoundMessage(head(pid), 0, 1, 0, 0, False, (), (silent(pid, 1, 1),)) for pid in (1, 2)])
    assert disk.calls == ["persist"] and disk.hard_state.applied == 1
    disk.calls.clear()
    driver.flush()
    assert disk.calls == [], "there is nothing to do twice"


def test_an_entry_leaves_before_the_rounds_that_it_completes_are_applied() -> None:
    """Other robots may wait for it alone."""
    robots = Robots(0)
    driver, disk = robots.drivers[0], robots.disks[0]
    driver.receive([RoundMessage(head(pid), 0, 1, 0, 0, False, (), (silent(pid, 1, 1),)) for pid in (1, 2)])
    driver.replica.propose(1, {}, stopped=False)
    driver.run()
    assert disk.calls == ["send", "persist"]
    [(_, message), _] = robots.sent
    assert message.applied == 0
    assert driver.replica.state is not None and driver.replica.state.applied == 1
