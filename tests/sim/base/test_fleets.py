"""Fleets of a scenario: which robots are theirs, how their states follow from those of bodies, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from koordgen.runtime.trace.schema import BoxRecord
from targets.sim.base.bodies import BodyState
from targets.sim.base.fleets import fleets_of, own_settings
from targets.sim.base.folder import FOLDERS, MARKER, ForeignFolder, RunFolder
from targets.sim.base.scenario import (
    BadScenario,
    FleetDescription,
    GeodeticOrigin,
    Robot,
    Scenario,
    Start,
    _check_fleets,
)

FENCE = BoxRecord((-9.0, -9.0, 0.0), (9.0, 9.0, 4.0))
NAMES = ("alpha.ann", "alpha.bob", "dora")
SCENARIO = Scenario(
    "line", "line.koord", "0", 0.5, GeodeticOrigin(47.0, 8.0, 400.0), FENCE,
    tuple(Robot(name, k, "quad", "", "", "", Start((float(k), 0.0, 0.0))) for k, name in enumerate(NAMES)),
    fleets=(
        FleetDescription("", (2, "alpha"), "line", "line.koord", "0", 0.5, FENCE, application_id=1),
        FleetDescription("alpha", (0, 1), "triangle", "triangle.koord", "1", 0.1, FENCE, application_id=7),
    ),
)  # fmt: skip


def state(x: float) -> BodyState:
    return BodyState((x, 2 * x, 1.0), (x, 0.0, 0.0), 0.5, 0.0)


def test_each_fleet_has_its_own_pids_names_and_states() -> None:
    outer, alpha = fleets_of(SCENARIO)
    assert (outer.names, outer.bodies, outer.scenario.app, outer.scenario.delta) == (
        ("dora", "alpha"), ((2,), (0, 1)), "line", 0.5,
    )  # fmt: skip
    assert (alpha.names, alpha.bodies, alpha.scenario.app, alpha.scenario.delta) == (
        ("alpha.ann", "alpha.bob"), ((0,), (1,)), "triangle", 0.1,
    )  # fmt: skip
    assert [robot.pid for robot in (*outer.scenario.robots, *alpha.scenario.robots)] == [0, 1, 0, 1]
    assert outer.is_squad(1) and not outer.is_squad(0) and not alpha.is_squad(0)
    assert [alpha.own_name(name) for name in alpha.names] == ["ann", "bob"]
    assert outer.members == ((1, "ann", 0), (1, "bob", 1)) and alpha.members == ()
    states = [state(0.0), state(1.0), state(5.0)]
    assert alpha.states(states) == states[:2]
    assert outer.states(states) == [states[2], BodyState((0.5, 1.0, 1.0), (0.5, 0.0, 0.0), 0.0, 0.0)]
    assert own_settings(SCENARIO) == [("ann", 7), ("bob", 7), ("dora", 1)]


def test_a_scenario_without_squads_is_one_fleet() -> None:
    (only,) = fleets_of(replace(SCENARIO, fleets=()))
    states = [state(float(k)) for k in range(3)]
    assert only.is_whole and only.names == NAMES and only.states(states) is states
    assert only.programs(Path("bundle")) == Path("bundle")


@pytest.mark.parametrize(
    ("members", "name", "said"),
    [
        ((2, "beta"), "alpha", "the squad beta is not described"),
        ((2, 1, "alpha"), "alpha", "each robot must be a member of one fleet"),
        (("alpha",), "alpha", "each robot must be a member of one fleet"),
        ((2, "source"), "source", "source is a folder of each run"),
    ],
)
def test_fleets_that_cannot_be_are_refused(members: tuple[int | str, ...], name: str, said: str) -> None:
    outer, alpha = SCENARIO.fleets
    fleets = replace(outer, members=members), replace(alpha, name=name)
    with pytest.raises(BadScenario, match=said):
        _check_fleets(Path("scenario.json"), replace(SCENARIO, fleets=fleets))


def test_the_folder_of_a_squad_belongs_to_the_run(tmp_path: Path) -> None:
    out = tmp_path / "run"
    with RunFolder(out, ["alpha"]) as folder:
        (folder / "alpha" / "trace.jsonl").write_text("old")
        (folder / "alpha" / "plots").mkdir()
    with RunFolder(out, ["beta"]) as folder:
        assert sorted(path.name for path in folder.iterdir()) == [MARKER, "beta"]
    (out / "alpha").mkdir()
    (out / "alpha" / "notes.txt").write_text("mine")
    with pytest.raises(ForeignFolder), RunFolder(out):
        pass
    assert (out / "alpha" / "notes.txt").exists() and (out / "beta").exists()
    assert "alpha" not in FOLDERS
