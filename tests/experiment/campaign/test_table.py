"""Table of a campaign: statistics, the interval of its failure rate, text and CSV."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from koordgen.experiment.campaign import plots, table
from koordgen.experiment.campaign.store import RunResult

RESULTS = [
    RunResult(0, {"seed": "1", "loss": "0.1"}, "held", "", "", 10.0, 0.9, 0, figures={"tasks": 20.0}),
    RunResult(1, {"seed": "2", "loss": "0.2"}, "held", "", "", 14.0, 0.7, 4, figures={"tasks": 20.0}),
    RunResult(2, {"seed": "3", "loss": "0.1"}, "violated", "at 1 s, a and b: close", "separation", 3.0, 0.1, 2),
    RunResult(3, {"seed": "4", "loss": "0.2"}, "failed", 'status 5: error: "x", full'),
]  # fmt: skip


@pytest.mark.parametrize(
    ("failures", "runs", "low", "high"),
    [
        (0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (0, 70, 0.0, 0.0520), (5, 100, 0.0215, 0.1118),
        (1, 2, 0.0945, 0.9055),
    ],
)  # fmt: skip
def test_wilsons_interval(failures: int, runs: int, low: float, high: float) -> None:
    assert table.wilson(failures, runs) == pytest.approx((low, high), abs=5e-5)


def test_of_no_run_nothing_is_known() -> None:
    assert table.wilson(0, 0) == (0.0, 1.0)
    found = table.document("app", 5, [], [{}])
    assert found["failure_rate"] is None and found["mission"] is None
    assert "no run has finished" in table.as_text(found)


def test_the_document() -> None:
    found = table.document("app", 6, RESULTS, [{"loss": "0.1"}, {"loss": "0.2"}])
    assert (found["held"], found["violated"], found["failed"], found["failure_rate"]) == (2, 1, 1, 0.3333)
    assert found["mission"] == {"mean": 12.0, "median": 12.0, "min": 10.0, "max": 14.0}, "of those that held"
    assert found["separation"]["min"] == 0.1 and found["late_rounds"] == {"mean": 2, "median": 2, "min": 0, "max": 4}
    assert [r["what"] for r in found["reasons"]] == ["separation", "did not run"]
    assert [(c["varied"], c["held"], c["violated"]) for c in found["cells"]] == [
        ({"loss": "0.1"}, 1, 1), ({"loss": "0.2"}, 1, 0),
    ]  # fmt: skip


def test_the_text() -> None:
    text = table.as_text(table.document("app", 6, RESULTS, [{"loss": "0.1"}, {"loss": "0.2"}]))
    first, *lines = text.splitlines()
    assert first == (
        "app: 6 runs: 2 held, 1 violated (33.3 %; 95 % confidence: 6.1 to 79.2 %), 1 did not run, 2 not yet run"
    )
    assert any(line.split() == ["mission", "time,", "s", "12", "12", "10", "14"] for line in lines)
    assert any(line.split() == ["tasks", "20", "20", "20", "20"] for line in lines)
    assert "separation: once, first in run 0002 (seed 3, loss 0.1): at 1 s, a and b: close" in lines


def test_the_rows() -> None:
    rows = list(csv.DictReader(io.StringIO(table.as_csv(RESULTS))))
    assert [row["run"] for row in rows] == ["0", "1", "2", "3"]
    assert rows[3]["why"] == 'status 5: error: "x", full' and rows[3]["mission"] == ""
    assert rows[0]["tasks"] == "20.0" and rows[2]["loss"] == "0.1"


def test_pictures(tmp_path: Path) -> None:
    words = [RunResult(9, {"seed": "9", "loss": "none"}, "held", mission=None), *RESULTS]
    drawn = plots.draw(words, tmp_path / "plots")
    assert sorted(path.name for path in drawn) == ["loss.png", "mission.png", "seed.png"]
    assert all(path.stat().st_size > 5000 for path in drawn)
    assert plots.draw([RESULTS[3]], tmp_path / "none") == []
