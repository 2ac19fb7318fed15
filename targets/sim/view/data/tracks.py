"""Tracks: each robot's positions over time as arrays, with markers, maps and marks for pictures."""

from __future__ import annotations

from base64 import b64decode
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koordgen.runtime.trace.schema import Header
from targets.sim.base.bodies import Vector
from targets.sim.view.data.markers import TO_DO
from targets.sim.view.data.rows import Chunk

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MarkerHistory:
    """A marker with its states and the times when they began."""

    position: Vector
    radius: float
    states: list[tuple[float, int]]

    def state(self, t: float) -> int:
        return next((state for since, state in reversed(self.states) if since <= t), TO_DO)


@dataclass(frozen=True, slots=True)
class Tracks:
    """Data of a run for pictures.

    `times[pid]` (s) and `places[pid]` (one row x, y, z in m, yaw in rad per sample). `near`: t and smallest distance.
    `maps`: GridMaps over time by variable and slot (-1: an allwrite variable). `paths[pid]`: t and points. `end`: the
    mission's end. `violations`: t, kind and robots. `members[pid]`: robot of a squad -> rows t, x, y, z, yaw."""

    header: Header
    times: list[Array]
    places: list[Array]
    near: Array
    end: float | None
    violations: list[tuple[float, str, list[str]]]
    markers: list[MarkerHistory]
    maps: dict[tuple[str, int], list[tuple[float, Any]]]
    paths: list[list[tuple[float, Array]]]
    members: list[dict[str, Array]]

    def span(self) -> tuple[float, float]:
        """Return the first and the last time."""
        known = [t for t in self.times if len(t)]
        return (min(float(t[0]) for t in known), max(float(t[-1]) for t in known)) if known else (0.0, 1.0)

    def upto(self, pid: int, t: float) -> int:
        """Return the number of a robot's samples up to `t`."""
        return int(np.searchsorted(self.times[pid], t, side="right"))


def tracks(header: Header, rows: Chunk) -> Tracks:
    """Convert the rows of a run to arrays."""
    own: list[list[list[float]]] = [[] for _ in header.robots]
    for row in rows["poses"]:
        own[row[0]].append(row[1:])
    arrays = [np.array(each, dtype=np.float64).reshape(-1, 5) for each in own]
    paths: list[list[tuple[float, Array]]] = [[] for _ in header.robots]
    for pid, t, points in rows["paths"]:
        paths[pid].append((t, np.array(points, dtype=np.float64).reshape(-1, 3)))
    of_squads: list[dict[str, list[list[float]]]] = [{} for _ in header.robots]
    for pid, t, name, *pose in rows.get("members", ()):
        of_squads[pid].setdefault(name, []).append([t, *pose])
    markers = [MarkerHistory(m.position, m.radius, []) for m in header.world.markers]
    for t, number, state, *more in rows["markers"]:
        if more and number == len(markers):
            markers.append(MarkerHistory(more[0]["position"], more[0]["radius"], []))
        markers[number].states.append((t, state))
    kinds = {v.name: v.kind for v in header.shared if v.type == "GridMap"}
    maps: dict[tuple[str, int], list[tuple[float, Any]]] = {}
    for name, pid, t, _, value in rows["shared"]:
        if name in kinds:
            maps.setdefault((name, -1 if kinds[name] == "allwrite" else pid), []).append((t, value))
    return Tracks(
        header,
        [a[:, 0] for a in arrays],
        [a[:, 1:] for a in arrays],
        np.array([row[:2] for row in rows["near"]], dtype=np.float64).reshape(-1, 2),
        next((row[0] for row in rows["marks"] if row[1] == "end"), None),
        [(row[0], row[2], row[3]) for row in rows["marks"] if row[1] == "violation"],
        markers,
        maps,
        paths,
        [{name: np.array(each, dtype=np.float64) for name, each in squad.items()} for squad in of_squads],
    )


def cells(value: Any) -> tuple[NDArray[np.uint8], tuple[float, float, float, float]] | None:
    """Return a GridMap's cells and extent, None for an invalid or empty one.

    Cells: row by row from below (0 unknown, 1 free, 3 occupied). Extent: left, right, bottom, top."""
    try:
        size, x, y, width, height, packed = value
        raw = np.frombuffer(b64decode(packed), dtype=np.uint8)
        pairs = np.stack([(raw >> shift) & 3 for shift in (0, 2, 4, 6)], axis=1).reshape(-1)
        grid = pairs[: width * height].reshape(height, width)
        box = (x * size, (x + width) * size, y * size, (y + height) * size)
    except (TypeError, ValueError):
        return None
    return (grid, box) if grid.size else None
