"""The pictures of a run: coordinates over time, the top view, the smallest separation; by matplotlib, off screen."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from koordgen.runtime.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from targets.sim.trace import End, Header, Pose, Record, Violation

matplotlib.use("Agg")

from matplotlib import pyplot as plt
from matplotlib.collections import PolyCollection

# Okabe and Ito, Color Universal Design (2008), without the yellow that vanishes on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (2, 1.5)), (0, (6, 2, 1.5, 2)))
MARKERS = ("o", "s", "^", "D", "v", "P")
RED, GREY, STONE = "#B00020", "#777777", "#CCCCCC"
MOST_POINTS = 20_000  # of one track in a picture
LEAD = 0.15  # of the mission's length that is shown before round 1
STYLE = {
    "font.size": 11, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "grid.color": "#DDDDDD", "grid.linewidth": 0.7, "axes.axisbelow": True, "figure.dpi": 110, "svg.hashsalt": "koord",
}  # fmt: skip

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Tracks:
    """Where each robot was: `times[pid]` (s) and `places[pid]` (m, a row each); the mission's end, the violations."""

    header: Header
    times: list[Array]
    places: list[Array]
    end: float | None
    violations: list[Violation]


def tracks(header: Header, records: Iterable[Record]) -> Tracks:
    """Gather the poses of a merged trace."""
    rows: list[list[tuple[float, float, float, float]]] = [[] for _ in header.robots]
    end: float | None = None
    violations: list[Violation] = []
    for record in records:
        match record:
            case Pose(t=t, pid=pid, position=(x, y, z)) if 0 <= pid < len(rows):
                rows[pid].append((t, x, y, z))
            case End(t=t):
                end = t
            case Violation():
                violations.append(record)
            case _:
                pass
    arrays = [np.array(r, dtype=np.float64).reshape(-1, 4) for r in rows]
    return Tracks(header, [a[:, 0] for a in arrays], [a[:, 1:] for a in arrays], end, violations)


def draw(found: Tracks, folder: Path) -> dict[str, Path]:
    """Write the pictures into `folder`; caption -> file. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    made: dict[str, Path] = {}
    with plt.rc_context(STYLE):
        made["Top view"] = _top(found, folder / "top.png")
        for axis, name in enumerate("xyz"):
            made[f"{name} over time"] = _over_time(found, axis, name, folder / f"{name}-t.png")
        if len(found.header.robots) > 1:
            made["Smallest separation over time"] = _separation(found, folder / "separation.png")
    return made


def _style(pid: int) -> dict[str, Any]:
    return {"color": COLOURS[pid % len(COLOURS)], "linestyle": DASHES[pid // len(COLOURS) % len(DASHES)]}


def _marker(found: Tracks, pid: int) -> str:
    """One marker for each target."""
    kinds = sorted({robot.target for robot in found.header.robots})
    return MARKERS[kinds.index(found.header.robots[pid].target) % len(MARKERS)]


def _thin(values: Array) -> Array:
    return values[:: max(1, len(values) // MOST_POINTS)]


def _span(found: Tracks) -> tuple[float, float]:
    """The times shown: the mission, a little before it, and the way to rest."""
    known = [t for t in found.times if len(t)]
    if not known:
        return 0.0, 1.0
    first, last = min(float(t[0]) for t in known), max(float(t[-1]) for t in known)
    return max(first, -LEAD * max(last, 1.0)), max(last, first + 0.1)


def _over_time(found: Tracks, axis: int, name: str, path: Path) -> Path:
    figure, axes = plt.subplots(figsize=(9, 4.6), layout="constrained")
    ends: list[tuple[float, int]] = []
    for pid, (times, places) in enumerate(zip(found.times, found.places, strict=True)):
        if len(times):
            width = 2.8 - 1.2 * pid / max(1, len(found.times) - 1)  # lines that cover one another stay visible
            axes.plot(_thin(times), _thin(places[:, axis]), linewidth=width, **_style(pid))
            ends.append((float(places[-1, axis]), pid))
    first, last = _span(found)
    axes.set_xlim(first, last)
    _mark_times(axes, found)
    _name_ends(axes, found, ends, last)
    direction = {"x": "east", "y": "north", "z": "up"}[name]
    axes.set(xlabel="time since round 1 (s)", ylabel=f"{name}, {direction} (m)")
    axes.set_title(f"{found.header.app}: {name} over time", loc="left", pad=16)
    return _save(figure, path)


def _mark_times(axes: Any, found: Tracks) -> None:
    """Round 1, the mission's end and the first violation, each named above the frame."""
    marks = [(0.0, "round 1", GREY)] if found.header.started else []
    if found.end is not None:
        marks.append((found.end, "end of mission", GREY))
    if found.violations:
        first = found.violations[0]
        marks.append((first.t, f"{first.what}: {', '.join(first.robots)}", RED))
    low, high = axes.get_xlim()
    for t, text, colour in marks:
        if low <= t <= high:
            axes.axvline(t, color=colour, linewidth=1.0, linestyle=(0, (3, 3)), zorder=1)
            right, left = t > low + 0.8 * (high - low), colour == RED or t < low + 0.2 * (high - low)
            side = "right" if right else "left" if left else "center"
            where, line, aside = (1.01, "bottom", 0) if colour == GREY else (0.98, "top", -4 if right else 4)
            axes.annotate(
                text, (t, where), xycoords=axes.get_xaxis_transform(), xytext=(aside, 0), textcoords="offset points",
                color=colour, fontsize=9, ha=side, va=line,
            )  # fmt: skip


def _name_ends(axes: Any, found: Tracks, ends: list[tuple[float, int]], last: float) -> None:
    """Robots' names beside the ends of their lines, moved apart where they would cover one another."""
    low, high = axes.get_ylim()
    gap = (high - low) * min(0.055, 1 / max(1, len(ends)))
    heights: list[float] = []
    for value, _ in sorted(ends):
        heights.append(max(value, heights[-1] + gap) if heights else value)
    shifts = [height - value for (value, _), height in zip(sorted(ends), heights, strict=True)]
    excess = max(sum(shifts) / len(shifts), heights[-1] - high) if shifts else 0.0
    for (value, pid), height in zip(sorted(ends), heights, strict=True):
        colour = COLOURS[pid % len(COLOURS)]
        axes.annotate(
            found.header.robots[pid].name,
            xy=(last, value),
            xytext=(last + (axes.get_xlim()[1] - axes.get_xlim()[0]) * 0.02, height - excess),
            color=colour,
            va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.6, "relpos": (0, 0.5)},
        )


def _top(found: Tracks, path: Path) -> Path:
    figure, axes = plt.subplots(figsize=(9, 7.2), layout="constrained")
    fence = found.header.geofence
    if fence:
        (x0, y0, _), (x1, y1, _) = fence
        axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color=GREY, linewidth=1.2, linestyle=(0, (5, 3)))
        axes.text(x0, y1, " geofence", color=GREY, fontsize=9, va="bottom")
    for obstacle in found.header.obstacles:
        axes.add_artist(_seen_from_above(obstacle))
    for pid, (times, places) in enumerate(zip(found.times, found.places, strict=True)):
        if not len(times):
            continue
        style, marker = _style(pid), _marker(found, pid)
        robot = found.header.robots[pid]
        upto = len(times) if found.end is None else max(1, int(np.searchsorted(times, found.end, side="right")))
        x, y = places[:upto, 0], places[:upto, 1]
        axes.plot(_thin(x), _thin(y), linewidth=1.6, alpha=0.85, **style)
        axes.plot(x[0], y[0], marker, markersize=9, markerfacecolor="white", markeredgewidth=1.6, color=style["color"])
        axes.plot(x[-1], y[-1], marker, markersize=10, color=style["color"], markeredgecolor="white")
        axes.annotate(
            f"{robot.name} ({robot.pid})", (x[-1], y[-1]), xytext=(9, 7), textcoords="offset points",
            color=style["color"], fontweight="bold",
        )  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim" if fence is None else "box")
    axes.margins(0.06)
    axes.set(xlabel="x, east (m)", ylabel="y, north (m)")
    axes.set_title(f"{found.header.app}: top view", loc="left")
    _legend(axes, found)
    return _save(figure, path)


def _seen_from_above(obstacle: Obstacle) -> Any:
    look = {"facecolor": STONE, "edgecolor": GREY, "linewidth": 0.8}
    match obstacle:
        case Block(lo, hi):
            return plt.Rectangle((lo.x, lo.y), hi.x - lo.x, hi.y - lo.y, **look)
        case Sphere(centre, radius) | Cylinder(centre, radius):
            return plt.Circle((centre.x, centre.y), radius, **look)
        case Mesh(vertices, faces):
            flat = [[(vertices[i].x, vertices[i].y) for i in face] for face in faces]
            return PolyCollection(flat, facecolor=STONE, edgecolor=STONE, linewidth=0.8)


def _legend(axes: Any, found: Tracks) -> None:
    handles = []
    for face, word in (("white", "start"), (GREY, "end of mission")):
        for target in sorted({robot.target for robot in found.header.robots}):
            pid = next(robot.pid for robot in found.header.robots if robot.target == target)
            handles.append(
                plt.Line2D(
                    [], [], linestyle="", marker=_marker(found, pid), markersize=9, markerfacecolor=face,
                    markeredgecolor=GREY, label=f"{target}, {word}",
                )
            )  # fmt: skip
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=len(handles), frameon=False)


def _separation(found: Tracks, path: Path) -> Path:
    figure, axes = plt.subplots(figsize=(9, 3.6), layout="constrained")
    times, smallest = separation(found)
    axes.plot(_thin(times), _thin(smallest), color=COLOURS[0], linewidth=1.8)
    asked = found.header.min_separation
    if asked > 0:
        axes.axhline(asked, color=RED, linewidth=1.2)
        axes.annotate(
            f"at least {asked:g} m asked", (1, asked), xycoords=("axes fraction", "data"), xytext=(-4, 4),
            textcoords="offset points", ha="right", color=RED, fontsize=9,
        )  # fmt: skip
    axes.set_xlim(*_span(found))
    axes.set_ylim(bottom=0)
    _mark_times(axes, found)
    axes.set(xlabel="time since round 1 (s)", ylabel="distance of the closest pair (m)")
    axes.set_title(f"{found.header.app}: smallest separation", loc="left", pad=16)
    return _save(figure, path)


def separation(found: Tracks) -> tuple[Array, Array]:
    """The distance of the closest pair at each sampled time: in space, between reference points."""
    count = min(len(t) for t in found.times)
    smallest = np.full(count, np.inf)
    for i, p in enumerate(found.places):
        for q in found.places[i + 1 :]:
            smallest = np.minimum(smallest, np.linalg.norm(p[:count] - q[:count], axis=1))
    return found.times[0][:count], smallest


def _save(figure: Any, path: Path) -> Path:
    try:
        figure.savefig(path, metadata={"Software": None})
    finally:
        plt.close(figure)
    return path
