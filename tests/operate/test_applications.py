"""Fleets with several applications: deployed, examined and collected like other fleets."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.fixtures.deployed import place
from benchmarks.fixtures.ssh_hosts import SshFleet, ssh_fleet
from koordgen import __version__, cli
from koordgen.operate.collect import SOURCE_FILE
from koordgen.operate.doctor import NoBundle, robots_bundle
from koordgen.operate.run_folder import write_source
from targets.sim.trace.files import read
from tests.sim.run.test_applications import CARS, QUADS

VERSION = f'__version__ = "{__version__}"'
FLEET = """\
delta: 0.1
origin: {{latitude: 47.397742, longitude: 8.545594, altitude: 488.0}}
geofence: {{lo: [-8, -7, -0.5], hi: [8, 7, 4.0]}}
insecure: true
deploy: {{folder: koordgen/fleet, python: "{python}", service: none, wheels: host}}
robots:
  - {{name: alice, target: quad, address: "127.0.0.1:{port}", host: "{login}", start: {{position: [-1, 0, 0]}},
     sim: {{fidelity: simple}}}}
  - {{name: bert, target: quad, address: "127.0.0.1:{next}", host: "{login}", start: {{position: [2, 0, 0]}},
     sim: {{fidelity: simple}}}}
applications:
  - {{name: cars, program: cars.koord}}
  - {{name: quads, program: quads.koord, robots: [alice], import: {{Cars: cars}}}}
"""


class Composed:
    """A fleet file with two applications, its robots' only host, and a simulated run of it."""

    def __init__(self, folder: Path, ssh: SshFleet) -> None:
        self.ssh, self.folder, self.run = ssh, folder, folder / "run"
        (folder / "cars.koord").write_text(CARS)
        (folder / "quads.koord").write_text(QUADS)
        port = 20000 + 2 * (os.getpid() % 10000)
        login = ssh.hosts["field"].login
        text = FLEET.format(python=sys.executable, port=port, next=port + 1, login=login)
        (folder / "fleet.yaml").write_text(text)
        options = ["--lockstep", "--duration", "2", "--quiet", "--no-report", "--out", str(self.run)]
        assert cli.main(["sim", self.file, *options]) == 3

    @property
    def file(self) -> str:
        return str(self.folder / "fleet.yaml")

    @property
    def host(self) -> Path:
        """Folder of the deployment on the host."""
        return place(self.ssh.hosts["field"])

    def command(self, *words: str) -> int:
        """Run a command over SSH; return its exit status."""
        return cli.main([*words, *self.ssh.arguments])


def test_the_facts_of_a_merged_trace_are_those_of_the_release_that_wrote_it(tmp_path: Path) -> None:
    names: dict[str, Any] = {"shared": [], "records": {}}
    applications = [{"name": "cars", "members": [0], "variables": {}}]
    releases = [
        {
            "source/composition.json": json.dumps(
                {"program_hash": hash_, "applications": applications, **names}
            ).encode(),
            "source/cars/cars.koord": hash_.encode(),
        }
        for hash_ in ("new", "old")
    ]
    releases.insert(0, {"source/composition.json": b"[]"})
    expected = {**names, "applications": ["cars"], "composition": applications}
    assert write_source(tmp_path, releases, "old") == expected
    assert (tmp_path / "source/cars/cars.koord").read_text() == "old"
    assert write_source(tmp_path, [], "old") == expected and write_source(tmp_path, [], "other") is None


def test_a_robots_bundle_with_several_programs_is_found(tmp_path: Path) -> None:
    for path in ("fleet/alice", "fleet/sim/agents/alice", "fleet/sim"):
        (tmp_path / path / "koordgen/runtime").mkdir(parents=True)
        for name, text in (("__main__.py", ""), ("applications.py", ""), ("koordgen/__init__.py", VERSION)):
            (tmp_path / path / name).write_text(text)
    assert robots_bundle(str(tmp_path / "fleet/alice")) == tmp_path / "fleet/alice"
    with pytest.raises(NoBundle) as found:
        robots_bundle(str(tmp_path / "fleet"))
    assert "name one of alice" in found.value.help
    with pytest.raises(NoBundle) as found:
        robots_bundle(str(tmp_path / "fleet/sim"))
    assert "the robots that it runs: " in found.value.help and "agents/alice" in found.value.help


@pytest.mark.parametrize("name", ["source/../x.koord", "../x.koord", "source/cars/../x", ".x.koord", "a/b/c"])
def test_files_of_a_host_do_not_leave_the_folder(name: str) -> None:
    assert not SOURCE_FILE.fullmatch(name)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Composed]:
    """The fleet, deployed; its host has the traces of the run."""
    folder = tmp_path_factory.mktemp("composed")
    with ssh_fleet(folder / "ssh", ["field"]) as ssh:
        fleet = Composed(folder, ssh)
        assert fleet.command("deploy", fleet.file) == 0
        for robot in ("alice", "bert"):
            (fleet.host / "traces" / robot).mkdir(parents=True, exist_ok=True)
            shutil.copy(fleet.run / "robots" / robot / "trace.jsonl", fleet.host / "traces" / robot)
        yield fleet


@pytest.mark.slow
def test_a_deployed_robot_has_the_programs_of_all_applications(fleet: Composed) -> None:
    for robot in ("alice", "bert"):
        bundle = fleet.host / "current" / robot
        assert (bundle / "program_cars.py").is_file() and (bundle / "program_quads.py").is_file()


@pytest.mark.slow
def test_a_program_of_such_a_fleet_is_not_deployed_alone(fleet: Composed, capfd: pytest.CaptureFixture[str]) -> None:
    assert fleet.command("deploy", str(fleet.folder / "cars.koord")) == 2
    assert "give a fleet file with `applications` in place of the program" in capfd.readouterr().err


@pytest.mark.slow
def test_a_collected_flight_has_the_names_of_its_applications(
    fleet: Composed, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "flight"
    assert fleet.command("collect", fleet.file, "-o", str(out)) == 0, capfd.readouterr().err
    assert "warning" not in capfd.readouterr().err
    header, records = read(out / "trace.jsonl")
    simulated, _ = read(fleet.run / "trace.jsonl")
    assert header.applications == ("cars", "quads") and header.composition == simulated.composition
    assert header.shared == simulated.shared and header.program_hash == simulated.program_hash
    assert {getattr(r, "event", None) for r in records} >= {"cars.Go", "quads.Look"}
    assert (out / "source/quads/quads.koord").read_text() == QUADS
    poses = [(r["pid"], r["t"]) for r in lines(out) if r["kind"] == "pose"]
    assert poses and len(poses) == len(set(poses))
    assert cli.main(["show", str(out), "--at", "0.5"]) == 0 and "cars.done" in capfd.readouterr().out


def lines(run: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (run / "trace.jsonl").read_text().splitlines()]
