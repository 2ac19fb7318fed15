"""Verdicts from windows: VALIDATED, VIOLATED, and INCONCLUSIVE."""

from __future__ import annotations

from pathlib import Path

import pytest

from koordgen.experiment.validate.samples import FILE, margin, read
from koordgen.experiment.validate.verdict import AssumptionVerdict, ProbabilityBound, verdicts
from tests.experiment.validate.windows import held, sample, text, window

BOUND = ProbabilityBound(0.05, 0.05)


def of(found: list[AssumptionVerdict], platform: str) -> AssumptionVerdict:
    return next(v for v in found if v.platform == platform)


def test_sixty_runs_validate_and_fifty_nine_do_not(tmp_path: Path) -> None:
    runs = [held(tmp_path, k) for k in range(60)]
    found = verdicts(runs, 0, BOUND)
    assert [(v.platform, v.verdict, v.runs, v.wanted) for v in found] == [
        ("quad full", "VALIDATED", 60, 0), ("car full", "VALIDATED", 60, 0),
    ]  # fmt: skip
    assert found[0].windows == 120 and found[0].epsilon <= 0.05 and found[0].interval[0] == 0.0
    fewer = verdicts(runs[:59], 0, BOUND)[0]
    assert (fewer.verdict, fewer.why, fewer.wanted) == ("INCONCLUSIVE", "1 more sample wanted", 1)
    assert verdicts(runs, 1, BOUND)[0].verdict == "INCONCLUSIVE", "one did not come to its end: it may be the bad one"


def test_a_violation_is_one_of_its_platform(tmp_path: Path) -> None:
    bad = [
        window(1, 0, "h"),
        window(1, 1, "v", (0.0, 0.04, 0.0)),
        window(2, 0, "h"),
        window(2, 1, "v", (0.0, 0.03, 0.0)),
    ]
    runs = [*(held(tmp_path, k) for k in range(60)), sample(tmp_path, bad, 60)]
    found = verdicts(runs, 0, BOUND)
    assert of(found, "quad full").verdict == "VALIDATED"
    car = of(found, "car full")
    assert (car.verdict, car.runs, car.violated, car.windows, car.violated_windows) == ("VIOLATED", 61, 1, 122, 2)
    assert car.worst is not None and car.worst.breach is not None
    assert (car.worst.run, car.worst.seed, car.worst.robot, car.worst.at) == (60, 61, "robot1", 0.0)
    assert car.breaches == {"across": 2} and car.farthest == {"across": 0.04}
    assert car.together == {"across": pytest.approx(0.07)}
    assert [(r.name, r.runs, r.windows, r.violated) for r in car.robots] == [("robot1", 1, 122, 2)]


def test_of_many_violations_the_farthest_is_told_or_the_first(tmp_path: Path) -> None:
    runs = [sample(tmp_path, [window(3, 0, "v", (0.0, d, 0.0))], k) for k, d in enumerate((0.1, 0.3, 0.2))]
    worst = verdicts(runs, 0, BOUND)[0].worst
    assert worst is not None and (worst.run, worst.at) == (1, 0.2)
    runs = [sample(tmp_path, [window(r, 0, "v")], k) for k, r in enumerate((7, 4))]
    worst = verdicts(runs, 0, BOUND)[0].worst
    assert worst is not None and (worst.run, worst.at, worst.breach) == (0, 0.6, None)


@pytest.mark.parametrize(
    ("came", "ended", "why"),
    [
        ("-", "completed", "never put to the test"), ("u", "completed", "in 1 window it was not known"),
        ("n", "completed", "had no value in 1 window"), ("o", "completed", "never put to the test"),
        ("h", "died", "1 run did not come to an end"), ("h", "idle", "1 run did not come to an end"),
    ],
)  # fmt: skip
def test_of_what_nothing_can_be_said(came: str, ended: str, why: str, tmp_path: Path) -> None:
    found = verdicts([sample(tmp_path, [window(1, 0, came)], ended=ended)], 0, ProbabilityBound(0.9, 0.9))[0]
    assert found.verdict == "INCONCLUSIVE" and why in found.why
    assert verdicts([sample(tmp_path, [window(1, 0, "h")])], 0, ProbabilityBound(0.9, 0.9))[0].verdict == "VALIDATED"


def test_a_violation_counts_whatever_became_of_the_run(tmp_path: Path) -> None:
    found = verdicts([sample(tmp_path, [window(1, 0, "v")], ended="died")], 3, BOUND)[0]
    assert found.verdict == "VIOLATED" and found.runs == 1


def test_each_assumption_has_its_own(tmp_path: Path) -> None:
    found = verdicts([sample(tmp_path, [window(1, 0, "hv")], lines=(8, 9))], 0, BOUND)
    assert [(v.assumption.line, v.verdict) for v in found if v.platform == "quad full"] == [
        (8, "INCONCLUSIVE"), (9, "VIOLATED"),
    ]  # fmt: skip


def test_margins_are_of_all_runs(tmp_path: Path) -> None:
    rows = ([window(1, 0, "v", (0.0, 0.1, 0.0), far=d), window(1, 1, "h")] for d in (0.5, 0.7, 0.2))
    runs = [sample(tmp_path, row, k) for k, row in enumerate(rows)]
    assert margin(runs, "quad full", outside=True) == 0.7
    assert margin(runs, "quad full", outside=False) == 5.0
    assert margin(runs, "car full", outside=True) == 0.0


@pytest.mark.parametrize("cut", [0.3, 0.7, 0.999])
def test_a_file_that_is_cut_off_is_no_sample(cut: float, tmp_path: Path) -> None:
    whole = text([window(r, 0, "h") for r in range(20)])
    (tmp_path / FILE).write_text(whole)
    assert read(tmp_path, 0) is not None
    (tmp_path / FILE).write_text(whole[: int(len(whole) * cut)])
    assert read(tmp_path, 0) is None
    assert read(tmp_path / "nowhere", 0) is None
