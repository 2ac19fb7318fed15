"""Files of a fleet's traces, format koord-trace/1, as much of them as can be read.

A record that cannot be read is passed over, and stands in its place as one of kind LOST: from there on something about
a robot is not known. Only a file that is no trace at all is refused.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from koordgen.replay.trace import FORMAT, BadTrace, Line

LOST = "lost"
LONGEST = 8 << 20  # bytes of a line; what is longer is passed over
MOST_ROBOTS = 1000
MOST_ROUND = 100_000_000
MOST_JUMP = 100_000  # rounds from one record to the next; a larger number is none
HEADER = b'{"kind":"header"'


@dataclass(frozen=True, slots=True)
class Flaw:
    """What is wrong at a line of a file; with `cut` the file ends there amid a record."""

    number: int
    what: str
    cut: bool = False


@dataclass
class Log:
    """One file. `names` are the robots that its header says, by pid; `own`: it is one robot's. Lines have pid -1 where
    it is not known whose they are."""

    path: Path
    app: str
    program_hash: str
    delta: float
    n_sys: int
    names: dict[int, str]
    own: bool
    last: dict[int, int] = field(default_factory=dict)  # the round that each robot told of last
    step: bool = False  # the run followed a counterexample of one step, whose beginning is any state
    lines: list[Line] = field(default_factory=list)
    flaws: list[Flaw] = field(default_factory=list)

    @property
    def cut(self) -> bool:
        return any(flaw.cut for flaw in self.flaws)


def found(given: Path) -> list[Path]:
    """The traces that a name stands for: a file, the merged trace in a run's folder, or else all traces below a folder.
    Raises BadTrace."""
    if not given.is_dir():
        return [given]
    merged = given / "trace.jsonl"
    if merged.is_file():
        header = _header(merged)
        if header is not None and "robots" in header:
            return [merged]
    below = [path for path in sorted(given.rglob("*.jsonl")) if path.is_file() and _header(path) is not None]
    if not below:
        raise BadTrace(f"{given}: no file *.jsonl in it is a trace of format {FORMAT}")
    return below


def _header(path: Path) -> Mapping[str, Any] | None:
    """The header of a trace; None where there is none."""
    try:
        with path.open("rb") as file:
            data = file.readline(LONGEST)
    except OSError as error:
        raise BadTrace(f"{path}: {error.strerror or error}") from None
    record = _parsed(data)
    return record if isinstance(record, dict) and record.get("format") == FORMAT else None


def opened(path: Path) -> Log:
    """All of a file. Raises BadTrace where it is none."""
    header = _header(path)
    if header is None:
        raise BadTrace(f"{path}: no header of format {FORMAT}")
    try:
        log = _log(path, header)
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise BadTrace(f"{path}:1: a broken header: {error!r}") from None
    try:
        with path.open("rb") as file:
            for number, data in _lines(file):
                _take(log, number, data)
    except OSError as error:
        raise BadTrace(f"{path}: {error.strerror or error}") from None
    return log


def _log(path: Path, header: Mapping[str, Any]) -> Log:
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
        raise ValueError(f"pids {sorted(names)} of {n_sys} robots")
    return Log(path, app, program_hash, delta, n_sys, names, own, step=header.get("followed") == "step")


def _lines(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Each line with its number; of one that is too long only the beginning, without its end."""
    number = 0
    while data := file.readline(LONGEST):
        number += 1
        yield number, data
        while len(data) == LONGEST and not data.endswith(b"\n"):
            data = file.readline(LONGEST)


def _take(log: Log, number: int, data: bytes) -> None:
    pid = next(iter(log.names)) if log.own else -1
    record = _parsed(data)
    if record is None:
        again = data.rfind(HEADER)  # a robot that was killed amid a record, and began anew
        if again > 0 and _parsed(data[again:]) is not None:
            _lose(log, number, pid, "is cut off where the robot began anew")
            _take(log, number, data[again:])
        elif len(data) >= LONGEST:
            _lose(log, number, pid, f"is longer than {LONGEST >> 20} MB")
        elif not data.endswith(b"\n"):
            _lose(log, number, pid, "the trace is cut off here", cut=True)
        elif data.strip():
            _lose(log, number, pid, "is no record")
        return
    if not log.own and isinstance(record.get("pid"), int) and 0 <= record["pid"] < log.n_sys:
        pid = record["pid"]
    kind = record.get("kind")
    sound = _SOUND.get(kind) if isinstance(kind, str) else None
    if sound is None:
        return
    if not sound(record) or (pid < 0 and kind != "header"):
        _lose(log, number, pid, f"a broken record of kind {kind}")
    elif kind == "round" and record["round"] > log.last.setdefault(pid, record["round"]) + MOST_JUMP:
        _lose(log, number, pid, f"round {record['round']} does not come after round {log.last[pid]}")
    else:
        if kind == "round":
            log.last[pid] = record["round"]
        log.lines.append(Line(number, pid, record))


def _lose(log: Log, number: int, pid: int, what: str, cut: bool = False) -> None:
    log.flaws.append(Flaw(number, what, cut))
    log.lines.append(Line(number, pid, {"kind": LOST}))


def _parsed(data: bytes) -> dict[str, Any] | None:
    try:
        record = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None


def _number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _int(value: Any, low: int = 0) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and low <= value <= MOST_ROUND


def _timed(record: Mapping[str, Any]) -> bool:
    return _number(record.get("time", record.get("t")))


def _groups(record: Mapping[str, Any], *names: str) -> bool:
    return all(isinstance(record.get(name, {}), dict) for name in names)


def _init(record: Mapping[str, Any]) -> bool:
    restored, fault = record.get("restored"), record.get("fault")
    return (
        _timed(record)
        and _groups(record, "sensors", "locals", "shared", "actuators", "copy")
        and _calls(record)
        and all(record.get(name) is None or isinstance(record[name], str) for name in ("event", "skipped"))
        and (fault is None or (isinstance(fault, dict) and isinstance(fault.get("reason"), str)))
        and (restored is None or _life(restored))
    )


def _life(restored: Any) -> bool:
    return isinstance(restored, dict) and _int(restored.get("round"), -1) and _groups(restored, "locals", "actuators")


def _round(record: Mapping[str, Any]) -> bool:
    numbers = all(_number(record.get(name, 0.0)) for name in ("late", "clock_bound"))
    return _init(record) and _int(record.get("round"), 1) and numbers


def _calls(record: Mapping[str, Any]) -> bool:
    calls = record.get("calls", [])
    return isinstance(calls, list) and all(
        isinstance(c, list) and len(c) == 3 and isinstance(c[0], str) and isinstance(c[1], list) for c in calls
    )


def _phase(record: Mapping[str, Any]) -> bool:
    return _timed(record) and isinstance(record.get("phase"), str) and isinstance(record.get("detail", ""), str)


def _view(record: Mapping[str, Any]) -> bool:
    members = record.get("members")
    whole = _int(record.get("number")) and _int(record.get("since"), -MOST_ROUND)
    return whole and isinstance(members, list) and all(_int(m, -1) for m in members)


def _monitor(record: Mapping[str, Any]) -> bool:
    texts = all(isinstance(record.get(name, ""), str) for name in ("of", "name", "line", "outcome", "why"))
    return texts and _int(record.get("round")) and _int(record.get("age", 0))


# What an audit looks at, and whether a record of the kind is whole.
_SOUND: dict[str, Callable[[Mapping[str, Any]], bool]] = {
    "header": lambda record: True,
    "init": _init,
    "round": _round,
    "phase": _phase,
    "view": _view,
    "monitor": _monitor,
}
