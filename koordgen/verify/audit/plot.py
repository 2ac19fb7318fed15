"""Picture of an audit: one row for each property, with coloured bars for its outcomes over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from koordgen.verify.audit.result import Outcome
from koordgen.verify.audit.show import Audit

COLOURS: dict[Outcome, str] = {"held": "#2a7f3f", "violated": "#c0392b", "no value": "#8e44ad", "unknown": "#bdc3c7"}


def draw(audits: Sequence[Audit], path: Path) -> None:
    """Write the picture of one mission's audits to a file. The suffix of `path` selects the format. Raises OSError."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    delta, last = audits[0].mission.delta, max(audit.mission.last for audit in audits)
    rows = [(audit.application, result) for audit in audits for result in audit.results if result.spans]
    figure = Figure(figsize=(10, 1.6 + 0.4 * len(rows)), layout="constrained")
    axes = figure.subplots()
    for place, (_, result) in enumerate(rows):
        for outcome, colour in COLOURS.items():
            bars = [
                ((span.since - 1) * delta, (span.until - span.since + 1) * delta)
                for span in result.spans
                if span.outcome == outcome
            ]
            axes.broken_barh(bars, (place - 0.35, 0.7), color=colour)
        if result.first is not None:
            axes.plot([result.first.observation.seconds(delta)], [place], "kx")
    titles = [": ".join(filter(None, (name, result.title)))[:40] for name, result in rows]
    axes.set_yticks(range(len(rows)), titles)
    axes.invert_yaxis()
    axes.set_xlabel("seconds since the start of round 1")
    axes.grid(axis="x", alpha=0.3)
    axes.set_title(f"{', '.join(audit.program for audit in audits)}: {last} rounds; x: first violation")
    figure.legend(
        handles=[Patch(color=colour, label=outcome) for outcome, colour in COLOURS.items()],
        loc="outside lower center", ncols=len(COLOURS),
    )  # fmt: skip
    figure.savefig(path, dpi=110)
