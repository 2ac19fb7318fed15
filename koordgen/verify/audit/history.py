"""History of each robot in one mission: the records of rounds, and gaps with unknown values."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from koordgen.lang.semantics.composition import Application
from koordgen.runtime.program.runner import LEFT
from koordgen.runtime.trace.schema import BadTrace
from koordgen.verify.audit.trace_files import LOST, TraceFile
from koordgen.verify.replay.trace import TraceLine

FOREVER = 1 << 60
# detail text of the phase record that an agent writes when it schedules round 1
_MISSION = re.compile(r"mission ([0-9a-f]{1,64}), round 1 at (-?\d{1,15}(?:\.\d{1,9})?) s of fleet time")


class Gap(NamedTuple):
    """Gap in a history: the rounds from `since` to the round before `until`, with the cause `why`."""

    since: int
    until: int
    why: str


def _why(gaps: Sequence[Gap], round_: int) -> str | None:
    return next((gap.why for gap in gaps if gap.since <= round_ < gap.until), None)


@dataclass
class ProcessLife:
    """Records of one process run, from the start of a robot's agent process to its end.

    The records are in the order of the trace. If the trace of a process run has several parts, each part has a
    ProcessLife of its own.

    `log`: the trace file that contains the records.
    `mission`: id of the mission in which the process took part; empty if unknown."""

    log: TraceFile
    pid: int
    mission: str = ""
    start: float | None = None  # fleet time at which round 1 begins, in seconds
    lines: list[TraceLine] = field(default_factory=list)

    @property
    def continues(self) -> bool:
        """Return whether an earlier part of the trace contains the start of the process."""
        return bool(self.lines and self.lines[0].record.get("part"))

    @property
    def has_rounds(self) -> bool:
        """Return whether the records contain at least one round."""
        return any(line.record["kind"] == "round" for line in self.lines)


@dataclass
class RobotHistory:
    """History of one robot in the mission.

    `lives`: records of the robot's process runs; empty if there is no trace of the robot.
    `lacks`: whether parts of the trace are missing.
    `since`: the first round whose values are known; above 0 only if parts of the trace are missing.
    `rounds`: number of the round -> record of the round.
    `turns`: number of a round -> the robot's locals and actuators at the start of this round, if they changed without a
        recorded event; None if they became unknown.
    `acts`: rounds in which the robot may have written values without a record.
    `out`: rounds in which the robot had stopped, so that the audit ignores it.
    `away`: rounds in which the robot was removed from the fleet by the other robots, so that the audit ignores it."""

    pid: int
    name: str
    lives: list[ProcessLife] = field(default_factory=list)
    lacks: bool = False
    since: int = 0
    init: Mapping[str, Any] | None = None
    rounds: dict[int, TraceLine] = field(default_factory=dict)
    turns: dict[int, Mapping[str, Any] | None] = field(default_factory=dict)
    acts: list[Gap] = field(default_factory=list)
    out: list[Gap] = field(default_factory=list)
    away: list[Gap] = field(default_factory=list)
    # rounds without a record, because the process restarted or a line of the trace cannot be read
    quiet: list[Gap] = field(default_factory=list)
    monitors: list[Mapping[str, Any]] = field(default_factory=list)

    @property
    def last(self) -> int:
        """Return the last recorded round; 0 if only `init` is recorded, -1 if nothing is recorded."""
        return max(self.rounds, default=0 if self.init is not None else -1)

    def may_act(self, round_: int) -> bool:
        """Return whether the robot may have written shared variables in a round without a record.

        Returns False for a round in which the robot was removed from the fleet, since other robots then ignore its
        writes."""
        return _why(self.acts, round_) is not None and _why(self.away, round_) is None

    def out_at(self, round_: int) -> str:
        """Return the reason why the robot takes no part in a round, such as a stop; empty if it takes part."""
        return _why(self.out, round_) or _why(self.away, round_) or ""

    def silent(self, round_: int) -> str:
        """Return a text for the user that explains why the robot's values in a round are unknown."""
        if not self.lives:
            return f"there is no trace of {self.name}"
        if self.out_at(round_):
            return f"{self.name} had left the model ({self.out_at(round_)})"
        why = _why(self.acts, round_) or _why(self.quiet, round_)
        if why or round_ not in self.rounds:
            return f"{self.name} recorded nothing" + (f": {why}" if why else "")
        return f"{self.name}'s trace does not contain the value"


@dataclass
class FleetMission:
    """One mission of a fleet, read from the trace files of its robots.

    `start`: fleet time at which round 1 began, in seconds; None if unknown.
    `notes`: remarks for the user about missing, ignored or damaged traces.
    `cut`: whether lines or parts of a trace are unreadable or missing."""

    name: str
    app: str
    delta: float
    start: float | None
    histories: list[RobotHistory]
    notes: list[str]
    cut: bool
    log: TraceFile  # one of the trace files; all files belong to the same program
    step: bool = False  # whether the run replayed a counterexample of a single step

    @property
    def first(self) -> int:
        """Return the first round that some trace records; 0 if a trace records `init`."""
        return min((history.since for history in self.histories if history.lives), default=0)

    @property
    def last(self) -> int:
        """Return the last round that a robot recorded while it took part in the mission."""
        return max((max((r for r in s.rounds if not s.out_at(r)), default=0) for s in self.histories), default=0)


def mission(logs: Sequence[TraceFile]) -> FleetMission:
    """Return the mission in which all given traces take part. Raises BadTrace if there is no such mission."""
    logs, old = _of_one_version(_by_age(logs))
    _same(logs)
    lives = _joined([life for log in logs for life in _lives(log)])
    names: dict[int, str] = {}
    for log in logs:
        for pid, name in log.names.items():
            if names.setdefault(pid, name) != name:
                other = next(each.path for each in logs if each.names.get(pid) == names[pid])
                raise BadTrace(f"{log.path}: robot {pid} is named {name}; in {other} it is named {names[pid]}")
    chosen = _chosen(lives)
    notes = [f"{log.path} is of an earlier version of the program, and is ignored" for log in old]
    notes += [f"{log.path}:{flaw.number}: {flaw.what}" for log in logs for flaw in log.flaws[:5]]
    notes += [f"{log.path}: {len(log.flaws) - 5} more lines are no records" for log in logs if len(log.flaws) > 5]
    left = {(life.pid, life.mission): life.log.path for life in lives if life.mission not in (chosen, "")}
    notes += [f"{path}: {names[pid]}'s part in mission {mission_} is ignored" for (pid, mission_), path in left.items()]
    histories = [RobotHistory(pid, names.get(pid, f"robot {pid}")) for pid in range(logs[0].n_sys)]
    for life in lives:
        if life.mission in (chosen, ""):
            histories[life.pid].lives.append(life)
    for history in histories:
        _build_rounds(history)
    _views(histories)
    notes[:0] = [
        f"{history.name}'s trace begins in round {history.since}: the older parts are missing (a robot deletes "
        "them when its trace reaches trace_limit)"
        for history in histories
        if history.since
    ]
    missing = [history.name for history in histories if not history.lives]
    if missing:
        notes.insert(0, f"there is no trace of {', '.join(missing)}")
    starts = [life.start for life in lives if life.mission == chosen and life.start is not None]
    cut = any(log.flaws for log in logs) or bool(missing) or any(history.lacks for history in histories)
    start, log = starts[0] if starts else None, logs[0]
    return FleetMission(chosen, log.app, log.delta, start, histories, notes, cut, log, log.step)


def of_application(whole: FleetMission, application: Application) -> FleetMission:
    """Return the part of a mission that concerns one application: the histories of its members, by their pids in it.

    `whole`: the mission of the fleet, whose histories have the records of all applications."""
    name, histories = application.name, list[RobotHistory]()
    for pid, robot in enumerate(application.members):
        of_robot = whole.histories[robot]
        lives = [
            replace(life, lines=[line for line in life.lines if line.record.get("application", name) == name])
            for life in of_robot.lives
        ]
        history = RobotHistory(pid, of_robot.name, lives, away=of_robot.away)
        _build_rounds(history)
        histories.append(history)
    return replace(whole, histories=histories, notes=[])


def _by_age(logs: Sequence[TraceFile]) -> list[TraceFile]:
    """Return the trace files sorted by robot, and the files of one robot by age, the oldest file first."""
    order = {family: k for k, family in enumerate(dict.fromkeys(log.family for log in logs))}
    return sorted(logs, key=lambda log: (order[log.family], log.age))


def _of_one_version(logs: Sequence[TraceFile]) -> tuple[list[TraceFile], list[TraceFile]]:
    """Split trace files into files of the version that a robot ran last, and files of earlier versions."""
    newest = {log.family: (log.program_hash, log.n_sys) for log in logs}
    kept: list[TraceFile] = []
    old: list[TraceFile] = []
    for log in logs:
        (kept if (log.program_hash, log.n_sys) == newest[log.family] else old).append(log)
    return kept, old


def _joined(lives: Sequence[ProcessLife]) -> list[ProcessLife]:
    """Set the mission of process runs whose records do not name a mission, and return all process runs.

    The mission is taken from a later part of the same process run. A process run that ended before its first round, and
    before it joined a mission, is left out if another process run follows in the same files."""
    joined: list[ProcessLife] = []
    # files of a robot -> the next later process run in these files
    later: dict[tuple[Path, int, int], ProcessLife] = {}
    for life in reversed(lives):
        follower = later.get((*life.log.family, life.pid))
        if follower is not None and follower.continues and not life.mission:
            life.mission, life.start = follower.mission, follower.start
        later[(*life.log.family, life.pid)] = life
        if follower is None or life.mission or life.has_rounds:
            joined.append(life)
    return joined[::-1]


def _same(logs: Sequence[TraceFile]) -> None:
    """Check that all trace files belong to one program and one fleet. Raises BadTrace otherwise."""
    first = logs[0]
    for log in logs[1:]:
        for what, mine, its in (
            ("program", first.app, log.app),
            ("version of the program", first.program_hash, log.program_hash),
            ("number of robots", first.n_sys, log.n_sys),
            ("delta", first.delta, log.delta),
        ):
            if mine != its:
                raise BadTrace(f"{first.path} and {log.path} differ in the {what}: {mine} and {its}")


def _lives(log: TraceFile) -> Iterator[ProcessLife]:
    """Yield the process runs in a trace file, in the order of the file.

    A process run may lack the records of some rounds, of `init`, or of the mission."""
    current: dict[int, ProcessLife] = {}
    for line in log.lines:
        record = line.record
        kind = record["kind"]
        begins = kind == "header" or (kind == "phase" and record["phase"] == "starting" and not record.get("detail"))
        for pid in log.names if line.pid < 0 else [line.pid]:
            life = current.get(pid)
            if life is None or (begins and any(each.record["kind"] not in ("header", "phase") for each in life.lines)):
                if life is not None:
                    yield life
                life = current[pid] = ProcessLife(log, pid)
            life.lines.append(line)
            told = _MISSION.match(record.get("detail", "")) if kind == "phase" else None
            if told:
                life.mission, life.start = told[1], float(told[2])
    yield from current.values()


def _chosen(lives: Sequence[ProcessLife]) -> str:
    """Return the id of the last mission that the traces of all robots name.

    Returns an empty text if no trace names a mission.
    All files that one robot wrote in one folder count as one trace. Raises BadTrace if there is no common mission."""
    # files of one robot in one folder -> (id of a mission -> the last file that names the mission)
    named: dict[tuple[Path, int], dict[str, Path]] = {}
    for life in lives:
        if life.mission:
            named.setdefault(life.log.family, {})[life.mission] = life.log.path
    if not named:
        return ""
    first, *others = named.values()
    common = [mission for mission in first if all(mission in other for other in others)]
    if common:
        return common[-1]
    odd = next((other for other in others if not set(first) & set(other)), others[0])
    (mine, path), (its, other) = list(first.items())[-1], list(odd.items())[-1]
    raise BadTrace(f"{path} and {other} are of different missions of the fleet: {mine} and {its}")


def _build_rounds(history: RobotHistory) -> None:
    """Build the history of a robot from its process runs. Raises BadTrace if two files record one round."""
    history.lives.sort(key=_order)
    builder = _HistoryBuilder(history)
    for life in history.lives:
        builder.live(life)
    builder.end()


def _order(life: ProcessLife) -> tuple[int, int]:
    """Return the sort key of a process run: its first recorded round, then its first line in the file."""
    first = FOREVER
    for line in life.lines:
        if line.record["kind"] in ("init", "round"):
            first = min(first, line.record.get("round", 0))
        elif line.record["kind"] == "checkpoint":
            first = min(first, line.record["round"] + 1)
    return first, life.lines[0].number


class _HistoryBuilder:
    """Builder of the history of one robot. Reads the records of the robot's process runs in order."""

    def __init__(self, history: RobotHistory) -> None:
        self.history = history
        self.previous = -1  # last round read from the records; 0 for `init`, -1 for no round
        # Reason why records of rounds after `previous` may be missing; empty if no record is missing.
        self.doubt = ""
        # Whether the reason in `doubt` is a restart or a missing trace, not an unreadable line.
        self.came_back = False
        self.stopping = False  # whether the robot has stopped in the present process run
        self.stopped = 0.0  # time of the stop in seconds
        self.times: list[tuple[float, int]] = []  # (time, number) of each round in the present process run
        self.left = FOREVER  # first round after the robot had left the mission
        self.whose: dict[int, Path] = {}  # number of a round -> file that records the round

    def live(self, life: ProcessLife) -> None:
        history = self.history
        if not life.continues:
            self.stopping, self.stopped, self.times, self.left = False, 0.0, [], FOREVER
            if life is not history.lives[0]:
                self.doubt, self.came_back = self.doubt or "its process had ended and was started again", True
        for line in life.lines:
            record = line.record
            match record["kind"]:
                case "init":
                    self.own(life, 0)
                    history.init, self.previous, self.doubt, self.came_back = record, 0, "", False
                case "checkpoint":
                    self.checkpoint(record)
                case "round":
                    self.left = min(self.left, record["round"] if record.get("skipped") == LEFT else FOREVER)
                    if self.own(life, record["round"]):
                        self.times.append((_time(record), record["round"]))
                        self.round(life, line)
                case "monitor":
                    history.monitors.append(record)
                case "phase" if record["phase"] == "stopping" and not self.stopping:
                    self.stopped, self.stopping = _time(record), True
                    history.out.append(Gap(0, FOREVER, record.get("detail", "") or "the robot had stopped"))
                case kind if kind == LOST:
                    self.doubt = self.doubt or f"{life.log.path}:{line.number} cannot be read"
                case _:
                    pass
        if self.stopping:
            since = max([r for time, r in self.times if time <= self.stopped], default=self.previous)
            history.out[-1] = history.out[-1]._replace(since=min(since + 1, self.left))
        elif self.left < FOREVER:  # the robot left the mission, but the record of its stop is missing or unreadable
            self.stopping = True
            history.out.append(Gap(self.left, FOREVER, "the robot had stopped"))

    def checkpoint(self, record: Mapping[str, Any]) -> None:
        """Read the checkpoint that begins a part of a trace. Earlier rounds without a record become unknown."""
        history, round_ = self.history, record["round"]
        if round_ > self.previous:
            self.lose(Gap(self.previous + 1, round_ + 1, self.doubt or "older parts of its trace are missing"))
            history.turns[round_ + 1] = record.get("own")
            history.lacks = True
            if self.previous < 0:
                history.since = round_ + 1
            self.previous = round_
        self.doubt, self.came_back = "", False

    def own(self, life: ProcessLife, round_: int) -> bool:
        """Return whether the history has no record of the round yet.

        Raises BadTrace if another file records this round."""
        before = self.whose.setdefault(round_, life.log.path)
        if before != life.log.path:
            what = f"round {round_}" if round_ else "its init"
            raise BadTrace(
                f"{before} and {life.log.path} are both of robot {self.history.name}, and both record {what}"
            )
        return round_ not in self.history.rounds

    def round(self, life: ProcessLife, line: TraceLine) -> None:
        history, round_ = self.history, line.record["round"]
        if self.previous < 0 and not self.doubt:
            self.doubt, self.came_back, history.lacks = f"{life.log.path} begins in round {round_}", True, True
        if self.doubt and round_ > self.previous:
            self.join(life, Gap(self.previous + 1, round_, self.doubt))
            self.doubt, self.came_back = "", False
        # the robot had stopped in an earlier process run, but has run again since round `round_`
        if history.out and history.out[-1].until == FOREVER and not self.stopping:
            history.out[-1] = history.out[-1]._replace(until=round_)
        history.rounds[round_] = line
        self.previous = max(self.previous, round_)

    def join(self, life: ProcessLife, gap: Gap) -> None:
        """Add a gap to the history. If the robot restarted, also add the locals and actuators that it restored."""
        self.history.quiet.append(gap)
        records = (line.record for line in life.lines if line.record["kind"] == "round")
        restored = next((r["restored"] for r in records if r.get("restored")), None) if self.came_back else None
        if self.previous < 0 and self.history.lacks:
            self.history.since = gap.until if restored is None else max(0, restored["round"])
        if restored is None:
            if self.came_back or gap.until > gap.since:
                self.lose(gap)
        elif restored["round"] >= gap.since:
            self.lose(gap._replace(until=restored["round"] + 1))
            self.history.turns[restored["round"]] = restored

    def lose(self, gap: Gap) -> None:
        self.history.acts.append(gap)
        self.history.turns[gap.since] = None

    def end(self) -> None:
        """Add the rounds after the last record as a gap, unless the robot had stopped."""
        lives = self.history.lives
        if not lives:
            self.lose(Gap(0, FOREVER, "the robot has no trace"))
        elif self.doubt or not self.stopping:
            why = self.doubt or f"its trace {lives[-1].log.path} ends earlier"
            self.lose(Gap(self.previous + 1, FOREVER, why))


def _time(record: Mapping[str, Any]) -> float:
    return float(record.get("time", record.get("t", 0.0)))


def _views(histories: Sequence[RobotHistory]) -> None:
    """Add to each history the rounds in which the robot was removed from the fleet by the other robots."""
    views = {
        line.record["number"]: line.record
        for history in histories
        for life in history.lives
        for line in life.lines
        if line.record["kind"] == "view" and len(line.record["members"]) == len(histories)
    }
    since: dict[int, int] = {}
    for _, view in sorted(views.items()):
        for history, member in zip(histories, view["members"], strict=True):
            if member < 0:
                since.setdefault(history.pid, view["since"])
            elif history.pid in since:
                history.away.append(
                    Gap(since.pop(history.pid), view["since"], "the other robots had removed the robot from the fleet")
                )
    for pid, first in since.items():
        histories[pid].away.append(Gap(first, FOREVER, "the other robots had removed the robot from the fleet"))
