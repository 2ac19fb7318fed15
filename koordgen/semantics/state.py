"""A fleet's state, and what lies outside of a program."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from koordgen.semantics.values import Value


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


class OutOfTime(BaseException):
    """The run of a program has passed its deadline: it has no result. No `except Exception` of an extern function or of
    an event's faults catches it."""


class Deadline(NamedTuple):
    """When a run ends without a result: at the time `until` of `clock`, seconds."""

    clock: Callable[[], float]
    until: float

    def look(self) -> None:
        """Raise OutOfTime when it has passed."""
        if self.clock() > self.until:
            raise OutOfTime("the time for this run is over")


class World(NamedTuple):
    """What a program calls. `externs`: its extern functions by name, over values as here, pure; also `spec fun`s, where
    properties that use them are to be executed. `answer`: what a callable port says, by pid, "Module.port" and
    arguments; an input, the same as often as an event is run again. What they raise discards the event. `deadline`: when
    whoever runs the program gives up, if ever."""

    externs: Mapping[str, Callable[..., Value]]
    answer: Callable[[int, str, tuple[Value, ...]], Value]
    deadline: Deadline | None = None


NOTHING = World({}, nobody)
