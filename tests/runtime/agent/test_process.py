"""Real processes over real UDP on loopback: rounds, signals, exit statuses, and what `main` says when it cannot."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest

from benchmarks.fixtures.fleet import NAMES, FakePlatform, settings
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.agent import process as agent
from koordgen.runtime.config.settings import Peer
from koordgen.runtime.net import socket_batch
from koordgen.runtime.net.transport import CannotOpen
from koordgen.runtime.vehicle.platform import Finding
from tests.runtime.agent.robot_main import body
from tests.runtime.net.transports import BROADCAST, MULTICAST, free_ports, needs_zenoh

MAIN = str(Path(__file__).with_name("robot_main.py"))


@pytest.fixture
def bundles(tmp_path: Path) -> list[Path]:
    """Three robots' folders with settings and the fleet's key."""
    n = 3
    ports = free_ports(2 * n)
    peers = [Peer(NAMES[i], "127.0.0.1", port) for i, port in enumerate(ports[:n])]
    folders = []
    for pid in range(n):
        folder = tmp_path / NAMES[pid]
        folder.mkdir()
        plain = msgspec.to_builtins(settings(pid, n, delta=0.05, key_file="fleet.key"))
        plain |= {"peers": msgspec.to_builtins(peers), "trace": str(folder / "trace.jsonl"), "control": ports[n + pid]}
        (folder / "settings.json").write_text(json.dumps(plain))
        (folder / "fleet.key").write_bytes(bytes(range(32)))
        (folder / "fleet.key").chmod(0o600)
        folders.append(folder)
    return folders


def change(folder: Path, **changes: Any) -> None:
    path = folder / "settings.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.fixture
def started() -> Iterator[list[subprocess.Popen[str]]]:
    running: list[subprocess.Popen[str]] = []
    yield running
    for process in running:
        if process.poll() is None:
            process.kill()
        process.communicate()


def start(folder: Path, running: list[subprocess.Popen[str]], *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, MAIN, str(folder), *arguments]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    running.append(process)
    return process


def rounds(folder: Path) -> list[dict[str, Any]]:
    path = folder / "trace.jsonl"
    whole = path.read_text().rpartition("\n")[0].splitlines() if path.exists() else []
    return [t for t in map(json.loads, whole) if t["kind"] == "round"]


def test_three_robots_run_and_end_safely(bundles: list[Path], started: list[subprocess.Popen[str]]) -> None:
    processes = [start(folder, started) for folder in bundles]
    limit = time.monotonic() + 20
    while time.monotonic() < limit and not all(len(rounds(f)) >= 20 for f in bundles):
        time.sleep(0.1)
    for process, number in zip(processes, (signal.SIGTERM, signal.SIGINT, signal.SIGTERM), strict=True):
        process.send_signal(number)
    for process in processes:
        _, errors = process.communicate(timeout=10)
        assert process.returncode == 0, errors
        assert "bert" not in errors or "running: mission" in errors
    for folder in bundles:
        lines = map(json.loads, (folder / "trace.jsonl").read_text().splitlines())
        phases = [t["phase"] for t in lines if t["kind"] == "phase"]
        assert [p for i, p in enumerate(phases) if p not in phases[:i]] == [
            *("starting", "joining", "running", "stopping", "stopped")
        ]
        assert len(rounds(folder)) >= 20
    ran = [r for r in rounds(bundles[1])[:20] if r["event"] == "TargetUpdate"]
    assert len(ran) >= 15
    # The same round begins at the same moment everywhere: one host, one monotonic clock.
    first = {r["round"]: r["time"] - r["late"] for r in rounds(bundles[0])}
    for r in rounds(bundles[2])[:20]:
        if r["round"] in first:
            assert abs(r["time"] - r["late"] - first[r["round"]]) < 0.01


@pytest.mark.parametrize(
    "kind", ["multicast", pytest.param("broadcast", marks=pytest.mark.slow), pytest.param("zenoh", marks=needs_zenoh)]
)
def test_three_robots_over_other_networks(
    bundles: list[Path], started: list[subprocess.Popen[str]], kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    network: dict[str, Any] = {"transport": kind}
    if kind != "zenoh":
        network |= {"group": MULTICAST if kind == "multicast" else BROADCAST, "port": free_ports(1)[0]}
    for folder in bundles:
        change(folder, network=network)
    assert run(bundles[1], "--check") == 0
    assert re.search(rf"^port .*\b{kind} ", capsys.readouterr().out, re.MULTILINE)
    processes = [start(folder, started) for folder in bundles]
    limit = time.monotonic() + 20
    while time.monotonic() < limit and not all(len(rounds(f)) >= 20 for f in bundles):
        time.sleep(0.1)
    for process in processes:
        process.send_signal(signal.SIGTERM)
    for process in processes:
        _, errors = process.communicate(timeout=10)
        assert process.returncode == 0, errors
    assert len([r for r in rounds(bundles[1])[:20] if r["event"] == "TargetUpdate"]) >= 10


def test_a_third_signal_ends_at_once(bundles: list[Path], started: list[subprocess.Popen[str]]) -> None:
    slow = bundles[0].parent / "slow.py"
    slow.write_text(
        f"import sys\nsys.argv[0] = {MAIN!r}\nsys.path.insert(0, {str(Path(MAIN).parents[2])!r})\n"
        "from pathlib import Path\nfrom tests.runtime.agent import robot_main as r\n"
        "class Never(r.FakePlatform):\n    stopped = False\n"
        "body = lambda settings, key: Never(r.STARTS[0])\n"
        "raise SystemExit(r.main(r.PROGRAM, body, Path(sys.argv[1]), []))\n"
    )
    process = subprocess.Popen([sys.executable, str(slow), str(bundles[0])], stderr=subprocess.PIPE, text=True)
    started.append(process)
    assert process.stderr is not None
    said = ""
    for expected in ("joining", "stopping", "one more signal"):
        while expected not in (line := process.stderr.readline()):
            assert line, said
            said += line
        process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=5) == 130


def ends_with(folder: Path) -> list[str]:
    """Its phases, when it came to an end by itself."""
    lines = map(json.loads, (folder / "trace.jsonl").read_text().splitlines())
    return [t["phase"] for t in lines if t["kind"] == "phase"]


def wait_until_joining(folder: Path) -> None:
    limit = time.monotonic() + 10
    while time.monotonic() < limit:
        if (folder / "trace.jsonl").exists() and '"joining"' in (folder / "trace.jsonl").read_text():
            return
        time.sleep(0.05)
    raise AssertionError("it never became ready")


@contextmanager
def hang_up(handler: signal.Handlers) -> Iterator[None]:
    """Processes that are started meanwhile inherit this handler of SIGHUP: these tests may run under nohup."""
    before = signal.signal(signal.SIGHUP, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_closed_terminal_brings_it_to_rest(bundles: list[Path], started: list[subprocess.Popen[str]]) -> None:
    with hang_up(signal.SIG_DFL):
        process = start(bundles[0], started)
    wait_until_joining(bundles[0])
    for _ in range(4):  # a shell and the kernel may each tell of it, more than once
        process.send_signal(signal.SIGHUP)
        time.sleep(0.02)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert ends_with(bundles[0])[-2:] == ["stopping", "stopped"]


def test_nohup_keeps_it_going(bundles: list[Path], started: list[subprocess.Popen[str]]) -> None:
    with hang_up(signal.SIG_IGN):
        process = start(bundles[0], started)
    wait_until_joining(bundles[0])
    process.send_signal(signal.SIGHUP)
    time.sleep(0.3)
    assert process.poll() is None and "stopping" not in ends_with(bundles[0])


def test_a_terminal_that_takes_nothing_holds_up_nobody(
    bundles: list[Path], started: list[subprocess.Popen[str]]
) -> None:
    read, write = os.pipe()
    os.set_blocking(write, False)
    with suppress(BlockingIOError):
        while True:
            os.write(write, bytes(4096))
    os.set_blocking(write, True)
    process = subprocess.Popen([sys.executable, MAIN, str(bundles[0])], stderr=write, text=True)
    started.append(process)
    try:
        wait_until_joining(bundles[0])
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=5) == 0
    finally:
        os.close(read)
        os.close(write)


def run(folder: Path, *arguments: str) -> int:
    return agent.main(PROGRAM, body, folder, list(arguments))


def test_check_moves_nothing(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(bundles[1], "--check") == 0
    said = capsys.readouterr().out
    assert "robot bert, pid 1 of 3" in said and "is free" in said and "a fake body" in said


def test_a_port_in_use_names_robot_and_address(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    port = json.loads((bundles[1] / "settings.json").read_text())["peers"][1]["port"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", port))
        for arguments in ([], ["--check"]):
            assert run(bundles[1], *arguments) == 5
            said = capsys.readouterr().err
            assert re.search(rf"error: .*127\.0\.0\.1:{port}, the address of robot bert: the address is in use", said)


def test_what_is_not_compiled_is_told_once_before_a_link_is_open(
    bundles: list[Path], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*given: Any) -> Any:
        raise CannotOpen("no link")

    monkeypatch.setattr(agent, "open_transport", refused)
    monkeypatch.setattr(socket_batch.COMPILED, "found", "there is no C compiler")
    assert run(bundles[1]) == 5
    warning, error = capsys.readouterr().err.splitlines()
    assert warning.startswith("warning: sockets are read by Python") and warning.endswith(": there is no C compiler")
    assert error == "error: no link"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"delta": "fast"}, "Expected `float`, got `str` - at `$.delta`"),
        ({"control": 65536}, "Expected `int` <= 65535 - at `$.control`"),
        ({"pid": 3}, "pid 3 is not among the 3 peers"),
        ({"wings": 2}, "unknown field `wings`"),
        ({"key_file": None}, "no key_file; a fleet without a key must declare `insecure: true`"),
        ({"key_file": "other.key"}, "other.key: No such file"),
        ({"peers": [["a", "b"]]}, "Expected `object`, got `array` - at `$.peers[0]`"),
    ],
)
def test_wrong_settings_are_status_1(
    bundles: list[Path], capsys: pytest.CaptureFixture[str], changes: dict[str, Any], message: str
) -> None:
    change(bundles[0], **changes)
    assert run(bundles[0], "--check") == 1
    said = capsys.readouterr().err
    assert message in said and "error: " in said


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_settings_that_are_not_finite_are_refused(
    bundles: list[Path], capsys: pytest.CaptureFixture[str], number: str
) -> None:
    over = bundles[0].parent / "over.json"
    over.write_text(f'{{"safety": {{"position_lost": {number}}}}}')
    assert run(bundles[0], "--check", "--settings", str(over)) == 1
    assert "over.json: not JSON: " in (said := capsys.readouterr().err) and f"{number} is not a finite number" in said


def test_a_key_others_may_read_is_refused(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    (bundles[0] / "fleet.key").chmod(0o644)
    assert run(bundles[0], "--check") == 1
    assert "other users may read it" in capsys.readouterr().err


def test_without_a_key_it_warns_loudly(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    change(bundles[0], key_file=None, insecure=True)
    assert run(bundles[0], "--check") == 0
    assert "warning: key: INSECURE" in capsys.readouterr().err


def test_a_bundle_without_settings_says_how_to_get_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path) == 1
    said = capsys.readouterr().err
    assert "--fleet FILE" in said and "--settings FILE" in said


def test_settings_and_pid_may_be_laid_over(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    over = bundles[0].parent / "over.json"
    over.write_text('{"delta": 0.2, "robot": "cleo"}')
    assert run(bundles[0], "--check", "--settings", str(over), "--pid", "2") == 0
    assert "robot cleo, pid 2 of 3, delta 0.2 s" in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [["--fly"], ["--pid", "two"], ["extra"]])
def test_wrong_usage_is_status_2(tmp_path: Path, arguments: list[str]) -> None:
    assert run(tmp_path, *arguments) == 2


def test_a_body_that_is_not_there_is_status_5(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    class Absent(FakePlatform):
        def diagnose(self) -> list[Finding]:
            return [Finding("link", "fail", "no autopilot answers on udpin:14550", why="is it powered?")]

    made = Absent(body(settings(0, 3), None).position)
    assert agent.main(PROGRAM, lambda s, k: made, bundles[0], ["--check"]) == 5
    assert "no autopilot answers on udpin:14550\n  help: is it powered?" in capsys.readouterr().err
    assert made.closed


def test_an_internal_error_is_status_70(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    def broken(s: object, k: object) -> FakePlatform:
        raise AttributeError("our mistake")

    assert agent.main(PROGRAM, broken, bundles[0], ["--check"]) == 70
    assert "internal error, please report it" in capsys.readouterr().err


def test_the_trace_of_an_earlier_life_is_set_aside(bundles: list[Path], started: list[subprocess.Popen[str]]) -> None:
    folder, trace = bundles[0], bundles[0] / "trace.jsonl"

    def joins() -> bool:
        with suppress(FileNotFoundError):  # for a moment there is none
            return '"joining"' in trace.read_text()
        return False

    for life in ("first", "second"):
        trace.write_text(life)
        process = start(folder, started)
        limit = time.monotonic() + 20
        while time.monotonic() < limit and not joins():
            time.sleep(0.05)
        process.terminate()
        process.communicate(timeout=10)
    assert (folder / "trace-1.jsonl").read_text() == "first"
    assert joins()
    assert (folder / "trace-2.jsonl").read_text() == "second"
