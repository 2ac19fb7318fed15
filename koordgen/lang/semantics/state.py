"""A fleet's state, and what lies outside of a program."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from koordgen.lang.semantics.values import Value


class Robot(NamedTuple):
    """One robot's own: `ports` by "Module.port", sensors and actuators alike."""

    locals: Mapping[str, Value]
    ports: Mapping[str, Value]
    stopped: bool


class Store(NamedTuple):
    """The shared variables: allread ones by name and pid, allwrite ones by name."""

    slots: Mapping[str, tuple[Value, ...]]
    cells: Mapping[str, Value]


class State(NamedTuple):
    """A fleet at a round's start; every robot's copy of the store is then the store itself. `round` is the number of
    the round to come, 0 when init has not run."""

    params: Mapping[str, Value]
    robots: tuple[Robot, ...]
    store: Store
    round: int


def nobody(pid: int, port: str, args: tuple[Value, ...]) -> Value:
    """The callable ports of a fleet that has none."""
    raise LookupError(f"nothing serves {port}")


class World(NamedTuple):
    """What a program calls. `externs`: its extern functions by name, over values as here, pure; also `spec fun`s, where
    properties that use them are to be executed. `answer`: what a callable port says, by pid, "Module.port" and
    arguments; an input, the same as often as an event is run again. What they raise discards the event. `turns`: those
    of loops that one event has here, where they are fewer than a robot's."""

    externs: Mapping[str, Callable[..., Value]]
    answer: Callable[[int, str, tuple[Value, ...]], Value]
    turns: int | None = None


NOTHING = World({}, nobody)
