"""Deployments over real SSH servers: the whole fleet takes a release, or nothing is changed."""

from __future__ import annotations

import asyncio
import fcntl
import json
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from benchmarks.fixtures.deployed import Deployed, deployed, place, state
from koordgen.cli.base import building
from koordgen.operate import host_tool_archive
from koordgen.operate.host_tool_archive import archive
from koordgen.operate.hosts import Answer, SshSession, sessions

FIRST: set[str | None] = set()  # the release with which each test begins
ROBOTS = {"alice": "a", "bert": "b", "cleo": "c", "dora": "c"}


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployed]:
    with deployed(tmp_path_factory.mktemp("fleet"), ROBOTS) as running:
        yield running


def test_real_bundles_on_three_hosts(fleet: Deployed, capfd: pytest.CaptureFixture[str]) -> None:
    capfd.readouterr()
    assert fleet.deploy() == 0, capfd.readouterr().err
    (first,) = fleet.confirmed()
    assert f"release {first}: on 4 robots, confirmed" in capfd.readouterr().out
    for robot, host in ROBOTS.items():
        assert (place(fleet.ssh.hosts[host]) / "current" / robot / "koordgen/runtime/agent/process.py").is_file()
    assert not (place(fleet.ssh.hosts["a"]) / "current/bert").exists()
    (key,) = (place(fleet.ssh.hosts["a"]) / "keys").iterdir()
    assert key.read_bytes() == fleet.key.read_bytes() and key.stat().st_mode & 0o777 == 0o600


@pytest.mark.slow
def test_real_bundles_on_twenty_hosts(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    names = [f"robot-{number:02}" for number in range(20)]
    with deployed(tmp_path, {name: name for name in names}) as fleet:
        capfd.readouterr()
        assert fleet.deploy("--format", "json") == 0
        (first,) = fleet.confirmed()
        assert json.loads(capfd.readouterr().out)["release"] == first
        fleet.write(version=2)
        assert fleet.deploy("--format", "json") == 0
        second = json.loads(capfd.readouterr().out)
        assert fleet.confirmed() == {second["release"]} != {first}
        assert all(host["sent_bytes"] < 100_000 for host in second["hosts"])
        assert fleet.rollback("--format", "json") == 0
        assert fleet.confirmed() == {first}
        print(second["seconds"], json.loads(capfd.readouterr().out)["seconds"])


@pytest.fixture
def standing(fleet: Deployed, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Deployed:
    """The fleet with a confirmed release of bundles that do nothing, and newer ones that are not deployed yet."""
    monkeypatch.setattr(building, "planned", fleet.planned)
    fleet.write(version=1)
    if fleet.confirmed() != FIRST or any(found and found["pending"] for found in fleet.states().values()):
        assert fleet.deploy() == 0
        FIRST.clear()
        FIRST.update(fleet.confirmed())
    fleet.write(version=3)
    capfd.readouterr()
    return fleet


def test_a_change_and_the_way_back(standing: Deployed, capfd: pytest.CaptureFixture[str]) -> None:
    (first,) = standing.confirmed()
    assert standing.deploy("--format", "json") == 0
    document = json.loads(capfd.readouterr().out)
    assert all(host["changed"] and host["before"] == first for host in document["hosts"])
    assert standing.confirmed() == {document["release"]} != {first}
    compiled = place(standing.ssh.hosts["a"]) / "pycache"
    found = {(path.parts[-3], path.name.partition(".")[0]): path.stat().st_ino for path in compiled.rglob("*.pyc")}
    old, new = str(first), document["release"]
    assert found[old, "same"] == found[new, "same"] and found[old, "changed"] != found[new, "changed"]

    assert standing.deploy("--format", "json") == 0  # again
    again = json.loads(capfd.readouterr().out)
    assert again["release"] == document["release"] and not any(host["changed"] for host in again["hosts"])

    assert standing.rollback("--format", "json") == 0
    back = json.loads(capfd.readouterr().out)
    assert standing.confirmed() == {first} == {back["release"]}
    assert all(host["sent_bytes"] < 2000 for host in back["hosts"])


def refused(fleet: Deployed, capfd: pytest.CaptureFixture[str], status: int = 1) -> str:
    """Deploy; require that it fails and that every host is as before. Return what was printed."""
    before = fleet.states()
    assert fleet.deploy() == status
    assert fleet.states() == before
    told = capfd.readouterr().err
    assert "nothing was changed" in told and told.count("error:") == 1, told
    return told


def test_a_lock_names_its_owner_and_its_age(standing: Deployed, capfd: pytest.CaptureFixture[str]) -> None:
    async def run() -> str:
        async with sessions([standing.ssh.hosts["b"].host("bert")], standing.ssh.options, archive()) as opened:
            await opened.call("lock", owner="anna@laptop", what="deploy")
            return await asyncio.to_thread(refused, standing, capfd)

    told = asyncio.run(run())
    assert "error: bert (" in told and "anna@laptop" in told and " s " in told
    assert standing.deploy() == 0  # the lock ended with its session


def test_a_robot_in_flight(standing: Deployed, capfd: pytest.CaptureFixture[str]) -> None:
    """A stand-in holds the lock file that an agent holds while it lives."""
    running = place(standing.ssh.hosts["c"]) / "running"
    running.mkdir(exist_ok=True)
    path = running / "dora.lock"
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        told = refused(standing, capfd)
    path.unlink()
    assert "error: cleo, dora (" in told and "agents run on the host: dora" in told and "koordgen stop" in told


def test_a_clock_that_is_off(
    standing: Deployed, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lie(monkeypatch, standing, "b", 'answer["clock"] -= 600')
    told = refused(standing, capfd)
    assert "error: bert (" in told and "600 s behind" in told and "date -u --set" in told


def test_no_space(standing: Deployed, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    lie(monkeypatch, standing, "a", "folder.Folder.free = lambda self: 1000")
    told = refused(standing, capfd)
    assert "error: alice (" in told and "no space" in told


def test_a_read_only_disk(
    standing: Deployed, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lie(monkeypatch, standing, "a", 'answer["writable"] = False')
    told = refused(standing, capfd)
    assert "error: alice (" in told and "cannot be written" in told


def test_services_that_would_end_with_the_login(
    standing: Deployed, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    standing.fleet.write_text(standing.fleet.read_text().replace("service: none", "service: systemd"))
    linger = 'answer["linger"] = not os.environ["HOME"].endswith("/a/home")'
    lie(monkeypatch, standing, None, linger)
    told = refused(standing, capfd)
    assert "error: alice (" in told and "loginctl enable-linger" in told


def test_a_processor_without_wheels(
    standing: Deployed, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    standing.write(version=3, wheels="./wheels")
    (standing.folder / "wheels").mkdir(exist_ok=True)
    lie(monkeypatch, standing, "a", 'answer["machine"] = "armv7l"')
    before = standing.states()
    assert standing.deploy() == 1
    told = capfd.readouterr().err
    assert "error: alice (" in told and "the host's processor is armv7l" in told and "nothing was changed" in told
    assert standing.states() == before


def test_a_release_of_another_fleet(standing: Deployed, capfd: pytest.CaptureFixture[str]) -> None:
    standing.write(version=3, application_id=8)
    before = standing.states()
    assert standing.deploy() == 1
    told = capfd.readouterr().err
    assert "application_id 7" in told and "--take-over" in told and "nothing was changed" in told
    assert standing.states() == before
    assert standing.deploy("--take-over") == 0
    standing.write(version=1)
    assert standing.deploy("--take-over") == 0


def test_a_release_of_robots_that_the_fleet_does_not_have(
    standing: Deployed, capfd: pytest.CaptureFixture[str]
) -> None:
    robots = standing.robots
    standing.robots = {"erna" if robot == "bert" else robot: host for robot, host in robots.items()}
    standing.write()
    told = refused(standing, capfd)
    assert "erna (" in told and "robots bert" in told and "--take-over" in told
    standing.robots = robots
    standing.write()


def test_a_host_that_cannot_be_reached(standing: Deployed, capfd: pytest.CaptureFixture[str]) -> None:
    host = standing.ssh.hosts["b"]
    host.stop()
    try:
        told = refused(standing, capfd, 5)
    finally:
        host.start()
    assert "error: bert (" in told and "refuses connections" in told


def test_robots_without_a_host(standing: Deployed, capfd: pytest.CaptureFixture[str]) -> None:
    text = standing.fleet.read_text()
    standing.fleet.write_text(text.replace(f', host: "{standing.ssh.hosts["b"].login}"', ""))
    assert standing.deploy() == 1
    told = capfd.readouterr().err
    assert "names no host for bert" in told and "host: pi@alice.local" in told


def test_a_link_that_is_cut_before_phase_two_reverts_all(
    standing: Deployed, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = standing.confirmed()
    with cut_before(standing, "prepare"):
        assert standing.deploy() == 5
    told = capfd.readouterr().err
    assert "error: bert (" in told and "link was cut during `prepare`" in told
    assert "every robot keeps its release; the hosts of bert could not be reached" in told
    assert standing.confirmed() == before
    for name in ("a", "c"):
        found = state(standing.ssh.hosts[name])
        assert found is not None and found["pending"] is None
    assert standing.deploy() == 0  # the host that could not be reached is no obstacle
    assert len(standing.confirmed()) == 1 and standing.confirmed() != before


def test_a_robot_that_misses_phase_two_is_named_and_repaired(
    standing: Deployed, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (before,) = standing.confirmed()
    with cut_before(standing, "confirm"):
        assert standing.deploy() == 1
    told = capfd.readouterr().err
    assert "bert missed the second phase" in told and "cannot begin a mission" in told and "repairs it" in told
    found = state(standing.ssh.hosts["b"])
    assert found is not None and found["confirmed"] == before and found["pending"]["prepared"]
    assert len(standing.confirmed()) == 2
    assert standing.deploy("--format", "json") == 0
    document = json.loads(capfd.readouterr().out)
    assert [host["changed"] for host in document["hosts"]] == [False, True, False]
    assert standing.confirmed() == {document["release"]}


def test_rotating_the_key(
    standing: Deployed, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    standing.write(version=1)
    old = standing.key.read_bytes()
    kept, waiting = (standing.key.with_name(f"fleet.key{ending}") for ending in (".before", ".next"))
    before = standing.confirmed()
    with cut_before(standing, "prepare"):
        assert standing.rotate() == 5
    assert standing.key.read_bytes() == old and standing.confirmed() == before
    with cut_before(standing, "confirm"):
        assert standing.rotate() == 1
    assert "keep both" in capfd.readouterr().err
    assert standing.key.read_bytes() == old and waiting.read_bytes() != old and len(standing.confirmed()) == 2
    new = waiting.read_bytes()

    assert standing.rotate() == 0  # repairs it with the same new key
    assert len(standing.confirmed()) == 1
    assert standing.key.read_bytes() == new and kept.read_bytes() == old and not waiting.exists()
    assert standing.key.stat().st_mode & 0o777 == kept.stat().st_mode & 0o777 == 0o600
    (present,) = standing.confirmed()
    for robot, name in ROBOTS.items():
        overlay = json.loads((place(standing.ssh.hosts[name]) / f"settings/{present}/{robot}.json").read_text())
        assert Path(overlay["key_file"]).read_bytes() == new
    capfd.readouterr()

    assert standing.rollback() == 1  # the release before has the old key
    assert "--key" in capfd.readouterr().err
    assert standing.rollback("--key", str(kept)) == 0
    assert standing.confirmed() == before


def test_rolling_back_to_what_is_not_there(standing: Deployed, capfd: pytest.CaptureFixture[str]) -> None:
    assert standing.rollback("--to", "0123456789abcdef") == 1
    told = capfd.readouterr().err
    assert "no release 0123456789abcdef" in told and "alice (" in told and "nothing was changed" in told


@pytest.mark.parametrize("verb", ["missing", "switch", "prepare"])
def test_an_interrupt_before_phase_two_reverts_all(
    standing: Deployed, capfd: pytest.CaptureFixture[str], verb: str
) -> None:
    before = standing.states()
    with interrupt_at(verb):
        assert standing.deploy() == 130
    assert "nothing was changed" in capfd.readouterr().err
    assert standing.states() == before


def test_an_interrupt_within_phase_two_comes_too_late(standing: Deployed, capfd: pytest.CaptureFixture[str]) -> None:
    with interrupt_at("confirm"):
        assert standing.deploy("--format", "json") == 0
    assert standing.confirmed() == {json.loads(capfd.readouterr().out)["release"]}


@contextmanager
def interrupt_at(verb: str) -> Iterator[None]:
    """Interrupt this process, as Ctrl-C does, when the host of bert is asked `verb`."""
    call = SshSession.call

    async def interrupting(session: SshSession, asked: str, data: bytes = b"", **arguments: Any) -> Answer:
        if asked == verb and "bert" in session.host.robots:
            os.kill(os.getpid(), signal.SIGINT)
        return await call(session, asked, data, **arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SshSession, "call", interrupting)
        yield


@contextmanager
def cut_before(fleet: Deployed, verb: str) -> Iterator[None]:
    """Cut the link to the host of bert as soon as it is asked `verb`."""
    call = SshSession.call

    async def cutting(session: SshSession, asked: str, data: bytes = b"", **arguments: Any) -> Answer:
        if asked == verb and "bert" in session.host.robots:
            fleet.ssh.hosts["b"].cut()
        return await call(session, asked, data, **arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SshSession, "call", cutting)
        yield


def lie(monkeypatch: pytest.MonkeyPatch, fleet: Deployed, name: str | None, change: str) -> None:
    """Send a tool that runs `change` on one host (None: all) before it starts; `answer` is what `inspect` returns."""
    home = "" if name is None else str(fleet.ssh.hosts[name].home)
    stub = f"""
import os
from host_tool import folder, host
if os.environ["HOME"].startswith({home!r}):
    inspect = host.inspect
    def changed(*arguments):
        answer = inspect(*arguments)
        {change}
        return answer
    host.inspect = changed
    {change if change.startswith("folder.") else "pass"}
from host_tool.__main__ import main
raise SystemExit(main())
"""
    monkeypatch.setattr(host_tool_archive, "_STUB", stub)


@pytest.mark.parametrize(
    "words",
    [
        "key is not in known_hosts", "key differs from the key in known_hosts", "the host refuses your SSH keys",
        "no address is known", "did not answer within", "refuses connections", "but agents need a 64-bit processor",
        "there is no wheel of", "agents run on the host", "works here since", "the host has a release of another fleet",
        "no space",
        "cannot be written", "the disk of this host is read-only", "behind", "services would end on the host when",
        "its bundle does not load", "the link was cut", "the login shell prints more than", "is not understood",
    ],
)  # fmt: skip
def test_the_messages_of_the_page_are_those_of_the_code(words: str) -> None:
    operate = Path(__file__).parents[2] / "koordgen/operate"
    page = (operate.parents[1] / "docs/how-to/deploy.md").read_text(encoding="utf-8")
    assert words in page.partition("\n## Messages\n")[2].partition("\n## Security\n")[0]
    assert any(words in path.read_text(encoding="utf-8") for path in operate.rglob("*.py"))
