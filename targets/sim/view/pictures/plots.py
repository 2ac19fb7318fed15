"""Plots of a run by matplotlib: coordinates over time, top view, smallest separation, maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib import pyplot as plt

from targets.sim.view.data.colours import COLOURS, GREY, RED, STATES
from targets.sim.view.data.tracks import Tracks
from targets.sim.view.pictures import ground

MARKERS = ("o", "s", "^", "D", "v", "P")
LEAD = 0.15  # share of the mission's length that is shown before round 1
MOST_MAPS = 4  # rows of maps in a picture


def draw(found: Tracks, folder: Path) -> dict[str, Path]:
    """Write the plots into `folder`. Return caption -> file. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    made: dict[str, Path] = {}
    with plt.rc_context(ground.STYLE):
        made["Top view"] = _top(found, folder / "top.png")
        for axis, name in enumerate("xyz"):
            made[f"{name} over time"] = _over_time(found, axis, name, folder / f"{name}-t.png")
        if len(found.header.robots) > 1:
            made["Smallest separation over time"] = _separation(found, folder / "separation.png")
        for name in sorted({name for name, _ in found.maps}):
            made[f"Map {name}"] = _maps(found, name, folder / f"map-{name}.png")
    return made


def _marker(found: Tracks, pid: int) -> str:
    """Return the marker symbol of a robot's target."""
    kinds = sorted({robot.target for robot in found.header.robots})
    return MARKERS[kinds.index(found.header.robots[pid].target) % len(MARKERS)]


def _span(found: Tracks) -> tuple[float, float]:
    """Return the times shown: the mission, a little before it, and the safe stop."""
    first, last = found.span()
    return max(first, -LEAD * max(last, 1.0)), max(last, first + 0.1)


def _over_time(found: Tracks, axis: int, name: str, path: Path) -> Path:
    figure, axes = plt.subplots(figsize=(9, 4.6), layout="constrained")
    ends: list[tuple[float, int]] = []
    for pid, (times, places) in enumerate(zip(found.times, found.places, strict=True)):
        if len(times):
            width = 2.8 - 1.2 * pid / max(1, len(found.times) - 1)  # decreasing widths keep overlapping lines visible
            axes.plot(times, places[:, axis], linewidth=width, **ground.style(pid))
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
    """Mark round 1, the mission's end and the first violation, with labels above the frame."""
    marks = [(0.0, "round 1", GREY)] if found.header.started else []
    if found.end is not None:
        marks.append((found.end, "end of mission", GREY))
    if found.violations:
        when, what, robots = found.violations[0]
        marks.append((when, f"{what}: {', '.join(robots)}", RED))
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
    """Write robots' names beside the ends of their lines, moved apart to avoid overlaps."""
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
    ground.lay(axes, found.header)
    until, names = found.span()[1] if found.end is None else found.end, []
    for pid, (times, places) in enumerate(zip(found.times, found.places, strict=True)):
        if not len(times):
            continue
        style, marker = ground.style(pid), _marker(found, pid)
        robot = found.header.robots[pid]
        upto = max(1, found.upto(pid, until))
        x, y = places[:upto, 0], places[:upto, 1]
        axes.plot(x, y, linewidth=1.6, alpha=0.85, **style)
        axes.plot(x[0], y[0], marker, markersize=9, markerfacecolor="white", markeredgewidth=1.6, color=style["color"])
        axes.plot(x[-1], y[-1], marker, markersize=10, color=style["color"], markeredgecolor="white", zorder=3)
        _draw_members(axes, found.members[pid], until, style)
        name = axes.annotate(
            f"{robot.name} ({robot.pid})", (x[-1], y[-1]), xytext=(9, 7), textcoords="offset points",
            color=style["color"], fontweight="bold", path_effects=ground.HALO, zorder=5,
        )  # fmt: skip
        names.append(name)
    ground.mark(axes, found, until)
    axes.set_title(f"{found.header.app}: top view", loc="left")
    _legend(axes, found)
    move_apart(figure, names)
    return _save(figure, path)


def _draw_members(axes: Any, members: Mapping[str, Any], until: float, style: Mapping[str, Any]) -> None:
    """Draw the ways of a squad's robots up to a time, with their places then."""
    for member in members.values():
        own = member[member[:, 0] <= until] if (member[:, 0] <= until).any() else member[:1]
        axes.plot(own[:, 1], own[:, 2], linewidth=0.8, alpha=0.5, **style)
        axes.plot(own[-1, 1], own[-1, 2], ".", markersize=9, color=style["color"], zorder=2.8)


def move_apart(figure: Any, labels: Sequence[Any]) -> None:
    """Move labels up until none overlaps another one. `labels`: annotations with offsets in points."""
    figure.draw_without_rendering()  # gives the labels their places
    placed: list[Any] = []
    for label in sorted(labels, key=lambda each: each.get_window_extent().y0):
        box = label.get_window_extent()
        while overlapped := [other for other in placed if box.overlaps(other)]:
            shift = max(other.y1 for other in overlapped) - box.y0 + 1.0  # pixels
            x, y = label.xyann
            label.xyann, box = (x, y + shift * 72.0 / figure.dpi), box.translated(0.0, shift)
        placed.append(box)


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
    for state, word in enumerate(("to do", "taken", "done") if found.markers else ()):
        face = STATES[state] if state == 2 else "white"
        handles.append(
            plt.Line2D([], [], linestyle="", marker="o", markersize=9, markerfacecolor=face,
                       markeredgecolor=STATES[state], label=word)
        )  # fmt: skip
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=4, frameon=False)


def _separation(found: Tracks, path: Path) -> Path:
    figure, axes = plt.subplots(figsize=(9, 3.6), layout="constrained")
    axes.plot(found.near[:, 0], found.near[:, 1], color=COLOURS[0], linewidth=1.8)
    asked = found.header.min_separation
    if asked > 0:
        colour = RED if (found.near[:, 1] < asked).any() else GREY
        axes.axhline(asked, color=colour, linewidth=1.2)
        axes.annotate(
            f"at least {asked:g} m asked", (1, asked), xycoords=("axes fraction", "data"), xytext=(-4, 4),
            textcoords="offset points", ha="right", color=colour, fontsize=9,
        )  # fmt: skip
    axes.set_xlim(*_span(found))
    axes.set_ylim(bottom=0)
    _mark_times(axes, found)
    axes.set(xlabel="time since round 1 (s)", ylabel="distance of the closest pair (m)")
    axes.set_title(f"{found.header.app}: smallest separation", loc="left", pad=16)
    return _save(figure, path)


def _maps(found: Tracks, name: str, path: Path) -> Path:
    """Draw a shared map at 1/3, 2/3 and the end of the mission; one row for each robot's slot."""
    slots = sorted(slot for variable, slot in found.maps if variable == name)[:MOST_MAPS]
    end = found.span()[1] if found.end is None else found.end
    figure, grid = plt.subplots(
        len(slots), 3, figsize=(12, 4.4 * len(slots) + 0.4), layout="constrained", squeeze=False
    )
    for row, slot in zip(grid, slots, strict=True):
        for axes, t in zip(row, (end / 3, 2 * end / 3, end), strict=True):
            ground.lay(axes, found.header, filled=False)
            ground.draw_map(axes, next((v for at, v in reversed(found.maps[name, slot]) if at <= t), None))
            axes.grid(False)
            for pid, places in enumerate(found.places):
                if (upto := found.upto(pid, t)) > 0:
                    x, y = places[upto - 1, :2]
                    axes.plot(x, y, _marker(found, pid), color=COLOURS[pid % len(COLOURS)], markeredgecolor="white")
            whose = f" of {found.header.robots[slot].name}" if slot >= 0 else ""
            axes.set_title(f"{name}{whose} at {t:.0f} s", loc="left", fontsize=11)
    shades = {"unknown": ground.UNKNOWN, "free": ground.FREE, "occupied": ground.OCCUPIED}
    handles = [plt.Rectangle((0, 0), 1, 1, facecolor=c, edgecolor=GREY, label=word) for word, c in shades.items()]
    handles.append(plt.Rectangle((0, 0), 1, 1, facecolor="none", edgecolor="#D55E00", label="obstacle"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    return _save(figure, path)


def _save(figure: Any, path: Path) -> Path:
    try:
        figure.savefig(path, metadata={"Software": None})
    finally:
        plt.close(figure)
    return path
