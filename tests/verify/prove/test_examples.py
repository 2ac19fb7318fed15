"""Every example is proved, for every number of robots and any params that its `initially` allows: docs/examples.md has
the same table."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from koordgen.build.pipeline import check_file
from koordgen.verify.prove.report.verdict import Question, prove
from koordgen.verify.prove.smt.solve import Limits, Solver
from tests.programs import programs_alone

ROOT = Path(__file__).parents[3]
PROVED = {
    "atomicsum/atomicsum": "Counted, Given, NothingLost, Bounds, All",
    "atomicsum/mutex": "Holder, Alone",
    "crossing/crossing": "MutualExclusion, Holder, Clear, Arrived, Waiting, Targets, (well-defined)",
    "delivery/delivery": "Homes, Separation, (well-defined)",
    "election/election": "Bidding, Everyone, Best, Agreement, (well-defined)",
    "follow/follow": "OneLeader, Route, (well-defined)",
    "formation/formation": "Together, Sent, (well-defined)",
    "hello/hello": "",  # no invariant, and no operation without a result
    "hvac/hvac": "Safe, (well-defined)",
    "lineform/geofence": "Geofence, (well-defined)",
    "lineform/lineform": "(well-defined)",
    "lineform/margin": "Targets, Geofence, (well-defined)",
    "mapping/mapping": "GlobalTruth, LocalTruth, Looked, (well-defined)",
    "patrol/patrol": "Begun, Apart, (well-defined)",
    "rendezvous/rendezvous": "Honest, (well-defined)",
    "task/once": "Listed, Taken, Once, (well-defined)",
    "task/separation": "Following, Arrived, Idle, Shared, Clear, Separation, (well-defined)",
    "task/task": "Following, Arrived, Idle, Shared, Ends, Paths, Tube, Near, Separation, (well-defined)",
}


@pytest.fixture(scope="module")
def solver() -> Iterator[Solver]:
    with Solver("z3", Limits(query=10.0, total=10_000.0)) as running:
        yield running


def test_no_example_is_left_out() -> None:
    found = {str(p.relative_to(ROOT / "examples").with_suffix("")) for p in programs_alone()}
    assert found == set(PROVED)


@pytest.mark.parametrize("example", PROVED)
def test_it_is_proved(example: str, solver: Solver) -> None:
    verdicts = prove(Question(check_file(str(ROOT / f"examples/{example}.koord")).program), solver)
    assert {v.invariant: v.verdict for v in verdicts} == dict.fromkeys(
        filter(None, PROVED[example].split(", ")), "PROVED"
    )


def test_the_documents_name_what_is_proved() -> None:
    rows = (ROOT / "docs/examples.md").read_text().splitlines()
    told = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows if row.startswith("| `")]
    assert {row[0].strip("`"): row[1] for row in told if row[0].strip("`") in PROVED} == {
        name: names.removesuffix("(well-defined)").removesuffix(", ") or "no invariant"
        for name, names in PROVED.items()
    }
