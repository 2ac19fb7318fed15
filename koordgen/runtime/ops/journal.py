"""Journal of a robot: writes its log lines, trace and metrics, and passes its rounds to monitors."""

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
from koordgen.runtime.trace.writer import Observe, RoundRecord, Trace
from koordgen.runtime.values.clock import Clock
from koordgen.runtime.vehicle.stall import State

_ACTING = {"off": "", "log": "", "hold": "; the robot holds", "land": "; it lands", "stop": "; it stops safely"}
_STALLED: dict[State, str] = {
    "begins": "no way for {:.0f} s",
    "goes on": "still no way after {:.0f} s",
    "ends": "the stall is over after {:.0f} s",
}
MOST_CHANGES, OFTEN = 6, 10.0  # at most MOST_CHANGES log lines about one property are written within OFTEN seconds
MOST_UNTOLD = 8  # records of rounds that may wait; then all must be written
METRICS_EVERY = 10.0  # seconds between two metrics records in the trace

T = TypeVar("T")
Emit = Callable[[str, str], None]  # level (info, warning, error) and a line


class Journal:
    """Journal of one robot.

    round: number of the present round, for log lines.
    monitors: functions that are called with the record of each round. A monitor that raises is switched off.
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
        self._changes: dict[str, tuple[float, int]] = {}  # property -> start of the interval, changes in it
        self._counted: Mapping[str, int] = {}
        self._faulty: dict[str, str] = {}  # application -> fault of its last event; "": none
        self._phase = ""
        self._last_progress = ""
        self._last = ""  # last log line
        self._measured = 0.0
        self.recent = Recent()
        self.untold: list[RoundRecord] = []  # records of committed rounds that wait to be written
        self.round = 0

    def phase(self, phase: str, detail: str) -> None:
        """Record a new phase of the agent. The log line omits a detail that the last log line already contains."""
        self._phase, self._last_progress = phase, ""
        self._trace.phase(self._clock.now(), phase, detail)
        self._line("info", f"{phase}: {detail}" if detail and not self._last.startswith(detail) else phase)

    def progress(self, text: str) -> None:
        """Record the progress within the phase, unless `text` equals the progress that was recorded last."""
        if text and text != self._last_progress:
            self._last_progress = text
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
        """Record that a stall of the vehicle begins, goes on or ends, after `lasted` seconds."""
        self._trace.stall(self._clock.now(), state, why, lasted)
        self.warn(f"{_STALLED[state].format(lasted)}: {why}")

    def monitor(self, change: Change, application: str = "") -> None:
        """Record a change of a property's verdict in the trace, and log it.

        application: application of the property; "" if the fleet has only one.
        A first verdict is logged only if it is a violation. If a property changes often, only the first changes in each
        interval are logged, and every violation that ends the robot's mission."""
        self._trace.monitor(change, application)
        word = _named(application, change.word)
        since, count = self._changes.get(word, (-math.inf, 0))
        if change.time - since > OFTEN:
            since, count = change.time, 0
        self._changes[word] = since, count + 1
        ends = change.outcome == "violated" and change.action in FOR_GOOD
        if count >= MOST_CHANGES and not ends:
            return
        if change.outcome == "violated":
            text = f"{word} is violated: {change.why}{_ACTING[change.action]}"
            self._line("error" if ends else "warning", text)
        elif change.before is not None:
            self._line("info", f"{word}: {change.outcome}" + (f": {change.why}" if change.why else ""))

    def judged(self, violated: bool, summary: str) -> None:
        """Log a summary of the final verdicts of the robot's monitors. `violated`: a property was violated."""
        if summary:
            self.log("warning" if violated else "info", f"properties: {summary}")

    def watch(self, monitor: Observe) -> None:
        """Add a monitor: a function that is called with the record of each committed round."""
        self._monitors.append(monitor)

    def streams(self, lines: Sequence[tuple[str, str]], round_: int, time: float, application: str = "") -> None:
        """Record the lines that an application wrote to its streams in a round; round 0 is `init`."""
        for port, text in lines:
            self._trace.stream(time, round_, port, text, application)
            self._line("info", _named(application, f"{port}: {text}"))

    def init(
        self, sensors: Mapping[str, Any], effects: Effects, after: Life, calls: Calls, time: float,
        application: str = "",
    ) -> None:  # fmt: skip
        """Record the run of an application's `init`: its sensor values and writes, and its variables `after` it."""
        self._trace.init(time, sensors, effects, after, calls, application)
        self.recent.wrote(0, effects.shared, application)
        self.streams(effects.streams, 0, time, application)

    def view(self, view: View, names: Sequence[str], over: bool) -> None:
        """Record a new view. In view 0 all robots are members.

        over: True if this robot's mission is over. Other robots may leave then, so the view is not logged as a warning.
        """
        self._trace.view(self._clock.now(), view.number, view.since, view.members)
        if view.number:
            self.log("info" if over else "warning", describe(view, names))

    @property
    def traces(self) -> bool:
        """True if the trace is written, so that callers must pass counters."""
        return self._trace.open

    @property
    def full(self) -> bool:
        """True if so many records of rounds wait that they must be written now."""
        return len(self.untold) >= MOST_UNTOLD

    def write_pending(self, counters: Mapping[str, int], rejected: Mapping[str, int]) -> None:
        """Write all waiting records of rounds, and the metrics if they are due."""
        for record in self.untold:
            self.observe(record, counters)
        self.measure(rejected, self.untold[-1].time)
        self.untold.clear()

    def observe(self, record: RoundRecord, counters: Mapping[str, int]) -> None:
        """Record a committed round. `counters`: all counters of the runtime; they are used only if `traces` is True."""
        if self._trace.open:
            changed = {k: v for k, v in counters.items() if k != "rounds" and self._counted.get(k, 0) != v}
            self._counted = counters
            self._trace.round(record, self._fleet_clock.bound(record.time), changed)
        if record.effects is not None:
            self.streams(record.effects.streams, record.round, record.time, record.application)
        fault = str(record.fault) if record.fault is not None else ""
        if fault and fault != self._faulty.get(record.application):
            holder = f"application {record.application}" if record.application else "the robot"
            self.error(f"{fault}; the event is discarded, {holder} holds")
        self._faulty[record.application] = fault
        skipped = f"{record.skipped}: {record.application}" if record.skipped and record.application else record.skipped
        self._metrics.round(record.round, record.late, record.event, skipped, record.frame is not None)
        self.recent.round(record)
        for monitor in tuple(self._monitors):
            if not self.attempt(monitor, record):
                self._monitors.remove(monitor)

    def attempt(self, monitor: Callable[[T], None], seen: T) -> bool:
        """Call a monitor. Log an exception. Return False if the monitor raised one, so that it is called no more."""
        try:
            monitor(seen)
        except Exception as error:
            self.error(f"a monitor failed and is off: {type(error).__name__}: {error}")
            return False
        return True

    def measure(self, rejected: Mapping[str, int], now: float, at_once: bool = False) -> None:
        """Record the metrics if they are due, or if `at_once`."""
        if at_once or now - self._measured >= METRICS_EVERY:
            self._measured = now
            self._trace.metrics(now, self._metrics.snapshot(now, rejected))

    def _line(self, level: str, text: str) -> None:
        self._last = text
        now = self._clock.now()
        self.recent.line(now, self.round, level, text)
        time = f"{self._fleet_clock.read(now):.3f}" if self._fleet_clock.known else "?"
        self._emit(level, f"{time} round {self.round} {self._robot}: {level}: {text}")


def _named(application: str, text: str) -> str:
    """Return a text about an application, with its name if the fleet has several."""
    return f"{application}: {text}" if application else text
