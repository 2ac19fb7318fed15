"""The user's own Python files in bundles, from the files of a build to a process."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from koordgen.build.bundle.write import write
from koordgen.build.pipeline import Rejected, plan_file
from koordgen.fleet import manifest
from koordgen.fleet.file import Fleet, read
from koordgen.fleet.settings import DriverClass
from koordgen.lang.source import Source, Span
from tests.build.emit.generated import checked

ROOT = Path(__file__).parents[3]
EXAMPLES = ROOT / "examples"


def planned(name: str, functions: str | None = None) -> dict[str, dict[str, bytes]]:
    folder = EXAMPLES / name
    return plan_file(str(folder / f"{name}.koord"), ["car"], str(folder / "fleet.yaml"), {}, functions)[1]


def test_functions_go_into_every_bundle() -> None:
    bundles = planned("mapping")
    text = (EXAMPLES / "mapping/mapping_functions.py").read_bytes()
    assert all(files["mapping_functions.py"] == text for name, files in bundles.items() if name != "fleet")


def test_another_file_goes_by_the_usual_name(tmp_path: Path) -> None:
    other = tmp_path / "other.py"
    other.write_bytes((EXAMPLES / "mapping/mapping_functions.py").read_bytes() + b"\n# another\n")
    assert planned("mapping", str(other))["alice"]["mapping_functions.py"].endswith(b"# another\n")


def test_robots_with_other_functions_refuse_one_another(tmp_path: Path) -> None:
    """The program's hash, which peers compare, covers what its extern functions do."""
    other = tmp_path / "other.py"
    other.write_bytes((EXAMPLES / "mapping/mapping_functions.py").read_bytes() + b"\n# another\n")

    def hashes(bundles: dict[str, dict[str, bytes]]) -> set[str]:
        text = bundles["alice"]["program.py"].decode()
        found = set(re.findall(r'program_hash="(\w{16})"', text))
        assert found == {json.loads(bundles["fleet"]["fleet.json"])["program_hash"]}
        return found

    assert hashes(planned("mapping")) == hashes(planned("mapping"))
    assert hashes(planned("mapping")) != hashes(planned("mapping", str(other)))


def test_a_build_without_the_functions_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Rejected) as rejected:
        planned("mapping", str(tmp_path / "none.py"))
    assert [d.code for _, d in rejected.value.found] == ["B006"]


def test_drivers_go_into_every_bundle_and_its_agent_finds_them(tmp_path: Path) -> None:
    bundles = planned("hvac")
    assert all("hvac_driver.py" in files for name, files in bundles.items() if name != "fleet")
    write({"alice": bundles["alice"]}, tmp_path)
    command = [sys.executable, str(tmp_path / "alice"), "--help"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_program_of_a_driver_that_fits_no_port_is_refused(tmp_path: Path) -> None:
    for file in (EXAMPLES / "hvac").iterdir():
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    driver = tmp_path / "hvac_driver.py"
    driver.write_text(driver.read_text().replace('"temp": "float"', '"temp": "bool"'))
    with pytest.raises(Rejected) as rejected:
        plan_file(str(tmp_path / "hvac.koord"), ["car"], str(tmp_path / "fleet.yaml"), {})
    ((_, found),) = rejected.value.found
    assert (found.code, found.message) == (
        "B005",
        "HVAC.temp has type bool in the driver Hvac, but float in the program",
    )


def test_streams_are_everyones() -> None:
    from koordgen.build.bundle.ports import check_ports

    program = checked('using Log:\n  stream stdout\nE:\n  pre: True\n  eff: Log.stdout << "a"\n')
    assert check_ports(program, [manifest.load("car")]) == []


FLEET = """delta: 0.1
origin: {latitude: 47.4, longitude: 8.5, altitude: 400.0}
geofence: {lo: [-5, -5, -1], hi: [5, 5, 4]}
robots: [{name: ann, target: car, address: "127.0.0.1:47900"}]
"""


def fleet(text: str) -> tuple[Fleet | None, list[str]]:
    found: list[str] = []

    def report(code: str, message: str, span: Span, help: str) -> None:
        found.append(f"{code} {span.line}: {message}")

    targets = {n: manifest.load(n) for n in manifest.available()}
    return read(Source("fleet.yaml", FLEET + text), targets, {}, report), found


def test_drivers_and_the_planners_budget_in_a_fleet_file() -> None:
    read_, found = fleet("modules: {HVAC: drivers.hvac:Hvac, Arm: arm:Arm}\nplanner_budget: 0.02\n")
    assert read_ is not None and not found
    assert read_.drivers == {"HVAC": DriverClass("drivers.hvac", "Hvac"), "Arm": DriverClass("arm", "Arm")}
    assert (read_.drivers["HVAC"].path, read_.planner_budget) == ("drivers/hvac.py", 0.02)
    usual, _ = fleet("")
    assert usual is not None and (usual.drivers, usual.planner_budget) == ({}, None)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("modules: [HVAC]\n", "F004 5: modules must be a mapping (key: value)"),
        ("modules: {HVAC: 3}\n", "F004 5: the driver of HVAC must be a text, not '3'"),
        ("modules: {HVAC: ../up:Up}\n", "F005 5: '../up:Up' does not name a driver class"),
        ("modules: {HVAC: hvac}\n", "F005 5: 'hvac' does not name a driver class"),
        ("modules: {HVAC: a:A, HVAC: a:B}\n", "F006 5: 'HVAC' appears twice in modules"),
        ("planner_budget: 3\n", "F005 5: planner_budget (seconds) is 3; it must be 0.0005 to 1"),
    ],
)
def test_what_is_wrong_in_a_fleet_file_is_told(text: str, message: str) -> None:
    assert fleet(text) == (None, [message])
