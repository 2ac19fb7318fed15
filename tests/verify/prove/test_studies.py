"""The case studies are proved, for any number of robots and for three; weaker versions of them are not."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from koordgen.build.pipeline import check_file
from koordgen.lang.ir.decl import Program
from koordgen.lang.node import replace
from koordgen.verify.prove.obligations.generate import obligations
from koordgen.verify.prove.smt.obligation import LabelledFormula
from koordgen.verify.prove.smt.solve import Limits, Solver
from koordgen.verify.prove.smt.term import all_of
from tests.verify.prove.proving import checked, proved_names

EXAMPLES = Path(__file__).parents[3] / "examples"
STUDIES = {
    "lineform/geofence": {"Geofence", "(well-defined)"},
    "task/separation": {"Following", "Arrived", "Idle", "Shared", "Clear", "Separation", "(well-defined)"},
    "task/once": {"Listed", "Taken", "Once", "(well-defined)"},
    "mapping/mapping": {"GlobalTruth", "LocalTruth", "Looked", "(well-defined)"},
    "election/election": {"Bidding", "Everyone", "Best", "Agreement", "(well-defined)"},
    "atomicsum/atomicsum": {"Counted", "Given", "NothingLost", "Bounds", "All"},
    "atomicsum/mutex": {"Holder", "Alone"},
}
WEAKER = [  # a study, what is left out of it, and what is no longer proved then
    ("lineform/geofence", " and Motion.target[i] in Rect(lo, hi)", "Geofence"),
    ("lineform/geofence", " and x[i] in Rect(lo, hi)", "Geofence"),
    ("lineform/geofence", "initially: forall i in ID: Motion.position[i] in Rect(lo, hi)", "Geofence"),
    ("task/separation", "  assume not reached or reached'\n", "Idle"),
    ("task/separation", "i != me and path_distance(path, paths[i]) <= eps", "Separation"),
    ("task/once", "        all_tasks.remove(cur_task)\n", "Once"),
    ("atomicsum/atomicsum", " atomic:", "NothingLost"),
    ("atomicsum/mutex", " atomic:", "Alone"),
    ("mapping/mapping", "axiom MergedTruth", "GlobalTruth"),
]


@pytest.fixture(scope="module")
def solver() -> Iterator[Solver]:
    with Solver("z3", Limits(query=10.0, total=10_000.0)) as running:
        yield running


def program(study: str) -> Program:
    return check_file(str(EXAMPLES / f"{study}.koord")).program


@pytest.mark.parametrize("study", STUDIES)
def test_it_is_proved_for_every_number_of_robots(study: str, solver: Solver) -> None:
    assert proved_names(program(study), solver) == STUDIES[study]


@pytest.mark.parametrize(
    "study",
    [
        "lineform/geofence",
        pytest.param("task/separation", marks=pytest.mark.slow),
        "mapping/mapping",
        "atomicsum/mutex",
    ],
)
def test_it_is_proved_for_three_robots(study: str) -> None:
    """Written out, which takes z3 seconds, and many on a busy machine."""
    with Solver("z3", Limits(query=120.0, total=1000.0)) as patient:
        assert STUDIES[study] - {"(well-defined)"} <= proved_names(program(study), patient, 3)


@pytest.mark.parametrize(("study", "part", "name"), WEAKER)
def test_what_is_weaker_is_not_proved(study: str, part: str, name: str, solver: Solver) -> None:
    text = (EXAMPLES / f"{study}.koord").read_text()
    assert part in text
    line = next(line for line in text.splitlines() if part.splitlines()[0] in line)
    left = {"axiom MergedTruth": line, "initially: forall i in ID: Motion.position[i] in Rect(lo, hi)": line}
    instead = "False" if part.startswith("i != me") else ""
    assert name not in proved_names(checked(text.replace(left.get(part, part), instead)), solver)


def test_it_says_no_more_for_more_robots() -> None:
    """For any number of robots: as many obligations and facts as there are, whatever the number."""
    many = [len(o.facts) for o in obligations(program("lineform/geofence"))]
    assert sum(many) < 200


def test_the_same_obligations_each_time() -> None:
    first, second = (obligations(program("task/separation")) for _ in range(2))
    assert [(o.name, [f.label for f in o.facts]) for o in first] == [
        (o.name, [f.label for f in o.facts]) for o in second
    ]


@pytest.mark.parametrize("study", ["lineform/geofence", "task/separation", "mapping/mapping"])
def test_what_little_is_told_follows_from_what_is_told_usually(study: str, solver: Solver) -> None:
    """And of distances the assumptions' consistency is asked with all of it, apart from single events."""
    usual = {o.name: o for o in obligations(program(study))}
    for o in obligations(program(study), detail="little"):
        all_of_them = LabelledFormula("little", all_of([fact.term for fact in o.facts]), o.file, 1)
        other = replace(usual[o.name], goal=all_of_them, conjuncts=(), expected="unsat")
        assert len(o.facts) <= len(other.facts) and solver.ask(other).result == "unsat"
        if o.kind == "consistency" and not o.event:
            proved_names = [[f.label for f in one.facts if f.label.startswith("distance")] for one in (o, other)]
            assert proved_names[0] == proved_names[1]
