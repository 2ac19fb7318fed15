"""Picture of a validation: in each round, how far each robot was outside the box from its position to its target."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from koordgen.experiment.validate.breach import BoxBreach, Kind
from koordgen.experiment.validate.samples import RunSample

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS: dict[Kind, str] = {"overshoot": "#c0392b", "across": "#2471a3", "away": "#8e44ad", "drift": "#909497"}
KINDS: tuple[Kind, ...] = get_args(Kind)
LEAST = 1e-4  # smallest distance on the logarithmic axis, in metres; smaller distances are drawn as LEAST
BINS = 40


def draw(samples: Sequence[RunSample], title: str, path: Path) -> bool:
    """Draw the breaches of all runs, one row of diagrams per platform. Return whether a picture was written.

    A breach is a robot's distance outside the box from its position to its target, in one round. The left diagram shows
    all breaches over time. The right diagram is their histogram; a black line marks the largest breach of each run. If
    no run recorded positions, no picture is written. Raises OSError."""
    from matplotlib.figure import Figure

    platforms = list(dict.fromkeys(p for sample in samples for p in sample.platforms)) if _moved(samples) else []
    if not platforms:
        return False
    figure = Figure(figsize=(11, 0.9 + 3.0 * len(platforms)), layout="constrained")
    rows = figure.subplots(len(platforms), 2, squeeze=False, sharex="col", sharey=True, width_ratios=(3, 1))
    for (over_time, counted), platform in zip(rows, platforms, strict=True):
        # own[k]: the breaches of this platform's robots in run k
        own = [[b for b in sample.breaches if sample.platforms[b.pid] == platform] for sample in samples]
        _over_time(over_time, own, f"{platform}: {_summary(own)}")
        _counted(counted, own)
    rows[-1][0].set_xlabel("start of the window (round of one robot), s since round 1")
    rows[-1][1].set_xlabel("windows")
    figure.suptitle(title)
    figure.savefig(path, dpi=110)
    return True


def _moved(samples: Sequence[RunSample]) -> bool:
    return any(sample.reach for sample in samples)


def _summary(own: Sequence[Sequence[BoxBreach]]) -> str:
    distances = [b.distance for run in own for b in run]
    if not distances:
        return "never outside"
    runs = sum(bool(run) for run in own)
    return f"outside the box in {len(distances)} windows of {runs} of {len(own)} runs, at most {max(distances):.3f} m"


def _over_time(axes: Axes, own: Sequence[Sequence[BoxBreach]], title: str) -> None:
    for kind in KINDS:
        found = [b for run in own for b in run if b.kind == kind]
        if found:
            axes.scatter(
                [b.at for b in found], [max(b.distance, LEAST) for b in found], s=7, c=COLOURS[kind],
                alpha=min(0.8, max(0.15, 600 / len(found))), linewidths=0,
            )  # fmt: skip
    axes.set_yscale("log")
    axes.set_ylim(bottom=LEAST * 0.8)
    axes.set_ylabel("outside the box, m")
    axes.set_title(title, fontsize=10, loc="left")
    axes.grid(alpha=0.3)


def _counted(axes: Axes, own: Sequence[Sequence[BoxBreach]]) -> None:
    drawn = [kind for kind in KINDS if any(b.kind == kind for run in own for b in run)]
    values = [[max(b.distance, LEAST) for run in own for b in run if b.kind == kind] for kind in drawn]
    if drawn:
        most = max(map(max, values)) * 1.01
        steps = [LEAST * (most / LEAST) ** (k / BINS) for k in range(BINS + 1)]
        axes.hist(
            values, bins=steps, orientation="horizontal", stacked=True, color=[COLOURS[kind] for kind in drawn],
            label=[f"{kind} ({len(own)})" for kind, own in zip(drawn, values, strict=True)],
        )  # fmt: skip
        axes.legend(loc="center right", fontsize=8)
    for run in own:
        if run:
            axes.axhline(max(b.distance for b in run), xmin=0.94, color="black", linewidth=0.6)
    axes.set_title("histogram; black lines: largest value of each run", fontsize=9, loc="left")
    axes.grid(alpha=0.3)
