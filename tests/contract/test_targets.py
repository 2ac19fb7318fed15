"""Contract of all targets: each folder with a manifest is tested."""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from koordgen.fleet import manifest
from koordgen.lang.ir.types import GENERIC, NAMED
from koordgen.runtime.config.settings import Settings
from koordgen.runtime.ops.checks import OWN
from koordgen.runtime.vehicle.platform import Platform
from tests.programs import ROOT, build, settings_of

TARGETS = [manifest.load(name) for name in manifest.available()]
AGENTS = [t for t in TARGETS if t.kind == "agent"]
DISTRIBUTION = {"serial": "pyserial", "fcl": "python-fcl", "PIL": "pillow", "mujoco": "mujoco-core"}
by_name = pytest.mark.parametrize("target", TARGETS, ids=lambda t: t.name)
agents_by_name = pytest.mark.parametrize("target", AGENTS, ids=lambda t: t.name)


@by_name
def test_the_entry_is_there(target: manifest.Target) -> None:
    module, _, name = target.entry.partition(":")
    assert callable(getattr(importlib.import_module(module), name))


@by_name
def test_requirements_are_pinned_and_cover_what_is_imported(target: manifest.Target) -> None:
    pins = {re.split(r"[^A-Za-z0-9._-]", line)[0] for line in target.requirements}
    assert all("==" in line for line in target.requirements)
    imported = {"msgspec"}
    for path in target.folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported.update(alias.name.split(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                imported.add(node.module.split(".")[0])
    asked_for = {"foxglove"}  # `--foxglove` loads it, and names the extra that installs it
    foreign = imported - set(sys.stdlib_module_names) - {"koordgen", "targets"} - asked_for
    assert {DISTRIBUTION.get(name, name) for name in foreign} <= pins


@by_name
def test_the_locked_versions_are_those_of_the_bundles(target: manifest.Target) -> None:
    """Tests run with the package versions that a robot installs."""
    lock = (Path(__file__).parents[2] / "requirements.lock").read_text()
    locked = {line.partition("==")[0]: line for line in lock.splitlines()}
    for line in target.requirements:
        if "< '3.11'" not in line:  # which koordgen itself does not run with
            assert locked[line.partition("==")[0]] == line.removesuffix("; python_version >= '3.11'"), "markers, too"


@agents_by_name
def test_it_offers_motion_with_types_of_the_language(target: manifest.Target) -> None:
    assert target.sensors["Motion.position"] == "Point"
    assert target.actuators["Motion.target"] == "Point"
    assert {"Motion.reached"} <= set(target.sensors)
    offered = (*target.sensors.values(), *target.actuators.values(), *target.callables.values())
    assert all(set(re.findall(r"\w+", t)) <= {*NAMED, *GENERIC} for t in offered)


@agents_by_name
def test_motion_with_scan_is_motion_and_scans(target: manifest.Target) -> None:
    for ports in (target.sensors, target.actuators, target.callables):
        plain, seeing = (
            {name.partition(".")[2]: t for name, t in ports.items() if name.startswith(f"{module}.")}
            for module in ("Motion", "MotionWithScan")
        )
        assert seeing.pop("pscan", None) == ("List<(Point, Scan)>" if ports is target.sensors else None)
        assert plain == seeing


@agents_by_name
def test_a_platform_is_made_from_default_settings_and_senses_what_the_manifest_offers(target: manifest.Target) -> None:
    settings: Settings = settings_of(target)
    module, _, name = target.entry.partition(":")
    platform: Platform = getattr(importlib.import_module(module), name)(settings, bytes(32))
    try:
        assert 0 < platform.period <= 0.1
        assert not platform.ready
        assert isinstance(platform.progress, str)
        assert set(platform.sense(0.0).values) == set(target.sensors)
        assert platform.sense(0.0).time is None, "no position before the body has told one"
    finally:
        platform.close()
        platform.close()


@agents_by_name
def test_simulation_names_a_body_and_a_device_of_the_harness(target: manifest.Target) -> None:
    from targets.sim.run import scene

    assert target.simulation["body"] in scene.BODIES
    assert target.simulation["device"] in scene.DEVICES


@agents_by_name
def test_every_setting_reaches_the_body(target: manifest.Target, tmp_path: Path) -> None:
    """The robot, not the build, would refuse a setting of the manifest that the platform does not know."""
    files = build(target.name)
    body = json.loads(files[f"{target.name}-0"]["settings.json"])["body"]
    assert set(body) == set(target.settings)


@agents_by_name
def test_diagnosis_names_what_is_missing_and_closes_what_it_opened(target: manifest.Target) -> None:
    """Without any device and with silent ports the diagnosis ends in time and without an exception, twice."""
    module, _, name = target.entry.partition(":")
    platform: Platform = getattr(importlib.import_module(module), name)(settings_of(target), bytes(32))
    opened = os.listdir("/proc/self/fd")
    began = time.monotonic()
    found = platform.diagnose()
    assert time.monotonic() - began <= 15.0
    assert os.listdir("/proc/self/fd") == opened
    failed = [f for f in found if f.state == "fail"]
    assert failed and all(f.found and f.why for f in failed), found
    assert len({f.name for f in found}) == len(found) and not {f.name for f in found} & set(OWN)
    assert not platform.ready
    platform.close()
    assert os.listdir("/proc/self/fd") == opened


@agents_by_name
def test_check_of_a_built_bundle_says_what_is_missing(target: manifest.Target, tmp_path: Path) -> None:
    files = build(target.name)[f"{target.name}-0"]
    for path, data in files.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(data)
    done = subprocess.run([sys.executable, str(tmp_path), "--check"], capture_output=True, text=True)
    assert done.returncode == 1
    assert "koordgen key new" in done.stderr
    done = subprocess.run([sys.executable, "-S", str(tmp_path), "--doctor"], capture_output=True, text=True)
    assert done.returncode == 5 and "FAIL  packages   not installed: msgspec" in done.stdout, "without any package"
    old = f"import runpy, sys; sys.version_info = (3, 9, 18); runpy.run_path({str(tmp_path)!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", old], capture_output=True, text=True)
    assert done.returncode == 5 and "help: install Python 3.10 or later" in done.stderr
    (tmp_path / f"targets/{target.name}/platform/platform.py").unlink()
    done = subprocess.run([sys.executable, str(tmp_path), "--doctor", "--format=json"], capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    found = {f["name"]: f for f in json.loads(done.stdout)["checks"]}
    assert found["files"]["found"] == f"targets/{target.name}/platform/platform.py is missing"
    assert f"No module named 'targets.{target.name}.platform.platform'" in found["import"]["found"]


@agents_by_name
def test_the_bundle_compiles_for_python_3_10(target: manifest.Target) -> None:
    for path, data in build(target.name)[f"{target.name}-0"].items():
        if path.endswith(".py"):
            ast.parse(data, path, feature_version=(3, 10))


def test_robots_limit_is_the_wires() -> None:
    from koordgen.cli.base import values
    from koordgen.fleet.applications import MOST_INSTANCES
    from koordgen.lang.ir import types
    from koordgen.runtime.net.wire import MAX_INSTANCES, MAX_ROBOTS
    from koordgen.verify.follow import read

    assert types.MOST_ROBOTS == values.MOST_ROBOTS == read.MOST_ROBOTS == MAX_ROBOTS
    assert MOST_INSTANCES == MAX_INSTANCES


@agents_by_name
def test_a_program_without_properties_has_no_file_for_them(target: manifest.Target) -> None:
    files = build(target.name)[f"{target.name}-0"]
    assert "properties.py" not in files
    assert b"properties" not in files["__main__.py"].lower() and b"drivers))" in files["__main__.py"]


@agents_by_name
def test_its_robots_take_their_properties_along_and_can_do_what_the_manifest_says(target: manifest.Target) -> None:
    files = build(target.name, ROOT / "templates/new/program.koord")[f"{target.name}-0"]
    assert b"PROPERTIES = Properties(" in files["properties.py"]
    assert b"from properties import PROPERTIES" in files["__main__.py"]
    assert b"drivers, PROPERTIES))" in files["__main__.py"]
    assert {"hold", "stop"} <= set(target.actions) <= {"hold", "stop", "land"}
