"""Verdict of a simulated run of Mapping: the shared map must agree with the obstacles of the world.

`python mapping_verdict.py DIR [--picture FILE]`, with the folder of the run. FILE becomes a PNG with the map at three
times. In DIR/trace.jsonl, for every version of the map that a robot wrote:

- a cell that is occupied in the map has an obstacle within the length of its diagonal from its centre;
- a cell that is free in the map has its centre at most half its side deep in an obstacle.

After 180 s, or at the end of a shorter run, 95 % of the free cells that can be reached must be known. These are the
cells that no obstacle touches, and that are connected with a robot's start through sides of such cells. Obstacles are
boxes and upright cylinders, which a lidar sees. Exit status: 0 yes, 3 no, 1 the files cannot be used, 2 usage.
"""

from __future__ import annotations

import base64
import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

WITHIN = 180.0  # seconds
SHARE = 0.95  # required share of the reachable free cells that are known
UNKNOWN, FREE, OCCUPIED = 0b00, 0b01, 0b11

Cell = tuple[int, int]
Place = tuple[float, float]


class Unusable(Exception):
    """Raised if the run's files cannot be judged. The message gives the reason."""


@dataclass(frozen=True)
class Box:
    """Box in plan view, in metres."""

    lo: Place
    hi: Place

    def beyond(self, p: Place) -> float:
        """Return the distance (m) of a point from the box; inside it is negative: the depth."""
        out = [max(lo - v, v - hi) for lo, v, hi in zip(self.lo, p, self.hi, strict=True)]
        return math.hypot(*(max(0.0, o) for o in out)) if max(out) > 0 else max(out)

    def touches(self, lo: Place, hi: Place) -> bool:
        """Return whether the box has a point in common with a rectangle."""
        return all(a <= d and c <= b for a, b, c, d in zip(self.lo, self.hi, lo, hi, strict=True))


@dataclass(frozen=True)
class Disc:
    """Disc in plan view, in metres."""

    centre: Place
    radius: float

    def beyond(self, p: Place) -> float:
        return math.dist(self.centre, p) - self.radius

    def touches(self, lo: Place, hi: Place) -> bool:
        nearest = [max(a, min(v, b)) for a, v, b in zip(lo, self.centre, hi, strict=True)]
        return math.dist(nearest, self.centre) <= self.radius


Shape = Box | Disc


@dataclass(frozen=True)
class Map:
    """GridMap of a trace: the state of each cell, by its index in the lattice."""

    t: float
    size: float
    window: tuple[int, int, int, int]  # x, y, width, height
    codes: dict[Cell, int]

    @classmethod
    def of(cls, t: float, value: list[Any]) -> Map:
        size, x, y, width, height, text = value
        bits = base64.b64decode(text)
        cells = [(x + i, y + j) for j in range(height) for i in range(width)]
        return cls(t, size, (x, y, width, height), {c: bits[k >> 2] >> 2 * (k & 3) & 3 for k, c in enumerate(cells)})

    def corners(self, cell: Cell) -> tuple[Place, Place]:
        x, y = cell
        return (x * self.size, y * self.size), ((x + 1) * self.size, (y + 1) * self.size)


@dataclass(frozen=True)
class Run:
    """Data of a run."""

    shapes: list[Shape]
    starts: list[Place]
    maps: list[Map]
    flaw: str


def read(folder: Path) -> Run:
    """Read trace and summary. Raises Unusable."""
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        with (folder / "trace.jsonl").open(encoding="utf-8") as file:
            records = [json.loads(line) for line in file]
        shapes = [_shape(obstacle) for obstacle in records[0]["obstacles"]]
        starts = {r["pid"]: (r["position"][0], r["position"][1]) for r in reversed(records) if r["kind"] == "pose"}
        handed = [r for r in records if r["kind"] == "round" and "map" in (r.get("shared") or {})]
        maps = [Map.of(r["t"], r["shared"]["map"]) for r in handed]
    except OSError as error:
        raise Unusable(f"{error.filename}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise Unusable(f"{folder}: not the folder of a run: {type(error).__name__}: {error}") from None
    if not maps:
        raise Unusable(f"{folder}: no robot wrote a map")
    flaw = "" if summary["verdict"] == "held" else f"the run itself: {summary['verdict']}, {summary['why']}"
    return Run(shapes, list(starts.values()), maps, flaw)


def _shape(obstacle: dict[str, Any]) -> Shape:
    match obstacle["shape"]:
        case "box":
            return Box((obstacle["lo"][0], obstacle["lo"][1]), (obstacle["hi"][0], obstacle["hi"][1]))
        case "cylinder":
            return Disc((obstacle["base"][0], obstacle["base"][1]), obstacle["radius"])
        case other:
            raise ValueError(f"unknown obstacle {other!r}; this verdict knows box, sphere and cylinder")


def reachable(run: Run) -> set[Cell]:
    """Return the cells of the map's window that no obstacle touches and that are connected with a start."""
    grid = run.maps[0]
    free = {c for c in grid.codes if not any(shape.touches(*grid.corners(c)) for shape in run.shapes)}
    starts = {(math.floor(x / grid.size), math.floor(y / grid.size)) for x, y in run.starts}
    found, waiting = set(starts & free), list(starts & free)
    while waiting:
        x, y = waiting.pop()
        for cell in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
            if cell in free and cell not in found:
                found.add(cell)
                waiting.append(cell)
    return found


def contradictions(run: Run) -> list[str]:
    """Return the cells that contradict the world, each once, with the first time."""
    found: dict[tuple[Cell, int], str] = {}
    for map_ in run.maps:
        for cell, code in map_.codes.items():
            if code == UNKNOWN or (cell, code) in found:
                continue
            lo, hi = map_.corners(cell)
            beyond = min((s.beyond(((lo[0] + hi[0]) / 2, (lo[1] + hi[1]) / 2)) for s in run.shapes), default=math.inf)
            if code == OCCUPIED and beyond > math.sqrt(2) * map_.size:
                found[cell, code] = f"at {map_.t:.1f} s cell {cell} is occupied, {beyond:.2f} m from any obstacle"
            elif code == FREE and beyond < -map_.size / 2:
                inside = f"{-beyond:.2f} m inside an obstacle"
                found[cell, code] = f"at {map_.t:.1f} s cell {cell} is marked as free, but lies {inside}"
    return list(found.values())


def known(map_: Map, cells: set[Cell]) -> float:
    """Return the share of cells that are known."""
    return sum(map_.codes[c] != UNKNOWN for c in cells) / len(cells) if cells else 0.0


def draw(run: Run, cells: set[Cell], file: str) -> None:
    """Draw the first map, the map halfway by the share of known cells, and the last map. Raises OSError."""
    from matplotlib.figure import Figure

    shares = [known(m, cells) for m in run.maps]
    wanted = [shares[0] + (shares[-1] - shares[0]) * part for part in (0.0, 0.5, 1.0)]
    chosen = [next(k for k, share in enumerate(shares) if share >= want - 1e-9) for want in wanted]
    figure = Figure(figsize=(15, 4.8), layout="constrained")
    for axes, k in zip(figure.subplots(1, 3), chosen, strict=True):
        map_ = run.maps[k]
        x, y, width, height = map_.window
        rows = [
            [(0.72, 1.0, 0.12)[(0, 1, 0, 2)[map_.codes[x + i, y + j]]] for i in range(width)] for j in range(height)
        ]
        edges = [v * map_.size for v in (x, x + width, y, y + height)]
        axes.imshow(rows, cmap="gray", vmin=0, vmax=1, origin="lower", extent=edges)
        for shape in run.shapes:
            if isinstance(shape, Box):
                (x0, y0), (x1, y1) = shape.lo, shape.hi
                axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color="#c0392b", linewidth=0.8)
        axes.set_title(f"{map_.t:.0f} s: {100 * shares[k]:.1f} % known")
        axes.set_xlabel("x, east (m)")
        axes.set_ylabel("y, north (m)")
    figure.savefig(file, dpi=90)


def main(argv: list[str]) -> int:
    picture = argv[2] if len(argv) == 3 and argv[1] == "--picture" else ""
    if not argv or argv[0].startswith("-") or len(argv) != (3 if picture else 1):
        print(
            "usage: python mapping_verdict.py DIR [--picture FILE] (the folder of a run of Mapping)",
            file=sys.stderr,
        )
        return 2
    try:
        run = read(Path(argv[0]))
    except Unusable as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    cells, wrong = reachable(run), contradictions(run)
    if picture:
        draw(run, cells, picture)
    in_time = [map_ for map_ in run.maps if map_.t <= WITHIN]
    share = known(in_time[-1], cells) if in_time else 0.0
    reached = next((m.t for m in run.maps if known(m, cells) >= SHARE), None)
    print(f"{len(run.maps)} maps were handed in; {len(cells)} cells are free and can be reached")
    for line in wrong[:10]:
        print(line)
    reasons = [f"{len(wrong)} cells contradict the truth: {wrong[0]}"] if wrong else []
    if share < SHARE:
        reasons.append(f"{100 * share:.1f} % of the reachable free cells are known, {100 * SHARE:g} % are wanted")
    if run.flaw:
        reasons.append(run.flaw)
    print("Mapping: the map is right" if not reasons else f"Mapping: NO: {'; '.join(reasons)}")
    figures = {"known, %": round(100 * share, 2), "contradictions": len(wrong)}
    if reached is not None:
        figures["95 % known, s"] = round(reached, 1)
    print(json.dumps(figures))
    return 3 if reasons else 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
