"""Results of a campaign, formatted as JSON, as CSV and as a text table."""

from __future__ import annotations

import csv
import io
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from koordgen.experiment.campaign.store import RunResult

Z = 1.959964  # 95 % of a standard normal distribution lie between -Z and Z
MOST_REASONS = 5


def wilson(failures: int, runs: int) -> tuple[float, float]:
    """Return the Wilson confidence interval (95 %) of a failure rate, given the numbers of failures and of runs.

    E. B. Wilson, "Probable Inference, the Law of Succession, and Statistical Inference", 1927."""
    if runs == 0:
        return 0.0, 1.0
    rate, share = failures / runs, Z * Z / runs
    middle = rate + share / 2
    half = Z * math.sqrt(rate * (1 - rate) / runs + share / (4 * runs))
    low, high = (middle - half) / (1 + share), (middle + half) / (1 + share)
    return (0.0 if failures == 0 else low), (1.0 if failures == runs else high)


def spread(values: Iterable[float | None]) -> dict[str, float] | None:
    """Return the mean, median, minimum and maximum of the values that are not None; None without such values."""
    found = [v for v in values if v is not None]
    if not found:
        return None
    named = {
        "mean": statistics.fmean(found), "median": statistics.median(found), "min": min(found), "max": max(found),
    }  # fmt: skip
    return {name: round(value, 4) for name, value in named.items()}


def counted(results: Sequence[RunResult]) -> dict[str, Any]:
    """Return the number of runs for each outcome, and statistics of the executed runs.

    The statistics of mission times omit runs with a violation, because a violation ends a run before the mission is
    complete."""
    held = [r for r in results if r.outcome == "held"]
    violated = [r for r in results if r.outcome == "violated"]
    ran = [*held, *violated]
    low, high = wilson(len(violated), len(ran))
    figures = dict.fromkeys(name for r in ran for name in r.figures)
    return {
        "held": len(held),
        "violated": len(violated),
        "failed": len(results) - len(ran),
        "failure_rate": round(len(violated) / len(ran), 4) if ran else None,
        "confidence": [round(low, 6), round(high, 6)],
        "mission": spread(r.mission for r in held),
        "separation": spread(r.separation for r in ran),
        "late_rounds": spread(r.late_rounds for r in ran),
        **{f"figure {name}": spread(r.figures.get(name) for r in ran) for name in figures},
    }


def reasons(results: Sequence[RunResult]) -> list[dict[str, Any]]:
    """Return each kind of violation and failure with its number of runs, the most frequent kind first.

    Each entry also has the number, the varied values and the reason of the first run of its kind."""
    found: dict[str, list[RunResult]] = {}
    for r in results:
        if r.outcome != "held":
            found.setdefault(r.what or ("did not run" if r.outcome == "failed" else "violated"), []).append(r)
    return [
        {"what": what, "runs": len(of), "first": of[0].run, "varied": of[0].varied, "why": of[0].why}
        for what, of in sorted(found.items(), key=lambda pair: -len(pair[1]))
    ]


def document(
    app: str, planned: int, results: Sequence[RunResult], cells: Sequence[Mapping[str, str]]
) -> dict[str, Any]:
    """Return the content of `campaign.json`.

    `planned`: number of planned runs.
    `cells`: all combinations of values of the lists that are varied, such as {"loss": "0.1"}."""
    parted = [
        {"varied": dict(cell), **counted([r for r in results if all(r.varied.get(k) == v for k, v in cell.items())])}
        for cell in cells
    ]
    return {
        "app": app,
        "planned": planned,
        **counted(results),
        "reasons": reasons(results),
        "cells": parted if len(parted) > 1 else [],
        "runs": [asdict(r) for r in results],
    }


def as_csv(results: Sequence[RunResult]) -> str:
    """Return the content of `campaign.csv`: one row for each run, with its varied values and its result."""
    varied = dict.fromkeys(name for r in results for name in r.varied)
    figures = dict.fromkeys(name for r in results for name in r.figures)
    held = io.StringIO()
    writer = csv.writer(held, lineterminator="\n")
    own = ("outcome", "mission", "separation", "late_rounds", "wall", "what", "why")
    writer.writerow(["run", *varied, *own, *figures])
    for r in results:
        cells = [getattr(r, name) for name in own]
        row = [r.run, *(r.varied.get(n, "") for n in varied), *cells, *(r.figures.get(n) for n in figures)]
        writer.writerow(["" if value is None else value for value in row])
    return held.getvalue()


_ROWS = {"mission": "mission time, s", "separation": "closest, m", "late_rounds": "late rounds"}


def as_text(found: Mapping[str, Any]) -> str:
    """Return the content of `campaign.txt`: the results as text tables. `found`: content of `campaign.json`."""
    lines = [f"{found['app']}: {_ends(found, found['planned'])}", ""]
    names = [n for n in found if n in _ROWS or n.startswith("figure ")]
    rows: list[tuple[str, ...]] = [("", "mean", "median", "min", "max")]
    for name in names:
        if spread_ := found[name]:
            shown = _ROWS.get(name) or name.removeprefix("figure ")
            rows.append((shown, *(f"{spread_[k]:.4g}" for k in ("mean", "median", "min", "max"))))
    lines += _aligned(rows) if len(rows) > 1 else ["no run has finished"]
    if found["cells"]:
        lines += ["", *_aligned(_cells(found["cells"]))]
    if found["reasons"]:
        lines.append("")
    for reason in found["reasons"][:MOST_REASONS]:
        own = ", ".join(f"{k} {v}" for k, v in reason["varied"].items())
        first = f"run {reason['first']:04d}{f' ({own})' if own else ''}"
        lines.append(f"{reason['what']}: {_times(reason['runs'])}, first in {first}: {reason['why']}")
    return "\n".join(lines) + "\n"


def _ends(found: Mapping[str, Any], planned: int) -> str:
    ran = found["held"] + found["violated"]
    parts = [f"{found['held']} held", f"{found['violated']} violated"]
    if ran:
        low, high = found["confidence"]
        parts[-1] += f" ({100 * found['violated'] / ran:.1f} %; 95 % confidence: {100 * low:.1f} to {100 * high:.1f} %)"
    if found["failed"]:
        parts.append(f"{found['failed']} did not run")
    if left := planned - ran - found["failed"]:
        parts.append(f"{left} not yet run")
    return f"{_runs(planned)}: {', '.join(parts)}"


def _cells(cells: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    names = list(cells[0]["varied"])
    rows: list[tuple[str, ...]] = [(*names, "held", "violated", "95 % confidence", "mission time, s", "closest, m")]
    for cell in cells:
        low, high = cell["confidence"]
        mission, separation = cell["mission"], cell["separation"]
        rows.append(
            (
                *(cell["varied"][n] for n in names), str(cell["held"]), str(cell["violated"]),
                f"{100 * low:.1f} to {100 * high:.1f} %", f"{mission['mean']:.4g}" if mission else "-",
                f"{separation['min']:.4g}" if separation else "-",
            )
        )  # fmt: skip
    return rows


def _aligned(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))]).rstrip()
        for row in rows
    ]


def _runs(number: int) -> str:
    return "1 run" if number == 1 else f"{number} runs"


def _times(number: int) -> str:
    return "once" if number == 1 else f"{number} times"
