"""Plots of a campaign: results of the runs over each varied quantity, and a histogram of mission times."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from koordgen.experiment.campaign.store import RunResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {"held": "#2a7f3f", "violated": "#c0392b"}
MARKS = {"held": "o", "violated": "X"}


def draw(results: Sequence[RunResult], folder: Path) -> list[Path]:
    """Draw one plot for each varied quantity, and a histogram of mission times. Return the PNG files.

    If no run was executed, no file is written. Raises OSError."""
    ran = [r for r in results if r.outcome in COLOURS]
    if not ran:
        return []
    folder.mkdir(exist_ok=True)
    names = dict.fromkeys(name for r in ran for name in r.varied)
    pictures = [_against(name, ran, folder / f"{re.sub(r'[^A-Za-z0-9_.-]', '_', name)}.png") for name in names]
    return [*pictures, _histogram(ran, folder / "mission.png")]


def _against(name: str, ran: Sequence[RunResult], path: Path) -> Path:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 6), layout="constrained")
    time, apart = figure.subplots(2, 1, sharex=True)
    places = _places([r.varied.get(name, "") for r in ran])
    for axes, label, values in (
        (time, "mission time, s", [r.mission for r in ran]),
        (apart, "closest, m", [r.separation for r in ran]),
    ):
        _draw_points(axes, [r.outcome for r in ran], places, values)
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    words = sorted({r.varied.get(name, "") for r in ran})
    if not all(map(_numeric, words)):
        apart.set_xticks(range(len(words)), words)
    apart.set_xlabel(name)
    violated = sum(r.outcome == "violated" for r in ran)
    time.set_title(f"{len(ran)} runs over {name}: {violated} runs with a violation")
    time.legend(loc="best")
    figure.savefig(path, dpi=110)
    return path


def _draw_points(axes: Axes, outcomes: Sequence[str], places: Sequence[float], values: Sequence[float | None]) -> None:
    for outcome, colour in COLOURS.items():
        points = [(x, y) for o, x, y in zip(outcomes, places, values, strict=True) if o == outcome and y is not None]
        if points:
            xs, ys = zip(*points, strict=True)
            axes.scatter(xs, ys, c=colour, marker=MARKS[outcome], s=28, label=outcome, alpha=0.8)


def _places(words: Sequence[str]) -> list[float]:
    """Return the position of each varied value on a plot's axis.

    If all values are numbers, each position is the number. Otherwise, the position is the index in sorted order."""
    if all(map(_numeric, words)):
        return [float(word) for word in words]
    order = {word: float(k) for k, word in enumerate(sorted(set(words)))}
    return [order[word] for word in words]


def _numeric(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _histogram(ran: Sequence[RunResult], path: Path) -> Path:
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(8, 4), layout="constrained")
    axes = figure.subplots()
    times = {o: [r.mission for r in ran if r.outcome == o and r.mission is not None] for o in COLOURS}
    drawn = [outcome for outcome in COLOURS if times[outcome]]
    axes.hist(
        [times[o] for o in drawn], bins="auto" if sum(map(len, times.values())) < 2 else 20, stacked=True,
        color=[COLOURS[o] for o in drawn], label=drawn, edgecolor="white",
    )  # fmt: skip
    if times["held"]:
        mean = sum(times["held"]) / len(times["held"])
        axes.axvline(mean, color="black", linewidth=1, linestyle="--", label=f"mean of runs that held: {mean:.1f} s")
    axes.set_xlabel("mission time, s")
    axes.set_ylabel("runs")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend()
    figure.savefig(path, dpi=110)
    return path
