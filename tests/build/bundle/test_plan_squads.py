"""Bundles of an outer fleet with squads: the files of each robot of both levels."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Collection
from pathlib import Path

import msgspec
import pytest

from koordgen.build.bundle import squads_harness
from koordgen.build.bundle.plan import Files
from koordgen.build.bundle.plan_squads import OUTER_SETTINGS
from koordgen.build.bundle.write import write
from koordgen.build.pipeline import Checked, Rejected, plan_file
from koordgen.fleet import squads
from koordgen.runtime.agent.squad import APPLICATION, Squad
from koordgen.runtime.config.settings import Settings
from targets.sim.base import scenario
from targets.sim.base.fleets import FOLDER, OF_FLEET
from tests.build.squad_files import LINEFORM, TRIANGLE, fleet_files

BUNDLES = ["alpha.ann", "alpha.bob", "alpha.cyd", "beta.eve", "beta.fay", "beta.gus", "dora"]


def planned(
    outer: Path, wanted: Collection[str] | None = None, app: Path = LINEFORM
) -> tuple[Checked, dict[str, Files]]:
    return plan_file(str(app), wanted, str(outer), {}, squads=True)


def settings(files: Files, name: str = "settings.json") -> Settings:
    return msgspec.json.decode(files[name], type=Settings)


def errors(outer: Path, wanted: Collection[str] | None = None, app: Path = LINEFORM) -> list[str]:
    with pytest.raises(Rejected) as rejected:
        planned(outer, wanted, app)
    return [f"{Path(s.path).name}:{d.span.line}: {d.code} {d.message}" for s, d in rejected.value.found]


def test_each_inner_robot_has_the_bundle_of_both_levels(tmp_path: Path) -> None:
    _, bundles = planned(fleet_files(tmp_path))
    assert sorted(bundles) == sorted([*BUNDLES, "fleet"])
    assert len({files["RELEASE"] for files in bundles.values()}) == 1
    bob = bundles["alpha.bob"]
    assert {"applications.py", "program_triangle.py", "source/triangle/triangle.koord"} <= set(bob), "the inner level"
    assert {"program.py", "lineform.koord", "params.json", "squad.py", OUTER_SETTINGS} <= set(bob), "the outer level"
    assert "properties.py" not in bob and "PROPERTIES" not in bob["squad.py"].decode()
    assert bob["program.py"] == bundles["dora"]["program.py"] and "squad.py" not in bundles["dora"]
    assert b"properties, SQUAD))" in bob["__main__.py"] and b"SQUAD" not in bundles["dora"]["__main__.py"]
    assert b"the squad `alpha`" in bob["README.md"] and b"squad" not in bundles["dora"]["README.md"]
    facts = json.loads(bundles["fleet"]["fleet.json"])
    assert facts["squads"][1] == {"name": "beta", "robots": ["eve", "fay", "gus"]}


def test_settings_of_both_levels(tmp_path: Path) -> None:
    _, bundles = planned(fleet_files(tmp_path))
    inner, outer = settings(bundles["alpha.bob"]), settings(bundles["alpha.bob"], OUTER_SETTINGS)
    assert (inner.robot, inner.pid, inner.delta, inner.application_id) == ("bob", 1, 0.1, 2)
    assert [peer.port for peer in inner.peers] == [47200, 47201, 47202]
    assert (outer.robot, outer.pid, outer.delta, outer.application_id) == ("alpha", 0, 0.3, 0)
    assert [(p.name, p.port, [a.port for a in p.also]) for p in outer.peers] == [
        ("alpha", 49201, []), ("dora", 47100, []), ("beta", 49300, [49301, 49302]),
    ]  # fmt: skip
    assert (outer.safety.position_stale, outer.safety.position_lost) == (0.5 + 3 * 0.1, 10000.0)
    assert inner.safety.position_lost == 2.0 and outer.body == {} and inner.body != {}
    dora = settings(bundles["dora"])
    assert [[a.port for a in peer.also] for peer in dora.peers] == [[49201, 49202], [], [49301, 49302]]


@pytest.mark.parametrize(("inner", "outer", "said"), [("a", "b", True), ("a", "a", False), ("a", "", False)])
def test_a_second_key_is_named(inner: str, outer: str, said: bool, tmp_path: Path) -> None:
    path = fleet_files(tmp_path)
    for file, key in ((path, outer), (tmp_path / "alpha.yaml", inner)):
        file.write_text(file.read_text().replace("insecure: true", f"key: {key}.key" if key else "insecure: true"))
    readme = planned(path)[1]["alpha.ann"]["README.md"].decode()
    assert ("Copy the outer fleet's key\nbeside it as `b.key`." in readme) == said
    assert "beside it as `a.key`" in readme


def test_the_name_of_the_settings_file_is_the_runtimes() -> None:
    assert next(f.default for f in Squad.__dataclass_fields__.values() if f.name == "settings") == OUTER_SETTINGS


LOADED = """
import sys
from types import SimpleNamespace
sys.path.insert(0, sys.argv[1])
from applications import FLEET
from koordgen.runtime.agent.squad import SensorValues
from koordgen.runtime.values.points import Point
from squad import SQUAD
fleet = SQUAD.with_outer(FLEET, 3, SimpleNamespace(may_claim=None, claim=None, has_unwritten=None, write=None))
store = {v.name: (v.initial(),) * 3 if v.kind == "allread" else v.initial() for v in fleet.shared()}
store |= {"shape.corner": (Point(1, 0, 0), Point(3, 0, 0), Point(2, 0, 0)), "shape.goal": Point(2, 0, 0)}
for port, value in SensorValues(SQUAD, fleet).of(store).items():
    print(port, value)
print(SQUAD.application, SQUAD.actuators, SQUAD.program.name, SQUAD.properties and len(SQUAD.properties.properties))
"""


def test_the_ports_of_a_squad_are_functions_and_variables_of_its_program(tmp_path: Path) -> None:
    outer = fleet_files(tmp_path)
    applications = "[{name: second, program: second.koord}, {name: shape, program: triangle.koord}]"
    (tmp_path / "second.koord").write_text("local: bool k\nGo:\n  pre: not k\n  eff: k = True\n")
    fleet = (tmp_path / "alpha.yaml").read_text()
    (tmp_path / "alpha.yaml").write_text(fleet.replace("[{name: triangle, program: triangle.koord}]", applications))
    app = tmp_path / "app.koord"
    lines = LINEFORM.read_text().replace("Point position", "bool reached")
    lines = lines.replace("x[pid] = Motion.position", "x[pid] = Point(0, 0, 0)").replace(
        "pre: not", "pre: Motion.reached and not"
    )
    app.write_text(f"{lines}invariant Few: N_SYS < 9\n")
    write({"ann": planned(outer, app=app)[1]["alpha.ann"]}, tmp_path / "out")
    command = [sys.executable, "-c", LOADED, str(tmp_path / "out/ann")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.stdout.splitlines() == [
        "Motion.reached True",
        "Motion.position Point(x=2.0, y=0.0, z=0.0)",
        "1 {'Motion.target': 'goal'} app 1",
    ], done.stderr


def test_the_release_covers_all_levels(tmp_path: Path) -> None:
    outer = fleet_files(tmp_path)
    first = planned(outer)[1]["dora"]["RELEASE"]
    (tmp_path / "triangle.koord").write_text(TRIANGLE.replace("radius = 0.8", "radius = 0.9"))
    _, bundles = planned(outer)
    assert bundles["dora"]["RELEASE"] == bundles["alpha.ann"]["RELEASE"] != first


def test_bundles_of_some_targets_only(tmp_path: Path) -> None:
    outer = fleet_files(tmp_path)
    assert sorted(planned(outer, ["car"])[1]) == ["dora", "fleet"]
    assert sorted(planned(outer, ["quad"])[1]) == [*BUNDLES[:-1], "fleet"]


def test_the_bundle_of_the_simulator_has_all_robots_and_both_levels(tmp_path: Path) -> None:
    sim = planned(fleet_files(tmp_path), ["sim"])[1]["sim"]
    scenario = json.loads(sim["scenario.json"])
    assert [(robot["name"], robot["pid"]) for robot in scenario["robots"]] == [
        ("alpha.ann", 0), ("alpha.bob", 1), ("alpha.cyd", 2), ("dora", 3), ("beta.eve", 4), ("beta.fay", 5),
        ("beta.gus", 6),
    ]  # fmt: skip
    outer, alpha, beta = scenario["fleets"]
    assert (outer["name"], outer["members"], outer["app"]) == ("", ["alpha", 3, "beta"], scenario["app"])
    assert (beta["name"], beta["members"], beta["delta"], beta["application_id"]) == ("beta", [4, 5, 6], 0.1, 3)
    commanded = {"name": APPLICATION, "members": [0, 1, 2], "variables": {"goal": "triangle.goal"}}
    assert alpha["applications"][-1] == commanded
    assert set(OF_FLEET) == alpha.keys() - {"name", "members"}
    assert {"program.py", "source/lineform.koord", "agents/alpha.ann/squad.py"} <= set(sim)
    inner = {"applications.py", "program_triangle.py", "squad.py", "program.py", "source/triangle/triangle.koord"}
    assert {f"{FOLDER}/beta/{path}" for path in inner} <= set(sim)


def test_names_that_the_build_and_the_simulator_share() -> None:
    assert squads_harness.FLEETS == FOLDER
    assert squads.RESERVED == scenario.RESERVED


def test_a_record_that_is_too_large_for_the_inner_fleet(tmp_path: Path) -> None:
    app = tmp_path / "app.koord"
    app.write_text(f"{LINEFORM.read_text()}local: string s max 20000\n")
    (found,) = errors(fleet_files(tmp_path), app=app)
    assert found.startswith("outer.yaml:6: B004 shared writes of one round of all applications of ann take up to ")


def test_files_of_two_levels_with_one_name_and_different_content_are_refused(tmp_path: Path) -> None:
    outer = fleet_files(tmp_path)
    (tmp_path / "triangle.koord").write_text(f"extern fun near_to() -> float\n{TRIANGLE}")
    (tmp_path / "triangle_functions.py").write_text("def near_to(): return 0.1\n")
    (folder := tmp_path / "other").mkdir()
    (folder / "triangle.koord").write_text(f"extern fun near_to() -> float\n{LINEFORM.read_text()}")
    (folder / "triangle_functions.py").write_text("def near_to(): return 0.2\n")
    (found,) = errors(outer, app=folder / "triangle.koord")
    assert "the outer program and the fleet of alpha need different files triangle_functions.py" in found


def test_warnings_about_inner_programs_are_kept(tmp_path: Path) -> None:
    outer = fleet_files(tmp_path)
    hidden = "Never:\n  pre: True\n  eff: corner[pid] = goal\n"
    (tmp_path / "triangle.koord").write_text(f"{TRIANGLE}{hidden}")
    checked, _ = planned(outer)
    assert [(Path(source.path).name, d.code) for source, d in checked.elsewhere] == [("triangle.koord", "K042")]


def test_links_of_both_levels_carry_what_squads_add(tmp_path: Path) -> None:
    outer = fleet_files(tmp_path)
    text = outer.read_text()
    outer.write_text(f"{text}link: {{rate: 300000, loss: 0.0}}\n")
    planned(outer)
    outer.write_text(f"{text}link: {{rate: 30000, loss: 0.0}}\n")
    (found,) = errors(outer)
    assert found.startswith("lineform.koord:7: B008 ") and "7 addresses of 3 robots x 2 senders" in found
    outer.write_text(text)
    alpha = (tmp_path / "alpha.yaml").read_text()
    (tmp_path / "alpha.yaml").write_text(f"{alpha}link: {{rate: 6000000, loss: 0.0}}\n")
    checked, _ = planned(outer)
    assert not checked.elsewhere, "a record may need several datagrams, but seldom does"
    (tmp_path / "alpha.yaml").write_text(f"{alpha}link: {{rate: 600000, loss: 0.0}}\n")
    (found,) = errors(outer)
    assert found.startswith("outer.yaml:6: B008 all applications together may send "), "the record counts"
