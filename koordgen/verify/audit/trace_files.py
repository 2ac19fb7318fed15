"""Reader of the trace files of a fleet, which also reads damaged files.

An unreadable record becomes a record of kind LOST. After such a record, the state of the robot is partly unknown. The
reader raises an error only for a file that is not a trace at all.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from koordgen.runtime.trace.parts import base_of
from koordgen.runtime.trace.schema import FORMAT, HEADER, MOST_ROBOTS, NO_HEADER, OLD_FORMAT, BadTrace, Upgrade
from koordgen.verify.replay.record import MOST_JUMP, Unsound, sound
from koordgen.verify.replay.trace import LONGEST, TraceLine, header_of, parts_of

LOST = "lost"
KINDS_READ = ("header", "init", "round", "phase", "view", "monitor", "checkpoint")


@dataclass(frozen=True, slots=True)
class TraceFlaw:
    """Mistake in a line of a trace file.

    `number`: number of the line, from 1.
    `cut`: whether the line is the last one and ends within a record."""

    number: int
    what: str
    cut: bool = False


@dataclass
class TraceFile:
    """One trace file.

    `names`: pid -> name of each robot in the file's header.
    `own`: whether the file is the trace of a single robot.
    `lines`: the records. A record has pid -1 if its robot is unknown.
    `family`: key that is equal for the files that one robot wrote in one folder.
    `age`: sort key of the files of a family, the oldest file first.
    `last`: pid -> round of the robot's last record."""

    path: Path
    app: str
    program_hash: str
    delta: float
    n_sys: int
    names: dict[int, str]
    own: bool
    family: tuple[Path, int]
    age: float
    last: dict[int, int] = field(default_factory=dict)
    # whether the run replayed a counterexample of a single step, which may begin in an unreachable state
    step: bool = False
    header: Mapping[str, Any] = field(default_factory=dict)
    lines: list[TraceLine] = field(default_factory=list)
    upgrade: Upgrade = field(default_factory=Upgrade)
    flaws: list[TraceFlaw] = field(default_factory=list)

    @property
    def cut(self) -> bool:
        return any(flaw.cut for flaw in self.flaws)


def trace_files(given: Path) -> list[Path]:
    """Return the trace files that a path denotes. Raises BadTrace if there are none.

    A file denotes itself and the earlier parts of the same trace. The folder of a run with a merged trace denotes the
    merged trace. Any other folder denotes all traces in the folder and its subfolders."""
    if not given.is_dir():
        return parts_of(given)
    merged = given / "trace.jsonl"
    if merged.is_file():
        header = _header(merged)
        if header is not None and "robots" in header:
            return [merged]
    below = [path for path in sorted(given.rglob("*.jsonl")) if path.is_file() and _header(path) is not None]
    if not below:
        raise BadTrace(f"{given}: no file *.jsonl in this folder is a trace of format {FORMAT} or {OLD_FORMAT}")
    return below


def _header(path: Path) -> Mapping[str, Any] | None:
    """Return the header of a trace file; None if the file has no header. Raises BadTrace on a read error."""
    try:
        return header_of(path)
    except OSError as error:
        raise BadTrace(f"{path}: {error.strerror or error}") from None


def read_trace_file(path: Path) -> TraceFile:
    """Read a whole trace file. Raises BadTrace if the file is not a trace or cannot be read."""
    header = _header(path)
    if header is None:
        raise BadTrace(f"{path}: {NO_HEADER}")
    try:
        log = _log(path, header)
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise BadTrace(f"{path}:1: a broken header: {error!r}") from None
    try:
        with path.open("rb") as file:
            for number, data in _lines(file):
                _add_line(log, number, data)
    except OSError as error:
        raise BadTrace(f"{path}: {error.strerror or error}") from None
    return log


def _log(path: Path, header: Mapping[str, Any]) -> TraceFile:
    if "counterexample" in header or not header["program_hash"]:
        raise BadTrace(f"{path}: a counterexample, which no robot ran: `koordgen report` shows it")
    app, program_hash, delta = str(header["app"]), str(header["program_hash"]), float(header["delta"])
    if not 0.0 < delta < 1e6:
        raise ValueError(f"delta {delta}")
    if own := "robots" not in header:
        n_sys, names = int(header["n_sys"]), {int(header["pid"]): str(header["robot"])}
    else:
        names = {int(robot["pid"]): str(robot["name"]) for robot in header["robots"]}
        n_sys = len(names)
    if not 1 <= n_sys <= MOST_ROBOTS or not all(0 <= pid < n_sys for pid in names):
        raise ValueError(f"the pids {sorted(names)} do not fit a fleet of {n_sys} robots")
    base, part = base_of(path)
    family, age = (base, next(iter(names))) if own else (path, -1), math.inf if part is None else part
    return TraceFile(
        path,
        app,
        program_hash,
        delta,
        n_sys,
        names,
        own,
        family,
        age,
        step=header.get("followed") == "step",
        header=header,
    )


def _lines(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield each line of a file with its number. Lines are cut to LONGEST bytes."""
    number = 0
    while data := file.readline(LONGEST):
        number += 1
        yield number, data
        while len(data) == LONGEST and not data.endswith(b"\n"):
            data = file.readline(LONGEST)


def _add_line(log: TraceFile, number: int, data: bytes) -> None:
    pid = next(iter(log.names)) if log.own else -1
    try:
        data = log.upgrade.line(data)
    except ValueError as error:
        raise BadTrace(f"{log.path}:{number}: {error}") from None
    record = _parsed(data)
    if record is None:
        # a robot that was killed while it wrote a record writes the header of its next start into the same line
        again = data.rfind(HEADER)
        if again > 0 and _parsed(data[again:]) is not None:
            _lose(log, number, pid, "the record is cut off, because the robot restarted")
            _add_line(log, number, data[again:])
        elif len(data) >= LONGEST:
            _lose(log, number, pid, f"the line is longer than {LONGEST >> 20} MB")
        elif not data.endswith(b"\n"):
            _lose(log, number, pid, "the trace is cut off here", cut=True)
        elif data.strip():
            _lose(log, number, pid, "is no record")
        return
    if not log.own and isinstance(record.get("pid"), int) and 0 <= record["pid"] < log.n_sys:
        pid = record["pid"]
    kind = record.get("kind")
    if kind not in KINDS_READ:
        return
    try:
        record = sound(record, data)
    except Unsound as error:
        _lose(log, number, pid, str(error))
        return
    if pid < 0 and kind != "header":
        _lose(log, number, pid, f"a broken record of kind {kind}")
    elif kind == "round" and record["round"] > log.last.setdefault(pid, record["round"]) + MOST_JUMP:
        _lose(log, number, pid, f"round {record['round']} does not come after round {log.last[pid]}")
    else:
        if kind == "round":
            log.last[pid] = record["round"]
        log.lines.append(TraceLine(number, pid, record))


def _lose(log: TraceFile, number: int, pid: int, what: str, cut: bool = False) -> None:
    log.flaws.append(TraceFlaw(number, what, cut))
    log.lines.append(TraceLine(number, pid, {"kind": LOST}))


def _parsed(data: bytes) -> dict[str, Any] | None:
    try:
        record = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None
