"""Suggested assumptions: margins of hand-made samples, and the prover's verdicts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from koordgen.build.pipeline import Checked, check_file
from koordgen.cli.experiment.validate import LIMITS
from koordgen.experiment.validate.suggest import about_way, suggestions
from koordgen.verify.prove.smt.solve import Solver, solver_of
from tests.experiment.validate.windows import sample, window

MARGIN = Path(__file__).parents[3] / "examples/lineform/margin.koord"
GEOFENCE = MARGIN.with_name("geofence.koord")
BOX = "position' in Rect(position, target)"


@pytest.fixture(scope="module")
def solver() -> Iterator[Solver]:
    with solver_of("z3", LIMITS) as found:
        yield found  # type: ignore[misc]


def boxed(folder: Path, old: str = "position' in Ball(target, 2)", new: str = BOX) -> tuple[Checked, int]:
    """LineForm with margins, under another assumption; its line."""
    text = MARGIN.read_text()
    assert text.count(old) == 1
    path = folder / "boxed.koord"
    path.write_text(text.replace(old, new))
    return check_file(str(path)), next(k for k, line in enumerate(text.splitlines(), 1) if old in line)


def test_the_weaker_assumption_closes_the_proof_where_there_is_room(tmp_path: Path, solver: Solver) -> None:
    checked, line = boxed(tmp_path)
    runs = [
        sample(tmp_path, [window(1, 0, "v", (0.0, 0.1, 0.0), far=d) | {"reach": 1.504}], lines=(line,))
        for d in (0.3, 0.514)
    ]
    found = suggestions(checked.source, checked.program, line, {}, runs, solver)
    assert [s.text for s in found] == [f"{BOX} or position' in Ball(target, 0.52)", "position' in Ball(target, 1.51)"]
    assert all(s.closes and s.by_platform["quad full"] == s.margin for s in found)
    assert {p.invariant for p in found[0].proved} == {"Targets", "Geofence", "(well-defined)"}


@pytest.mark.slow
def test_more_than_there_is_room_for_does_not(tmp_path: Path, solver: Solver) -> None:
    checked, line = boxed(tmp_path)
    runs = [sample(tmp_path, [window(1, 0, "v", (0.0, 0.1, 0.0), far=0.4)], lines=(line,))]
    box, ball = suggestions(checked.source, checked.program, line, {}, runs, solver)
    assert box.closes and not ball.closes and ball.margin == 5.0
    assert {p.invariant: p.verdict == "PROVED" for p in ball.proved}["Geofence"] is False


@pytest.mark.slow
def test_nothing_closes_the_published_invariant(tmp_path: Path, solver: Solver) -> None:
    checked = check_file(str(GEOFENCE))
    line = next(m.assumptions[0].span.line for m in checked.program.modules)
    runs = [sample(tmp_path, [window(1, 0, "v", (0.0, 0.1, 0.0), far=0.4)], lines=(line,))]
    assert not any(s.closes for s in suggestions(checked.source, checked.program, line, {}, runs, solver))


def test_it_stands_where_the_other_one_stood(tmp_path: Path, solver: Solver) -> None:
    long = "(\n    position' in Rect(position,\n    target))"
    checked, line = boxed(tmp_path, new=long)
    runs = [sample(tmp_path, [window(1, 0, "v", (0.0, 0.1, 0.0), far=0.4)], lines=(line,))]
    line = checked.program.modules[0].assumptions[0].span.line
    assert suggestions(checked.source, checked.program, line, {}, runs, solver)[0].closes


def test_of_others_there_is_no_suggestion(tmp_path: Path, solver: Solver) -> None:
    checked, line = boxed(tmp_path, new="distance(position', position) <= 0.2")
    assert about_way(checked.program, line) is None
    assert suggestions(checked.source, checked.program, line, {}, [], solver) == []
