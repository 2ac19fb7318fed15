"""Verdict of a simulated run of LineForm: the robots must end in a line.

`python verdict.py DIR`, with the folder of the run. Positions are the true ones from DIR/trace.jsonl, in plan view. The
robots between the two extremal ones (pid 0 and N-1) must end within 0.30 m of the straight line between those two, and
within 0.30 m of their evenly spaced places along it. They must have started at least 1.5 m off that line, or the run
would show nothing. No two robots may ever have been closer than 0.3 m. Exit status: 0 yes, 3 no, 1 the files cannot be
used, 2 usage.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

OFF_LINE, OFF_PLACE = 0.30, 0.30  # metres, at the end, at most
OFF_LINE_AT_START = 1.5  # metres, at least
SEPARATION = 0.3  # metres, at least
FORMATS = ("koord-trace/1", "koord-trace/2")

Place = tuple[float, float]


class Unusable(Exception):
    """Raised if the run's files cannot be judged. The message gives the reason."""


@dataclass(frozen=True)
class Run:
    """Result of a run: plan positions (m) by pid at its start and at the mission's end, and smallest separation (m).

    The separation is a distance in space. `flaw`: reason why the run cannot pass; "" if there is none.
    """

    names: list[str]
    starts: list[Place]
    ends: list[Place]
    separation: float
    flaw: str


def read(folder: Path) -> Run:
    """Read trace.jsonl, and from the summary the smallest separation between samples of the trace. Raises Unusable."""
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        with (folder / "trace.jsonl").open(encoding="utf-8") as file:
            return _run([json.loads(line) for line in file], summary)
    except OSError as error:
        raise Unusable(f"{error.filename}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise Unusable(f"{folder}: not the folder of a run: {type(error).__name__}: {error}") from None


def _run(records: list[dict[str, Any]], summary: dict[str, Any]) -> Run:
    header = records[0]
    if header.get("format") not in FORMATS:
        raise ValueError(f"the trace has no header of format {' or '.join(FORMATS)}")
    names = [robot["name"] for robot in header["robots"]]
    end = min((r["t"] for r in records if r["kind"] == "end"), default=math.inf)
    time = -math.inf
    now: dict[int, tuple[float, float, float]] = {}  # poses at the time of the present sample
    starts: list[Place | None] = [None] * len(names)
    ends: list[Place | None] = [None] * len(names)
    separation = float((summary["min_separation"] or {"distance": math.inf})["distance"])
    for record in records:
        if record["kind"] != "pose":
            continue
        pid, (x, y, z) = record["pid"], map(float, record["position"])
        if not 0 <= pid < len(names) or not all(map(math.isfinite, (x, y, z))):
            raise ValueError(f"no pose of a robot: {record}")
        if record["t"] != time:
            time, now = record["t"], {}
        separation = min([separation, *(math.dist((x, y, z), place) for place in now.values())])
        now[pid] = (x, y, z)
        starts[pid] = starts[pid] or (x, y)
        if record["t"] <= end:
            ends[pid] = (x, y)
    if len(names) < 3 or None in starts or None in ends or not math.isfinite(separation):
        raise ValueError("the verdict needs three robots or more, and poses of all of them")
    flaw = "" if summary["verdict"] == "held" else f"the run itself: {summary['verdict']}, {summary['why']}"
    return Run(names, [s for s in starts if s], [e for e in ends if e], separation, flaw)


@dataclass(frozen=True)
class Figures:
    """Deviations of one robot (m): from the line at start and end, and from its place on the line at the end."""

    name: str
    off_at_start: float
    off_line: float
    off_place: float

    @property
    def good(self) -> bool:
        return self.off_at_start >= OFF_LINE_AT_START and self.off_line <= OFF_LINE and self.off_place <= OFF_PLACE


def judge(run: Run) -> list[Figures]:
    """Return the figures of the robots between the extremal ones. Raises Unusable if those two are at one point."""
    (x0, y0), (x1, y1) = run.ends[0], run.ends[-1]
    length = math.hypot(x1 - x0, y1 - y0)
    if length < OFF_LINE:
        raise Unusable(f"the extremal robots ended {length:.2f} m apart: that is no line")
    ux, uy = (x1 - x0) / length, (y1 - y0) / length

    def off(place: Place) -> float:
        return abs(ux * (place[1] - y0) - uy * (place[0] - x0))

    figures = []
    for pid in range(1, len(run.names) - 1):
        x, y = run.ends[pid]
        along = ux * (x - x0) + uy * (y - y0)
        ideal = length * pid / (len(run.names) - 1)
        figures.append(Figures(run.names[pid], off(run.starts[pid]), off((x, y)), abs(along - ideal)))
    return figures


def main(argv: list[str]) -> int:
    if len(argv) != 1 or argv[0].startswith("-"):
        print("usage: python verdict.py DIR (the folder of a run of LineForm)", file=sys.stderr)
        return 2
    try:
        run = read(Path(argv[0]))
        figures = judge(run)
    except Unusable as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    width = max(len("robot"), *(len(f.name) for f in figures))
    print(f"{'robot':{width}}  off the line at the start  off the line at the end  off its place at the end")
    for f in figures:
        print(f"{f.name:{width}}  {f.off_at_start:24.3f}m  {f.off_line:22.3f}m  {f.off_place:23.3f}m")
    limits = f">= {OFF_LINE_AT_START:g} m", f"<= {OFF_LINE:g} m", f"<= {OFF_PLACE:g} m"
    print(f"{'':{width}}  {limits[0]:>25}  {limits[1]:>23}  {limits[2]:>24}")
    print(f"closest two robots ever came: {run.separation:.3f} m (>= {SEPARATION:g} m)")
    reasons = [f"{f.name} is out of bounds" for f in figures if not f.good]
    if run.separation < SEPARATION:
        reasons.append("two robots came too close")
    if run.flaw:
        reasons.append(run.flaw)
    print("LineForm: they lined up" if not reasons else f"LineForm: NO: {'; '.join(reasons)}")
    return 3 if reasons else 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
