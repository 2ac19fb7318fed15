"""State of a fleet, and the outside world: functions and ports that a program calls."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from koordgen.lang.semantics.values import Value


class Robot(NamedTuple):
    """Private state of one robot. `ports` has its sensors and actuators, by "Module.port"."""

    locals: Mapping[str, Value]
    ports: Mapping[str, Value]
    stopped: bool


class Store(NamedTuple):
    """Shared variables: `slots` has allread ones by name and pid, `cells` allwrite ones by name."""

    slots: Mapping[str, tuple[Value, ...]]
    cells: Mapping[str, Value]


class State(NamedTuple):
    """State of a fleet at a round's start, when every robot's copy of the store is equal to the store.

    `round` is the number of the next round, 0 before init.
    """

    params: Mapping[str, Value]
    robots: tuple[Robot, ...]
    store: Store
    round: int


def nobody(pid: int, port: str, args: tuple[Value, ...]) -> Value:
    """Answer for callable ports of a fleet without any: raises LookupError."""
    raise LookupError(f"nothing serves {port}")


class World(NamedTuple):
    """Functions and ports outside of a program, which it calls.

    An exception that they raise discards the event.

    `externs` has pure extern functions by name, and `spec fun`s if properties that use them are to be executed.
    `answer` returns the answer of a callable port for a pid, "Module.port" and arguments. The answer is an input: it
    must be the same when an event is run again. `turns` limits the turns of an event; None: as on robots.
    """

    externs: Mapping[str, Callable[..., Value]]
    answer: Callable[[int, str, tuple[Value, ...]], Value]
    turns: int | None = None


NOTHING = World({}, nobody)
