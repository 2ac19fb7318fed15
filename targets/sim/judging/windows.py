"""Every window of a run: for each round and robot how each port assumption came out, and how far the body went outside
the box between where it was and its target. `windows.jsonl` beside the trace, when it is asked for; a Watcher fills it.

The first line says what the numbers are of, each further one is a window, the last one says that the run came to its
end: a file without it is none.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from koordgen.runtime.program.property import Properties
from koordgen.runtime.values.points import Point
from targets.sim.base.scenario import Scenario

FORMAT, FILE = "koord-windows/1", "windows.jsonl"
DIGITS = 6  # behind the point, of metres and metres a second
ROUNDING = 1e-9  # metres: what is outside by less is so by rounding, and is not told
# held, violated, no value, not known, out of the model, nothing was asked of the port that it is about
Came = Literal["h", "v", "n", "u", "o", "-"]
Array = NDArray[Any]


class Windows:
    """Of one run. `put` and `moved` are told window by window, `write` at the end."""

    def __init__(self, found: Properties, scenario: Scenario, seed: int) -> None:
        self._rows: list[dict[str, Any]] = []
        self._n = len(scenario.robots)
        self.goal = _goal(found)
        left = [u for u in found.unchecked if u.kind == "assume"]
        self._head = {
            "format": FORMAT, "app": scenario.app, "program_hash": scenario.program_hash, "seed": seed,
            "delta": scenario.delta, "body": self.goal.rpartition(".")[0],
            "robots": [{"name": r.name, "platform": f"{r.target} {r.sim.fidelity}"} for r in scenario.robots],
            "assumptions": [{"module": a.module, "line": a.line} for a in found.assumptions],
            "unchecked": [{"module": u.name, "line": u.line, "why": u.why} for u in left],
        }  # fmt: skip

    def begin(self, round_: int) -> None:
        """The window that begins when a round's events have run."""
        self._rows += [{"round": round_, "pid": pid, "came": ""} for pid in range(self._n)]

    def put(self, pid: int, came: Came) -> None:
        """How the next assumption came out for a robot."""
        self._rows[pid - self._n]["came"] += came

    def moved(self, positions: Array, velocities: Array, targets: list[Any], gone: list[int]) -> None:
        """Where the bodies were in it: arrays (moments, robots, 3) in metres and metres a second, local ENU; each
        robot's target, and who was out of the model."""
        for pid, target in enumerate(targets):
            if isinstance(target, Point) and pid not in gone:
                self._rows[pid - self._n] |= _geometry(
                    positions[:, pid], velocities[:, pid], np.array([target.x, target.y, target.z])
                )

    def write(self, folder: Path, ended: str) -> None:
        """Raises OSError."""
        lines = [self._head, *self._rows, {"end": ended}]
        with (folder / FILE).open("w", encoding="utf-8") as file:
            file.writelines(json.dumps(line, separators=(",", ":")) + "\n" for line in lines)


def _goal(found: Properties) -> str:
    """The actuator that holds the body at its own position until it is written; "" without one."""
    places = {p.name for p in found.program.ports if p.is_position}
    return next((p.name for p in found.program.ports if p.held in places), "")


def _geometry(places: Array, velocities: Array, target: Array) -> dict[str, Any]:
    """Of one window: where it began and how fast, how far from the target it came; and where the body was outside of
    the box between its place and the target, by how much (the vector from the box), how fast then, and how far from the
    target."""
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
    """Not less than it is: margins are learned of it."""
    return round(float(value) + 0.5 * 0.1**DIGITS, DIGITS)
