"""Picture of an audit: one row for each property, with coloured bars for its outcomes over time."""

from __future__ import annotations

from pathlib import Path

from koordgen.verify.audit.result import Outcome
from koordgen.verify.audit.show import Audit

COLOURS: dict[Outcome, str] = {"held": "#2a7f3f", "violated": "#c0392b", "no value": "#8e44ad", "unknown": "#bdc3c7"}


def draw(audit: Audit, path: Path) -> None:
    """Write the picture of an audit to a file. The suffix of `path` selects the format. Raises OSError."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    mission = audit.mission
    rows = [result for result in audit.results if result.spans]
    figure = Figure(figsize=(10, 1.6 + 0.4 * len(rows)), layout="constrained")
    axes = figure.subplots()
    for place, result in enumerate(rows):
        for outcome, colour in COLOURS.items():
            bars = [
                ((span.since - 1) * mission.delta, (span.until - span.since + 1) * mission.delta)
                for span in result.spans
                if span.outcome == outcome
            ]
            axes.broken_barh(bars, (place - 0.35, 0.7), color=colour)
        if result.first is not None:
            axes.plot([result.first.observation.seconds(mission.delta)], [place], "kx")
    titles = [f"{result.title}"[:40] for result in rows]
    axes.set_yticks(range(len(rows)), titles)
    axes.invert_yaxis()
    axes.set_xlabel("seconds since the start of round 1")
    axes.grid(axis="x", alpha=0.3)
    axes.set_title(f"{audit.program}: {mission.last} rounds; x: first violation")
    figure.legend(
        handles=[Patch(color=colour, label=outcome) for outcome, colour in COLOURS.items()],
        loc="outside lower center", ncols=len(COLOURS),
    )  # fmt: skip
    figure.savefig(path, dpi=110)
