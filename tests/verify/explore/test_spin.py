"""Spin and the plain search agree on the reachable states of an election."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.fixtures import spin
from koordgen.build.pipeline import check_file
from tests.verify.explore.reference import explored

ELECTION = Path(__file__).parents[3] / "examples/election/election.koord"


@pytest.mark.slow
@pytest.mark.skipif(not spin.installed(), reason=spin.MISSING)
@pytest.mark.parametrize("tight", [False, True])
@pytest.mark.parametrize("n_sys", [2, 3, 4])
def test_ends_of_rounds_are_those_of_spin(n_sys: int, tight: bool, tmp_path: Path) -> None:
    made, result = explored(
        check_file(str(ELECTION)).program, n_sys, symmetry=False, independence=False, forgetting=False
    )
    assert result.violation is None and not result.stopped
    states = [made.machine.state(fleet) for fleet in made.known]
    ours = {
        tuple([
            number
            for bid, robot in zip(state.store.slots["bid"], state.robots, strict=True)
            for number in (bid, robot.locals["leader"], int(robot.stopped))
        ])
        for state in states
    }  # fmt: skip
    ran = spin.ran(spin.election(n_sys, 7, tight), tmp_path, printing=True)
    assert spin.ends(ran.output) == ours
