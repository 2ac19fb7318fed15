"""Runner of one robot's program: keeps the local variables, and runs one event at a time within a time limit."""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from types import FrameType, MappingProxyType
from typing import Any

import msgspec

from koordgen.runtime.program.program import Effects, Event, Fault, Frame, Program, choose, run
from koordgen.runtime.values.clock import Clock

# Reasons for which a robot skips a round. Logs, traces, --status, summaries and reports use these names.
#
# A reason is `NAME` or `NAME: detail`. docs/reference/cli.md and `koordgen explain skip` list all names.

NO_EVENT = "no event enabled"
FAULT = "fault"
STOPPED = "stopped"
NOT_CURRENT = "not current"
NOT_CONFIRMED = "not confirmed"
WOKE_LATE = "woke after the publish deadline"
NO_SENSOR_VALUE = "no sensor value"
NO_POSITION = "no position"
LOST_CONTENTION = "lost contention"
NOT_COUNTED = "not counted"
LEFT = "left the mission"
NAMES = (
    NO_EVENT, NOT_CURRENT, NOT_CONFIRMED, LOST_CONTENTION, FAULT, WOKE_LATE, NO_SENSOR_VALUE, NO_POSITION, STOPPED,
    NOT_COUNTED, LEFT,
)  # fmt: skip


def name_of(reason: str) -> str:
    """Return the name of a reason for a skipped round, without the detail behind the colon."""
    return reason.partition(":")[0]


LATE = "not finished by the round's publish deadline"
INIT_TIME = 1.0  # largest duration of `init` in seconds

Limit = Callable[[float], AbstractContextManager[None]]
Call = Callable[[str, tuple[Any, ...]], Any]


class Overrun(BaseException):
    """Raised in an event that has used up its time.

    It is a BaseException, so `except Exception` in an extern function does not catch it."""


class EndedAtOnce(BaseException):
    """Raised anywhere in the agent's process when the user ends the process immediately.

    KeyboardInterrupt is not used, because user code may raise it."""


NO_VALUES: Mapping[str, Any] = MappingProxyType({})
_UNLIMITED = nullcontext()


def unlimited(seconds: float) -> AbstractContextManager[None]:
    """Return a context manager without a time limit. An event that takes too long is detected only at its end."""
    return _UNLIMITED


class Interrupting:
    """Context manager that raises Overrun in its block after a number of seconds of real time.

    So an endless loop cannot block the robot's control loop. Create only one object in a process, in the main thread,
    where signals arrive. The object uses SIGALRM until the process ends."""

    def __init__(self) -> None:
        self._armed = False
        self._seconds = 0.0
        signal.signal(signal.SIGALRM, self._ring)

    def __call__(self, seconds: float) -> Interrupting:
        self._seconds = max(1e-4, seconds)
        return self

    def __enter__(self) -> None:
        self._armed = True
        try:  # the signal may already arrive in this block
            # The timer repeats the signal, because a bare `except` may catch the first Overrun.
            signal.setitimer(signal.ITIMER_REAL, self._seconds, 0.05)
        except BaseException:
            self.__exit__()
            raise

    def __exit__(self, *error: object) -> None:
        self._armed = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _ring(self, number: int, frame: FrameType | None) -> None:
        # A signal during __exit__ raises nothing, because __exit__ must turn the timer off.
        over = frame is not None and frame.f_code is Interrupting.__exit__.__code__
        if self._armed and not over:
            raise Overrun("out of time")


class EventResult(msgspec.Struct, frozen=True):
    """Result of a round: the effects of an event, or a fault without effects, or no event (all fields None).

    `lock`: lock of the fleet that an atomic event needs; its effects count as soon as its transaction has won the lock.
    It is -1 for an event that is not atomic."""

    event: str | None = None
    effects: Effects | None = None
    fault: Fault | None = None
    lock: int = -1


class Runner:
    """Runner of one program on one robot. The caller updates `locals` when the effects of an event count.

    given: values of local variables that replace their initial values.
    locks: for each lock of the program, the lock of the fleet that protects the same variables; empty: the same lock.
    """

    def __init__(
        self,
        program: Program,
        pid: int,
        n_sys: int,
        clock: Clock,
        limit: Limit,
        given: Mapping[str, Any] = NO_VALUES,
        locks: Sequence[int] = (),
    ) -> None:
        self.program = program
        self.locals: Mapping[str, Any] = {v.name: v.initial() for v in program.locals} | dict(given)
        self._pid = pid
        self._n_sys = n_sys
        self._locks = locks or range(len(program.locks))
        self._clock = clock
        self._limit = limit

    def frame(
        self, shared: Mapping[str, Any], sensors: Mapping[str, Any], actuators: Mapping[str, Any], call: Call
    ) -> Frame:
        return Frame(self._pid, self._n_sys, self.locals, shared, sensors, actuators, call)

    def init(self, frame: Frame) -> Effects | Fault:
        """Run the program's `init` and set `locals`. A program without `init` has no effects."""
        if self.program.init is None:
            return Effects(self.locals, {}, {}, False)
        try:
            with self._limit(INIT_TIME):
                done = run(self.program, self.program.init, self.program.begin(frame))
        except Overrun:
            return Fault(self.program.source, 0, f"init not finished within {INIT_TIME} s")
        if isinstance(done, Effects):
            self.locals = done.locals
        return done

    def step(self, frame: Frame, deadline: float) -> EventResult:
        """Run the first enabled event of the program as the event of this round.

        An event that is not finished by `deadline` (local time in seconds) is discarded as a whole."""
        event: Event | None = None
        done: Effects | Fault
        try:
            with self._limit(deadline - self._clock.now()):
                state = self.program.begin(frame)
                chosen = choose(self.program, state)
                if chosen is None:
                    return EventResult()
                if isinstance(chosen, Fault):
                    return EventResult(fault=chosen)
                event = chosen
                done = run(self.program, event.effect, state, event.line)
        except Overrun:
            done = Fault(self.program.source, event.line if event else 0, LATE)
        name = event.name if event else None
        if isinstance(done, Fault):
            return EventResult(name, fault=done)
        if self._clock.now() > deadline:
            return EventResult(name, fault=Fault(self.program.source, event.line if event else 0, LATE))
        return EventResult(name, done, lock=-1 if event is None or event.lock is None else self._locks[event.lock])
