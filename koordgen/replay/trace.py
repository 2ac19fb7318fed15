"""Traces of format koord-trace/1 as the replayer reads them: a robot's own, and the merged one of a run."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from koordgen.replay.record import MOST_JUMP, MOST_ROBOTS, flaw_of

FORMAT = "koord-trace/1"
KINDS = ("init", "round", "stream", "view")


class BadTrace(Exception):
    """A file that is no trace, or is broken amid it; the message names the file and the line."""


class Line(NamedTuple):
    """One record, by its number in the file, from 1."""

    number: int
    pid: int
    record: dict[str, Any]


@dataclass
class Trace:
    """A trace's header; `robots` are the fleet's names, by pid, empty of robots whose names it does not say. `own`: it
    is one robot's, `pid` which one. `followed`: of a run that followed a counterexample, a "run" or a "step", else "".
    `lines` reads the rest; when the file ends amid a line, `cut` is its number."""

    path: Path
    app: str
    program_hash: str
    robots: tuple[str, ...]
    own: bool
    pid: int
    cut: int = 0
    followed: str = ""

    def lines(self) -> Iterator[Line]:
        """The records that a replay needs, in their order. Raises BadTrace."""
        last: dict[int, int] = {}  # the round that each robot told of last
        for number, record in records(self):
            if record.get("kind") not in KINDS:
                continue
            pid = self.pid if self.own else record.get("pid")
            if not isinstance(pid, int) or not 0 <= pid < len(self.robots):
                raise BadTrace(f"{self.path}:{number}: no robot {pid!r}")
            if flaw := flaw_of(record):
                raise BadTrace(f"{self.path}:{number}: {flaw}")
            if record["kind"] == "round":
                if record["round"] > last.get(pid, record["round"]) + MOST_JUMP:
                    raise BadTrace(f"{self.path}:{number}: round {record['round']} after round {last[pid]}")
                last[pid] = record["round"]
            yield Line(number, pid, record)


def opened(path: Path) -> Trace:
    """The trace at `path`. Raises BadTrace."""
    blank = Trace(path, "", "", (), False, 0)
    number, header = next(records(blank), (0, {}))
    if header.get("kind") != "header" or header.get("format") != FORMAT:
        raise BadTrace(f"{path}: no header of format {FORMAT}")
    try:
        app, program_hash = str(header["app"]), str(header.get("program_hash", ""))
        if "counterexample" in header:
            raise BadTrace(f"{path} is a counterexample's, not of a run: `koordgen sim --follow` lets agents run it")
        followed = str(header.get("followed", ""))
        if "robots" in header:
            names = tuple(str(robot["name"]) for robot in header["robots"])
            if not 1 <= len(names) <= MOST_ROBOTS:
                raise ValueError(f"{len(names)} robots")
            return Trace(path, app, program_hash, names, False, 0, followed=followed)
        n, pid = int(header["n_sys"]), int(header["pid"])
        if not (1 <= n <= MOST_ROBOTS and 0 <= pid < n):
            raise ValueError(f"pid {pid} of {n} robots")
        names = tuple(str(header["robot"]) if p == pid else "" for p in range(n))
        return Trace(path, app, program_hash, names, True, pid, followed=followed)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadTrace(f"{path}:{number}: a broken header: {error!r}") from None


def records(trace: Trace) -> Iterator[tuple[int, dict[str, Any]]]:
    """Every record with the number of its line. Raises BadTrace."""
    try:
        with trace.path.open("rb") as file:
            for number, line in enumerate(file, 1):
                try:
                    record = json.loads(line)
                except (ValueError, RecursionError):
                    if not line.endswith(b"\n"):
                        trace.cut = number
                        return
                    raise BadTrace(f"{trace.path}:{number}: no line of JSON, as traces have them") from None
                if not isinstance(record, dict):
                    raise BadTrace(f"{trace.path}:{number}: no record")
                yield number, record
    except OSError as error:
        raise BadTrace(f"{trace.path}: {error.strerror or error}") from None
