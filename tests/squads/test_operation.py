"""Fleets with squads at work: the robots of all levels are stopped, asked and installed, each with its own settings."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from hashlib import blake2s
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

from benchmarks.fixtures.deployed import place
from benchmarks.fixtures.ssh_hosts import ssh_fleet
from koordgen.cli import main
from koordgen.cli.operate.ssh import chosen_robots, fleet_hosts, read_fleet
from koordgen.operate import basestation, estop, run_folder, run_levels
from koordgen.operate.dashboard import RowsOfLevels
from koordgen.operate.estop import Called, CannotStop, Contact, Place, contacts_of, find_fleet
from koordgen.operate.host_tool import folder
from koordgen.operate.release import Fleetwide, key_id, release_id
from koordgen.operate.run_levels import join_hosts
from koordgen.operate.status import StatusAnswer, squads_of, table, to_json
from koordgen.runtime.trace.schema import FORMAT, Round
from koordgen.runtime.vehicle.feed import Feed
from koordgen.verify.audit.history import mission
from koordgen.verify.audit.trace_files import read_trace_file
from targets.sim.base import fleets
from targets.sim.trace.files import read
from targets.sim.view.web.fleet_rows import Report, read_report
from tests.build.squad_files import fleet_files
from tests.operate.fake_host import KEY, KEY_ID, FakeHost, FakeRelease
from tests.runtime.agent.test_process import started
from tests.runtime.net.transports import free_ports
from tests.squads.test_processes import Processes, until

__all__ = ["started"]  # a fixture

ALPHA, BETA = ["alpha.ann", "alpha.bob", "alpha.cyd"], ["beta.eve", "beta.fay", "beta.gus"]
OTHER = bytes(range(32, 64))


def with_keys(folder: Path) -> Path:
    """Write fleet files in which each fleet has a key of its own. Return the outer file."""
    outer = fleet_files(folder)
    (folder / "in").mkdir()
    for name in ("outer", "alpha", "beta"):
        path = folder / f"{name}.yaml"
        path.write_text(path.read_text().replace("insecure: true", f"key: {name}.key"))
        place = folder / "in" if name == "alpha" else folder
        write_key(place / f"{name}.key", name)
    (folder / "alpha.yaml").rename(folder / "in/alpha.yaml")
    outer.write_text(outer.read_text().replace("alpha.yaml", "in/alpha.yaml"))
    return outer


def with_program(folder: Path) -> None:
    shutil.copy(folder.parent / "triangle.koord", folder)


def write_key(path: Path, name: str) -> None:
    path.write_bytes(key(name))
    path.chmod(0o600)


def key(name: str) -> bytes:
    return name.encode().ljust(32, b"-")


def contacts(path: Path, warned: list[str], key_path: str | None = None) -> tuple[Contact, ...]:
    return contacts_of(find_fleet(path, warned.append), str(path), key_path, warned.append)


def test_each_robot_is_called_with_the_key_and_the_id_of_its_own_fleet(tmp_path: Path) -> None:
    warned: list[str] = []
    found = contacts(with_keys(tmp_path), warned)
    assert [contact.place.name for contact in found] == [*ALPHA, "dora", *BETA] and not warned
    assert [(c.robot, c.place.port, c.application, c.key) for c in found[2:5]] == [
        ("cyd", 48202, 2, key("alpha")), ("dora", 48100, 0, key("outer")), ("eve", 48300, 3, key("beta")),
    ]  # fmt: skip


def test_robots_are_called_although_files_of_other_squads_are_broken(tmp_path: Path) -> None:
    outer, warned = with_keys(tmp_path), list[str]()
    (tmp_path / "beta.yaml").unlink()
    (tmp_path / "in/alpha.yaml").write_text("world: [\n" + (tmp_path / "in/alpha.yaml").read_text())
    found = {contact.place.name: contact for contact in contacts(outer, warned)}
    assert list(found) == [*ALPHA, "dora", "beta"]
    assert found["alpha.bob"].key == key("alpha") and found["alpha.bob"].place.port == 48201
    assert found["beta"].trouble == "the robots of its fleet are not known"
    assert "in/alpha.yaml: the file is not YAML" in warned[0] and "beta.yaml: No such file" in warned[1]

    outer.write_text("world: [\n" + outer.read_text())
    assert [contact.place.name for contact in contacts(outer, warned)] == [*ALPHA, "dora", "beta"]
    results = estop.stop_all([found["beta"]], 0.1)
    assert results == [Called(found["beta"].place, "", 0.0, "no answer: the robots of its fleet are not known")]


def test_robots_are_called_although_a_key_is_missing(tmp_path: Path) -> None:
    outer, warned = with_keys(tmp_path), list[str]()
    (tmp_path / "beta.key").unlink()
    found = contacts(outer, warned)
    assert "the robots of beta are not called" in warned[0] and found[-1].trouble.startswith("no key: ")
    assert found[0].key == key("alpha") and not found[0].trouble
    write_key(tmp_path / "given.key", "given")
    given = [contact.key for contact in contacts(outer, warned, str(tmp_path / "given.key"))]
    assert given == [key("alpha")] * 3 + [key("given")] * 4, "a squad's own key comes first"
    for file in ("in/alpha.key", "outer.key"):
        (tmp_path / file).unlink()
    with pytest.raises(CannotStop):
        contacts(outer, warned)


def test_a_build_names_the_robots_of_both_levels(tmp_path: Path) -> None:
    for name, number in (("dora", 0), ("alpha.ann", 2), ("alpha.bob", 2), ("beta.ann", 3)):
        (folder := tmp_path / "build/app" / name).mkdir(parents=True)
        settings = {
            "robot": name.rpartition(".")[2], "pid": 0, "peers": [{"host": "h", "port": 1}], "control": 10 + number,
            "application_id": number, "insecure": True,
        }  # fmt: skip
        (folder / "settings.json").write_text(json.dumps(settings))
        if "." in name:
            (folder / "outer.json").write_text("{}")
    warned: list[str] = []
    found = contacts(tmp_path / "build/app", warned)
    assert [(c.place.name, c.robot, c.application, c.place.port) for c in found] == [
        ("alpha.ann", "ann", 2, 12), ("alpha.bob", "bob", 2, 12), ("beta.ann", "ann", 3, 13), ("dora", "dora", 0, 10),
    ]  # fmt: skip
    (tmp_path / "outer.yaml").write_text(
        "insecure: true\nrobots: [{name: dora, address: 'h:9'}, {name: beta, inner: b.yaml}]"
    )
    found = contacts(tmp_path / "outer.yaml", warned)
    assert [(c.place.name, c.place.port) for c in found] == [("dora", 1009), ("beta.ann", 13)]
    assert "b.yaml: No such file or directory; calling those of the last build" in warned[-1]


def test_the_keys_that_each_robot_needs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outer = str(with_keys(tmp_path))
    with_program(tmp_path / "in")
    assert main(["key", "list", outer, "--format", "json"]) == 0
    found = [
        (each["robot"], Path(each["file"]).name, each["id"]) for each in json.loads(capsys.readouterr().out)["keys"]
    ]
    names = [("alpha.ann", "alpha"), ("alpha.ann", "outer"), ("alpha.bob", "alpha")]
    assert found[:3] == [(robot, f"{name}.key", key_id(key(name))) for robot, name in names]
    assert len(found) == 13 and found[6][:2] == ("dora", "outer.key")
    (tmp_path / "beta.key").unlink()
    assert main(["key", "list", outer]) == 1
    told = capsys.readouterr()
    assert told.err.count("beta.key: No such file") == 1 and "alpha.cyd" in told.out


def answer(name: str, outer: dict[str, Any] | None = None) -> StatusAnswer:
    report: dict[str, Any] = {
        "release": "a" * 32, "phase": "running", "round": 70, "current": 1, "rounds": 1, "peers": {}, "late_ms": {},
        "monitors": {"violated": []}, "robot": name.rpartition(".")[2],
    }  # fmt: skip
    return StatusAnswer(Place(name, "h", 1), report if outer is None else {**report, "outer": outer}, 0.1, "")


def test_status_shows_a_squad_above_its_robots() -> None:
    known = {"robot": "alpha", "host": 1}
    old = {**known, "host": 0, "phase": "running", "round": 20, "pose": None}  # cut off, and not the host any more
    new = {**known, "phase": "running", "round": 23, "pose": {"position": [1.0, 2.25, 0.5]}, "battery": None}
    silent = StatusAnswer(Place("beta.eve", "h", 2), None, 2.0, "no answer")
    answers = [answer("alpha.ann", old), answer("alpha.bob", new), answer("alpha.cyd", known), answer("dora"), silent]
    lines = table(answers).splitlines()
    assert [line.split()[:4] for line in lines[1:6]] == [
        ["alpha", "a" * 8, "running", "23"], *[[name, "a" * 8, "running", "70"] for name in ALPHA],
        ["dora", "a" * 8, "running", "70"],
    ]  # fmt: skip
    assert lines[1].endswith("hosted by alpha.bob; position (m): 1.00, 2.25, 0.50")
    assert lines[2].startswith("  alpha.ann") and "no robot of it reports that it hosts it" in lines[6]
    found = json.loads(to_json(answers))
    assert [robot["robot"] for robot in found["robots"]] == [*ALPHA, "dora", "beta.eve"]
    assert found["squads"] == [
        {"robot": "alpha", "members": ALPHA, "host": "alpha.bob", "report": new},
        {"robot": "beta", "members": ["beta.eve"], "host": None, "report": None},
    ]
    assert squads_of([answer("dora")]) == {} and "squads" not in json.loads(to_json([answer("dora")]))


def test_the_dashboard_has_a_row_for_each_squad_and_robot() -> None:
    names = ["alpha.ann", "alpha.bob", "dora"]
    board: list[Any] = []
    contacts = [Contact(Place(name, "h", 1), name.rpartition(".")[2], 0, None) for name in names]
    rows = RowsOfLevels(contacts, lambda row, report, note: board.append((row, report and dict(report), note)))
    assert rows.names == ["alpha", *names] and rows.squads == {"alpha"}
    ann = answer("alpha.ann", {"robot": "alpha", "host": 0, "phase": "running", "round": 20, "pose": None})
    assert isinstance(ann.report, dict)
    ann.report.update(
        names=["ann", "bob"], peers={"1": {"loss": 0.5}}, shared=[["triangle.goal", "allwrite", 3, 1]], boot="ab",
        applications=[{"name": "triangle", "members": [0, 1]}], outcomes=[[1, 1, "event", "triangle: Keep", [0.1]]],
    )  # fmt: skip
    rows.on_answer(0, ann)
    (row, report, _), (above, squad, note) = board
    assert (row, above, note) == (1, 0, "hosted by alpha.ann") and report is not None and squad is not None
    assert report["peers"] == {"2": {"loss": 0.5}} and report["shared"] == [["alpha.triangle.goal", "allwrite", 3, 1]]
    assert report["applications"] == [{"name": "alpha.triangle", "members": [1, 2]}]
    assert report["outcomes"] == [[1, 1, "event", "alpha.triangle: Keep", [0.1]]]
    assert (squad["round"], squad["release"], squad["boot"]) == (20, "a" * 32, "ab")
    assert isinstance(read_report(squad), Report)
    rows.on_answer(1, answer("alpha.bob", {"robot": "alpha", "host": 0}))
    assert board[-1][0] == 2, "a robot that is not the host tells nothing of the squad"
    rows.on_answer(0, StatusAnswer(Place("alpha.ann", "h", 1), None, 0.5, "no answer"))
    assert board[-2:] == [(1, None, "no answer"), (0, None, "no robot of it reports that it hosts it")]
    ann.report["peers"] = {"7": {}}
    rows.on_answer(0, ann)
    assert board[-2][1] is None and "its report cannot be read" in board[-2][2]

    plain = RowsOfLevels(contacts[2:], lambda row, report, note: board.append((row, report and dict(report), note)))
    dora = answer("dora")
    plain.on_answer(0, dora)
    assert board[-1] == (0, dora.report, "") and plain.names == ["dora"]


def test_names_are_those_of_simulated_runs() -> None:
    assert (run_folder.SQUAD, run_levels.HOSTED) == (fleets.SQUAD, folder.OUTER)


def on_one_computer(folder: Path) -> str:
    """Write fleet files whose robots all run on one computer. Return the outer file."""
    outer = fleet_files(folder)
    for name in ("outer", "alpha", "beta"):
        path = folder / f"{name}.yaml"
        path.write_text(path.read_text().replace("address:", "host: pi@field, address:"))
    outer.write_text(outer.read_text() + "deploy: {folder: squads, service: none}\n")
    return str(outer)


def test_commands_name_robots_or_whole_squads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outer = on_one_computer(tmp_path)
    fleet = read_fleet(outer)
    robots = chosen_robots(fleet, outer, [])
    assert [(r.name, r.squad, r.file.name) for r in robots[2:5]] == [
        ("alpha.cyd", "alpha", "alpha.yaml"), ("dora", "", "outer.yaml"), ("beta.eve", "beta", "beta.yaml"),
    ]  # fmt: skip
    assert [r.name for r in chosen_robots(fleet, outer, ["beta", "alpha.bob"])] == ["alpha.bob", *BETA]
    (host,) = fleet_hosts(fleet, outer, robots)
    assert (host.robots, host.folder, host.login.text) == ((*ALPHA, "dora", *BETA), "squads", "pi@field")
    assert main(["start", outer, "alpha.bop"]) == 2
    assert "did you mean alpha.bob? the robots are alpha, alpha.ann, alpha.bob" in capsys.readouterr().err
    (tmp_path / "alpha.yaml").write_text((tmp_path / "alpha.yaml").read_text().replace("host: pi@field, ", "", 1))
    assert main(["logs", outer]) == 1
    assert "the fleet file names no host for alpha.ann" in capsys.readouterr().err


def test_a_release_depends_on_the_keys_of_its_squads() -> None:
    fleetwide = Fleetwide(7, "app", "none", "python3", KEY_ID)
    entry = {"bundle": "b", "packages": "p", "host": "h", "venv": ""}
    ids = {release_id(fleetwide, {"alpha.ann": {**entry, **more}}) for more in ({}, {"key": ""}, {"key": KEY_ID})}
    assert len(ids) == 3


@pytest.fixture
def host(tmp_path: Path) -> Iterator[FakeHost]:
    made = FakeHost(tmp_path)
    yield made
    with made.session() as session:
        session.call("stop", robots=None, seconds=60)


def test_robots_of_two_squads_with_one_name_share_a_computer(host: FakeHost) -> None:
    """Their agents have folders, keys, states and logs of their own."""
    names = ["alpha.ann", "beta.ann"]
    release = FakeRelease("squads", dict(zip(names, free_ports(2), strict=True)))
    other = blake2s(OTHER, person=b"koordgen", digest_size=8).hexdigest()
    for name, files in release.bundles.items():
        settings = {**json.loads(files["settings.json"]), "robot": "ann", "insecure": False}
        release.bundles[name] = files | {
            "settings.json": json.dumps(settings).encode(), "outer.json": b'{"insecure": false}',
        }  # fmt: skip
    release.document["robots"] = {"alpha.ann": {"key": other}, "beta.ann": {"key": KEY_ID}}
    (host.folder / "state").mkdir(parents=True)
    with host.session() as session:
        session.call("lock", owner="anna@laptop", what="deploy")
        session.call("key", OTHER, id=other)
        release.put(session)
        assert set(session.call("start", robots=None)["robots"].values()) == {"ready"}
        assert session.call("status", robot="beta.ann")["document"]["robot"] == "ann"
        for name in names:
            texts = [text for _, text in session.call("logs", robot=name, lines=9)["lines"]]
            assert texts == ["starts ann"]
            (host.folder / "traces" / name / "outer/trace-1.jsonl").write_text("of the squad\n")
            assert [each["name"] for each in session.call("traces", robot=name)["files"]] == ["trace.jsonl"]
            (listed,) = session.call("traces", robot=name, outer=True)["files"]
            fetched = session.call("fetch", robot=name, file=listed["name"], offset=3, length=99, outer=True)
            assert fetched["data"] == b"the squad\n"
        assert sorted(session.call("stop", robots=None, seconds=60)["stopped"]) == names
    folder = host.folder
    own = [json.loads((folder / "settings" / release.id / name / "settings.json").read_text()) for name in names]
    outer = [json.loads((folder / "settings" / release.id / name / "outer.json").read_text()) for name in names]
    assert [each["state"] for each in own] == [str(folder / "state/alpha"), str(folder / "state/beta")]
    assert [Path(each["key_file"]).stem for each in own] == [other, KEY_ID]
    assert [Path(each["key_file"]).read_bytes() for each in outer] == [KEY, KEY]
    assert len({each["trace"] for each in own + outer}) == 4


def squad_trace(folder: Path, host: str, rounds: range, name: str = "trace.jsonl", mark: str = "") -> None:
    """Write a trace of `alpha` that one host wrote, on a clock of its own."""
    (place := folder / "robots" / f"alpha.{host}" / "outer").mkdir(parents=True, exist_ok=True)
    header = {"kind": "header", "format": FORMAT, "app": "a", "robot": "alpha", "pid": 0, "n_sys": 1, "delta": 0.1}
    records: list[dict[str, Any]] = [{**header, "program_hash": "b" * 16}]
    records += [{"kind": "phase", "phase": "running", "detail": f"mission ab, round 1 at 7 s of fleet time{mark}"}]
    for number in rounds:
        base = {"sensors": {}, "locals": {"k": number}, "shared": {}, "actuators": {}}
        records.append({"kind": "round", "round": number, "event": mark or None, "late": 0.0, **base} if number else
                       {"kind": "init", "stopped": False, **base})  # fmt: skip
    start = len(host) * 1000.0
    lines = [json.dumps(each if k == 0 else {**each, "time": start + k * 0.1}) for k, each in enumerate(records)]
    (place / name).write_text("\n".join(lines) + "\n")


def test_the_traces_of_a_squads_hosts_become_one(tmp_path: Path) -> None:
    """Rounds that a host recorded, but that its successor recorded again, count as the successor's."""
    squad_trace(tmp_path, "ann", range(6), "trace-1.jsonl", "first")
    squad_trace(tmp_path, "bob", range(5, 9), mark="second")
    squad_trace(tmp_path, "ann", range(8, 12), mark="third")
    squad_trace(tmp_path, "cyd", range(0))  # it has lost the claim before its first round
    for _ in range(2):  # also if a later collection does it again
        join_hosts(tmp_path, "alpha")
        files = sorted(path.name for path in (tmp_path / "robots/alpha").iterdir())
        assert files == ["trace-1.jsonl", "trace-2.jsonl", "trace.jsonl"]
    (history,) = mission([read_trace_file(path) for path in (tmp_path / "robots/alpha").iterdir()]).histories
    assert [line.record["event"] for _, line in sorted(history.rounds.items())] == [
        *["first"] * 4, *["second"] * 3, *["third"] * 4,
    ]  # fmt: skip
    assert history.name == "alpha" and history.init is not None


@pytest.mark.slow
def test_squads_are_deployed_and_their_traces_collected(
    tmp_path: Path, started: list[subprocess.Popen[str]], capfd: pytest.CaptureFixture[str]
) -> None:
    """Real traces with a change of the host, which the computer of all robots keeps as it does those of its agents."""
    processes = Processes(tmp_path, started)
    until(lambda: len(processes.counts("alpha")) >= 3)
    host = [*ALPHA][processes.status("alpha.bob")["outer"]["host"]]
    last = max(processes.counts("alpha"))
    processes.kill(host)
    until(lambda: max(processes.counts("alpha")) > last + 4)
    for process in started:
        process.kill()
    with ssh_fleet(tmp_path / "ssh", ["field"]) as ssh:
        for name in ("outer", "alpha", "beta"):
            path = tmp_path / f"{name}.yaml"
            path.write_text(path.read_text().replace("address:", f'host: "{ssh.hosts["field"].login}", address:'))
        deploy = f'deploy: {{folder: koordgen/fleet, python: "{sys.executable}", service: none, wheels: host}}\n'
        outer = tmp_path / "outer.yaml"
        outer.write_text(outer.read_text() + deploy)
        program = str(tmp_path / "count.koord")
        assert main(["deploy", program, "--fleet", str(outer), *ssh.arguments]) == 0, capfd.readouterr().err
        assert "on 7 robots, confirmed" in capfd.readouterr().out
        assert main(["status", str(outer), *ssh.arguments]) == 5
        assert "its agent does not run" in capfd.readouterr().out
        main(["doctor", "--fleet", str(outer), "--format", "json", *ssh.arguments])
        robots = json.loads(capfd.readouterr().out)["robots"]
        checks = {each["robot"]: [check["name"] for check in each["checks"]] for each in robots}
        assert list(checks) == [*ALPHA, "dora", *BETA]
        assert "outer key" in checks["beta.eve"] and "outer" not in checks["dora"]
        for robot in checks:
            for level, folder in (("settings", ""), ("outer", "outer")):
                for path in (tmp_path / "bundles").glob(f"{robot}.{level}*.jsonl"):
                    there = place(ssh.hosts["field"]) / "traces" / robot / folder
                    shutil.copy(path, there / path.name.replace(f"{robot}.{level}", "trace"))
        run = tmp_path / "run"
        assert main(["collect", str(outer), "-o", str(run), *ssh.arguments]) == 0, capfd.readouterr().err
    header, records = read(run / "trace.jsonl")
    assert [(r.name, r.target) for r in header.robots] == [("alpha", "squad"), ("dora", "car"), ("beta", "squad")]
    counted = [int(bytes(r.locals["k"])) for r in records if isinstance(r, Round) and r.pid == 0 and r.event]
    assert counted == sorted(set(counted)) and len(counted) > 3, "three before the death of the host, and one after it"
    header, records = read(run / "alpha/trace.jsonl")
    assert [r.name for r in header.robots] == ["ann", "bob", "cyd"] and header.applications == ("triangle", "outer")
    assert {r.application for r in records if isinstance(r, Round)} == {"triangle", "outer"}
    assert (run / "source/count.koord").is_file() and (run / "alpha/source/triangle/triangle.koord").is_file()


class StillSystem:
    """Stand-in for `motioncapture.MotionCapture` without a frame."""

    rigidBodies: ClassVar[dict[str, Any]] = {}

    def waitForNextFrame(self) -> None:
        time.sleep(0.01)


def test_robots_of_squads_get_their_poses_with_the_key_of_their_fleet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outer = with_keys(tmp_path)
    with_program(tmp_path / "in")
    alpha, fed = tmp_path / "in/alpha.yaml", 'target: quad, settings: {positioning: vision, feed: "udp:0.0.0.0:47310"}'
    alpha.write_text(alpha.read_text().replace("target: quad", fed, 1))
    monkeypatch.setattr(basestation, "connected", lambda *_: StillSystem())
    serving = basestation.station(read_fleet(str(outer)), str(outer), None, "vicon", "h", 50.0, pytest.fail)
    sent: dict[int, bytes] = {}
    sender: Any = SimpleNamespace(sendto=lambda datagram, address: sent.update({address[1]: datagram}))
    bodies = {name: ((1.0 * place, 2.0, 1.0), (0.0, 0.0, 0.0, 1.0)) for place, name in enumerate(["alpha.ann", "dora"])}
    serving._pass_on(sender, (1.0, bodies), lambda: 1.0)
    assert serving.camera.end() and len(sent) == 2
    for name, level, number, port in (("ann", "alpha", 2, 47310), ("dora", "outer", 0, 47300)):
        feed = Feed(name, key(level), number)
        assert feed.receive(sent[port], 1.0), feed.rejected
