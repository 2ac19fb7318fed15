"""`koordgen estop` and `--status` on real agents: fast, even through a bad network; messages without an answer."""

from __future__ import annotations

import json
import os
import random
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.fixtures.fleet import NAMES, settings
from koordgen.cli import main
from koordgen.operate import estop
from tests.runtime.agent.test_process import bundles, change, rounds, run, start, started

__all__ = ["bundles", "started"]  # fixtures
ROOT = Path(__file__).parents[2]


class Network:
    """Network between caller and agents: a port for each agent; datagrams are lost in both directions."""

    def __init__(self, controls: list[int], loss: float, seed: int) -> None:
        self._loss, self._random = loss, random.Random(seed)
        self._fronts = [self._socket() for _ in controls]
        self._backs = [self._socket() for _ in controls]
        self.ports = [int(front.getsockname()[1]) for front in self._fronts]
        for back, control in zip(self._backs, controls, strict=True):
            back.connect(("127.0.0.1", control))
        self._callers: dict[int, Any] = {}
        self._over = False
        self._thread = threading.Thread(target=self._carry)
        self._thread.start()

    def close(self) -> None:
        self._over = True
        self._thread.join()
        for each in (*self._fronts, *self._backs):
            each.close()

    @staticmethod
    def _socket() -> socket.socket:
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        made.bind(("127.0.0.1", 0))
        return made

    def _carry(self) -> None:
        while not self._over:
            for each in select.select([*self._fronts, *self._backs], [], [], 0.05)[0]:
                try:
                    datagram, sender = each.recvfrom(2000)
                    if self._random.random() < self._loss:
                        continue
                    if each in self._fronts:
                        self._callers[self._fronts.index(each)] = sender
                        self._backs[self._fronts.index(each)].send(datagram)
                    else:
                        index = self._backs.index(each)
                        self._fronts[index].sendto(datagram, self._callers[index])
                except ConnectionRefusedError:
                    continue


@pytest.fixture
def fleet(bundles: list[Path]) -> Path:
    """Return a fleet file of the three bundles, with their key beside it."""
    controls = controls_of(bundles)
    key = bundles[0].parent / "fleet.key"
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    return written(bundles[0].parent / "fleet.yaml", controls)


def controls_of(bundles: list[Path]) -> list[int]:
    return [json.loads((folder / "settings.json").read_text())["control"] for folder in bundles]


def written(path: Path, controls: list[int]) -> Path:
    robots = "".join(
        f"  - {{name: {name}, target: quad, address: '127.0.0.1:{47100 + i}', control: {control}}}\n"
        for i, (name, control) in enumerate(zip(NAMES, controls, strict=False))
    )
    path.write_text(f"delta: 0.05\nrobots:\n{robots}")
    return path


def phases(folder: Path) -> list[tuple[str, str, float]]:
    path = folder / "trace.jsonl"
    whole = path.read_text().rpartition("\n")[0].splitlines() if path.exists() else []
    return [(t["phase"], t["detail"], t["time"]) for t in map(json.loads, whole) if t["kind"] == "phase"]


def wait_for(folders: list[Path], phase: str) -> None:
    limit = time.monotonic() + 20
    while time.monotonic() < limit:
        if all(phase in [p for p, _, _ in phases(f)] for f in folders):
            return
        time.sleep(0.05)
    raise AssertionError(f"not all reached {phase}: {[phases(f) for f in folders]}")


@pytest.mark.parametrize(("loss", "seed"), [(0.0, 1), (0.3, 2), pytest.param(0.3, 3, marks=pytest.mark.slow)])
def test_all_robots_come_to_rest_soon(
    bundles: list[Path],
    fleet: Path,
    started: list[subprocess.Popen[str]],
    capsys: pytest.CaptureFixture[str],
    loss: float,
    seed: int,
) -> None:
    processes = [start(folder, started) for folder in bundles]
    wait_for(bundles, "joining")
    network = Network(controls_of(bundles), loss, seed)
    written(fleet, network.ports)
    try:
        began = time.monotonic()  # the agents' clock too
        assert main(["estop", str(fleet), "--format", "json"]) == 0
    finally:
        network.close()
    robots = json.loads(capsys.readouterr().out)["robots"]
    assert [(r["robot"], r["answered"], r["note"]) for r in robots] == [(name, True, "") for name in NAMES[:3]]
    for process, folder in zip(processes, bundles, strict=True):
        _, errors = process.communicate(timeout=5)
        assert process.returncode == 0, errors
        ((_, why, when),) = [p for p in phases(folder) if p[0] == "stopping"]
        assert why == "emergency stop"
        assert when - began < 0.2 + 0.2, "0.2 s, and as much for a busy machine"


def test_what_people_read(
    bundles: list[Path], fleet: Path, started: list[subprocess.Popen[str]], capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Two robots answer, one does not."""
    monkeypatch.setattr(estop, "ANSWER_TIMEOUT", 0.6)
    for folder in bundles[:2]:
        start(folder, started)
    wait_for(bundles[:2], "joining")
    assert main(["estop", str(fleet)]) == 5
    told = capsys.readouterr()
    lines = told.out.splitlines()
    assert lines[0].startswith("alice  is stopping: it lands or brakes, answered after ")
    assert lines[2].startswith("cleo   NO ANSWER: no agent runs at this address (127.0.0.1:")
    assert told.err == (
        "error: 1 of 3 robots did not answer\n"
        "  help: stop these robots by hand now: by remote control, by kill switch, or by cutting their power\n"
    )


def test_another_key_stops_nobody(
    bundles: list[Path], fleet: Path, started: list[subprocess.Popen[str]], capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(estop, "ANSWER_TIMEOUT", 0.3)
    start(bundles[0], started)
    wait_for(bundles[:1], "joining")
    other = fleet.parent / "other.key"
    other.write_bytes(bytes(32))
    other.chmod(0o600)
    assert main(["estop", str(fleet), "--key", str(other)]) == 5
    assert "3 of 3 robots did not answer" in capsys.readouterr().err
    assert "stopping" not in [p for p, _, _ in phases(bundles[0])]
    assert run(bundles[0], "--status", "--format", "json") == 0
    assert json.loads(capsys.readouterr().out)["rejected"]["order: not authentic"] > 5


def test_a_key_that_others_may_read_stops_all_the_same(
    bundles: list[Path], fleet: Path, started: list[subprocess.Popen[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    (fleet.parent / "fleet.key").chmod(0o644)
    for folder in bundles:
        start(folder, started)
    wait_for(bundles, "joining")
    assert main(["estop", str(fleet)]) == 0
    assert "warning: " in (told := capsys.readouterr().err) and "other users may read it" in told


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "No such file"),
        ("robots: [", "not YAML"),
        ("delta: 0.1\n", "the fleet file lists no robots"),
        ("- 1\n", "the fleet file lists no robots"),
        ("robots: [{name: a, address: 'localhost:1'}]\n", "fleet.key: No such file"),
        ("robots: [{name: a, address: 'localhost:1'}]]\n", "fleet.key: No such file"),
        ("robots: [{name: a, address: 'localhost:1'}]\nkey: mine.key\n", "mine.key: No such file"),
    ],
)
def test_when_nobody_can_be_called(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, text: str | None, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "fleet.yaml"
    if text is not None:
        path.write_text(text)
    assert main(["estop", str(path)]) == 1
    told = capsys.readouterr().err
    assert words in told and "no robot was called; stop these robots by hand" in told


def test_mistakes_elsewhere_in_the_fleet_file_stop_no_stop(tmp_path: Path) -> None:
    text = (
        "dleta: x\ninsecure: true\napplication_id: 9\nrobots:\n"
        "  - {name: alice, adress: 1}\n  - 7\n  - {address: 'a:64999'}\n  - {address: 'b:65000', control: no}\n"
        "  - {name: emil, address: '[::1]:100', control: 5}\n"
    )
    fleet = estop.read_fleet(text)
    assert [(p.name, p.host, p.port) for p in fleet.places] == [
        ("alice", "", 0),
        ("robot 1", "", 0),
        ("robot 2", "a", 63999),
        ("robot 3", "b", 64000),
        ("emil", "::1", 5),
    ]
    assert (fleet.application, fleet.key) == (9, "")
    results = estop.stop_all([estop.Contact(place, place.name, 9, None) for place in fleet.places[:2]], 0.1)
    assert [r.note for r in results] == ["the fleet file has no address for the robot"] * 2


ONE_LINE = """robots: [{name: al, target: quad, address: '10.0.0.1:47100'}, {address: 10.0.0.2:47101, name: bo}]
key: mine.key
"""
BLOCKS = """application_id: 7
key: "mine.key"
robots:
  - name: al
    target: quad
    address: 10.0.0.1:47100   # the old one was 10.0.0.9:47100
    start: {position: [0, 0, 0], yaw: 0}
  # - {name: cy, address: 10.0.0.3:47102}
  - control: 5000
    address: "10.0.0.2:47101"
    name: bo
"""


@pytest.mark.parametrize(
    "harm", ["%s\n\t- x: ]", "[%s", "%s\nrobots: {", "a: &a [*a, *b]\n%s", "%s\n\x00", "robots:\n%s"]
)
@pytest.mark.parametrize(("text", "control", "application"), [(ONE_LINE, 48101, 0), (BLOCKS, 5000, 7)])
def test_whom_a_broken_fleet_file_names(harm: str, text: str, control: int, application: int) -> None:
    fleet = estop.scan_fleet(harm % text)
    assert [(p.name, p.host, p.port) for p in fleet.places] == [("al", "10.0.0.1", 48100), ("bo", "10.0.0.2", control)]
    assert (fleet.application, fleet.key) == (application, "mine.key")


@pytest.mark.parametrize(
    "source",
    [
        "a broken file",
        pytest.param("no file", marks=pytest.mark.slow),
        pytest.param("the build's folder", marks=pytest.mark.slow),
        "addresses",
    ],
)
def test_whatever_the_state_of_the_fleet_file(
    bundles: list[Path], fleet: Path, started: list[subprocess.Popen[str]], capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch, source: str,
) -> None:  # fmt: skip
    """All robots are stopped, and errors in the file are reported."""
    for folder in bundles:
        start(folder, started)
    wait_for(bundles, "joining")
    monkeypatch.chdir(fleet.parent)
    built = fleet.parent / "build" / "app"
    built.parent.mkdir()
    arguments, said = ["estop", str(fleet)], ""
    match source:
        case "a broken file":
            fleet.write_text(fleet.read_text() + "world: [\n")
            said = "not YAML"
        case "no file":
            fleet.unlink()
            said = "No such file"
        case "the build's folder":
            arguments = ["estop", str(built), "--key", "fleet.key"]
        case "addresses":
            places = [f"127.0.0.1:{control - 1000}" for control in controls_of(bundles)]
            arguments = ["estop", *[word for place in places for word in ("--address", place)]]
    if source in ("no file", "the build's folder"):
        built.symlink_to(bundles[0].parent, target_is_directory=True)
    assert main([*arguments, "--format", "json"]) == 0
    told = capsys.readouterr()
    assert len(json.loads(told.out)["robots"]) == 3
    assert said in told.err and bool(said) == ("warning: " in told.err)
    for process in started:
        assert process.wait(timeout=20) == 0


def test_a_host_that_nobody_knows_keeps_nobody_waiting(
    monkeypatch: pytest.MonkeyPatch, bundles: list[Path], fleet: Path, started: list[subprocess.Popen[str]]
) -> None:
    real = socket.getaddrinfo

    def slow(host: str, *arguments: Any, **more: Any) -> Any:
        if host == "slow.local":
            time.sleep(1.5)
        return real(host, *arguments, **more)

    monkeypatch.setattr(socket, "getaddrinfo", slow)
    start(bundles[0], started)
    wait_for(bundles[:1], "joining")
    there = estop.read_fleet(fleet.read_text()).places[0]
    began = time.monotonic()
    places = [estop.Place("slow", "slow.local", 9), there]
    results = estop.stop_all([estop.Contact(place, place.name, 0, bytes(range(32))) for place in places], 0.5)
    assert time.monotonic() - began < 1.0
    assert [(r.phase, r.note) for r in results] == [("", "no answer"), ("stopping", "")]


def test_it_needs_no_package_beside_yaml_and_waits_for_no_compiler(fleet: Path, tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules.update(dict.fromkeys(['msgspec', 'numpy', 'jinja2']))\n"
        "from koordgen.operate import estop; estop.ANSWER_TIMEOUT = 0.05\n"
        "from koordgen.cli import main; sys.exit(main(['estop', sys.argv[1]]))"
    )
    cache = tmp_path / "cache"
    env = {**os.environ, "XDG_CACHE_HOME": str(cache)}
    done = subprocess.run([sys.executable, "-c", code, str(fleet)], capture_output=True, text=True, cwd=ROOT, env=env)
    assert done.returncode == 5 and "3 of 3 robots did not answer" in done.stderr, done.stderr
    assert not cache.exists(), "nothing was compiled"


# --- status


def test_status_of_a_running_agent(
    bundles: list[Path], fleet: Path, started: list[subprocess.Popen[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(bundles[1], "--status") == 5
    told = capsys.readouterr().err
    assert (
        "error: robot bert does not answer at 127.0.0.1:" in told
        and "check that the robot's agent runs on this computer" in told
    )
    for folder in bundles:
        start(folder, started)
    limit = time.monotonic() + 20
    while len(rounds(bundles[1])) < 10 and time.monotonic() < limit:
        time.sleep(0.05)
    assert run(bundles[1], "--status", "--format", "json") == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["robot"], report["pid"], report["phase"], report["names"]) == ("bert", 1, "running", [*NAMES[:3]])
    assert report["rounds"] > 3 and report["round"] > 3 and report["late_ms"]["p50"] > 0
    assert run(bundles[1], "--status") == 0
    assert "bert  pid 1 of 3, lineform: running, round" in capsys.readouterr().out


def test_the_state_lies_beside_the_bundle(
    bundles: list[Path], fleet: Path, started: list[subprocess.Popen[str]]
) -> None:
    process = start(bundles[0], started)
    wait_for(bundles[:1], "joining")
    state = bundles[0].parent / "state" / "alice.state"
    assert state.stat().st_mode & 0o777 == 0o600
    assert "alice.state" not in [p.name for p in bundles[0].rglob("*")]
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=5) == 0


def test_no_state_is_warned_of(bundles: list[Path], fleet: Path, started: list[subprocess.Popen[str]]) -> None:
    change(bundles[0], state=None)
    process = start(bundles[0], started, "--quiet")
    wait_for(bundles[:1], "joining")
    process.send_signal(signal.SIGTERM)
    assert "warning: state: nothing is persisted" in process.communicate(timeout=5)[1]


def test_a_full_disk_is_status_5_before_anything_moves(
    bundles: list[Path],
    fleet: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(*_: int) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "posix_fallocate", full)
    assert run(bundles[0]) == 5
    told = capsys.readouterr().err
    assert f"error: state: {tmp_path}/state/alice.state: No space left on device" in told
    assert phases(bundles[0]) == []


def test_settings_of_an_agent_have_defaults() -> None:
    assert settings(0, 1).control_port == 48100 and settings(0, 1).state == "state"


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr("koordgen.runtime.ops.status.TIMEOUT", 1.0)
    yield
