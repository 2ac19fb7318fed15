"""Pictures of reachsets. All platforms are drawn side by side at one scale, from above and over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from koordgen.experiment.validate.tube import Reachset, above

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Colours that people with colour blindness can distinguish (Okabe and Ito, Color Universal Design, 2008).
TUBE, EDGE, WAY, START, GOAL = "#CFE5F3", "#0072B2", "#444444", "#009E73", "#D55E00"
DASHED = (0, (4, 3))
INCHES = 5.2  # width of one column of the picture, in inches
MARGIN = 0.06  # empty margin around the drawn boxes, as a fraction of their extent


def draw_reachsets(reachsets: Sequence[Reachset], file: Path) -> Path:
    """Draw reachsets side by side at one scale, and write the picture to `file`.

    In each column, the upper diagram shows x and y; the lower one shows the position in the target's direction over
    time. Raises ValueError if `reachsets` is empty, and OSError."""
    from matplotlib.figure import Figure

    if not reachsets:
        raise ValueError("no reachset to draw; at least one is needed")
    (x0, y0), (x1, y1) = _extent(reachsets)
    tall = min(max(INCHES * (y1 - y0) / (x1 - x0), 1.6), 1.4 * INCHES)
    figure = Figure(figsize=(INCHES * len(reachsets), tall + 3.9), layout="constrained")
    grid = figure.subplots(2, len(reachsets), squeeze=False, sharex="row", sharey="row", height_ratios=[tall, 2.6])
    for found, top, along in zip(reachsets, *grid, strict=True):
        _from_above(top, found)
        _along(along, found)
        top.set(xlim=(x0, x1), ylim=(y0, y1))
        top.set_aspect("equal", adjustable="box")
        top.set_title(_title(found), fontsize=10)
        top.set_xlabel("x (east), m")
        along.set_xlabel("time since the command, s")
    grid[0][0].set_ylabel("y (north), m")
    grid[1][0].set_ylabel("towards the target, m")
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=5 if len(reachsets) > 1 else 3, fontsize=8.5, frameon=False
    )
    figure.savefig(file, dpi=110)
    return file


def _title(found: Reachset) -> str:
    far = f"{abs(found.overshoot):.2f} m"
    past = f"reaches {far} beyond the target" if found.overshoot > 0 else f"stays {far} before the target"
    new = f"contains {found.covered:.1%} of {found.samples[2]} new paths (claimed: {1 - found.epsilon:.0%})"
    return f"{found.platform}: {past}\n{new}"


def _extent(reachsets: Sequence[Reachset]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lower and the upper corner, in x and y, of the area that contains all drawn reachsets."""
    every = np.vstack([np.vstack([_corners(f).reshape(-1, 2), np.zeros(2), f.offset[:2]]) for f in reachsets])
    low, high = every.min(axis=0), every.max(axis=0)
    room = MARGIN * float((high - low).max())
    return low - room, high + room


def _corners(found: Reachset) -> NDArray[np.float64]:
    """Return the four corners of each of a reachset's J boxes in x and y, as an array of shape (J, 4, 2)."""
    u, left = (axis[:2] for axis in above(found.offset))
    return found.ahead[:, [0, 1, 1, 0], None] * u + found.aside[:, [0, 0, 1, 1], None] * left


def _from_above(axes: Axes, found: Reachset) -> None:
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle, Polygon, Rectangle

    boxes = [Polygon(corners) for corners in _corners(found)]
    # Draw the edges of all boxes first and their faces over the edges: only the outline of the union stays visible.
    axes.add_collection(PatchCollection(boxes, facecolor=EDGE, edgecolor=EDGE, linewidth=2.0, zorder=1))
    axes.add_collection(PatchCollection(boxes, facecolor=TUBE, edgecolor="none", linewidth=0, zorder=2))
    for k, way in enumerate(found.paths):
        axes.plot(way[:, 0], way[:, 1], color=WAY, linewidth=0.7, zorder=3, label="" if k else "samples")
    x, y = found.offset[:2]
    axes.add_patch(Circle((0, 0), found.start.radius, fill=False, color=START, linewidth=2, zorder=5, label="starts"))
    axes.add_patch(
        Rectangle((min(0, x), min(0, y)), abs(x), abs(y), fill=False, color="black", linestyle=DASHED, linewidth=1.4,
                  zorder=4, label="Rect(position, target)")
    )  # fmt: skip
    axes.plot(
        x, y, marker="X", markersize=10, color=GOAL, markeredgecolor="white", linestyle="", zorder=6, label="target"
    )
    axes.fill([np.nan], [np.nan], facecolor=TUBE, edgecolor=EDGE, label="reachset")
    axes.grid(alpha=0.25)


def _along(axes: Axes, found: Reachset) -> None:
    goal, u = math.hypot(*found.offset[:2]), above(found.offset)[0]
    low, high = found.ahead.T
    axes.stairs(high, found.edges, baseline=low, fill=True, facecolor=TUBE, edgecolor=EDGE, linewidth=1.0, zorder=2)
    for way in found.paths:
        axes.plot(found.edges, way @ u, color=WAY, linewidth=0.7, zorder=3)
    axes.axhline(goal, color=GOAL, linewidth=1.4, zorder=4)
    axes.axhline(0, color="black", linestyle=DASHED, linewidth=1.0, zorder=1)
    axes.axhline(goal, color="black", linestyle=DASHED, linewidth=1.0, zorder=5)
    axes.set_xlim(found.edges[0], found.edges[-1])
    axes.grid(alpha=0.25)
