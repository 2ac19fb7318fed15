"""Journal of a robot: log lines, trace, metrics and monitors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from koordgen.runtime.net.fleet_clock import FleetClock
from koordgen.runtime.net.metrics import Metrics
from koordgen.runtime.net.wire import View
from koordgen.runtime.ops.recent import Recent
from koordgen.runtime.program.program import Calls, Effects, Life
from koordgen.runtime.replication.views import describe
from koordgen.runtime.trace.monitored import FOR_GOOD, Change
from koordgen.runtime.trace.writer import Observe, Record, Trace
from koordgen.runtime.values.clock import Clock
from koordgen.runtime.vehicle.stall import State

_ACTING = {"off": "", "log": "", "hold": "; the robot holds", "land": "; it lands", "stop": "; it comes to rest"}
_STALLED: dict[State, str] = {
    "begins": "no way for {:.0f} s",
    "goes on": "still no way after {:.0f} s",
    "ends": "the stall is over after {:.0f} s",
}
MOST_CHANGES, OFTEN = 6, 10.0  # largest number of log lines about one property, within so many seconds
MOST_UNTOLD = 8  # number of waiting records of rounds at which they must be written
METRICS_EVERY = 10.0  # seconds between two metrics records in the trace

T = TypeVar("T")
Emit = Callable[[str, str], None]  # level (info, warning, error) and a line


class Journal:
    """Journal of one robot.

    round: number of the present round, for log lines.
    monitors: called with each round's record; a monitor that raises an exception is switched off.
    """

    def __init__(
        self,
        robot: str,
        trace: Trace,
        emit: Emit,
        clock: Clock,
        fleet_clock: FleetClock,
        metrics: Metrics,
        monitors: Sequence[Observe],
    ) -> None:
        self._robot = robot
        self._trace = trace
        self._emit = emit
        self._clock = clock
        self._fleet_clock = fleet_clock
        self._metrics = metrics
        self._monitors = list(monitors)
        self._changes: dict[str, tuple[float, int]] = {}  # of properties: start of the interval, number of changes
        self._counted: Mapping[str, int] = {}
        self._faulty = ""
        self._phase = ""
        self._said = ""
        self._last = ""  # line
        self._measured = 0.0
        self.recent = Recent()
        self.untold: list[Record] = []  # records of committed rounds
        self.round = 0

    def phase(self, phase: str, detail: str) -> None:
        """Record a new phase of the agent. A detail that repeats the last log line is left out."""
        self._phase, self._said = phase, ""
        self._trace.phase(self._clock.now(), phase, detail)
        self._line("info", f"{phase}: {detail}" if detail and not self._last.startswith(detail) else phase)

    def progress(self, text: str) -> None:
        """Record the progress within a phase, unless the text is the same as the last one."""
        if text and text != self._said:
            self._said = text
            self._trace.phase(self._clock.now(), self._phase, text)
            self._line("info", text)

    def log(self, level: str, text: str) -> None:
        self._trace.log(self._clock.now(), level, text)
        self._line(level, text)

    def warn(self, text: str) -> None:
        self.log("warning", text)

    def error(self, text: str) -> None:
        self.log("error", text)

    def stall(self, state: State, why: str, lasted: float) -> None:
        """Record that the vehicle has had no path for `lasted` seconds, or has one again."""
        self._trace.stall(self._clock.now(), state, why, lasted)
        self.warn(f"{_STALLED[state].format(lasted)}: {why}")

    def monitor(self, change: Change) -> None:
        """Record a change of a property's verdict.

        It is also logged, except for a first verdict that is no violation, and for most changes of a property that
        changes often."""
        self._trace.monitor(change)
        since, count = self._changes.get(change.word, (-math.inf, 0))
        if change.time - since > OFTEN:
            since, count = change.time, 0
        self._changes[change.word] = since, count + 1
        ends = change.outcome == "violated" and change.action in FOR_GOOD
        if count >= MOST_CHANGES and not ends:
            return
        if change.outcome == "violated":
            text = f"{change.word} is violated: {change.why}{_ACTING[change.action]}"
            self._line("error" if ends else "warning", text)
        elif change.before is not None:
            self._line("info", f"{change.word}: {change.outcome}" + (f": {change.why}" if change.why else ""))

    def judged(self, violated: bool, summary: str) -> None:
        """Record the final verdicts of the robot's monitors."""
        if summary:
            self.log("warning" if violated else "info", f"properties: {summary}")

    def watch(self, monitor: Observe) -> None:
        """Add a callback for each round's record."""
        self._monitors.append(monitor)

    def streams(self, lines: Sequence[tuple[str, str]], round_: int, time: float) -> None:
        """Record the program's output of a round; 0 is `init`. Every agent serves streams."""
        for port, text in lines:
            self._trace.stream(time, round_, port, text)
            self._line("info", f"{port}: {text}")

    def init(self, sensors: Mapping[str, Any], effects: Effects, after: Life, calls: Calls, time: float) -> None:
        """Record the execution of `init`."""
        self._trace.init(time, sensors, effects, after, calls)
        self.recent.wrote(0, effects.shared)
        self.streams(effects.streams, 0, time)

    def view(self, view: View, names: Sequence[str], over: bool) -> None:
        """Record a new view. In view 0 all robots are members.

        over: this robot's mission is over. That other robots leave is normal then, so it is not logged as a warning.
        """
        self._trace.view(self._clock.now(), view.number, view.since, view.members)
        if view.number:
            self.log("info" if over else "warning", describe(view, names))

    @property
    def traces(self) -> bool:
        """True if counters are recorded."""
        return self._trace.open

    @property
    def full(self) -> bool:
        """True if the waiting records must be recorded now."""
        return len(self.untold) >= MOST_UNTOLD

    def tell(self, counters: Mapping[str, int], rejected: Mapping[str, int]) -> None:
        """Record all waiting rounds, and the metrics if they are due."""
        for record in self.untold:
            self.observe(record, counters)
        self.measure(rejected, self.untold[-1].time)
        self.untold.clear()

    def observe(self, record: Record, counters: Mapping[str, int]) -> None:
        """Record a committed round; `counters` are all counters, if it `traces`."""
        if self._trace.open:
            changed = {k: v for k, v in counters.items() if k != "rounds" and self._counted.get(k, 0) != v}
            self._counted = counters
            self._trace.round(record, self._fleet_clock.bound(record.time), changed)
        if record.effects is not None:
            self.streams(record.effects.streams, record.round, record.time)
        fault = str(record.fault) if record.fault is not None else ""
        if fault and fault != self._faulty:
            self.error(f"{fault}; the event is discarded, the robot holds")
        self._faulty = fault
        self._metrics.round(record.round, record.late, record.event, record.skipped, record.frame is not None)
        self.recent.round(record)
        for monitor in tuple(self._monitors):
            if not self.attempt(monitor, record):
                self._monitors.remove(monitor)

    def attempt(self, monitor: Callable[[T], None], seen: T) -> bool:
        """Call a monitor. An exception is logged and stops only that monitor."""
        try:
            monitor(seen)
        except Exception as error:
            self.error(f"a monitor failed and is off: {type(error).__name__}: {error}")
            return False
        return True

    def measure(self, rejected: Mapping[str, int], now: float, at_once: bool = False) -> None:
        """Record the metrics if they are due."""
        if at_once or now - self._measured >= METRICS_EVERY:
            self._measured = now
            self._trace.metrics(now, self._metrics.snapshot(now, rejected))

    def _line(self, level: str, text: str) -> None:
        self._last = text
        now = self._clock.now()
        self.recent.line(now, self.round, level, text)
        time = f"{self._fleet_clock.read(now):.3f}" if self._fleet_clock.known else "?"
        self._emit(level, f"{time} round {self.round} {self._robot}: {level}: {text}")
