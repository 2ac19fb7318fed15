"""Plot of runs of Task, side by side: the paths that robots published, and the times of their trips.

`python paths.py PICTURE DIR...`, a PNG to write and the folders of runs. Exit status: 0 done, 1 the files cannot be
used, 2 usage.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")


@dataclass(frozen=True)
class Trip:
    """A robot's trip to a task: begin and end (s), and the path (m, local ENU)."""

    pid: int
    task: int
    path: list[list[float]]
    begin: float
    end: float


def trips(folder: Path) -> tuple[list[str], list[Trip]]:
    """Return the names of robots, and all trips that were travelled. Raises OSError, ValueError, KeyError."""
    with (folder / "trace.jsonl").open(encoding="utf-8") as file:
        header, *records = [json.loads(line) for line in file]
    taken: dict[int, dict[str, Any]] = {}
    found = []
    for record in records:
        if record["kind"] != "round":
            continue
        pid = record["pid"]
        if record.get("event") == "Assign" and record["locals"].get("on_task"):
            taken[pid] = record
        elif record.get("event") == "Complete" and pid in taken:
            begun = taken.pop(pid)
            path, task = begun["shared"]["shared_paths"], begun["locals"]["cur_task"][1]
            found.append(Trip(pid, task, path, begun["t"], record["t"]))
    return [robot["name"] for robot in header["robots"]], found


def draw(picture: str, folders: list[Path]) -> None:
    """Draw the paths from above, and below them a time line for each robot. Raises OSError, and what `trips` raises."""
    figure = Figure(figsize=(5.6 * len(folders), 8.4), layout="constrained")
    read = [trips(folder) for folder in folders]
    last = max(trip.end for _, found in read for trip in found)
    above, below = figure.subplots(2, len(folders), squeeze=False, height_ratios=(4, 1))
    for plan, line, folder, (names, found) in zip(above, below, folders, read, strict=True):
        for trip in found:
            colour = COLOURS[trip.pid % len(COLOURS)]
            x, y, _ = zip(*trip.path, strict=True)
            plan.plot(x, y, color=colour, linewidth=1.6)
            plan.plot(x[-1], y[-1], "o", color=colour, markersize=5)
            plan.annotate(str(trip.task), (x[-1], y[-1]), xytext=(4, 4), textcoords="offset points", fontsize=8)
            line.barh(trip.pid, trip.end - trip.begin, left=trip.begin, color=colour, edgecolor="white")
        travelled = sum(trip.end - trip.begin for trip in found) / max(trip.end for trip in found)
        plan.set_title(f"{folder.name}: {max(t.end for t in found):.1f} s, {travelled:.2f} robots under way on average")
        plan.set_aspect("equal")
        plan.set_xlabel("x, east (m)")
        plan.set_ylabel("y, north (m)")
        plan.grid(alpha=0.3)
        line.set_yticks(range(len(names)), names)
        line.set_xlim(0, last)
        line.set_xlabel("t (s)")
    figure.savefig(picture, dpi=90)


def main(argv: list[str]) -> int:
    if len(argv) < 2 or argv[0].startswith("-"):
        print("usage: python paths.py PICTURE DIR... (the folders that runs of Task left)", file=sys.stderr)
        return 2
    try:
        draw(argv[0], [Path(name) for name in argv[1:]])
    except (OSError, ValueError, KeyError) as error:
        print(f"error: {type(error).__name__}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
