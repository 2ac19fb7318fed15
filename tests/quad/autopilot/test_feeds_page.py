"""docs/reference/feeds.md names the parameters that the agent reads back, with the values that it wants."""

from __future__ import annotations

import re
from pathlib import Path

from targets.quad.autopilot.ardupilot import POSITIONING
from targets.quad.autopilot.px4 import POSITIONING as OF_PX4

PAGE = (Path(__file__).parents[3] / "docs/reference/feeds.md").read_text(encoding="utf-8")


def test_the_parameters_for_feeds_are_those_that_are_read_back() -> None:
    rows = [line.split("|")[1:-1] for line in PAGE.splitlines() if line.startswith("| `")]
    documented = {
        (mode, name): {float(v) for v in re.findall(r"\d+", cell)}
        for cells in rows
        if len(cells) == 4
        for name in re.findall(r"[A-Z0-9_]{5,}", cells[0])
        for mode, cell in zip(("gps_input", "vision", "odometry"), cells[1:], strict=True)
        if cell.strip()
    }
    read = {(m, n): set(w.values) for m, ws in POSITIONING.items() for w in ws for n in (w.name, *w.older)}
    older = {k: v for k, v in read.items() if k not in documented}
    assert {k: v for k, v in read.items() if k in documented} == documented
    assert set(older) <= {("vision", "GPS_TYPE"), ("odometry", "GPS_TYPE")}
    prose = " ".join(PAGE.split())
    for mode, wanted in ((m, w) for m, ws in OF_PX4.items() for w in ws):
        values = " (or ".join(f"{v:g}" for v in wanted.values)
        told = f"{values}{')' if '(' in values else ''}"
        assert f"`{wanted.name}` {told}" in prose or f"{told} with `{mode}`" in prose
