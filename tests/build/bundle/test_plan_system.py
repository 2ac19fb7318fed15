"""Bundles of several applications: the files of each robot, and agents that run from them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from koordgen.build.bundle.plan import Files, plan, read_ingredients
from koordgen.build.bundle.plan_system import (
    ApplicationFiles,
    NamesClash,
    SystemIngredients,
    plan_system,
    read_system_ingredients,
)
from koordgen.build.bundle.write import write
from koordgen.fleet import file as fleet
from koordgen.fleet import manifest
from koordgen.lang import resources
from koordgen.lang.semantics.composition import Application, System
from koordgen.lang.source import Source
from tests.golden.test_golden import PROGRAMS
from tests.lang.semantics.compositions import compiled
from tests.lang.semantics.test_system import MAPPING, TASK

PROGRAM, FLEET = PROGRAMS["lineform"]
SAFE = "invariant Few: forall i in ID: place[i] < 20\n"
ROBOTS = ("alice", "bert", "cleo", "dora", "emil")


def ingredients(system: System, sources: list[bytes], beside: list[Files] | None = None) -> SystemIngredients:
    targets = {n: manifest.load(n) for n in manifest.available()}
    source = Source("fleet.yaml", FLEET.read_text())
    read = fleet.read(source, targets, {}, lambda *told: pytest.fail(str(told)))
    used = tuple(targets.values())
    own = beside or [{} for _ in sources]
    parts = tuple([ApplicationFiles(text, files, {}) for text, files in zip(sources, own, strict=True)])
    assert read is not None
    return read_system_ingredients(system, parts, used, read, resources.package(), {"mapping": 0.75})


def pair() -> SystemIngredients:
    """Mapping on robots 0 and 1, Task on 1 to 4."""
    mapping, task = compiled("mapping", MAPPING + SAFE), compiled("task", TASK)
    applications = (
        Application("mapping", mapping, (0, 1)),
        Application("task", task, (1, 2, 3, 4), (("Mapping", "mapping"),)),
    )
    return ingredients(System(applications, 5), [(MAPPING + SAFE).encode(), TASK.encode()])


def test_every_robot_has_all_programs_and_one_release() -> None:
    bundles = plan_system(pair(), {"quad", "car"})
    assert set(bundles) == {*ROBOTS, "fleet"}
    assert len({files["RELEASE"] for files in bundles.values()}) == 1
    for robot in ROBOTS:
        files = bundles[robot]
        assert {"program_mapping.py", "program_task.py", "applications.py", "properties_mapping.py"} <= set(files)
        assert not {"program.py", "properties.py", "properties_task.py"} & set(files)
        assert files["source/task/task.koord"] == TASK.encode()
        assert json.loads(files["settings.json"])["app"] == "mapping+task"
    assert b"PARAM_MAPPING_N_SYS: int = 2" in bundles["alice"]["program_task.py"]
    facts = json.loads(bundles["fleet"]["fleet.json"])
    assert facts["applications"][0] == {"name": "mapping", "members": ["alice", "bert"]}
    assert set(plan_system(pair(), {"car"})) < set(bundles)


def test_the_hash_covers_programs_members_and_names() -> None:
    def hashes(these: SystemIngredients) -> tuple[str, str]:
        facts = json.loads(plan_system(these, ())["fleet"]["fleet.json"])
        return facts["program_hash"], facts["interface_hash"]

    these = pair()
    first, task = these.system.applications
    seen = {hashes(these)}
    renamed = Application("task", task.program, task.members, (("Mapping", "map"),))
    for applications in (
        (Application("mapping", first.program, (0, 1, 2)), task),
        (first, Application("task", task.program, (1, 2), task.bindings)),
        (Application("map", first.program, (0, 1)), renamed),
    ):
        seen.add(hashes(ingredients(System(applications, 5), [b"", b""])))
    other = compiled("task", TASK.replace("sum += p", "sum += p + 1"))
    changed_system = System((first, Application("task", other, task.members, task.bindings)), 5)
    changed = hashes(ingredients(changed_system, [b"", b""]))
    assert changed[0] != hashes(these)[0] and changed[1] == hashes(these)[1]
    assert len(seen) == 4


def test_one_application_on_all_robots_has_the_files_of_its_program() -> None:
    mapping = compiled("mapping", MAPPING)
    these = ingredients(System((Application("mapping", mapping, tuple(range(5))),), 5), [MAPPING.encode()])
    alone = read_ingredients(mapping, MAPPING.encode(), these.targets, these.fleet, resources.package())
    assert plan_system(these, {"quad", "car"}) == plan(alone, {"quad", "car"})


def test_files_of_two_applications_with_one_name_and_different_content_are_refused() -> None:
    these = pair()
    clash: list[Files] = [{"helper.py": b"a = 1\n"}, {"helper.py": b"a = 2\n"}]
    with pytest.raises(NamesClash, match="mapping and task need different files helper"):
        plan_system(ingredients(these.system, [b"", b""], clash), {"quad"})
    same: list[Files] = [{"helper.py": b"a = 1\n"}, {"helper.py": b"a = 1\n"}]
    assert plan_system(ingredients(these.system, [b"", b""], same), {"quad"})["alice"]["helper.py"] == b"a = 1\n"


def test_an_agent_loads_its_applications_from_its_bundle(tmp_path: Path) -> None:
    write({"bert": plan_system(pair(), {"quad", "car"})["bert"]}, tmp_path)
    done = subprocess.run(
        [sys.executable, str(tmp_path / "bert"), "--doctor", "--format", "json"],
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    report = json.loads(done.stdout)
    found = {each["name"]: each for each in report["checks"]}
    assert report["app"] == "mapping+task" and found["program"]["state"] == "ok", done.stdout + done.stderr
    assert found["files"]["state"] == "ok"
