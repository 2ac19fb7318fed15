"""Monitor reports: verdicts of the robots' own monitors, compared with the simulator's verdicts.

Robots know less than the simulator and check once per round."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import msgspec

from koordgen.runtime.trace.schema import Monitor, Verdict

MOST = 200  # changes that pages show
OF_ONE = 6  # per property and robot without a reaction: a box may be left again and again
ACTS = {"hold": "holds", "land": "lands", "stop": "stops safely"}
SOON = 2  # rounds within which a robot's monitor has evaluated the property

Key = tuple[str, str, str]  # of, name, line


class MonitorSummary(msgspec.Struct):
    """Monitor reports on one property.

    `seen`: robots that reported a violation, with the first time. `acted`: their reactions. `missed`: robots that
    reported "holds" from current data while the property was violated. `mistaken`: robots that reported a violation
    while it held, as far as the simulator judged it."""

    of: str
    name: str
    line: str
    seen: dict[str, float] = {}
    acted: dict[str, str] = {}
    missed: list[str] = []
    mistaken: list[str] = []


class DisplayFilter:
    """Filter of monitor records for display: violations and their ends, up to fixed numbers."""

    def __init__(self) -> None:
        self._violated: set[tuple[int, Key]] = set()
        self._of_one: Counter[tuple[int, Key]] = Counter()
        self._count = 0

    def add(self, record: Monitor) -> bool:
        """Return whether a record is shown. Call in the order of the trace."""
        key = (record.pid, _key(record))
        if record.outcome == "violated":
            self._violated.add(key)
        elif key not in self._violated:
            return False
        else:
            self._violated.discard(key)
        self._of_one[key] += 1
        shown = self._of_one[key] <= (MOST if record.action in ACTS else OF_ONE) and self._count < MOST
        self._count += shown
        return shown


def status_text(record: Monitor) -> str:
    """Return property, outcome and reaction as a short text."""
    does = f", {ACTS[record.action]}" if record.outcome == "violated" and record.action in ACTS else ""
    return f"{record.of} {record.name}".strip() + f": {record.outcome}{does}"


class Monitored:
    """Collector of monitor records by property and robot."""

    def __init__(self, names: dict[int, str], delta: float) -> None:
        self._names, self._delta = names, delta
        self._records: dict[Key, dict[int, list[Monitor]]] = {}

    def add(self, record: Monitor) -> None:
        self._records.setdefault(_key(record), {}).setdefault(record.pid, []).append(record)

    def beside(self, verdicts: Sequence[Verdict]) -> list[MonitorSummary]:
        """Compare with the simulator's verdicts. Return the properties with something to report.

        A property that the simulator does not judge, such as a contract of a function, has no `missed`."""
        truths = {(v.of, v.name, v.line): v for v in verdicts}
        found = []
        for key, by_robot in self._records.items():
            one, truth = MonitorSummary(*key), truths.get(key)
            for pid, records in sorted(by_robot.items()):
                name = self._names.get(pid, f"robot {pid}")
                first = next((r for r in records if r.outcome == "violated"), None)
                if first is not None:
                    one.seen[name] = first.t
                    if first.action in ACTS:
                        one.acted[name] = first.action
                    if truth is not None and truth.outcome == "held":
                        one.mistaken.append(name)
                elif truth is not None and truth.outcome == "violated" and self._held(records, truth.since):
                    one.missed.append(name)
            if one.seen or one.missed:
                found.append(one)
        return found

    def _held(self, records: list[Monitor], since: float | None) -> bool:
        """Return whether the robot reported "holds" from current data after it had time to evaluate."""
        until = (0.0 if since is None else since) + SOON * self._delta
        last = next((r for r in reversed(records) if r.t <= until), None)
        return last is not None and last.outcome == "held" and last.age == 0


def as_text(found: MonitorSummary) -> str:
    """Return a summary as one line."""
    parts = []
    if found.seen:
        does = {name: f" ({ACTS[action]})" for name, action in found.acted.items()}
        parts.append("seen by " + ", ".join(f"{n} at {t:.2f} s{does.get(n, '')}" for n, t in found.seen.items()))
    if found.missed:
        parts.append(f"{', '.join(found.missed)} said that it holds")
    if found.mistaken:
        parts.append(f"in truth it held: {', '.join(found.mistaken)} measured otherwise")
    return f"{found.of} {found.name} ({found.line}): {'; '.join(parts)}"


def _key(record: Monitor) -> Key:
    return record.of, record.name, record.line
