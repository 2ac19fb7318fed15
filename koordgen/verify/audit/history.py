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
# Format of an agent's phase record when its rounds begin.
_MISSION = re.compile(r"mission ([0-9a-f]{1,64}), round 1 at (-?\d{1,15}(?:\.\d{1,9})?) s of fleet time")


class Gap(NamedTuple):
    """Rounds from `since` to before `until` without a record of a robot, and the cause."""

    since: int
    until: int
    why: str


def _why(gaps: Sequence[Gap], round_: int) -> str | None:
    return next((gap.why for gap in gaps if gap.since <= round_ < gap.until), None)


@dataclass
class ProcessLife:
    """One start of a robot's process, with its records in their order."""

    log: TraceFile
    pid: int
    mission: str = ""
    start: float | None = None  # fleet time of round 1, s
    lines: list[TraceLine] = field(default_factory=list)

    @property
    def continues(self) -> bool:
        """Return whether this is a later part of the trace of one start."""
        return bool(self.lines and self.lines[0].record.get("part"))

    @property
    def tells(self) -> bool:
        """Return whether it has a record of any round."""
        return any(line.record["kind"] == "round" for line in self.lines)


@dataclass
class RobotHistory:
    """One robot in the mission.

    `lives`: empty if there is no trace of it. `turns`: at the start of a round its own variables get these values (with
    `locals` and `actuators`), or become unknown (None). `acts`: rounds in which it may have written values without a
    record. `out`: rounds in which it had stopped; `away`: in which the others had removed it; in both it is outside of
    the model. `lacks`: parts of its trace are missing; then `since` is the first round that is known."""

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
    quiet: list[Gap] = field(default_factory=list)  # gaps that another life, or a broken line, causes
    monitors: list[Mapping[str, Any]] = field(default_factory=list)

    @property
    def last(self) -> int:
        """Return the last round with a record; 0 for `init` only, -1 for none."""
        return max(self.rounds, default=0 if self.init is not None else -1)

    def may_act(self, round_: int) -> bool:
        """Return whether it may have written in a round without a record, and the others accept its writes."""
        return _why(self.acts, round_) is not None and _why(self.away, round_) is None

    def out_at(self, round_: int) -> str:
        """Return why the robot is outside of the model in a round; empty while it is in the model."""
        return _why(self.out, round_) or _why(self.away, round_) or ""

    def silent(self, round_: int) -> str:
        """Return in words why the robot's part of a round is unknown."""
        if not self.lives:
            return f"there is no trace of {self.name}"
        if self.out_at(round_):
            return f"{self.name} had left the model ({self.out_at(round_)})"
        why = _why(self.acts, round_) or _why(self.quiet, round_)
        if why or round_ not in self.rounds:
            return f"{self.name} recorded nothing" + (f": {why}" if why else "")
        return f"{self.name}'s trace does not contain it"


@dataclass
class FleetMission:
    """One mission of a fleet, from all trace files. `notes` are for the user."""

    name: str
    app: str
    delta: float
    start: float | None
    histories: list[RobotHistory]
    notes: list[str]
    cut: bool
    log: TraceFile  # one of the files; all are of the same program
    step: bool = False  # the run executed a counterexample of one step

    @property
    def first(self) -> int:
        """Return the first round that a trace records. 0: everything is recorded, from `init` on."""
        return min((history.since for history in self.histories if history.lives), default=0)

    @property
    def last(self) -> int:
        """Return the last round to evaluate: the last one in which a robot in the model has a record."""
        return max((max((r for r in s.rounds if not s.out_at(r)), default=0) for s in self.histories), default=0)


def mission(logs: Sequence[TraceFile]) -> FleetMission:
    """Return the only mission in the files. Raises BadTrace."""
    logs, old = _of_one_version(_by_age(logs))
    _same(logs)
    lives = _joined([life for log in logs for life in _lives(log)])
    names: dict[int, str] = {}
    for log in logs:
        for pid, name in log.names.items():
            if names.setdefault(pid, name) != name:
                other = next(each.path for each in logs if each.names.get(pid) == names[pid])
                raise BadTrace(f"{log.path}: robot {pid} is {name}; in {other} it is {names[pid]}")
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
    """Return the files of each robot together, the oldest first."""
    order = {family: k for k, family in enumerate(dict.fromkeys(log.family for log in logs))}
    return sorted(logs, key=lambda log: (order[log.family], log.age))


def _of_one_version(logs: Sequence[TraceFile]) -> tuple[list[TraceFile], list[TraceFile]]:
    """Return the files of the program that each robot ran last, and those of earlier programs."""
    newest = {log.family: (log.program_hash, log.n_sys) for log in logs}
    kept: list[TraceFile] = []
    old: list[TraceFile] = []
    for log in logs:
        (kept if (log.program_hash, log.n_sys) == newest[log.family] else old).append(log)
    return kept, old


def _joined(lives: Sequence[ProcessLife]) -> list[ProcessLife]:
    """Give each part the mission that a later part of the same start names.

    Records of a robot that restarted before its first round belong to no mission and are left out."""
    joined: list[ProcessLife] = []
    later: dict[tuple[Path, int, int], ProcessLife] = {}  # the next life in the same files
    for life in reversed(lives):
        follower = later.get((*life.log.family, life.pid))
        if follower is not None and follower.continues and not life.mission:
            life.mission, life.start = follower.mission, follower.start
        later[(*life.log.family, life.pid)] = life
        if follower is None or life.mission or life.tells:
            joined.append(life)
    return joined[::-1]


def _same(logs: Sequence[TraceFile]) -> None:
    """Check that all files are of one program and one fleet. Raises BadTrace."""
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
    """Yield each robot's lives, in their order. A life may lack any round, `init` and mission."""
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
    """Return the mission that all files have a part in.

    Files that one robot wrote in one folder count as one. Raises BadTrace if there is none."""
    named: dict[tuple[Path, int], dict[str, Path]] = {}  # each mission, with the last file that names it
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
    """Build a robot's rounds from its lives. Raises BadTrace."""
    history.lives.sort(key=_order)
    teller = _HistoryBuilder(history)
    for life in history.lives:
        teller.live(life)
    teller.end()


def _order(life: ProcessLife) -> tuple[int, int]:
    """Order lives of one file as they stand in it, those of several files by their rounds."""
    first = FOREVER
    for line in life.lines:
        if line.record["kind"] in ("init", "round"):
            first = min(first, line.record.get("round", 0))
        elif line.record["kind"] == "checkpoint":
            first = min(first, line.record["round"] + 1)
    return first, life.lines[0].number


class _HistoryBuilder:
    """Builder of one robot's history from its lives."""

    def __init__(self, history: RobotHistory) -> None:
        self.history = history
        self.previous = -1  # last round with a record; 0: `init`
        self.doubt = ""  # why there may be rounds after it without a record
        self.came_back = False  # the doubt is due to another life, or to a missing trace
        self.resting, self.rested = False, 0.0  # whether it stopped in the present life, and when
        self.times: list[tuple[float, int]] = []  # time and number of its rounds
        self.left = FOREVER  # first round in which it had left the mission
        self.whose: dict[int, Path] = {}  # round -> file that records it

    def live(self, life: ProcessLife) -> None:
        history = self.history
        if not life.continues:
            self.resting, self.rested, self.times, self.left = False, 0.0, [], FOREVER
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
                case "phase" if record["phase"] == "resting" and not self.resting:
                    self.rested, self.resting = _time(record), True
                    history.out.append(Gap(0, FOREVER, record.get("detail", "") or "it had come to rest"))
                case kind if kind == LOST:
                    self.doubt = self.doubt or f"{life.log.path}:{line.number} cannot be read"
                case _:
                    pass
        if self.resting:
            since = max([r for time, r in self.times if time <= self.rested], default=self.previous)
            history.out[-1] = history.out[-1]._replace(since=min(since + 1, self.left))
        elif self.left < FOREVER:  # the record of its stop cannot be read
            self.resting = True
            history.out.append(Gap(self.left, FOREVER, "it had come to rest"))

    def checkpoint(self, record: Mapping[str, Any]) -> None:
        """Begin another part of the trace. Unrecorded rounds before it are unknown."""
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
        """Return whether a round is recorded for the first time.

        Raises BadTrace if another file records it, too."""
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
        if history.out and history.out[-1].until == FOREVER and not self.resting:  # of an earlier life
            history.out[-1] = history.out[-1]._replace(until=round_)
        history.rounds[round_] = line
        self.previous = max(self.previous, round_)

    def join(self, life: ProcessLife, gap: Gap) -> None:
        """Add the gap before a record, and the state with which a robot that restarted went on."""
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
        """Add the rounds after the last record, if the robot may have continued."""
        lives = self.history.lives
        if not lives:
            self.lose(Gap(0, FOREVER, "there is no trace of it"))
        elif self.doubt or not self.resting:
            why = self.doubt or f"its trace ends there ({lives[-1].log.path})"
            self.lose(Gap(self.previous + 1, FOREVER, why))


def _time(record: Mapping[str, Any]) -> float:
    return float(record.get("time", record.get("t", 0.0)))


def _views(histories: Sequence[RobotHistory]) -> None:
    """Add the rounds in which a robot was removed by the others."""
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
                history.away.append(Gap(since.pop(history.pid), view["since"], "the others had counted it out"))
    for pid, first in since.items():
        histories[pid].away.append(Gap(first, FOREVER, "the others had counted it out"))
