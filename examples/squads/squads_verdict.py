"""Verdict of a simulated run of the squads: they must line up with the car, and each squad must hold its triangle.

`python squads_verdict.py DIR`, with the folder of the run. Positions are the true ones from the traces; that of a squad
is the mean of its robots' positions. At the mission's end, beta must be within 0.30 m of the straight line between
alpha and dora, and of the middle between the two, in plan view. It must have started at least 1.5 m off that line. From
FORMED seconds on, each quad must be within 0.15 m of its corner: the place in a triangle around its squad's position.
Exit status: 0 yes, 3 no, 1 the files cannot be used, 2 usage.
"""

from __future__ import annotations

import json
import math
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

SQUADS = ("alpha", "beta")
OFF_LINE, OFF_MIDDLE = 0.30, 0.30  # metres, at the end, at most
OFF_LINE_AT_START = 1.5  # metres, at least
OFF_CORNER = 0.15  # metres, from FORMED on, at most
FORMED = 5.0  # seconds after the start of the outer mission
RADIUS = 0.6  # metres between the middle of a triangle and its corners: param of triangle.koord

Place = tuple[float, float, float]
Poses = dict[float, dict[int, Place]]  # time (s) -> pid -> position (m, local ENU)


class Unusable(Exception):
    """Raised if the run's files cannot be judged. The message gives the reason."""


def read(trace: Path, robots: int) -> tuple[Poses, float]:
    """Return the poses of all robots in a merged trace, and the time of the mission's end. Raises Unusable."""
    poses: Poses = defaultdict(dict)
    end = math.inf
    try:
        with trace.open(encoding="utf-8") as file:
            for record in map(json.loads, file):
                if record["kind"] == "pose":
                    x, y, z = map(float, record["position"])
                    poses[record["t"]][record["pid"]] = x, y, z
                elif record["kind"] == "end":
                    end = record["t"]
    except (ValueError, KeyError, TypeError) as error:
        raise Unusable(f"{trace}: not the trace of a run: {type(error).__name__}: {error}") from None
    complete = {t: found for t, found in sorted(poses.items()) if t <= end and len(found) == robots}
    if not complete or end == math.inf:
        raise Unusable(f"{trace}: has no poses of {robots} robots, or no end of the mission")
    return complete, end


def off_line(place: Place, one: Place, other: Place) -> float:
    """Return the distance of a place from the straight line through two others, in plan view."""
    (x0, y0, _), (x1, y1, _) = one, other
    length = math.hypot(x1 - x0, y1 - y0)
    if length < OFF_LINE:
        raise Unusable(f"alpha and dora are {length:.2f} m apart: that is no line")
    return abs((x1 - x0) * (place[1] - y0) - (y1 - y0) * (place[0] - x0)) / length


def off_corner(poses: Poses, start: float) -> float:
    """Return the largest distance of a robot of a squad from its corner, from a time on."""
    worst = 0.0
    for t, places in poses.items():
        if t < start:
            continue
        count = len(places)
        middle = [sum(place[axis] for place in places.values()) / count for axis in range(3)]
        for pid, place in places.items():
            turn = 2 * math.pi * pid / count
            corner = middle[0] + RADIUS * math.cos(turn), middle[1] + RADIUS * math.sin(turn), middle[2]
            worst = max(worst, math.dist(place, corner))
    return worst


def judge(folder: Path) -> tuple[list[tuple[str, float, str, bool]], str]:
    """Return the figures of a run, and the reason why it cannot pass in spite of them; "" if there is none.

    A figure has its name, the value (m), the limit as text, and whether the value is within it."""
    try:
        summary: Any = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        flaw = "" if summary["verdict"] == "held" else f"the run itself: {summary['verdict']}, {summary['why']}"
    except (ValueError, KeyError, TypeError) as error:
        raise Unusable(f"{folder}: not the folder of a run: {type(error).__name__}: {error}") from None
    outer, end = read(folder / "trace.jsonl", 3)
    (alpha, beta, dora), first = (list(outer.values())[-1][pid] for pid in range(3)), next(iter(outer.values()))
    at_start, at_end = off_line(first[1], first[0], first[2]), off_line(beta, alpha, dora)
    off_middle = math.hypot(beta[0] - (alpha[0] + dora[0]) / 2, beta[1] - (alpha[1] + dora[1]) / 2)
    found = [
        ("beta off the line at the start", at_start, f">= {OFF_LINE_AT_START:g}", at_start >= OFF_LINE_AT_START),
        ("beta off the line at the end", at_end, f"<= {OFF_LINE:g}", at_end <= OFF_LINE),
        ("beta off the middle at the end", off_middle, f"<= {OFF_MIDDLE:g}", off_middle <= OFF_MIDDLE),
    ]
    for squad in SQUADS:
        poses, inner_end = read(folder / squad / "trace.jsonl", 3)
        worst = off_corner(poses, FORMED + inner_end - end)  # each fleet counts from its own round 1
        found.append((f"{squad}'s quads off their corners", worst, f"<= {OFF_CORNER:g}", worst <= OFF_CORNER))
    return found, flaw


def main(argv: list[str]) -> int:
    if len(argv) != 1 or argv[0].startswith("-"):
        print("usage: python squads_verdict.py DIR (the folder of a run of the squads)", file=sys.stderr)
        return 2
    try:
        found, flaw = judge(Path(argv[0]))
    except (Unusable, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    for name, value, limit, good in found:
        print(f"{name:32} {value:7.3f} m  ({limit} m){'' if good else '  NO'}")
    reasons = [name for name, _, _, good in found if not good] + [flaw] * bool(flaw)
    print("squads: they lined up in their triangles" if not reasons else f"squads: NO: {'; '.join(reasons)}")
    return 3 if reasons else 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
