"""Verdict of a simulated run of Task: every task must be visited exactly once. `python task_verdict.py DIR`.

DIR is the folder of the run; data come from DIR/trace.jsonl. Each task of the initial list must be done by exactly one
robot, once. When a robot reported a task as done, its true position must have been within 0.3 m of the task. No two
robots may ever have been closer than `min_separation` of the fleet file, at any step of the physics. Also prints the
time at which the last task was done, and the average number of robots that were travelling until then. Exit status: 0
yes, 3 no, 1 the files cannot be used, 2 usage.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

NEAR = 0.3  # metres
DONE = re.compile(r"task (-?\d+) done")

Place = tuple[float, float, float]


class Unusable(Exception):
    """Raised if the run's files cannot be judged. The message gives the reason."""


@dataclass
class Seen:
    """Data of a trace: tasks by their id, each report of a done task, and the time that robots were travelling.

    `done`: time (s), pid, task, distance from the task (m). The travelling time (s) is summed over all robots.
    """

    tasks: dict[int, Place] = field(default_factory=dict)
    done: list[tuple[float, int, int, float]] = field(default_factory=list)  # t, pid, task, metres
    under_way: float = 0.0
    names: dict[int, str] = field(default_factory=dict)


def read(folder: Path) -> tuple[Seen, dict[str, Any]]:
    """Read the trace and the summary. Raises Unusable."""
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        with (folder / "trace.jsonl").open(encoding="utf-8") as file:
            return _seen([json.loads(line) for line in file]), summary
    except OSError as error:
        raise Unusable(f"{error.filename}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise Unusable(f"{folder}: not the folder of a run: {type(error).__name__}: {error}") from None


def _seen(records: list[dict[str, Any]]) -> Seen:
    header, *rest = records
    seen = Seen(names={robot["pid"]: robot["name"] for robot in header["robots"]})
    places: dict[int, Place] = {}
    since: dict[int, float] = {}
    for record in rest:
        pid = record.get("pid", -1)
        match record["kind"]:
            case "pose":
                places[pid] = tuple(record["position"])
            case "round" if "all_tasks" in (record.get("shared") or {}):
                if not seen.tasks:  # the first version of the list
                    target, number = record["locals"]["cur_task"]
                    listed = [(target, number), *record["shared"]["all_tasks"]]
                    seen.tasks = {id_: tuple(place) for place, id_ in listed}
                since[pid] = record["t"]
            case "stream" if found := DONE.fullmatch(record["text"]):
                number = int(found[1])
                off = math.dist(places[pid], seen.tasks.get(number, (math.inf,) * 3))
                seen.done.append((record["t"], pid, number, off))
                seen.under_way += record["t"] - since.get(pid, record["t"])
    return seen


def judge(seen: Seen, summary: dict[str, Any]) -> list[str]:
    """Return the reasons why the run fails; empty if it passes."""
    times = Counter(number for _, _, number, _ in seen.done)
    reasons = [] if seen.tasks else ["no task was taken"]
    reasons += [f"task {number} was visited {times[number]} times" for number in seen.tasks if times[number] != 1]
    reasons += [f"task {number} was not in the list" for number in times if number not in seen.tasks]
    reasons += [
        f"{seen.names[pid]} was {off:.2f} m from task {number} when it said that it was done"
        for _, pid, number, off in seen.done
        if not off <= NEAR
    ]
    if summary["verdict"] != "held":
        reasons.append(f"the run itself: {summary['verdict']}, {summary['why']}")
    return reasons


def main(argv: list[str]) -> int:
    if len(argv) != 1 or argv[0].startswith("-"):
        print("usage: python task_verdict.py DIR (the folder of a run of Task)", file=sys.stderr)
        return 2
    try:
        seen, summary = read(Path(argv[0]))
        reasons = judge(seen, summary)
    except (Unusable, KeyError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    for t, pid, number, off in seen.done:
        print(f"{t:7.1f} s  {seen.names[pid]} did task {number}, {off:.3f} m from it")
    last = max((t for t, *_ in seen.done), default=0.0)
    closest = (summary.get("min_separation") or {}).get("distance", math.inf)
    print(f"closest two robots ever came: {closest:.3f} m")
    print("Task: every task was visited once" if not reasons else f"Task: NO: {'; '.join(reasons)}")
    visited = len({number for _, _, number, _ in seen.done})
    figures = {"tasks visited": visited, "last task, s": round(last, 2)}
    if last:
        figures["robots under way"] = round(seen.under_way / last, 3)
    print(json.dumps(figures))
    return 3 if reasons else 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
