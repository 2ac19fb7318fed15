"""A deployed fleet is started, watched, stopped and collected over real SSH servers."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.fixtures.deployed import Deployed, deployed, place
from koordgen import cli
from koordgen.build.bundle.write import SUMS, sums
from koordgen.cli.base import building
from tests.operate.test_run_folder import PROGRAM, flight
from tests.verify.replay.parts import Kept

HOSTS = {"alice": "one", "bert": "one", "cleo": "two"}
AGENT = b"""\
import json, os, signal, socket, sys, time
if "--doctor" in sys.argv:
    name = json.load(open(sys.argv[0] + "/settings.json"))["robot"]
    state = "fail" if name == "cleo" else "ok"
    finding = {"name": "port", "state": state, "found": "47100", "wanted": "", "why": ""}
    print(json.dumps({"app": "line", "status": 5 if name == "cleo" else 0, "checks": [finding]}))
    raise SystemExit(5 if name == "cleo" else 0)
if "--status" in sys.argv:
    raise SystemExit(5)
if "--help" in sys.argv:
    raise SystemExit(0)
signal.signal(signal.SIGTERM, lambda *_: (print("landing", flush=True), sys.exit(0)))
print("flying", flush=True)
socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM).sendto(b"READY=1", os.environ["NOTIFY_SOCKET"].replace("@", "\\0"))
while True:
    time.sleep(0.05)
"""


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployed]:
    """Three robots on two hosts, with a confirmed release of agents that only print, and the traces of a flight."""
    home = tmp_path_factory.mktemp("flight")
    flown = flight(home, Kept(home, PROGRAM, 20000))
    with deployed(tmp_path_factory.mktemp("fleet"), HOSTS) as running, pytest.MonkeyPatch.context() as patch:
        patch.setattr(building, "planned", lambda *_, **__: (bundles(running), "line"))
        assert running.deploy() == 0
        for robot, host in HOSTS.items():
            shutil.copytree(
                flown / "robots" / robot, place(running.ssh.hosts[host]) / "traces" / robot, dirs_exist_ok=True
            )
        yield running
        run(running, "stop")


def bundles(fleet: Deployed) -> dict[str, dict[str, bytes]]:
    """Agents that only print, with the program of the flight."""
    found = {}
    for robot, files in fleet.planned()[0].items():
        files = {name: data for name, data in files.items() if name not in (SUMS, "line.koord")}
        files |= {"__main__.py": AGENT, "app.koord": PROGRAM.encode(), "params.json": b"{}", "RELEASE": b"ab" * 16}
        found[robot] = {**files, SUMS: sums(files)}
    return found


def run(fleet: Deployed, command: str, *arguments: str) -> int:
    return cli.main([command, str(fleet.fleet), *fleet.ssh.arguments, *arguments])


def test_agents_are_started_and_stopped_and_their_lines_are_shown(
    fleet: Deployed, capfd: pytest.CaptureFixture[str]
) -> None:
    capfd.readouterr()
    assert run(fleet, "start", "alice", "cleo") == 0
    assert re.fullmatch(r"started alice, cleo, release [0-9a-f]{8}\n", capfd.readouterr().out)
    assert run(fleet, "start") == 0
    assert "started bert" in (said := capfd.readouterr().out) and "running already: alice, cleo" in said
    assert run(fleet, "stop", "bert") == 0
    assert capfd.readouterr().out == "stopped bert\n"
    assert run(fleet, "stop") == 0
    assert capfd.readouterr().out == "stopped alice, cleo\nno agent ran on: bert\n"
    assert run(fleet, "logs", "--lines", "100") == 0
    lines = [line.split(maxsplit=3) for line in capfd.readouterr().out.splitlines()]
    assert [line[:2] for line in lines] == sorted(line[:2] for line in lines)
    for robot in HOSTS:
        own = [text for _, _, name, text in lines if name == robot]
        assert own.index("flying") < own.index("landing")


def test_a_name_that_is_no_robot_is_refused(fleet: Deployed, capfd: pytest.CaptureFixture[str]) -> None:
    assert run(fleet, "start", "alise") == 2
    assert "did you mean alice?" in capfd.readouterr().err


def test_nothing_starts_where_releases_differ(fleet: Deployed, capfd: pytest.CaptureFixture[str]) -> None:
    file = place(fleet.ssh.hosts["two"]) / "deployment.json"
    before = file.read_text()
    file.write_text(before.replace(json.loads(before)["confirmed"], "f" * 16))
    try:
        assert run(fleet, "start") == 1
        said = capfd.readouterr()
        assert re.search(r"different releases: [0-9a-f]{8} on alice, bert; ffffffff on cleo", said.err), said.err
        assert "nothing was started" in said.err and said.out == ""
    finally:
        file.write_text(before)


def test_status_asks_hosts_where_no_agent_answers(fleet: Deployed, capfd: pytest.CaptureFixture[str]) -> None:
    run(fleet, "stop")
    capfd.readouterr()
    assert run(fleet, "status", "--format", "json") == 5
    said = capfd.readouterr()
    assert "the agents of alice, bert, cleo do not run" in said.err and "koordgen start" in said.err
    found = json.loads(said.out)
    assert [robot["host"]["release"] for robot in found["robots"]] == ["ab" * 16] * 3
    assert {robot["host"]["id"] for robot in found["robots"]} == fleet.confirmed() and found["odd_releases"] == {}
    assert all(robot["host"]["free"] > 0 and not robot["host"]["running"] for robot in found["robots"])


def test_doctors_of_all_robots_look(fleet: Deployed, capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["doctor", "--fleet", str(fleet.fleet), *fleet.ssh.arguments]) == 5
    assert [line.split() for line in capfd.readouterr().out.splitlines()] == [
        ["robot", "ok", "warn", "fail"], ["alice", "1", "0", "0"], ["bert", "1", "0", "0"], ["cleo", "0", "0", "1"],
        ["FAIL", "port:", "47100"],
    ]  # fmt: skip


def test_a_collected_flight_is_a_run_folder(fleet: Deployed, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "flight"
    assert run(fleet, "collect", "-o", str(folder)) == 0, capfd.readouterr().err
    capfd.readouterr()
    for robot, host in HOSTS.items():
        there = place(fleet.ssh.hosts[host]) / "traces" / robot
        for path in there.iterdir():
            assert (folder / "robots" / robot / path.name).read_bytes() == path.read_bytes()
    assert cli.main(["replay", str(folder)]) == 0, capfd.readouterr().err
    capfd.readouterr()

    fleet.ssh.hosts["two"].stop()
    try:
        assert run(fleet, "collect", "-o", str(folder)) == 5
        said = capfd.readouterr()
        assert "not all files of cleo were collected" in said.err and "refuses connections" in said.err
        fetched = {line.split()[0]: float(line.split()[3]) for line in said.out.splitlines()}
        assert set(fetched) == {"alice", "bert"} and all(megabytes < 0.01 for megabytes in fetched.values())
    finally:
        fleet.ssh.hosts["two"].start()
