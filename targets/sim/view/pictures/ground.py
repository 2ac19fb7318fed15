"""Background of top views on axes of matplotlib: arena, geofence, obstacles, maps, markers."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np

from koordgen.runtime.trace.schema import Header
from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from targets.sim.view.data.colours import COLOURS, DASHES, GREY, STATES, STONE
from targets.sim.view.data.tracks import Tracks, cells

matplotlib.use("Agg")

from matplotlib import pyplot as plt
from matplotlib.collections import PolyCollection
from matplotlib.colors import ListedColormap
from matplotlib.path import Path as Lines
from matplotlib.patheffects import withStroke

STYLE = {
    "font.size": 11, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "grid.color": "#DDDDDD", "grid.linewidth": 0.7, "axes.axisbelow": True, "figure.dpi": 110, "svg.hashsalt": "koord",
    "text.parse_math": False,  # names may contain any character
}  # fmt: skip
HALO = [withStroke(linewidth=3, foreground="white")]  # around text on top of lines
TICK = Lines([(-0.5, 0.0), (-0.15, -0.4), (0.5, 0.45)])
UNKNOWN, FREE, OCCUPIED = "#C9CCD1", "#FFFFFF", "#2B2F38"


def style(pid: int) -> dict[str, Any]:
    """Return a robot's colour and dashes."""
    return {"color": COLOURS[pid % len(COLOURS)], "linestyle": DASHES[pid // len(COLOURS) % len(DASHES)]}


def lay(axes: Any, header: Header, filled: bool = True) -> None:
    """Draw frames and obstacles (as outlines unless `filled`), with axes of equal scale and labels."""
    if header.geofence:
        (x0, y0, _), (x1, y1, _) = header.geofence
        axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color=GREY, linewidth=1.2, linestyle=(0, (5, 3)))
        axes.text(x0, y1, " geofence", color=GREY, fontsize=9, va="bottom")
    if header.world.arena:
        (x0, y0, _), (x1, y1, _) = header.world.arena.lo, header.world.arena.hi
        axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color=GREY, linewidth=1.6)
    for obstacle in header.obstacles:
        axes.add_artist(_seen_from_above(obstacle, filled))
    axes.set_aspect("equal", adjustable="box" if header.geofence else "datalim")
    axes.margins(0.06)
    axes.set(xlabel="x, east (m)", ylabel="y, north (m)")


def _seen_from_above(obstacle: Obstacle, filled: bool) -> Any:
    look: dict[str, Any] = {
        "facecolor": STONE if filled else "none",
        "edgecolor": GREY if filled else "#D55E00",
        "linewidth": 0.8,
    }
    match obstacle:
        case Block(lo, hi):
            return plt.Rectangle((lo.x, lo.y), hi.x - lo.x, hi.y - lo.y, **look)
        case Sphere(centre, radius) | Cylinder(centre, radius):
            return plt.Circle((centre.x, centre.y), radius, **look)
        case Mesh(vertices, faces):
            flat = [[(vertices[i].x, vertices[i].y) for i in face] for face in faces]
            return PolyCollection(flat, **(look | {"edgecolor": STONE} if filled else look))


def mark(axes: Any, found: Tracks, t: float) -> list[Any]:
    """Draw the markers at a time: to do as a ring, taken as a ring with a dot, done as a disc with a tick."""
    made = []
    for marker in found.markers:
        x, y, z = marker.position
        state = marker.state(t)
        colour = STATES[state]
        face = colour if state == 2 else "white"
        (dot,) = axes.plot(
            x, y, "o", markersize=14, markerfacecolor=face, markeredgecolor=colour, markeredgewidth=1.8, zorder=2.5
        )
        made.append(dot)
        if state:
            sign, ink = (TICK, "white") if state == 2 else (".", colour)
            made += axes.plot(
                x, y, marker=sign, markersize=9, color=ink, markerfacecolor="none" if state == 2 else ink,
                markeredgewidth=2, linestyle="", zorder=2.6,
            )  # fmt: skip
        if z > 0.05:
            made.append(axes.annotate(f"{z:.1f} m", (x, y), (0, -17), textcoords="offset points", fontsize=8,
                                      ha="center", color=colour))  # fmt: skip
    return made


def draw_map(axes: Any, value: Any) -> Any:
    """Draw a GridMap's cells. Return the image, None for an invalid map."""
    found = cells(value)
    if found is None:
        return None
    grid, box = found
    shades = ListedColormap([UNKNOWN, FREE, FREE, OCCUPIED])
    return axes.imshow(
        np.asarray(grid), origin="lower", extent=box, cmap=shades, vmin=0, vmax=3, interpolation="nearest", zorder=0.5
    )
