"""Recent history of one robot for its status report: log lines, results of rounds, writes of shared variables.

The history has a fixed largest size. Each update costs O(1), because values are encoded only for a status report. Log
lines are numbered from 1, and rounds have numbers, so a client can merge successive reports without duplicates."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import msgspec

from koordgen.runtime.trace.writer import RoundRecord

MOST_LINES, LONGEST_LINE, LINES_BYTES = 32, 200, 2500
MOST_ROUNDS, LONGEST_OUTCOME, ROUNDS_BYTES = 64, 100, 2000
LONGEST_VALUE, VALUES_BYTES = 300, 2000  # largest size of one value, and of all values, in bytes of JSON
MOST_POINTS = 32

_encoder = msgspec.json.Encoder(enc_hook=repr)
Line = tuple[int, float, int, str, str]  # number of the line, local time in seconds, round, level, text
RoundResult = tuple[int, str, str, float]  # round, outcome, detail, seconds after the round's start


class ApplicationResult(msgspec.Struct):
    """Last results of one of several applications. Round 0: none yet.

    round: round of its last record.
    event: its last event without a fault.
    event_round: round of that event.
    fault: fault of the last record; "" if it has none.
    """

    round: int = 0
    event: str = ""
    event_round: int = 0
    fault: str = ""

    def add(self, record: RoundRecord) -> None:
        self.round = record.round
        self.fault = "" if record.fault is None else str(record.fault)[:LONGEST_OUTCOME]
        if record.event is not None and record.fault is None:
            self.event, self.event_round = record.event, record.round


class Recent:
    """Last log lines and rounds of a robot, and the last value that the robot wrote into each shared variable.

    stored: (application, name in its program) -> name in the store of a shared variable; see FleetProgram.names.
    """

    def __init__(self) -> None:
        self.stored: Mapping[tuple[str, str], str] = {}
        self._lines: deque[Line] = deque(maxlen=MOST_LINES)
        self._rounds: deque[RoundResult] = deque(maxlen=MOST_ROUNDS)
        self._written: dict[str, tuple[int, Any]] = {}
        self._applications: dict[str, ApplicationResult] = {}
        self._count = 0
        self._decided = 0.0  # time of the newest round's record, in seconds of the local clock

    def line(self, time: float, round_: int, level: str, text: str) -> None:
        """Add a log line of the robot."""
        self._count += 1
        self._lines.append((self._count, time, round_, level, text[:LONGEST_LINE]))

    def round(self, record: RoundRecord) -> None:
        """Add the result of a round, and the shared variables that the round's event wrote."""
        if record.fault is not None:
            outcome, detail = "fault", str(record.fault)
        elif record.skipped is not None:
            outcome, detail = "skipped", record.skipped
        else:
            outcome, detail = "event", record.event or ""
        if record.application:
            detail = f"{record.application}: {detail}"
            self.of(record.application).add(record)
        self._rounds.append((record.round, outcome, detail[:LONGEST_OUTCOME], record.late))
        self._decided = record.time
        if record.effects is not None:
            self.wrote(record.round, record.effects.shared, record.application)

    def of(self, application: str) -> ApplicationResult:
        """Return the last results of one of several applications."""
        return self._applications.setdefault(application, ApplicationResult())

    def wrote(self, round_: int, values: Mapping[str, Any], application: str = "") -> None:
        """Add the shared variables that the event of a round wrote; round 0 is `init`."""
        for name, value in values.items():
            self._written[self.stored.get((application, name), name)] = round_, value

    def report(self, now: float, kinds: Mapping[str, str]) -> dict[str, Any]:
        """Return the history as values that JSON can encode. Ages are in seconds at local time `now`.

        kinds: name of a shared variable -> kind (allread or allwrite).
        The result has these keys:
        lines: [number, age, round, level, text] of each log line.
        outcomes: [first round, number of rounds, outcome, detail, list of the rounds' lateness in ms] for each sequence
        of rounds with equal outcomes.
        decided: age of the last outcome.
        shared: [name, kind, round, value] of each write; a long value is {"cut": first part of its JSON}.
        """
        written = ([name, kinds[name], round_, _plain(value)] for name, (round_, value) in self._written.items())
        lines = ([number, round(now - time, 2), *more] for number, time, *more in reversed(self._lines))
        return {
            "lines": _within(LINES_BYTES, lines)[::-1],
            "outcomes": _within(ROUNDS_BYTES, reversed(_runs(self._rounds)))[::-1],
            "decided": round(now - self._decided, 3),
            "shared": _within(VALUES_BYTES, written),
        }


def _runs(rounds: Iterable[RoundResult]) -> list[list[Any]]:
    """Return sequences of rounds with equal outcomes. Those of several applications overlap."""
    runs: list[list[Any]] = []
    last: dict[tuple[str, str], list[Any]] = {}
    for number, outcome, detail, late in rounds:
        late_ms, run = round(late * 1e3, 1), last.get((outcome, detail))
        if run is not None and run[0] + run[1] == number:
            run[1] += 1
            run[4].append(late_ms)
        else:
            last[outcome, detail] = run = [number, 1, outcome, detail, [late_ms]]
            runs.append(run)
    return runs


def _within(most: int, rows: Iterable[list[Any]]) -> list[list[Any]]:
    """Return the longest beginning of the rows whose JSON has at most `most` bytes."""
    kept: list[list[Any]] = []
    for row in rows:
        most -= len(_encoder.encode(row))
        if most < 0:
            break
        kept.append(row)
    return kept


def _plain(value: Any) -> Any:
    text = _encoder.encode(value)
    if len(text) > LONGEST_VALUE:
        return {"cut": text[:LONGEST_VALUE].decode("utf-8", "ignore")}
    return json.loads(text)


def goal(actuators: Mapping[str, Any], is_finite: Callable[[Any], bool]) -> list[list[float]]:
    """Return the points of the commanded path or target in metres, local ENU; an empty list without a command.

    A long path is thinned to at most MOST_POINTS points; the last point is always kept."""
    for port in (".path", ".target"):
        for name, value in actuators.items():
            points = (value if port == ".path" else (value,)) if name.endswith(port) else ()
            if points and all(map(is_finite, points)):
                every = -(-len(points) // MOST_POINTS)
                return [[round(c, 3) for c in (p.x, p.y, p.z)] for p in points[::-1][::every][::-1]]
    return []
