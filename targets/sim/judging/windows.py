"""Records of all windows of a run: results of port assumptions, and excursions of bodies.

For each round and robot: how each port assumption came out, and how far the body left the box between its position and
its target. A Watcher fills it and, on request, `windows.jsonl` is written beside the trace. Its first line is a header,
each further line a window, the last line the end of the run: a file without an end is incomplete."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from koordgen.runtime.program.property import Properties
from koordgen.runtime.values.points import Point
from targets.sim.base.scenario import Scenario

FORMAT, FILE = "koord-windows/1", "windows.jsonl"
DIGITS = 6  # number of decimals of values in metres, and in metres per second
ROUNDING = 1e-9  # metres; a smaller excess is due to rounding and not recorded
# held, violated, no value, not known, out of the model, nothing was called on the assumption's port
Came = Literal["h", "v", "n", "u", "o", "-"]
Array = NDArray[Any]


class Windows:
    """Windows of one run. `put` and `moved` are called window by window, `write` at the end.

    members: robots that run the application, whose pids are their places here; None: all robots."""

    def __init__(self, found: Properties, scenario: Scenario, seed: int, members: Sequence[int] | None = None) -> None:
        self._rows: list[dict[str, Any]] = []
        robots = [r for r in scenario.robots if members is None or r.pid in members]
        self._n = len(robots)
        self.goal = _goal(found)
        left = [u for u in found.unchecked if u.kind == "assume"]
        self._head = {
            "format": FORMAT, "app": scenario.app, "program_hash": scenario.program_hash, "seed": seed,
            "delta": scenario.delta, "body": self.goal.rpartition(".")[0],
            "robots": [{"name": r.name, "platform": f"{r.target} {r.sim.fidelity or r.body}"} for r in robots],
            "assumptions": [{"module": a.module, "line": a.line} for a in found.assumptions],
            "unchecked": [{"module": u.name, "line": u.line, "why": u.why} for u in left],
        }  # fmt: skip

    def begin(self, round_: int) -> None:
        """Begin the windows of a round, whose events have run."""
        self._rows += [{"round": round_, "pid": pid, "came": ""} for pid in range(self._n)]

    def put(self, pid: int, came: Came) -> None:
        """Record the result of the next assumption for a robot."""
        self._rows[pid - self._n]["came"] += came

    def moved(self, positions: Array, velocities: Array, targets: list[Any], lost: list[int]) -> None:
        """Record the motion of the bodies in the window.

        Arrays (observations, robots, 3) in metres and metres a second, local ENU; each robot's target; robots out of
        the model."""
        for pid, target in enumerate(targets):
            if isinstance(target, Point) and pid not in lost:
                self._rows[pid - self._n] |= _geometry(
                    positions[:, pid], velocities[:, pid], np.array([target.x, target.y, target.z])
                )

    def write(self, folder: Path, ended: str) -> None:
        """Write the file. Raises OSError."""
        lines = [self._head, *self._rows, {"end": ended}]
        with (folder / FILE).open("w", encoding="utf-8") as file:
            file.writelines(json.dumps(line, separators=(",", ":")) + "\n" for line in lines)


def _goal(found: Properties) -> str:
    """Return the actuator whose value is the body's position until its first command; "" if there is none."""
    places = {p.name for p in found.program.ports if p.is_position}
    return next((p.name for p in found.program.ports if p.held in places), "")


def _geometry(places: Array, velocities: Array, target: Array) -> dict[str, Any]:
    """Return the geometry of one window.

    Its start position and velocity, and the largest distance from the target. If the body left the box between start
    and target: the largest excess (vector from the box), the velocity then, and the largest distance from the target
    outside."""
    start = places[0]
    lo, hi = np.minimum(start, target), np.maximum(start, target)
    excess = np.maximum(places - hi, 0.0) + np.minimum(places - lo, 0.0)
    outside = np.sqrt((excess * excess).sum(axis=1))
    away = np.sqrt(((places - target) ** 2).sum(axis=1))
    worst = int(outside.argmax())
    row = {
        "start": _rounded(start), "target": _rounded(target), "velocity": _rounded(velocities[0]),
        "reach": _up(away.max()),
    }  # fmt: skip
    if outside[worst] > ROUNDING:
        far = float(away[outside > ROUNDING].max())
        out = [round(float(c), 9) for c in excess[worst]]
        row |= {"out": out, "then": _rounded(velocities[worst]), "far": _up(far)}
    return row


def _rounded(vector: Array) -> list[float]:
    return [round(float(c), DIGITS) for c in vector]


def _up(value: float) -> float:
    """Round a value up, so that a margin learned from it is never too small."""
    return round(float(value) + 0.5 * 0.1**DIGITS, DIGITS)
