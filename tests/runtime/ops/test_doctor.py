"""`--doctor` of an agent on a fake body: each thing that may be wrong, and that everything opened is closed."""

from __future__ import annotations

import json
import re
import socket
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from benchmarks.fixtures.fleet import FakePlatform
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.agent import process as agent
from koordgen.runtime.agent.squad import Squad
from koordgen.runtime.config.settings import BadSettings, Peer, Settings
from koordgen.runtime.net import socket_batch
from koordgen.runtime.net.layout import Layout, TooLarge
from koordgen.runtime.ops.doctor import examine, is_loopback, unknown
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Finding, Unready
from tests.runtime.agent.robot_main import body
from tests.runtime.agent.test_process import bundles, change
from tests.runtime.net.transports import free_ports

__all__ = ["bundles"]  # a fixture

Make = Callable[[Settings, bytes | None], Any]


def examined(folder: Path, capsys: pytest.CaptureFixture[str], make: Make = body) -> tuple[int, dict[str, Any]]:
    done = agent.main(PROGRAM, make, folder, ["--doctor", "--format", "json"])
    told = json.loads(capsys.readouterr().out)
    assert told["status"] == done and told["app"] == PROGRAM.name
    found = {f["name"]: f for f in told["checks"]}
    assert len(found) == len(told["checks"])
    return done, found


def test_all_that_is_looked_at(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    done, found = examined(bundles[1], capsys)
    assert done == 0
    assert list(found) == [
        "python", "processor", "packages", "files", "settings", "program", "compiled", "protocol", "disk", "trace",
        "key", "peers", "port", "control", "fake", "clock",
    ]  # fmt: skip
    assert "robot bert, pid 1 of 3" in found["settings"]["found"]
    assert {name for name, f in found.items() if f["state"] == "warn"} <= {
        "packages", "files", "processor", "clock", "peers",
    }  # fmt: skip


def test_as_a_table(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert agent.main(PROGRAM, body, bundles[1], ["--doctor"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("ok    fake       a fake body") for line in lines) and " 0 failed" in lines[-1]


@pytest.mark.parametrize("which", ["port", "control"])
def test_a_port_in_use(bundles: list[Path], capsys: pytest.CaptureFixture[str], which: str) -> None:
    settings = json.loads((bundles[1] / "settings.json").read_text())
    port = settings["control"] if which == "control" else settings["peers"][1]["port"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", port))
        done, found = examined(bundles[1], capsys)
    assert done == 5 and [f["name"] for f in found.values() if f["state"] == "fail"] == [which]
    assert "in use" in found[which]["found"] and found["fake"]["state"] == "ok", "the rest is looked at all the same"


def test_a_key_that_others_may_read(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    (bundles[0] / "fleet.key").chmod(0o644)
    keys: list[bytes | None] = []

    def make(settings: Settings, key: bytes | None) -> FakePlatform:
        keys.append(key)
        return body(settings, key)

    done, found = examined(bundles[0], capsys, make)
    assert done == 1 and "chmod 600" in found["key"]["found"] and found["fake"]["state"] == "ok"
    assert keys == [None]


def test_no_key_at_all(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    change(bundles[0], key_file=None, insecure=True)
    done, found = examined(bundles[0], capsys)
    assert done == 0 and found["key"]["state"] == "warn" and "INSECURE" in found["key"]["found"]
    change(bundles[0], insecure=False)
    done, found = examined(bundles[0], capsys)
    assert done == 1 and found["key"]["state"] == "fail"


def test_settings_that_cannot_be_read(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    change(bundles[0], delta="fast")
    done, found = examined(bundles[0], capsys)
    assert done == 1 and "$.delta" in found["settings"]["found"] and "python" in found and "key" not in found


def test_a_peer_without_an_address(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    peers = json.loads((bundles[0] / "settings.json").read_text())["peers"]
    peers[2]["host"] = "no..name"
    change(bundles[0], peers=peers)
    done, found = examined(bundles[0], capsys)
    assert done == 5 and found["peers"]["found"] == "no address for no..name" and "port" not in found


def test_a_fleet_on_one_host_alone_is_warned_of(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    done, found = examined(bundles[0], capsys)
    assert (done, found["peers"]["state"]) == (0, "warn")
    assert found["peers"]["found"] == "all 3 robots are at 127.0.0.1" and "build again" in found["peers"]["why"]
    peers = json.loads((bundles[0] / "settings.json").read_text())["peers"]
    peers[2]["host"] = "192.0.2.7"
    change(bundles[0], peers=peers)
    assert examined(bundles[0], capsys)[1]["peers"]["state"] == "ok"


@pytest.mark.parametrize(
    ("host", "loopback"),
    [("127.0.0.1", True), ("127.3.0.9", True), ("::1", True), ("localhost", True), ("192.0.2.7", False), ("a", False)],
)
def test_loopback_hosts(host: str, loopback: bool) -> None:
    assert is_loopback(host) == loopback


def test_names_are_not_waited_for_beyond_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[str] = []
    never = threading.Event()

    def slow(host: str, *rest: Any, **more: Any) -> Any:
        begun.append(host)
        if host == "slow":
            never.wait(5.0)

    monkeypatch.setattr(socket, "getaddrinfo", slow)
    peers = [Peer("a", "slow", 1), Peer("b", "quick", 2), Peer("c", "quick", 3)]
    try:
        assert unknown(peers, 0.05) == ["slow"] and begun == ["quick", "slow"]
    finally:
        never.set()


def test_a_program_that_no_wire_can_carry(
    bundles: list[Path], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def too_large(*given: Any) -> None:
        raise TooLarge("xs is too large")

    monkeypatch.setattr(Layout, "of", too_large)
    done, found = examined(bundles[0], capsys)
    assert done == 1 and found["program"]["found"] == "xs is too large"


@pytest.mark.parametrize(
    ("error", "status"), [(BadSettings("body: flight_height"), 1), (Unready("the car's settings: wheelbase"), 1)]
)
def test_settings_that_the_body_refuses(
    bundles: list[Path], capsys: pytest.CaptureFixture[str], error: Exception, status: int
) -> None:
    def make(settings: Settings, key: bytes | None) -> Any:
        raise error

    done, found = examined(bundles[0], capsys, make)
    assert done == status and found["body"]["state"] == "fail" and "clock" in found


def test_what_was_opened_is_closed_when_one_ends_early(bundles: list[Path]) -> None:
    made: list[FakePlatform] = []

    class Slow(FakePlatform):
        def diagnose(self) -> list[Finding]:
            return [Finding("a", "fail", "broken"), Finding("b", "ok", "never told")]

    def make(settings: Settings, key: bytes | None) -> FakePlatform:
        made.append(Slow(Point()))
        return made[-1]

    with closing(examine(PROGRAM, bundles[0], None, None, make, {})) as found:
        assert any(f.name == "a" for f in found)
    assert made[0].closed
    assert agent.main(PROGRAM, make, bundles[0], ["--check"]) == 5 and made[1].closed


def test_a_driver_that_cannot_be_made(bundles: list[Path]) -> None:
    def make_driver() -> Any:
        raise OSError("no bus")

    found = {f.name: f for f in examine(PROGRAM, bundles[0], None, None, body, {"HVAC": make_driver})}
    assert found["drivers"].state == "fail" and "no bus" in found["drivers"].found


def test_what_is_C_is_compiled_so_that_no_mission_waits_for_it(
    bundles: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    done, found = examined(bundles[0], capsys)
    assert done == 0 and found["compiled"]["state"] == "ok"
    assert re.fullmatch(r"socket I/O in C, loaded in \d+ ms", found["compiled"]["found"])


def test_a_large_fast_fleet_should_run_compiled(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    _, found = examined(bundles[0], capsys)
    assert found["protocol"]["state"] == "ok" and "interpreted" in found["protocol"]["found"]
    path = bundles[0] / "settings.json"
    known = json.loads(path.read_text())
    more = [{**known["peers"][0], "name": f"more{i}", "port": 20000 + i} for i in range(8)]
    path.write_text(json.dumps({**known, "delta": 0.01, "peers": [*known["peers"], *more]}))
    _, found = examined(bundles[0], capsys)
    assert found["protocol"]["state"] == "warn" and "1000 messages a second" in found["protocol"]["found"]
    assert f"python3 {bundles[0]} --compile" in found["protocol"]["why"]


def test_a_computer_without_a_compiler(
    bundles: list[Path], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket_batch.COMPILED, "found", "there is no C compiler")
    done, found = examined(bundles[0], capsys)
    assert done == 0
    assert (found["compiled"]["state"], found["compiled"]["found"]) == ("warn", "there is no C compiler")
    assert re.search(r"\d+ % more CPU, .*apt install gcc", found["compiled"]["why"])


def test_the_outer_robot_that_a_fleet_is(bundles: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    """Its settings, key and addresses are checked on each robot that may become its host."""
    settings = json.loads((bundles[1] / "settings.json").read_text())
    peers = [{**peer, "name": f"outer-{peer['name']}", "port": port} for peer, port in zip(
        settings["peers"], free_ports(len(settings["peers"])), strict=True
    )]  # fmt: skip
    outer = {**settings, "robot": "squad", "application_id": 9, "peers": peers}
    squad = Squad(0, {}, {}, PROGRAM)

    def found(**changes: Any) -> tuple[int, dict[str, Any]]:
        (bundles[1] / "outer.json").write_text(json.dumps({**outer, **changes}))
        done = agent.main(PROGRAM, body, bundles[1], ["--doctor", "--format", "json"], squad=squad)
        return done, {f["name"]: f for f in json.loads(capsys.readouterr().out)["checks"]}

    done, checks = found()
    assert done == 0 and list(checks)[-6:] == ["outer", "outer key", "outer peers", "outer port", "fake", "clock"]
    assert f"robot squad of {PROGRAM.name}" in checks["outer"]["found"]
    done, checks = found(application_id=settings["application_id"])
    assert done == 1 and "as in the inner fleet" in checks["outer"]["found"] and "outer key" not in checks
    done, checks = found(key_file="missing.key")
    assert done == 1 and checks["outer key"]["state"] == "fail" and checks["outer port"]["state"] == "ok"
    done, checks = found(peers=settings["peers"], pid=7)
    assert done == 1 and "pid 7 is not among" in checks["outer"]["found"] and checks["fake"]["state"] == "ok"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", peers[1]["port"]))
        done, checks = found()
    assert done == 5 and "in use" in checks["outer port"]["found"]

    (overlay := bundles[1].parent / "overlay").mkdir()
    for name, text in (("settings.json", "{}"), ("outer.json", '{"delta": 0.7}')):
        (overlay / name).write_text(text)
    agent.main(PROGRAM, body, bundles[1], ["--doctor", "--settings", str(overlay / "settings.json")], squad=squad)
    assert "delta 0.7 s" in capsys.readouterr().out, "settings of the outer robot are overridden beside those given"
