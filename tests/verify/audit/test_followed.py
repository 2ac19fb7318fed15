"""Counterexamples that agents executed: an audit of the run finds the same violation in the same round."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.sim.follow.test_follow import EXAMPLES, MUTANTS, found, same
from tests.verify.audit.fleets import audited, by_name
from tests.verify.explore.test_search import LOST

BELOW = """\
allread: int n[N_SYS]
Up:
  pre: True
  eff: n[pid] = n[pid] + 1
invariant Below: forall i in ID: n[i] < 3
"""


def agrees(folder: Path, trace: Path, robots: int, served: str = "") -> None:
    """The simulator's first violation of a property, the counterexample's name, and the audit's, of both kinds of
    traces."""
    run = same(folder, trace, robots, served).folder
    ending = next(r for r in map(json.loads, trace.read_text().splitlines()) if r["kind"] == "violation")
    verdicts = {p["name"]: p for p in json.loads((run / "summary.json").read_text())["properties"]}
    for given in (run, run / "robots"):
        status, document = audited(given)
        mine = by_name(document)[ending["name"]]
        assert status == 3 and mine["verdict"] == verdicts[ending["name"]]["outcome"]
        since = verdicts[ending["name"]]["since"]
        assert mine["first"]["seconds"] == pytest.approx(max(0.0, since), abs=0.011)


def test_a_lost_update(tmp_path: Path) -> None:
    agrees(tmp_path, found(tmp_path, LOST, 2), 2)


def test_what_the_prover_found(tmp_path: Path) -> None:
    agrees(tmp_path, found(tmp_path, BELOW, 2, command="prove"), 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a lost update", "all but one is atomic", "a missing not"])
def test_mutants_of_examples(tmp_path: Path, name: str) -> None:
    app, old, new, robots, more = MUTANTS[name]
    text = (EXAMPLES / f"{app}.koord").read_text()
    assert old in text
    agrees(tmp_path, found(tmp_path, text.replace(old, new, 1), robots, more), robots)
