"""Small replicas of a store, and entries of their robots, for tests."""

from __future__ import annotations

from typing import Any

import msgspec

from koordgen.runtime.net.layout import Layout
from koordgen.runtime.net.wire import Entry, Head, View, Write
from koordgen.runtime.program.program import Variable
from koordgen.runtime.replication.state_machine import StateMachine
from koordgen.runtime.values.bounds import Fixed

SHARED = (
    Variable("x", "allread", int, Fixed(9), lambda: 0),
    Variable("last", "allwrite", int, Fixed(9), lambda: -1),
)


def layout(n: int = 3) -> Layout:
    return Layout(SHARED, n)


def view(n: int = 3) -> View:
    return View(0, 1, (0,) * n)


def fleet(n: int = 3) -> list[StateMachine]:
    """Return the state machines of all robots at the beginning of round 1."""
    inits = [Entry(pid, 0, 0, 0) for pid in range(n)]
    return [StateMachine.begin(layout(n), pid, view(n), inits) for pid in range(n)]


def head(pid: int) -> Head:
    """Return the head of a message of a robot."""
    return Head(0, bytes(8), bytes(8), pid, bytes(8), bytes(8), 0, 0, None, ())


def write(index: int, value: Any) -> Write:
    return Write(index, msgspec.Raw(msgspec.msgpack.encode(value)))


def acted(author: int, round_: int, *writes: Write, incarnation: int = 0, lock: int = -1, **more: Any) -> Entry:
    """Return the entry of a round in which an event ran."""
    return Entry(author, incarnation, round_, round_, acted=True, lock=lock, writes=writes, **more)


def silent(author: int, first: int, round_: int, incarnation: int = 0, stopped: bool = False) -> Entry:
    """Return the entry of rounds in which nothing happened."""
    return Entry(author, incarnation, first, round_, stopped)


def writes_of(entry: Entry) -> tuple[Write, ...]:
    """Return the writes of an entry whose author has one instance."""
    assert isinstance(entry.writes, tuple)
    return entry.writes


def append(state: StateMachine, *entries: Entry, round_: int = 20) -> list[str | None]:
    """Hand entries to a state machine in this round. Return for each why it was refused."""
    return [state.append(entry, round_) for entry in entries]


def contents(state: StateMachine) -> Any:
    """Return what robots that have applied the same rounds must agree on."""
    return state.applied, state.shared, state.stopped, state.acted
