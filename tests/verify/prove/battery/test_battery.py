"""Each construct in a small program: exactly the provable invariants are proved; also for three robots."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from koordgen.verify.prove.smt.solve import Limits, Solver
from tests.verify.prove.battery.battery import BATTERY
from tests.verify.prove.proving import checked, proved_names


@pytest.fixture(scope="module")
def solver() -> Iterator[Solver]:
    with Solver("z3", Limits(query=5.0, total=10_000.0)) as running:
        yield running


@pytest.mark.parametrize("name", BATTERY)
def test_what_is_provable_is_proved_and_nothing_else(name: str, solver: Solver) -> None:
    text, wanted = BATTERY[name]
    assert proved_names(checked(text), solver) == wanted


@pytest.mark.parametrize("name", ["geofence", "mutual exclusion", "searching", "sums", "init"])
def test_the_same_for_three_robots(name: str, solver: Solver) -> None:
    text, wanted = BATTERY[name]
    wanted = wanted - {"(well-defined)"}  # of a robot whose number is known there may be nothing to show
    assert proved_names(checked(text), solver, 3) - {"(well-defined)"} == wanted
