"""History of each robot in one mission, round by round, with the gaps in which its state is unknown."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from koordgen.runtime.program.runner import LEFT
from koordgen.runtime.trace.schema import BadTrace
from koordgen.verify.audit.trace_files import LOST, TraceFile
from koordgen.verify.replay.trace import TraceLine

FOREVER = 1 << 60
# Format of the phase record that an agent writes when its first round is scheduled.
_MISSION = re.compile(r"mission ([0-9a-f]{1,64}), round 1 at (-?\d{1,15}(?:\.\d{1,9})?) s of fleet time")


class Gap(NamedTuple):
    """Rounds of which a robot has no record: from `since` to the round before `until`. `why` is the cause."""

    since: int
    until: int
    why: str


def _why(gaps: Sequence[Gap], round_: int) -> str | None:
    return next((gap.why for gap in gaps if gap.since <= round_ < gap.until), None)


@dataclass
class ProcessLife:
    """Records of one process run: of the time from one start of a robot's process to its end.

    The records are in the order of the trace. A process run whose trace has several parts has one object per part.

    `mission`: id of the mission in which the process took part; empty if unknown."""

    log: TraceFile
    pid: int
    mission: str = ""
    start: float | None = None  # fleet time at which round 1 begins, in seconds
    lines: list[TraceLine] = field(default_factory=list)

    @property
    def continues(self) -> bool:
        """Return whether these records are a later part of a trace.

        Then an earlier part contains the start of the process."""
        return bool(self.lines and self.lines[0].record.get("part"))

    @property
    def has_rounds(self) -> bool:
        """Return whether the records contain a round."""
        return any(line.record["kind"] == "round" for line in self.lines)


@dataclass
class RobotHistory:
    """History of one robot in the mission.

    `lives`: records of the robot's process runs; empty if there is no trace of the robot.
    `lacks`: whether parts of the trace are missing.
    `since`: the first round whose values are known; above 0 only if parts of the trace are missing.
    `rounds`: round -> record.
    `turns`: round -> values (`locals` and `actuators`) that the robot's own variables get at the start of this round;
        None if they become unknown.
    `acts`: rounds in which the robot may have written values without a record.
    `out`: rounds in which the robot had stopped, so that it is outside of the model.
    `away`: rounds in which the other robots had removed it from the fleet, so that it is outside of the model."""

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
    # rounds without a record because the process restarted or a line of the trace is broken
    quiet: list[Gap] = field(default_factory=list)
    monitors: list[Mapping[str, Any]] = field(default_factory=list)

    @property
    def last(self) -> int:
        """Return the last round with a record; 0 if only `init` is recorded, -1 if there is no record."""
        return max(self.rounds, default=0 if self.init is not None else -1)

    def may_act(self, round_: int) -> bool:
        """Return whether the robot may have written values in this round without a record.

        Returns False if the other robots had removed the robot by then, since they ignore its writes."""
        return _why(self.acts, round_) is not None and _why(self.away, round_) is None

    def out_at(self, round_: int) -> str:
        """Return the reason why the robot is outside of the model in a round; empty if it is in the model."""
        return _why(self.out, round_) or _why(self.away, round_) or ""

    def silent(self, round_: int) -> str:
        """Return a text that explains why the robot's values in a round are unknown."""
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
    """One mission of a fleet, from all trace files.

    `notes`: remarks about the traces that the user should know.
    `cut`: whether a trace file ends within a record."""

    name: str
    app: str
    delta: float
    start: float | None
    histories: list[RobotHistory]
    notes: list[str]
    cut: bool
    log: TraceFile  # one of the trace files; all of them belong to the same program
    step: bool = False  # whether the run executed a counterexample of a single step

    @property
    def first(self) -> int:
        """Return the first round that a trace records; 0 if everything from `init` on is recorded."""
        return min((history.since for history in self.histories if history.lives), default=0)

    @property
    def last(self) -> int:
        """Return the last round to evaluate: the last one recorded by a robot that is in the model then."""
        return max((max((r for r in s.rounds if not s.out_at(r)), default=0) for s in self.histories), default=0)


def mission(logs: Sequence[TraceFile]) -> FleetMission:
    """Return the only mission that all trace files contain. Raises BadTrace."""
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


def _by_age(logs: Sequence[TraceFile]) -> list[TraceFile]:
    """Return the trace files ordered by robot.

    The files of one robot are ordered by age, the oldest first."""
    order = {family: k for k, family in enumerate(dict.fromkeys(log.family for log in logs))}
    return sorted(logs, key=lambda log: (order[log.family], log.age))


def _of_one_version(logs: Sequence[TraceFile]) -> tuple[list[TraceFile], list[TraceFile]]:
    """Return the files of the program version that each robot ran last, and the files of earlier versions."""
    newest = {log.family: (log.program_hash, log.n_sys) for log in logs}
    kept: list[TraceFile] = []
    old: list[TraceFile] = []
    for log in logs:
        (kept if (log.program_hash, log.n_sys) == newest[log.family] else old).append(log)
    return kept, old


def _joined(lives: Sequence[ProcessLife]) -> list[ProcessLife]:
    """Return the process runs, each with its mission.

    A part of a trace without a mission gets the mission that a later part of the same process run names. Records of a
    robot that restarted before its first round belong to no mission and are left out."""
    joined: list[ProcessLife] = []
    later: dict[tuple[Path, int, int], ProcessLife] = {}  # the process run that follows in the same files
    for life in reversed(lives):
        follower = later.get((*life.log.family, life.pid))
        if follower is not None and follower.continues and not life.mission:
            life.mission, life.start = follower.mission, follower.start
        later[(*life.log.family, life.pid)] = life
        if follower is None or life.mission or life.has_rounds:
            joined.append(life)
    return joined[::-1]


def _same(logs: Sequence[TraceFile]) -> None:
    """Check that all files belong to the same program and fleet. Raises BadTrace if they do not."""
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
    """Yield the records of each process run in a file, in the file's order.

    The records of a process run may lack any round, `init`, or the mission."""
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
    """Return the mission in which all robots' files take part.

    All files that one robot wrote in one folder are treated as one. Returns an empty text if no file names a mission.
    Raises BadTrace if there is no common mission."""
    # for each robot's files: mission -> the last file that names it
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
    """Build a robot's history from the records of its process runs. Raises BadTrace."""
    history.lives.sort(key=_order)
    teller = _HistoryBuilder(history)
    for life in history.lives:
        teller.live(life)
    teller.end()


def _order(life: ProcessLife) -> tuple[int, int]:
    """Return a sort key for process runs: the first recorded round, then the position in the file."""
    first = FOREVER
    for line in life.lines:
        if line.record["kind"] in ("init", "round"):
            first = min(first, line.record.get("round", 0))
        elif line.record["kind"] == "checkpoint":
            first = min(first, line.record["round"] + 1)
    return first, life.lines[0].number


class _HistoryBuilder:
    """Builder of one robot's history from the records of its process runs."""

    def __init__(self, history: RobotHistory) -> None:
        self.history = history
        self.previous = -1  # last round with a record; 0 for `init`, -1 for none
        self.doubt = ""  # reason why there may be rounds after `previous` without a record; empty if there are none
        self.came_back = False  # whether `doubt` is due to a restart or to a missing trace, not to a broken line
        # whether the robot has stopped in the present process run, and the time of the stop
        self.stopping, self.stopped = False, 0.0
        self.times: list[tuple[float, int]] = []  # (time, number) of each recorded round
        self.left = FOREVER  # first round in which the robot had left the mission
        self.whose: dict[int, Path] = {}  # round -> the file that records it

    def live(self, life: ProcessLife) -> None:
        history = self.history
        if not life.continues:
            self.stopping, self.stopped, self.times, self.left = False, 0.0, [], FOREVER
            if life is not history.lives[0]:
                self.doubt, self.came_back = self.doubt or "its process had ended, and began anew", True
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
                    history.out.append(Gap(0, FOREVER, record.get("detail", "") or "it had come to rest"))
                case kind if kind == LOST:
                    self.doubt = self.doubt or f"{life.log.path}:{line.number} cannot be read"
                case _:
                    pass
        if self.stopping:
            since = max([r for time, r in self.times if time <= self.stopped], default=self.previous)
            history.out[-1] = history.out[-1]._replace(since=min(since + 1, self.left))
        elif self.left < FOREVER:  # the robot left the mission, but the record of its stop cannot be read
            self.stopping = True
            history.out.append(Gap(self.left, FOREVER, "it had come to rest"))

    def checkpoint(self, record: Mapping[str, Any]) -> None:
        """Begin the next part of the trace. Rounds before it without a record become unknown."""
        history, round_ = self.history, record["round"]
        if round_ > self.previous:
            self.lose(Gap(self.previous + 1, round_ + 1, self.doubt or "older parts of its trace are not there"))
            history.turns[round_ + 1] = record.get("own")
            history.lacks = True
            if self.previous < 0:
                history.since = round_ + 1
            self.previous = round_
        self.doubt, self.came_back = "", False

    def own(self, life: ProcessLife, round_: int) -> bool:
        """Return whether this is the first record of a round.

        Raises BadTrace if another file records the same round."""
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
            self.doubt, self.came_back, history.lacks = f"{life.log.path} begins there", True, True
        if self.doubt and round_ > self.previous:
            self.join(life, Gap(self.previous + 1, round_, self.doubt))
            self.doubt, self.came_back = "", False
        # the robot had stopped in an earlier process run, and now runs again
        if history.out and history.out[-1].until == FOREVER and not self.stopping:
            history.out[-1] = history.out[-1]._replace(until=round_)
        history.rounds[round_] = line
        self.previous = max(self.previous, round_)

    def join(self, life: ProcessLife, gap: Gap) -> None:
        """Add the gap before a record, and the state that a restarted robot restored."""
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
        """Add the rounds after the last record as a gap, unless the robot certainly stopped."""
        lives = self.history.lives
        if not lives:
            self.lose(Gap(0, FOREVER, "the robot has no trace"))
        elif self.doubt or not self.stopping:
            why = self.doubt or f"its trace ends there ({lives[-1].log.path})"
            self.lose(Gap(self.previous + 1, FOREVER, why))


def _time(record: Mapping[str, Any]) -> float:
    return float(record.get("time", record.get("t", 0.0)))


def _views(histories: Sequence[RobotHistory]) -> None:
    """Add the rounds in which other robots had removed a robot from the fleet."""
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
                history.away.append(Gap(since.pop(history.pid), view["since"], "the other robots had removed it"))
    for pid, first in since.items():
        histories[pid].away.append(Gap(first, FOREVER, "the other robots had removed it"))
