"""Several fleets in one world: each has its own network, rounds, trace and properties."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli import main
from targets.sim.trace.files import read
from tests.sim.lockstep.fleets import together
from tests.sim.lockstep.lockstep import ran, summary

pytestmark = pytest.mark.slow

COUNT = """\
using Motion:
  sensors: Point position
allwrite: int n = 0
local: int mine = 0
Count:
  pre: mine < {rounds}
  eff: atomic:
    mine += 1
    n += 1
End:
  pre: mine >= {rounds}
  eff: stop
invariant Few: n < {most}
"""
FLEET = """\
delta: {delta}
origin: {{latitude: 47.397742, longitude: 8.545594, altitude: 488.0}}
geofence: {{lo: [-8, -7, -0.5], hi: [8, 7, 4.0]}}
insecure: true
robots:
"""
ROBOT = """\
  - name: {0}
    target: car
    address: 127.0.0.1:{1}
    start: {{position: [{2}, 0, 0]}}
    sim: {{fidelity: simple}}
"""


def built(folder: Path, app: str, delta: float, starts: dict[str, float], port: int, most: int) -> Path:
    folder.mkdir()
    (folder / f"{app}.koord").write_text(COUNT.format(rounds=4, most=most))
    robots = "".join(ROBOT.format(name, port + k, x) for k, (name, x) in enumerate(starts.items()))
    (folder / "fleet.yaml").write_text(FLEET.format(delta=delta) + robots)
    arguments = ["build", str(folder / f"{app}.koord"), "--fleet", str(folder / "fleet.yaml"), "--target", "sim"]
    assert main([*arguments, "-o", str(folder / "build")]) == 0
    return folder / "build" / app / "sim"


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fleets `one` (ann, bert) and `two` (ann, cleo, dora), which is named alpha."""
    folder = tmp_path_factory.mktemp("fleets")
    one = built(folder / "one", "one", 0.1, {"ann": -3, "bert": -1}, 47100, 100)
    return together(one, "alpha", built(folder / "two", "two", 0.2, {"ann": 1, "cleo": 3, "dora": 5}, 47200, 5))


def records(trace: Path) -> tuple[Any, list[Any]]:
    header, found = read(trace)
    return header, list(found)


@pytest.fixture(scope="module")
def run(bundle: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "run"
    assert ran(bundle, folder, 3, "--seed=1") == 3
    return folder


def test_fleets_in_one_world_have_traces_of_their_own(run: Path) -> None:
    outer, records_of_outer = records(run / "trace.jsonl")
    inner, records_of_inner = records(run / "alpha" / "trace.jsonl")
    assert [(r.name, r.pid) for r in outer.robots] == [("ann", 0), ("bert", 1)]
    assert [(r.name, r.pid) for r in inner.robots] == [("ann", 0), ("cleo", 1), ("dora", 2)]
    assert (outer.app, outer.delta, inner.app, inner.delta) == ("one", 0.1, "two", 0.2)
    for found, count, lowest in ((records_of_outer, 2, -4.0), (records_of_inner, 3, 0.0)):
        poses = [r for r in found if type(r).__name__ == "PoseRecord"]
        assert {r.pid for r in poses} == set(range(count))
        assert all(lowest < r.position[0] < lowest + 6 for r in poses)
        assert {r.pid for r in found if type(r).__name__ == "Round" and r.event == "Count"} == set(range(count))
        assert [type(r).__name__ for r in found].count("End") == 1


def test_each_fleet_is_judged_by_its_own_properties(run: Path) -> None:
    whole, inner = summary(run), summary(run / "alpha")
    assert whole["verdict"] == inner["verdict"] == "violated"
    assert "alpha: " in whole["why"] and "two.koord" in whole["why"]
    assert {(p["name"], p["outcome"]) for p in whole["properties"]} == {("Few", "held"), ("alpha: Few", "violated")}
    assert [p["outcome"] for p in inner["properties"]] == ["violated"]
    assert (run / "source" / "one.koord").is_file()
    assert (run / "alpha" / "source" / "two.koord").is_file()


def test_a_robot_of_an_inner_fleet_can_be_cut_off_from_its_fleet(bundle: Path, tmp_path: Path) -> None:
    groups = [["alpha.ann", "ann", "bert"], ["alpha.cleo", "alpha.dora"]]
    faults = {"events": [{"at": 0.05, "for": 3, "partition": groups}]}
    (tmp_path / "faults.json").write_text(json.dumps(faults))
    ran(bundle, tmp_path / "run", 6, "--seed=1", f"--scenario={tmp_path / 'faults.json'}")
    _, of_outer = records(tmp_path / "run" / "trace.jsonl")
    _, of_inner = records(tmp_path / "run" / "alpha" / "trace.jsonl")
    last_of_outer = max(r.t for r in of_outer if type(r).__name__ == "Round" and r.event == "Count")
    assert last_of_outer < 2.0  # both are in one group
    cut_off = [r.t for r in of_inner if type(r).__name__ == "Round" and r.pid == 0 and r.event == "Count"]
    assert max(cut_off) > 3.0
