"""Rows of a real fleet for the dashboard, built from the agents' periodic reports.

Reports overlap: log lines and rounds are numbered, so rows are built only once. Times are seconds since the dashboard's
start. A report is untyped JSON of another computer, perhaps of another release: it is converted first, and refused with
a reason if it does not fit."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import msgspec

from koordgen.runtime.trace.schema import (
    ApplicationRecord,
    EventFault,
    Header,
    LogLine,
    MetricsRecord,
    PeerQuality,
    Phase,
    PoseRecord,
    Round,
    SharedVariable,
)
from targets.sim.base.bodies import Vector
from targets.sim.base.fleets import SQUAD
from targets.sim.view.data.rows import Chunk, Rows

FRESH = 1.0  # seconds: a robot whose last report is older counts as silent
LINKS_EVERY = 2.0  # seconds between two rows of a robot's links
Count = Annotated[int, msgspec.Meta(ge=0, le=2**53)]  # exact in a double, as JavaScript needs
Lines = tuple[tuple[Count, float, Count, str, str], ...]
Outcomes = tuple[tuple[Count, Count, Literal["event", "skipped", "fault"], str, tuple[float, ...]], ...]


class ReportedPose(msgspec.Struct, frozen=True):
    """Pose of a robot: metres, local ENU; yaw in radians; the age of both in seconds."""

    position: Vector
    yaw: float | None = None
    age: float = 0.0


class ReportedViolation(msgspec.Struct, frozen=True):
    """A property that the robot's monitor reports as violated."""

    of: str = ""
    name: str = ""
    line: str = ""
    why: str = ""

    @property
    def words(self) -> str:
        return f"{self.of} {self.name}".strip()


class MonitorReport(msgspec.Struct, frozen=True):
    counts: dict[str, int] = {}
    violated: tuple[ReportedViolation, ...] = ()


class Computer(msgspec.Struct, frozen=True):
    """A robot's computer: error of its clock (ms), free disk (GB), temperature (degrees Celsius)."""

    clock_ms: float | None = None
    disk_gb: float | None = None
    temperature: float | None = None


class ReportedApplication(msgspec.Struct, frozen=True):
    """One of several applications of a robot: its last results (koordgen/runtime/ops/recent.py), and its counters."""

    name: str
    pid: Count = 0
    members: tuple[Count, ...] = ()
    stopped: bool = False
    round: Count = 0
    event: str = ""
    event_round: Count = 0
    fault: str = ""
    counts: dict[str, int] = {}


class Report(msgspec.Struct, frozen=True):
    """Report of an agent (koordgen/runtime/agent/process.py).

    Older agents lack fields that have a default here."""

    phase: str
    round: Count
    app: str = ""
    release: str = ""
    boot: str = ""
    delta: float = 0.0
    geofence: tuple[Vector, Vector] | None = None
    pose: ReportedPose | None = None
    battery: float | None = None
    goal: tuple[Vector, ...] = ()
    lines: Lines = ()
    outcomes: Outcomes = ()
    decided: float = 0.0
    shared: tuple[tuple[str, Literal["allread", "allwrite"], Count, Any], ...] = ()
    monitors: MonitorReport = MonitorReport()
    host: Computer = Computer()
    rounds: Count = 0
    current: Count = 0
    late_ms: dict[str, float] = {}
    rejected: dict[str, int] = {}
    peers: dict[str, PeerQuality] = {}
    applications: tuple[ReportedApplication, ...] = ()

    def application(self, detail: str) -> str:
        """Return the application that the detail of an outcome names; "" if the robot has only one."""
        name = detail.partition(": ")[0]
        return name if any(name == each.name for each in self.applications) else ""

    @property
    def loss(self) -> float | None:
        """Share of datagrams lost on the worst link."""
        losses = [peer.get("loss") for peer in self.peers.values()]
        return max((loss for loss in losses if isinstance(loss, (int, float))), default=None)


def read_report(plain: Any) -> Report | str:
    """Return a report, or the reason why it is invalid. NaN and lone surrogates are invalid, as in JSON."""
    try:
        return msgspec.json.decode(msgspec.json.encode(plain), type=Report)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        return f"its report cannot be read: {error}"


def completed(header: Header, report: Report) -> Header:
    """Return the header completed by a report; the same object if nothing was missing."""
    known = {variable.name for variable in header.shared}
    more = tuple(SharedVariable(name, kind, "") for name, kind, *_ in report.shared if name not in known)
    changes: dict[str, Any] = {"shared": (*header.shared, *more)} if more else {}
    if not header.app and report.app:
        changes["app"] = report.app
    if not header.delta and report.delta:
        changes["delta"] = report.delta
    if header.geofence is None and report.geofence is not None:
        changes["geofence"] = report.geofence
    composition = _composition(header, report, (*header.shared, *more))
    if composition and composition != header.composition:
        changes |= {"composition": composition, "applications": tuple([each.name for each in composition])}
    return msgspec.structs.replace(header, **changes) if changes else header


def _composition(header: Header, report: Report, shared: tuple[SharedVariable, ...]) -> tuple[ApplicationRecord, ...]:
    """Return the applications of the robots that have reported so far; empty if the fleet has only one."""
    known = () if isinstance(header.composition, msgspec.UnsetType) else header.composition
    members = {each.name: each.members for each in known} | {each.name: each.members for each in report.applications}

    def own(name: str) -> dict[str, str]:
        prefix = f"{name}."
        return {v.name.removeprefix(prefix): v.name for v in shared if v.name.startswith(prefix)}

    return tuple([ApplicationRecord(name, robots, own(name)) for name, robots in members.items()])


@dataclass
class _RobotData:
    """State of a robot, from its reports so far."""

    report: Report | None = None
    at: float | None = None  # time of the last report
    questions: int = 0
    answers: int = 0
    note: str = ""  # why the last answer is missing, or a remark on it
    silent: bool = True
    line: int = 0  # number of the last log line
    rounds: dict[str, int] = field(default_factory=dict)  # application -> last round whose result is known
    phase: str = ""
    goal: tuple[Vector, ...] = ()
    posed: float = -math.inf  # time of the last pose
    linked: float = -math.inf  # time of the last row of links
    written: dict[str, int] = field(default_factory=dict)  # variable -> round of the last write
    violated: frozenset[str] = frozenset()

    def restart(self) -> None:
        """Reset the counters: another process of this robot reports."""
        self.line = 0
        self.rounds, self.written = {}, {}


class FleetRows:
    """Converter of reports to rows. Not thread-safe."""

    def __init__(self, header: Header) -> None:
        self.header = header
        self._rows = Rows(header)
        self._more: Chunk = {}
        self._robots = [_RobotData() for _ in header.robots]

    def renew(self, header: Header) -> None:
        """Continue with a more complete header; each robot's last report is converted again."""
        before = self._robots
        self.__init__(header)  # type: ignore[misc]
        for pid, (known, old) in enumerate(zip(self._robots, before, strict=True)):
            if old.report is not None and old.at is not None:
                self.add_report(pid, old.report, old.note, old.at)
            known.questions, known.answers, known.silent, known.note = old.questions, old.answers, old.silent, old.note

    def add_report(self, pid: int, report: Report, note: str, t: float) -> None:
        """Add a report that arrived at time `t`."""
        known = self._robots[pid]
        if known.report is not None and known.report.boot != report.boot:
            self._mark(t, "restart", "its agent has restarted", pid)
            known.restart()
        if known.silent and known.at is not None:
            self._mark(t, "answers", "answers again", pid, f"was silent for {t - known.at:.1f} s")
        known.report, known.at, known.note, known.silent = report, t, note, False
        known.questions += 1
        known.answers += 1
        self._motion(pid, known, report, t)
        self._add_lines(pid, known, report, t)
        self._decided(pid, known, report, t)
        if t - known.linked >= LINKS_EVERY:
            known.linked = t
            self._rows.add(MetricsRecord(report.late_ms, report.rejected, report.peers, pid=pid), t)
        violated = frozenset(each.words for each in report.monitors.violated)
        for each in report.monitors.violated:
            if each.words not in known.violated:
                detail = ": ".join(filter(None, (each.line, each.why)))
                self._mark(t, "monitor", f"{each.words}: violated", pid, detail)
        for words in sorted(known.violated - violated):
            self._mark(t, "monitor", f"{words}: no longer violated", pid)
        known.violated = violated

    def miss(self, pid: int, note: str, t: float) -> None:
        """Record that a robot did not answer at time `t`."""
        known = self._robots[pid]
        known.questions += 1
        known.note = note
        if not known.silent and t - (known.at or 0.0) > FRESH:
            known.silent = True
            self._mark(t, "silent", "does not answer", pid, note)

    def taken(self, t: float) -> Chunk:
        """Return the rows since the last call, by table; `t` is the present time."""
        chunk, more, self._more = self._rows.taken(), self._more, {}
        chunk.pop("near", None)  # it includes silent robots
        for table, rows in more.items():
            chunk.setdefault(table, []).extend(rows)
        if chunk.get("poses") and (near := self._closest(t)) is not None:
            chunk["near"] = [near]
        return chunk

    def table(self) -> list[dict[str, Any]]:
        """Return the latest data of each robot, by pid. `at`: arrival of its report; None: it never answered."""
        return [self._entry(known) for known in self._robots]

    def _entry(self, known: _RobotData) -> dict[str, Any]:
        entry: dict[str, Any] = {
            "at": known.at, "silent": known.silent, "note": known.note, "questions": known.questions,
            "answers": known.answers,
        }  # fmt: skip
        report = known.report
        if report is None:
            return entry
        return entry | {
            "phase": report.phase, "round": report.round, "app": report.app, "release": report.release,
            "battery": report.battery, "pose": report.pose, "loss": report.loss, "host": report.host,
            "current": report.current / report.rounds if report.rounds else None, "late": report.late_ms.get("p99"),
            "applications": report.applications,
            "violated": [each.words for each in report.monitors.violated], "properties": report.monitors.counts,
        }  # fmt: skip

    def _motion(self, pid: int, known: _RobotData, report: Report, t: float) -> None:
        if report.phase != known.phase:
            known.phase = report.phase
            self._rows.add(Phase(report.phase, pid=pid), t)
        pose = report.pose
        if pose is not None and t - pose.age > known.posed + 1e-3 and all(map(math.isfinite, pose.position)):
            known.posed = t - pose.age
            self._rows.add(PoseRecord(pid, pose.position, pose.yaw or 0.0), known.posed)
        if report.goal != known.goal:
            known.goal = report.goal
            self._add("paths", [pid, round(t, 3), report.goal])

    def _add_lines(self, pid: int, known: _RobotData, report: Report, t: float) -> None:
        for number, age, _, level, text in report.lines:
            if number <= known.line:
                continue
            if known.line and number > known.line + 1:
                lost = f"{number - known.line - 1} lines before this one arrived too fast to be shown"
                self._rows.add(LogLine("warning", lost, pid=pid), t - age)
            known.line = number
            self._rows.add(LogLine(level, text, pid=pid), t - age)

    def _decided(self, pid: int, known: _RobotData, report: Report, t: float) -> None:
        """Add rows of decided rounds and of the shared variables that they wrote."""
        runs = [(first, outcome, detail, late) for first, _, outcome, detail, late in report.outcomes]
        last = max((first + len(late) - 1 for first, _, _, late in runs), default=0)
        delta = report.delta or self.header.delta

        def when(number: int) -> float:
            return t - report.decided - (last - number) * delta

        new: list[Round] = []
        for first, outcome, detail, late in runs:
            application = report.application(detail)
            for number, late_ms in enumerate(late, first):
                if number > known.rounds.get(application, 0):
                    known.rounds[application] = number
                    told = Round(
                        number, detail if outcome == "event" else None, detail if outcome == "skipped" else None,
                        EventFault("", 0, detail) if outcome == "fault" else None, late_ms / 1e3, pid=pid,
                    )  # fmt: skip
                    new.append(told)
        for told in sorted(new, key=lambda each: each.round):  # runs of several applications overlap
            self._rows.add(told, when(told.round))
        for name, _, number, value in report.shared:
            if number > known.written.get(name, -1):
                known.written[name] = number
                self._add("shared", [name, pid, round(when(number) if number else t, 3), number, value])

    def _closest(self, t: float) -> list[Any] | None:
        """Return the closest pair of the robots whose positions are known now."""
        places = [
            (pid, known.report.pose.position)
            for pid, known in enumerate(self._robots)
            if self.header.robots[pid].target != SQUAD  # its robots have places of their own
            and known.report is not None
            and known.report.pose is not None
            and t - known.posed <= FRESH
        ]
        pairs = ((math.dist(a, b), i, j) for (i, a), (j, b) in itertools.combinations(places, 2))
        apart, i, j = min(pairs, default=(math.inf, 0, 0))
        return [round(t, 3), round(apart, 3), i, j] if math.isfinite(apart) else None

    def _mark(self, t: float, kind: str, what: str, pid: int, detail: str = "") -> None:
        self._add("marks", [round(t, 3), kind, what, [self.header.robots[pid].name], detail])

    def _add(self, table: str, row: list[Any]) -> None:
        self._more.setdefault(table, []).append(row)


# Rows per series that a page receives when opened: per robot, or per writer of a shared variable.
MOST = {"poses": 1200, "rounds": 2000, "late": 300, "links": 150, "logs": 200, "phases": 50, "paths": 100, "shared": 30}
MOST_OF_ALL = {"marks": 300, "near": 1500, "markers": 300}
ALL_POSES, ALL_ROUNDS = 40_000, 40_000


class LatestRows:
    """The latest rows of each series: a dashboard may be open for days."""

    def __init__(self, header: Header) -> None:
        robots = max(1, len(header.robots))
        self._most = MOST | {"poses": min(MOST["poses"], ALL_POSES // robots)}
        self._most["rounds"] = min(MOST["rounds"], ALL_ROUNDS // robots)
        self._kept: dict[str, dict[Any, deque[list[Any]]]] = {}

    def extend(self, chunk: Chunk) -> None:
        """Add rows, each table's in order of time."""
        for table, rows in chunk.items():
            series = self._kept.setdefault(table, {})
            for row in rows:
                key = None if table in MOST_OF_ALL else tuple(row[:2]) if table == "shared" else row[0]
                if key not in series:
                    series[key] = deque(maxlen=MOST_OF_ALL.get(table) or self._most[table])
                series[key].append(row)

    def whole(self) -> Chunk:
        """Return all kept rows, by table."""
        return {table: list(self._all(series)) for table, series in self._kept.items()}

    def _all(self, series: dict[Any, deque[list[Any]]]) -> Iterator[list[Any]]:
        return itertools.chain.from_iterable(series.values())
