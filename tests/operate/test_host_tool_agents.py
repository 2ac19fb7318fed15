"""The robot-side tool runs agents: start, stop, restarts, logs, traces, packages, systemd units."""

from __future__ import annotations

import os
import signal
import subprocess
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from koordgen import cli
from koordgen.lang.resources import examples
from tests.operate.fake_host import FakeHost, FakeRelease, digest, refused, send, wait
from tests.runtime.net.transports import free_ports


@pytest.fixture
def host(tmp_path: Path) -> Iterator[FakeHost]:
    made = FakeHost(tmp_path)
    yield made
    for path in sorted((made.folder / "running").glob("*.*"), reverse=True):  # supervisors first
        if path.suffix in (".supervisor", ".lock") and path.read_text():
            pid = int(path.read_text())
            if str(made.folder).encode() in _command_line(pid):
                os.kill(pid, signal.SIGKILL)


def _command_line(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


@pytest.fixture
def ports() -> dict[str, int]:
    return dict(zip(("alice", "bert"), free_ports(2), strict=True))


def test_agents_of_the_confirmed_release_are_started_and_stopped(host: FakeHost, ports: dict[str, int]) -> None:
    first, second = FakeRelease("one", ports), FakeRelease("two", ports)
    with host.session() as session:
        assert refused(session.call, "start", robots=None).code == "unconfirmed"
        first.put(session, "prepare")
        assert refused(session.call, "start", robots=None).code == "unconfirmed"
        session.call("confirm", id=first.id)
        assert refused(session.call, "start", robots=["carol"]).code == "unknown robot"
        assert session.call("start", robots=["bert"])["robots"] == {"bert": "ready"}
        assert session.call("start", robots=None)["robots"] == {"alice": "ready", "bert": "running"}
        assert session.call("status", robot="bert")["document"] == {"phase": "running", "robot": "bert"}
        assert session.call("inspect")["robots"]["alice"]["phase"] == "running"
        second.put(session, "verify")
        assert refused(session.call, "switch", id=second.id, seconds=60).code == "in flight"
    with host.session() as session:  # agents outlive the session that started them
        assert session.call("stop", robots=["alice"], seconds=60) == {"stopped": ["alice"]}
        assert [n for n, r in session.call("inspect")["robots"].items() if r["running"]] == ["bert"]
        assert session.call("stop", robots=None, seconds=60) == {"stopped": ["bert"]}
        assert session.call("stop", robots=None, seconds=60) == {"stopped": []}
        assert session.call("status", robot="bert")["status"] == 5
        texts = [text for _, text in session.call("logs", robot="alice", lines=9)["lines"]]
        assert texts == ["starts alice", "at rest", "the agent has ended with status 0"]
    assert sorted(host.runs) == [("alice", first.id), ("bert", first.id)]
    assert not list((host.folder / "releases").rglob("__pycache__"))


def test_an_agent_that_crashed_is_started_again_and_one_that_ended_is_not(
    host: FakeHost, ports: dict[str, int]
) -> None:
    release = FakeRelease("one", ports)
    with host.session() as session:
        release.put(session)
        (host.folder / "ends").write_text("3")
        error = refused(session.call, "start", robots=["alice"])
        assert error.code == "not started" and "starts alice / the agent has ended with status 3" in error.message
        assert host.runs == [("alice", release.id)]
        (host.folder / "ends").unlink()
        session.call("start", robots=["alice"])
        os.kill(session.call("inspect")["robots"]["alice"]["pid"], signal.SIGKILL)
        robots = session.call("inspect")["robots"]
        assert robots["alice"]["running"]  # its supervisor waits to start it again
        wait(lambda: len(host.runs) == 3 and session.call("inspect")["robots"]["alice"]["phase"] == "running")
        texts = [text for _, text in session.call("logs", robot="alice", since=None)["lines"]]
        assert "the agent has failed with status -9; it is started again in 1 s" in texts
        session.call("stop", robots=None, seconds=60)


def test_a_robot_that_does_not_come_to_rest_is_named(host: FakeHost, ports: dict[str, int]) -> None:
    with host.session() as session:
        FakeRelease("one", ports, stays=True).put(session)
        session.call("start", robots=None)
        error = refused(session.call, "stop", robots=["bert"], seconds=0.2)
        assert error.code == "still running" and "bert (running)" in error.message and "alice" not in error.message


def test_log_lines_are_asked_for_by_number_and_by_time(host: FakeHost) -> None:
    (host.folder / "logs").mkdir(parents=True)
    (host.folder / "logs" / "alice.log.1").write_text("1.5 one\n2.0 two\nhalf a li")
    (host.folder / "logs" / "alice.log").write_text("3.25 three is longer\n4.0 \n")
    with host.session() as session:
        found = session.call("logs", robot="alice", lines=2)
        assert found == {"lines": [[3.25, "three is longer"], [4.0, ""]], "next": 4.0}
        assert session.call("logs", robot="alice", since=None, lines=2)["lines"] == [[1.5, "one"], [2.0, "two"]]
        found = session.call("logs", robot="alice", since=2.0, lines=1)
        assert found == {"lines": [[3.25, "three is longer"]], "next": 3.25}
        assert session.call("logs", robot="alice", since=4.0) == {"lines": [], "next": 4.0}
        assert refused(session.call, "logs", robot="../alice", lines=2).code == "bad request"


def test_traces_are_listed_and_fetched_in_parts(host: FakeHost) -> None:
    place = host.folder / "traces" / "alice"
    place.mkdir(parents=True)
    (place / "trace.jsonl").write_bytes(b"0123456789")
    (place / "secret").symlink_to("/etc/passwd")
    with host.session() as session:
        assert [(f["name"], f["size"]) for f in session.call("traces", robot="alice")["files"]] == [("trace.jsonl", 10)]

        def fetch(name: str, offset: int, length: int) -> Any:
            return session.call("fetch", robot="alice", file=name, offset=offset, length=length)["data"]

        assert fetch("trace.jsonl", 0, 4) == b"0123"
        (place / "trace.jsonl").rename(place / "trace-1.jsonl")  # the agent begins another part
        (place / "trace.jsonl").write_bytes(b"new")
        assert fetch("trace.jsonl", 4, 100) == b"456789" and fetch("trace.jsonl", 10, 100) == b""
        assert fetch("trace.jsonl", 0, 100) == b"new"
        for name in ("../../deployment.json", "/etc/passwd", "secret", "", "absent"):
            assert refused(fetch, name, 0, 10).code in ("bad request", "missing")


def test_the_doctor_and_the_release_are_told(host: FakeHost, ports: dict[str, int]) -> None:
    release = FakeRelease("one", ports)
    with host.session() as session:
        release.put(session)
        found = session.call("doctor", robot="alice")
        assert (found["status"], found["document"]) == (1, {"robot": "alice", "checks": []})
        assert refused(session.call, "doctor", robot="carol").code == "unknown robot"
        assert session.call("release", id=release.id) == {"release": release.document, "files": release.files}
        assert refused(session.call, "release", id="0" * 16).code == "missing"


def test_a_log_is_bounded_and_a_full_disk_costs_lines_only(tmp_path: Path) -> None:
    from koordgen.operate.host_tool import logs

    log = logs.AgentLog(tmp_path / "alice.log")
    for _ in range(10_000):
        log.write("x" * 4000)
    log.close()
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) < 17_000_000
    stamps = [stamp for stamp, _ in logs.read_log(tmp_path / "alice.log")]
    assert len(stamps) > 2000 and sorted(set(stamps)) == stamps
    full = logs.AgentLog(Path("/dev/full"))
    for text in "abc":
        full.write(text)
    full.close()


def test_the_unit_is_one_that_systemd_accepts(tmp_path: Path) -> None:
    from koordgen.operate.host_tool import service
    from koordgen.operate.host_tool.deployment import Boot
    from koordgen.operate.host_tool.folder import Folder

    root = tmp_path / "a 100% $HOME folder"
    root.mkdir()
    folder = Folder(root)
    path = tmp_path / service.unit_name(folder, "alice")
    path.write_text(service.unit_text(folder, Boot(Path("/proc/sys/kernel/random/boot_id")), "alice"))
    done = subprocess.run(
        ["systemd-analyze", "--user", "verify", str(path)],
        capture_output=True, text=True, env=os.environ | {"XDG_RUNTIME_DIR": str(tmp_path)},
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    lines = path.read_text().splitlines()
    for wanted in ("Type=notify", "NotifyAccess=main", "Restart=on-failure", "RestartPreventExitStatus=1 2 3 130"):
        assert wanted in lines
    other = Folder(tmp_path / "other" / root.name)
    assert service.unit_name(other, "alice") != service.unit_name(folder, "alice")


# Keeps the state of units in files, and lets no unit start when the file `fails` is there.
_SYSTEMCTL = """#!/bin/sh
cd "$XDG_RUNTIME_DIR" || exit 1
echo "$@" >> calls
shift
case "$1" in
start) test -e fails && { echo "Job failed." >&2; exit 1; }; shift; for unit; do echo active > "$unit"; done;;
stop) shift 2; for unit; do echo inactive > "$unit"; done;;
show) shift 2; for unit; do echo "Id=$unit"; echo "ActiveState=$(cat "$unit" 2>/dev/null)"; echo; done;;
esac
"""
_JOURNALCTL = """#!/bin/sh
echo '{"__REALTIME_TIMESTAMP": "1500000", "MESSAGE": "one"}'
echo '{"__REALTIME_TIMESTAMP": "2500000", "MESSAGE": [116, 119, 111]}'
"""


def test_agents_run_as_user_units_where_systemd_is(host: FakeHost, ports: dict[str, int]) -> None:
    release = FakeRelease("one", ports)
    release.document["service"] = "systemd"
    runtime, programs = host.root / "runtime", host.root / "bin"
    programs.mkdir()
    for name, text in (("systemctl", _SYSTEMCTL), ("journalctl", _JOURNALCTL)):
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    host.environment["PATH"] = f"{programs}:{host.environment['PATH']}"
    host.environment["XDG_RUNTIME_DIR"] = str(runtime)
    with host.session() as session:
        release.put(session)
        assert refused(session.call, "start", robots=None).code == "no systemd"
        (runtime / "systemd").mkdir(parents=True)
        (runtime / "systemd" / "private").touch()
        assert session.call("inspect")["systemd"]
        (runtime / "fails").touch()
        assert refused(session.call, "start", robots=None).code == "not started"
        (runtime / "fails").unlink()
        session.call("start", robots=["alice"])
        units = list((host.root / ".config" / "systemd" / "user").iterdir())
        assert sorted(path.name.rsplit("-", 1)[1] for path in units) == ["alice.service", "bert.service"]
        assert session.call("inspect")["robots"]["alice"]["running"]
        assert refused(session.call, "switch", id=release.id, seconds=60).code == "in flight"
        assert session.call("logs", robot="alice", since=1.5)["lines"] == [[2.5, "two"]]
        assert session.call("stop", robots=None, seconds=60) == {"stopped": ["alice"]}
        assert any(
            line.startswith("--user disable koordgen-fleet-") for line in (runtime / "calls").read_text().split("\n")
        )


@pytest.mark.slow
def test_packages_are_installed_from_stored_wheels_alone(host: FakeHost, ports: dict[str, int], tmp_path: Path) -> None:
    import pip

    folder = Path(pip.__file__).parent
    pip_wheel, own_wheel = tmp_path / f"pip-{pip.__version__}-py3-none-any.whl", tmp_path / "hat-1.0-py3-none-any.whl"
    with zipfile.ZipFile(pip_wheel, "w") as file:
        for path in folder.rglob("*.py"):
            file.write(path, path.relative_to(folder.parent))
        for path in folder.rglob("*.pem"):
            file.write(path, path.relative_to(folder.parent))
    with zipfile.ZipFile(own_wheel, "w") as file:
        file.writestr("hat.py", "SIZE = 58\n")
        file.writestr("hat-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: hat\nVersion: 1.0\n")
        file.writestr("hat-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        file.writestr("hat-1.0.dist-info/RECORD", "hat.py,,\n")
    names, venv = [pip_wheel.name, own_wheel.name], "ab" * 16
    release = FakeRelease("one", ports)
    with host.session() as session:
        session.call("lock", owner="anna@laptop", what="deploy")
        make: dict[str, Any] = {"digest": venv, "requirements": "hat==1.0\n", "wheels": names}
        assert refused(session.call, "packages", **make).code == "missing"
        send(session, "wheels", {path.name: path.read_bytes() for path in (pip_wheel, own_wheel)})
        error = refused(session.call, "packages", **(make | {"requirements": "hat==2.0\n"}))
        assert error.code == "packages" and "hat==2.0" in error.message
        assert not (host.folder / "venvs" / venv).exists()
        assert session.call("packages", **make) == {"made": True} and session.call("packages", **make) == {
            "made": False
        }
        release.document["venv"] = venv
        release.put(session)
        assert session.call("missing", wheels=[[n, digest((tmp_path / n).read_bytes())] for n in names])["wheels"] == []
    python = host.folder / "venvs" / venv / "bin" / "python"
    assert subprocess.run([python, "-c", "import hat; print(hat.SIZE)"], capture_output=True).stdout == b"58\n"


@pytest.mark.slow
def test_a_real_agent_runs_from_its_release(host: FakeHost, tmp_path: Path) -> None:
    """A quad of examples/lineform: it waits for its autopilot and the other robots, and comes to rest when asked."""
    position, own, peer, *control = free_ports(5)
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(
        "{delta: 0.1, insecure: true, origin: {latitude: 47.4, longitude: 8.5, altitude: 488.0},\n"
        "geofence: {lo: [-6, -5, -1], hi: [6, 5, 4]}, robots: [\n"
        f"{{name: alice, target: quad, address: '127.0.0.1:{own}', control: {control[0]},\n"
        f"  settings: {{autopilot: 'udpin:127.0.0.1:{position}'}}}},\n"
        f"{{name: bert, target: quad, address: '127.0.0.1:{peer}', control: {control[1]}}}]}}\n"
    )
    program = str(examples() / "lineform" / "lineform.koord")
    assert cli.main(["build", program, "--fleet", str(fleet), "--out", str(tmp_path / "out")]) == 0
    bundle = tmp_path / "out" / "lineform" / "alice"
    release = FakeRelease("real", {}, key="")
    release.take_over("alice", {str(p.relative_to(bundle)): p.read_bytes() for p in bundle.rglob("*") if p.is_file()})
    with host.session() as session:
        release.put(session)
        assert session.call("start", robots=None) == {"robots": {"alice": "ready"}}
        told = session.call("status", robot="alice")["document"]
        assert (told["robot"], told["phase"]) == ("alice", "starting")
        assert told["release"] == (bundle / "RELEASE").read_text().strip()
        assert refused(session.call, "switch", id=release.id, seconds=60).message.endswith("alice (starting)")
        assert session.call("stop", robots=None, seconds=60) == {"stopped": ["alice"]}
        texts = [text for _, text in session.call("logs", robot="alice", lines=99)["lines"]]
        assert any(text.endswith("alice: info: stopped") for text in texts)
        assert session.call("verify", id=release.id)["checked"] == len(release.bundles["alice"])  # as it was
    assert (host.folder / "state" / "alice.state").exists()
    assert b'"alice"' in (host.folder / "traces" / "alice" / "trace.jsonl").read_bytes()
