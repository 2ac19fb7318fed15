"""Verdict of a simulated run of the survey: the map must be true, and every task that can be reached must be done.

`python survey_verdict.py DIR`, with the folder of the run. In DIR/trace.jsonl:

- in every version of the map, an occupied cell has an obstacle within the length of its diagonal from its centre, and a
  free cell has its centre at most half its side deep in an obstacle;
- at the end, 95 % of the free cells are known that no obstacle touches and that are connected with a robot's start;
- each task whose cell is one of these was done once, and its robot was truly within 0.3 m of it; all other tasks were
  reported as not reachable;
- from its first path on, a quad was always above a cell that the map knew to be free.

Obstacles are boxes, which a lidar sees. Exit status: 0 yes, 3 no, 1 the files cannot be used, 2 usage.
"""

from __future__ import annotations

import base64
import json
import math
import re
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SHARE = 0.95  # required share of the reachable free cells that are known
NEAR = 0.3  # metres
UNKNOWN, FREE, OCCUPIED = 0b00, 0b01, 0b11
TOLD = re.compile(r"task (-?\d+) (done|is not reachable)")

Cell = tuple[int, int]
Place = tuple[float, float, float]
Box = tuple[Place, Place]  # lower and upper corner


class Unusable(Exception):
    """Raised if the run's files cannot be judged. The message gives the reason."""


@dataclass(frozen=True)
class Map:
    """GridMap of a trace: the state of each cell, by its index in the lattice. `size`: side of a cell (m)."""

    t: float
    size: float
    codes: dict[Cell, int]

    @classmethod
    def of(cls, t: float, value: list[Any]) -> Map:
        size, x, y, width, height, text = value
        bits = base64.b64decode(text)
        cells = [(x + i, y + j) for j in range(height) for i in range(width)]
        return cls(t, size, {c: bits[k >> 2] >> 2 * (k & 3) & 3 for k, c in enumerate(cells)})

    def cell(self, place: Place) -> Cell:
        return math.floor(place[0] / self.size), math.floor(place[1] / self.size)


@dataclass
class Run:
    """Data of a run. `done`: task, distance of its robot from it (m). `astray`: places of quads above no free cell."""

    boxes: list[Box] = field(default_factory=list)
    starts: dict[int, Place] = field(default_factory=dict)
    tasks: dict[int, Place] = field(default_factory=dict)
    maps: list[Map] = field(default_factory=list)
    done: list[tuple[int, float]] = field(default_factory=list)
    given_up: set[int] = field(default_factory=set)
    astray: list[str] = field(default_factory=list)
    flaw: str = ""


def read(folder: Path) -> Run:
    """Read trace, summary and the tasks of the program. Raises Unusable."""
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        params = json.loads((folder / "source" / "task" / "params.json").read_text(encoding="utf-8"))
        tasks = {task["id"]: tuple(task["target"]) for task in params["tasks"]}
        with (folder / "trace.jsonl").open(encoding="utf-8") as file:
            run = _seen([json.loads(line) for line in file], tasks)
    except OSError as error:
        raise Unusable(f"{error.filename}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise Unusable(f"{folder}: not the folder of a run: {type(error).__name__}: {error}") from None
    if not run.maps:
        raise Unusable(f"{folder}: no robot wrote a map")
    if summary["verdict"] != "held":
        run.flaw = f"the run itself: {summary['verdict']}, {summary['why']}"
    return run


def _seen(records: list[dict[str, Any]], tasks: dict[int, Any]) -> Run:
    header, *rest = records
    run = Run(tasks=tasks, boxes=[(tuple(each["lo"]), tuple(each["hi"])) for each in header["obstacles"]])
    names = {robot["pid"]: robot["name"] for robot in header["robots"]}
    places: dict[int, Place] = {}
    flying: set[int] = set()
    for record in rest:
        pid = record.get("pid", -1)
        match record["kind"]:
            case "pose":
                places[pid] = tuple(record["position"])
                run.starts.setdefault(pid, places[pid])
                if pid in flying and run.maps and run.maps[-1].codes.get(run.maps[-1].cell(places[pid])) != FREE:
                    run.astray.append(f"at {record['t']:.1f} s {names[pid]} was above a cell that is not known")
            case "round":
                if "map" in record["shared"]:
                    run.maps.append(Map.of(record["t"], record["shared"]["map"]))
                if record["application"] == "task" and record["actuators"]:
                    flying.add(pid)
            case "stream" if told := TOLD.match(record["text"]):
                task = int(told[1])
                if told[2] == "done":
                    run.done.append((task, math.dist(places[pid], tasks[task])))
                else:
                    run.given_up.add(task)
            case "end":
                flying.clear()  # robots land
    return run


def reachable(run: Run) -> set[Cell]:
    """Return the cells of the map's window that no obstacle touches and that are connected with a start."""
    grid = run.maps[0]
    free = {c for c in grid.codes if not any(_touches(box, c, grid.size) for box in run.boxes)}
    found = {grid.cell(place) for place in run.starts.values()} & free
    waiting = list(found)
    while waiting:
        x, y = waiting.pop()
        for cell in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
            if cell in free and cell not in found:
                found.add(cell)
                waiting.append(cell)
    return found


def _touches(box: Box, cell: Cell, size: float) -> bool:
    return all(box[0][k] <= (cell[k] + 1) * size and cell[k] * size <= box[1][k] for k in (0, 1))


def contradictions(run: Run) -> list[str]:
    """Return the cells that contradict the world, each once, with the first time."""
    found: dict[tuple[Cell, int], str] = {}
    for map_ in run.maps:
        for cell, code in map_.codes.items():
            if code == UNKNOWN or (cell, code) in found:
                continue
            centre = [(v + 0.5) * map_.size for v in cell]
            beyond = min((_beyond(box, centre) for box in run.boxes), default=math.inf)
            if code == OCCUPIED and beyond > math.sqrt(2) * map_.size:
                found[cell, code] = f"at {map_.t:.1f} s cell {cell} is occupied, {beyond:.2f} m from any obstacle"
            elif code == FREE and beyond < -map_.size / 2:
                found[cell, code] = f"at {map_.t:.1f} s cell {cell} is free, but lies in an obstacle"
    return list(found.values())


def _beyond(box: Box, place: list[float]) -> float:
    """Return the distance (m) of a place from a box in plan view; inside it is negative: the depth."""
    out = [max(box[0][k] - place[k], place[k] - box[1][k]) for k in (0, 1)]
    return math.hypot(*(max(0.0, o) for o in out)) if max(out) > 0 else max(out)


def flaws(run: Run) -> list[str]:
    """Return the reasons why a run is not right."""
    cells, last = reachable(run), run.maps[-1]
    wrong, times = contradictions(run), Counter(task for task, _ in run.done)
    share = sum(last.codes[c] != UNKNOWN for c in cells) / max(1, len(cells))
    found = [f"{len(wrong)} cells contradict the truth: {wrong[0]}"] if wrong else []
    if share < SHARE:
        found.append(f"{100 * share:.1f} % of the reachable free cells are known, {100 * SHARE:g} % are wanted")
    for task, place in run.tasks.items():
        if last.cell(place) not in cells:
            found += [f"task {task} cannot be reached, and nobody said so"] if task not in run.given_up else []
        elif times[task] != 1:
            found.append(f"task {task} was done {times[task]} times")
    found += [f"task {task} was reported from {far:.2f} m away" for task, far in run.done if far > NEAR]
    found += run.astray[:1]
    return found + ([run.flaw] if run.flaw else [])


def main(argv: list[str]) -> int:
    if len(argv) != 1 or argv[0].startswith("-"):
        print("usage: python survey_verdict.py DIR (the folder of a run of the survey)", file=sys.stderr)
        return 2
    try:
        run = read(Path(argv[0]))
    except Unusable as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    reasons = flaws(run)
    print("Survey: the map is right, and all tasks are done" if not reasons else f"Survey: NO: {'; '.join(reasons)}")
    figures = {"tasks done": len(run.done), "not reachable": len(run.given_up), "maps": len(run.maps)}
    print(json.dumps(figures))
    return 3 if reasons else 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
