"""Reader of traces for the replay: a robot's own trace, or the merged trace of a run.

A robot's own trace may have several parts (koordgen/runtime/trace/parts.py). The reader joins the parts to one trace.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from koordgen.runtime.trace.parts import base_of, numbered
from koordgen.runtime.trace.schema import MOST_ROBOTS, NO_HEADER, BadTrace, Upgrade, format_of
from koordgen.verify.replay.record import MOST_JUMP, Unsound, sound

LONGEST = 8 << 20  # largest size of a trace's header, in bytes
KINDS = ("init", "round", "stream", "view", "checkpoint")


class TraceLine(NamedTuple):
    """Record of a trace, with its line number, counted from 1.

    In a trace of several parts, the count continues from one part to the next part."""

    number: int
    pid: int
    record: dict[str, Any]


@dataclass
class TraceParts:
    """Trace in one or several parts.

    `path`: the last part.
    `header`: the header of the last part.
    `older`: the earlier parts, the oldest part first.
    `robots`: the robots' names by pid. A robot whose name is not in the header has an empty name.
    `own`: whether the trace belongs to the robot `pid` alone.
    `followed`: "run" or "step" if the traced run executed a counterexample; otherwise empty.
    `cut`: the number of an incomplete line at the end of a part; 0 if every line is complete.
    `since`: the first round whose values are known; above 0 only if the oldest parts are missing."""

    path: Path
    app: str
    program_hash: str
    robots: tuple[str, ...]
    own: bool
    pid: int
    cut: int = 0
    followed: str = ""
    older: tuple[Path, ...] = ()
    since: int = 0
    header: dict[str, Any] = field(default_factory=dict)
    # (number of lines before the part, file of the part) of each part
    begins: list[tuple[int, Path]] = field(default_factory=list)

    def place(self, number: int) -> str:
        """Return the position of a line as "FILE:LINE", where LINE counts within the line's part."""
        before, path = next((each for each in reversed(self.begins) if each[0] < number), (0, self.path))
        return f"{path}:{number - before}"

    def lines(self) -> Iterator[TraceLine]:
        """Yield the records that a replay needs, in the trace's order. Raises BadTrace."""
        last: dict[int, int] = {}  # pid -> last recorded round
        for number, record, data in records(self):
            if record.get("kind") not in KINDS:
                continue
            pid = self.pid if self.own else record.get("pid")
            if not isinstance(pid, int) or not 0 <= pid < len(self.robots):
                raise BadTrace(f"{self.place(number)}: the fleet has no robot with pid {pid!r}")
            try:
                record = sound(record, data)
            except Unsound as flaw:
                raise BadTrace(f"{self.place(number)}: {flaw}") from None
            if record["kind"] == "checkpoint" and not last:
                self.since = self.since or record["round"] + 1
            if record["kind"] == "round" and record["round"] > last.get(pid, record["round"]) + MOST_JUMP:
                raise BadTrace(
                    f"{self.place(number)}: round {record['round']} after round {last[pid]}: rounds are missing"
                )
            if record["kind"] in ("init", "round"):
                last[pid] = record.get("round", 0)
            yield TraceLine(number, pid, record)


def open_trace(path: Path) -> TraceParts:
    """Open the trace at `path`, together with the earlier parts of the same trace. Raises BadTrace."""
    *older, path = parts_of(path)
    blank = TraceParts(path, "", "", (), False, 0)
    number, header, line = next(records(blank), (0, {}, b""))
    if not format_of(line):
        raise BadTrace(f"{path}: {NO_HEADER}")
    try:
        app, program_hash = str(header["app"]), str(header.get("program_hash", ""))
        if "counterexample" in header:
            raise BadTrace(
                f"{path} is the trace of a counterexample, not of a run: `koordgen sim --follow` runs it with agents"
            )
        followed = str(header.get("followed", ""))
        if "robots" in header:
            names = tuple(str(robot["name"]) for robot in header["robots"])
            if not 1 <= len(names) <= MOST_ROBOTS:
                raise ValueError(f"{len(names)} robots")
            return TraceParts(path, app, program_hash, names, False, 0, followed=followed, header=header)
        n, pid = int(header["n_sys"]), int(header["pid"])
        if not (1 <= n <= MOST_ROBOTS and 0 <= pid < n):
            raise ValueError(f"pid {pid} does not fit a fleet of {n} robots")
        names = tuple(str(header["robot"]) if p == pid else "" for p in range(n))
        return TraceParts(
            path, app, program_hash, names, True, pid, followed=followed, older=tuple(older), header=header
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadTrace(f"{path}:{number}: a broken header: {error!r}") from None


def parts_of(path: Path) -> list[Path]:
    """Return the parts of a robot's trace up to the part at `path`, oldest first. Raises BadTrace.

    A part without a header belongs to a robot that was killed while it started. If `path` is such a part, or does not
    exist, the newest earlier part replaces it. If `path` is not a part of a robot's trace, only `path` itself is
    returned."""
    try:
        base, number = base_of(path)
        older = [each for at, each in numbered(base) if number is None or at < number]
        if older and _is_unwritten(path):
            path = older.pop()
        parts, last = [path], header_of(path) or {}
        while last.get("part") and older:
            header = header_of(older[-1]) or {}
            if any(header.get(name, 0) != value for name, value in {**last, "part": last["part"] - 1}.items()):
                break
            parts.insert(0, older.pop())
            last = header
    except OSError as error:
        raise BadTrace(f"{path}: {error.strerror or error}") from None
    return parts


def header_of(path: Path) -> dict[str, Any] | None:
    """Return the header of a trace, in the present format; None if the file has no header.

    Raises OSError. Raises BadTrace if this version of koordgen cannot read the trace's format."""
    with path.open("rb") as file:
        line = file.readline(LONGEST)
    try:
        if not format_of(line):
            return None
        line = Upgrade().line(line)
    except ValueError as error:
        raise BadTrace(f"{path}: {error}") from None
    with suppress(ValueError, RecursionError):
        return sound(json.loads(line), line)
    return None


def _is_unwritten(path: Path) -> bool:
    """Return whether the first line of a trace part is missing or incomplete."""
    if not path.exists():
        return True
    with path.open("rb") as file:
        return not file.readline(LONGEST).endswith(b"\n")


def records(trace: TraceParts) -> Iterator[tuple[int, dict[str, Any], bytes]]:
    """Yield (line number, record in the present format, text of the line) for each record of a trace.

    Raises BadTrace."""
    trace.begins, number = [], 0
    for path in (*trace.older, trace.path):
        trace.begins.append((number, path))
        upgrade = Upgrade()
        try:
            with path.open("rb") as file:
                for line in file:
                    number += 1
                    try:
                        line = upgrade.line(line)
                    except ValueError as error:
                        raise BadTrace(f"{trace.place(number)}: {error}") from None
                    try:
                        record = json.loads(line)
                    except (ValueError, RecursionError):
                        if line.endswith(b"\n"):
                            raise BadTrace(f"{trace.place(number)}: not a line of JSON") from None
                        trace.cut = number
                        break
                    if not isinstance(record, dict):
                        raise BadTrace(f"{trace.place(number)}: the line contains no record")
                    yield number, record, line
        except OSError as error:
            raise BadTrace(f"{path}: {error.strerror or error}") from None
