"""Traces of runs that never happened, for tests of what reads them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from koordgen.runtime.trace.schema import FORMAT, End, Header, Mark, RobotName
from targets.sim.run.run import RunResult
from targets.sim.run.scene import Closest

Place = tuple[float, float, float]


def header(names: list[str]) -> Header:
    robots = tuple(RobotName(name, pid, "quad" if pid % 2 == 0 else "car") for pid, name in enumerate(names))
    fence = ((-6.0, -5.0, -0.5), (6.0, 5.0, 4.0))
    return Header(FORMAT, "line<form>", "0123456789abcdef", 0.1, 3, robots, 10.0, True, 0.3, fence)


def moving(starts: list[Place], ends: list[Place], seconds: int = 10) -> list[dict[str, Any]]:
    """Poses twice a second, each robot on a straight line from its start to its end, then 2 s at rest."""
    found = []
    for k in range(-2, 2 * seconds + 5):
        share = min(1.0, max(0.0, k / (2 * seconds)))
        for pid, (a, b) in enumerate(zip(starts, ends, strict=True)):
            place = [p + share * (q - p) for p, q in zip(a, b, strict=True)]
            found.append({"kind": "pose", "t": k / 2, "pid": pid, "position": place, "yaw": 0.0})
    return found


def write(path: Path, head: Header, records: list[dict[str, Any]], marks: Sequence[Mark] | None = None) -> Path:
    lines = [*records, *(msgspec.to_builtins(mark) for mark in marks or [End(10.0, "completed")])]
    lines.sort(key=lambda record: float(record["t"]))
    path.write_bytes(b"".join(msgspec.json.encode(line) + b"\n" for line in [msgspec.to_builtins(head), *lines]))
    return path


def outcome(**change: Any) -> RunResult:
    make: Callable[..., RunResult] = RunResult
    usual: dict[str, Any] = {
        "started": True, "ended": "completed", "zero": 0.0, "duration": 10.0, "marks": [],
        "closest": Closest(0.8, 4.0, (0, 1)), "real_time_factor": 0.998, "late_steps": 3, "steps": 2400,
    }  # fmt: skip
    return make(**{**usual, **change})
