"""Breadth-first search of all states that a fleet can reach, round by round.

Because of this order, the first violation that the search finds has the fewest rounds.

`BreadthFirstSearch` is common to explorations of one program and of several applications. It handles packed states, and
units: robots if there is one program, otherwise instances of applications.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator
from typing import Generic, NamedTuple, Protocol, TypeVar

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.semantics.deadline import OutOfTime
from koordgen.verify.explore.machine import Packed
from koordgen.verify.explore.rounds import Node, Predecessor, steps_to
from koordgen.verify.prove.report.reach import ENVIRONMENT

SHOWN = 0.25  # seconds between two progress reports
V = TypeVar("V")  # description of a violation


class ExplorationBounds(NamedTuple):
    """Limits of an exploration. None means that there is no limit."""

    rounds: int | None = None
    states: int | None = None
    seconds: float | None = None


class ExplorationProgress(NamedTuple):
    """Progress of an exploration.

    `depth`: number of rounds up to which all states are explored.
    `states`: number of different states at the ends of rounds.
    `waiting`: number of states in `states` whose next round is not explored yet.
    `steps`: number of program steps taken.
    `seconds`: seconds since the start of the exploration."""

    depth: int
    states: int
    waiting: int
    steps: int
    seconds: float


class PackedRunState(NamedTuple):
    """Packed state of a run, with the step that led to the state.

    `event`: the step: "" for the first state, "init", an event's name, or "(environment)".
    `unit`: the robot or the instance that ran the event; None for other steps."""

    fleet: Packed
    event: str
    unit: int | None
    round: int


class _LimitReached(Exception):
    """Raised if the exploration reaches a limit. The message names the limit."""


class RoundResults(Protocol):
    """Function that returns the possible results of a round; see RoundExplorer."""

    def ends(self, fleet: Packed) -> Collection[Node]: ...

    def ends_with_predecessors(self, fleet: Packed) -> dict[Node, Predecessor | None]: ...


class EnvironmentResults(Protocol):
    """Function that returns the possible results of the environment's step; see EnvironmentSteps."""

    def moved(self, fleet: Packed) -> Iterator[Packed]: ...


class BreadthFirstSearch(ABC, Generic[V]):
    """One exploration.

    `rounds`: results of rounds in the search. `exact`: results of rounds in runs that are shown to users.
    `around`: results of steps of the environment. `has_sensors`: whether these steps can change a state.
    `clock`: function that returns the time in seconds.
    `show`: function that is called with the progress at intervals of more than SHOWN seconds.
    `deadlock`: whether a deadlock is a violation."""

    rounds: RoundResults
    exact: RoundResults

    def __init__(
        self, around: EnvironmentResults, has_sensors: bool, bounds: ExplorationBounds, clock: Callable[[], float],
        show: Callable[[ExplorationProgress], None], deadlock: bool,
    ) -> None:  # fmt: skip
        self.around, self.has_sensors, self.bounds, self.clock, self.show = around, has_sensors, bounds, clock, show
        self.deadlock = deadlock
        self._fresh()

    def _fresh(self) -> None:
        """Discard all explored states. The search then starts from the beginning."""
        # state at the end of a round -> its predecessor at the end of the previous round
        self.known: dict[Packed, Packed | None] = {}
        # explored states within a round: after all events, before the environment's step
        self.within: set[Packed] = set()
        # State after `init` -> state before `init`.
        self.begin: dict[Packed, Packed] = {}
        # states in which no event is enabled now, but some event can become enabled later
        self.live: set[Packed] = set()
        self.stuck = 0
        self.steps = self.depth = 0
        self.waiting = 0

    @abstractmethod
    def _starts(self) -> Iterator[tuple[Packed, Packed]]:
        """Yield pairs of start states: a state before `init`, and a state that is possible after `init`."""

    @abstractmethod
    def _after_init(self, before: Packed) -> list[Packed]:
        """Return all states that are possible after `init`, from the state `before`."""

    @abstractmethod
    def _all_stopped(self, fleet: Packed) -> bool:
        """Return whether no robot of the fleet will run an event again, because each has stopped."""

    @abstractmethod
    def _is_broken(self, fleet: Packed) -> bool:
        """Return whether the state `fleet` violates a property."""

    @abstractmethod
    def _has_failed(self) -> bool:
        """Return whether a step violated a property since the last call of `_forget_failures`."""

    @abstractmethod
    def _forget_failures(self) -> None: ...

    @abstractmethod
    def _event_name(self, unit: int, event: int) -> str: ...

    @abstractmethod
    def _broken(self, run: list[PackedRunState]) -> V:
        """Return the violation in the last state of a run, for which `_is_broken` is true."""

    @abstractmethod
    def _failed_init(self, before: Packed) -> V:
        """Return the violation of an `init` in the state `before`, for which `_has_failed` is true."""

    @abstractmethod
    def _failed_in(self, fleet: Packed) -> V:
        """Return the violation of a step in the round from the state `fleet`, for which `_has_failed` is true."""

    @abstractmethod
    def _deadlocked(self, fleet: Packed) -> V: ...

    def alike(self, fleet: Packed) -> Packed:
        """Return the representative of the state `fleet`, by the reductions of the search."""
        return fleet

    def _sorted(self, fleet: Packed) -> Packed:
        """Return the representative of a state in which the private states are already reduced."""
        return fleet

    def _moved(self, end: Packed) -> Iterator[Packed]:
        """Return representatives of all states that are possible after the environment's step, not sorted yet."""
        return self.around.moved(end)

    def _settled(self) -> tuple[V | None, str]:
        return self._explored()

    def _found(self) -> tuple[V | None, str]:
        """Explore until all states are explored, a violation is found, or a limit is reached.

        Return the violation, and the reason why the exploration ended early."""
        self.started = self.shown = self.clock()
        violation, stopped = None, ""
        try:
            violation, stopped = self._settled()
        except _LimitReached as over:
            stopped = str(over)
        except OutOfTime:  # the time limit was reached within one event or one round
            stopped = self._bound_of_time()
        except KeyboardInterrupt:
            stopped = "interrupted"
        if not violation and not stopped and self.stuck:
            stopped = f"the assumptions leave sensors no value in {self.stuck} states"
        return violation, stopped

    def progress(self) -> ExplorationProgress:
        return ExplorationProgress(self.depth, len(self.known), self.waiting, self.steps, self.clock() - self.started)

    def _explored(self) -> tuple[V | None, str]:
        layer: list[Packed] = []
        for before, after in self._starts():
            if self._has_failed():
                return self._failed_init(before), ""
            alike = self.alike(after)
            if alike not in self.begin:
                self.begin[alike], self.known[alike] = before, None
                layer.append(alike)
                if self._is_broken(after):
                    return self._broken(self._run_to(alike)), ""
            self._look()
        if not layer:
            return None, "no state satisfies `initially`"
        while layer:
            if self.depth == self.bounds.rounds:
                return None, f"the limit of {self.depth} round{'s' * (self.depth != 1)}"
            following: list[Packed] = []
            for number, fleet in enumerate(layer):
                self.waiting = len(layer) - number + len(following)
                self._look()
                if violation := self._round(fleet, following):
                    return violation, ""
            layer = following
            self.depth += 1
        self.waiting = 0
        return None, ""

    def _round(self, fleet: Packed, following: list[Packed]) -> V | None:
        """Explore one round from the state `fleet`, and append the newly found states to `following`."""
        found = self.rounds.ends(fleet)
        self.steps += len(found) - 1
        if self._has_failed():
            return self._failed_in(fleet)
        if self.deadlock and len(found) == 1 and self._dead(fleet):
            return self._deadlocked(fleet)
        for _, fleet_then in found:
            end = self._sorted(fleet_then)
            if end in self.within:
                continue
            self.within.add(end)
            if self.has_sensors and self._is_broken(end):
                return self._broken(self._within(fleet, end))
            moves = 0
            for moved in self._moved(end):
                moves += 1
                alike = self._sorted(moved)
                if alike not in self.known:
                    self.known[alike] = fleet
                    following.append(alike)
                    if self._is_broken(alike):
                        return self._broken(self._run_to(alike))
            self.stuck += not moves
            self._look()
        return None

    def _look(self) -> None:
        """Report the progress if a report is due, and raise _LimitReached if a limit is reached."""
        now = self.clock()
        if now > self.shown + SHOWN:
            self.shown = now
            self.show(self.progress())
        if self.bounds.seconds is not None and now - self.started > self.bounds.seconds:
            raise _LimitReached(self._bound_of_time())
        if self.bounds.states is not None and len(self.known) > self.bounds.states:
            raise _LimitReached(f"the limit of {self.bounds.states} state{'s' * (self.bounds.states != 1)}")

    def _bound_of_time(self) -> str:
        return f"the time limit of {self.bounds.seconds or 0:g} s"

    def _dead(self, fleet: Packed) -> bool:
        """Return whether the state `fleet` is a deadlock.

        In a deadlock, at least one robot has not stopped, but no event will ever be enabled, whatever the environment
        does."""
        if self._all_stopped(fleet):
            return False
        seen, pending = {fleet}, [fleet]
        for state in pending:  # the loop body appends to `pending`
            if state in self.live or len(self.rounds.ends(state)) > 1 or self._has_failed():
                # the search will find these failures again and report them, when it explores the round from `state`
                self._forget_failures()
                self.live.add(fleet)
                return False
            new = [m for m in map(self.alike, self.around.moved(state)) if m not in seen]
            seen.update(new)
            pending += dict.fromkeys(new)
        return True

    def _run_to(self, fleet: Packed) -> list[PackedRunState]:
        """Return a run to a state at the end of a round. The run consists of real states, not representatives."""
        return self._run_and_end(fleet)[0]

    def _run_and_end(self, fleet: Packed) -> tuple[list[PackedRunState], Packed]:
        """Return a run to a state at the end of a round, and the real state in which the run ends.

        A real state is a state of the run, not the representative `fleet` that stands for it in the search."""
        chain = [fleet]
        while (parent := self.known[chain[-1]]) is not None:
            chain.append(parent)
        before = self.begin[chain[-1]]
        at = next(after for after in self._after_init(before) if self.alike(after) == chain[-1])
        run = [PackedRunState(before, "", None, 0), PackedRunState(at, "init", None, 0)]
        for number, target in enumerate(reversed(chain[:-1]), 1):
            at = self._step_to(run, at, target, number)
        return run, at

    def _step_to(self, run: list[PackedRunState], at: Packed, target: Packed, number: int) -> Packed:
        """Append one round to a run, so that the run leads to a state with the representative `target`.

        Return the state to which the run then leads."""
        found = self.exact.ends_with_predecessors(at)
        for node in sorted(found, key=lambda node: node[0].bit_count()):
            for moved in self.around.moved(node[1]):
                if self.alike(moved) == target:
                    run += self._steps_taken(found, node, number)
                    if self.has_sensors:
                        run.append(PackedRunState(moved, ENVIRONMENT, None, number))
                    return moved
        raise InternalError("an explored state cannot be reached from its predecessor")

    def _within(self, fleet: Packed, end: Packed) -> list[PackedRunState]:
        """Return a run whose last round starts in `fleet` and stops before the environment's step.

        `end` represents the last state of the run."""
        run, at = self._run_and_end(fleet)
        number = run[-1].round + 1
        found = self.exact.ends_with_predecessors(at)
        node = min((n for n in found if self.alike(n[1]) == end), key=lambda node: node[0].bit_count())
        return [*run, *self._steps_taken(found, node, number)]

    def _steps_taken(self, found: dict[Node, Predecessor | None], node: Node, number: int) -> Iterator[PackedRunState]:
        for unit, event, fleet in steps_to(found, node):
            yield PackedRunState(fleet, self._event_name(unit, event), unit, number)
