"""`koordgen doctor`: folders that are not bundles, and a built bundle against a simulated autopilot over UDP."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.fixtures.quad_rig import STEP, PointMass
from koordgen.cli import main
from targets.sim.autopilots.autopilot import SimulatedAutopilot
from targets.sim.base.bodies import DeviceContext
from tests.programs import build
from tests.runtime.net.transports import free_ports

ORIGIN = (47.4, 8.5, 400.0)  # of tests.programs


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    for path, data in build("quad")["quad-0"].items():
        (tmp_path / "quad-0" / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "quad-0" / path).write_bytes(data)
    key = tmp_path / "quad-0/fleet.key"
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    return tmp_path / "quad-0"


class Autopilot:
    """Simulated autopilot in real time, in its own thread."""

    def __init__(self) -> None:
        self._body = PointMass((1.0, -2.0, 0.0))
        harness = {"boot": 0.2, "position_noise": 0.0}
        self.device = SimulatedAutopilot(self._body, DeviceContext("quad-0", {}, harness, ORIGIN, 1, b""))
        self._over = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        stepped = time.monotonic()
        while not self._over:
            while stepped < time.monotonic():
                stepped += STEP
                self._body.step(STEP)
                self.device.step(stepped)
            time.sleep(0.005)

    def close(self) -> None:
        self._over = True
        self._thread.join()
        self.device.close()


@pytest.fixture
def autopilot() -> Iterator[Autopilot]:
    made = Autopilot()
    yield made
    made.close()


def overlay(bundle: Path, **body: Any) -> str:
    ports = free_ports(3)
    peers = [{"name": f"quad-{i}", "host": "127.0.0.1", "port": ports[i]} for i in range(2)]
    path = bundle.parent / "over.json"
    path.write_text(json.dumps({"peers": peers, "control": ports[2], "body": body}))
    return str(path)


def told(capfd: pytest.CaptureFixture[str]) -> dict[str, Any]:
    return {f["name"]: f for f in json.loads(capfd.readouterr().out)["checks"]}


def test_a_robot_that_is_ready(bundle: Path, autopilot: Autopilot, capfd: pytest.CaptureFixture[str]) -> None:
    over = overlay(bundle, **autopilot.device.overrides)
    began = time.monotonic()
    assert main(["doctor", str(bundle), "--settings", over, "--format", "json"]) == 0
    assert time.monotonic() - began < 15.0
    found = told(capfd)
    assert all(found[name]["state"] == "ok" for name in ("files", "key", "port", "link", "parameters", "place")), found
    assert "ArduPilot quadrotor 4.7.0" in found["firmware"]["found"]
    assert autopilot.device.copter.mode == 0 and not autopilot.device.copter.armed, "nothing was moved"


@pytest.mark.slow
def test_a_robot_without_an_autopilot(bundle: Path, capfd: pytest.CaptureFixture[str]) -> None:
    over = overlay(bundle, autopilot=f"udpin:127.0.0.1:{free_ports(1)[0]}")
    (bundle / "program.py").write_text((bundle / "program.py").read_text() + "# changed\n")
    assert main(["doctor", str(bundle), "--settings", over, "--format", "json"]) == 1
    found = told(capfd)
    assert found["files"]["found"] == "program.py is changed" and "no autopilot answers" in found["link"]["found"]


def refused(capsys: pytest.CaptureFixture[str], path: Path) -> str:
    assert main(["doctor", str(path)]) == 1
    said = capsys.readouterr()
    assert said.out == "" and "help: " in said.err
    return said.err


def test_folders_that_are_no_robots(tmp_path: Path, bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "no such folder" in refused(capsys, tmp_path / "nobody")
    (tmp_path / "empty").mkdir()
    assert "not a bundle" in refused(capsys, tmp_path / "empty")
    assert "not a bundle\n  help: name one of quad-0 in it" in refused(capsys, tmp_path)
    assert "no such folder" in refused(capsys, bundle / "program.py")


def test_a_bundle_that_runs_a_fleet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for path in ("__main__.py", "koordgen/runtime/x.py", "agents/alice/program.py"):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text("")
    said = refused(capsys, tmp_path)
    assert "runs a whole fleet" in said and str(tmp_path / "agents/alice") in said


@pytest.mark.parametrize(("text", "version"), [('__version__ = "0.0.7"\n', "0.0.7"), ("", "of unknown version")])
def test_a_bundle_of_another_version(bundle: Path, capsys: pytest.CaptureFixture[str], text: str, version: str) -> None:
    (bundle / "koordgen/__init__.py").write_text(text)
    assert f"made by koordgen {version}, and this is koordgen" in refused(capsys, bundle)
