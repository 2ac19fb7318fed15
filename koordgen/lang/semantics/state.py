"""State of a fleet, and the world outside of the program: extern functions and callable ports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from koordgen.lang.semantics.values import Value


class Robot(NamedTuple):
    """Private state of one robot. `ports` maps "Module.port" to the value of a sensor or actuator."""

    locals: Mapping[str, Value]
    ports: Mapping[str, Value]
    stopped: bool


class Store(NamedTuple):
    """Values of the shared variables: of allread variables by name and pid, of allwrite variables by name."""

    slots: Mapping[str, tuple[Value, ...]]
    cells: Mapping[str, Value]


class State(NamedTuple):
    """State of a fleet at a round's start, when all robots' copies of the shared variables agree.

    `round` is the number of the round that begins; it is 0 before `init` has run.
    """

    params: Mapping[str, Value]
    robots: tuple[Robot, ...]
    store: Store
    round: int


def nobody(pid: int, port: str, args: tuple[Value, ...]) -> Value:
    """Raise LookupError: the answer to a call of a port if nothing implements the callable ports."""
    raise LookupError(f"nothing serves {port}")


class World(NamedTuple):
    """Implementations of the extern functions and callable ports that a program calls.

    If an implementation raises an exception, the event is discarded.

    `externs` maps the name of an extern function to its implementation, which must be pure. It also holds
    implementations of `spec fun`s if properties that call them are to be executed. `answer` returns the answer of a
    callable port for a pid, "Module.port" and arguments. It must return the same answer if the event is run again.
    `turns` is the event's budget of loop turns; None stands for the default, MAX_TURNS in exec.py.
    """

    externs: Mapping[str, Callable[..., Value]]
    answer: Callable[[int, str, tuple[Value, ...]], Value]
    turns: int | None = None


NOTHING = World({}, nobody)
