"""`koordgen status` on real agents: every robot has its line, and the exit status says what is wrong."""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from benchmarks.fixtures.fleet import NAMES
from koordgen.cli import main
from koordgen.runtime.ops.status import applications_table
from tests.runtime.agent.test_process import bundles, start, started

__all__ = ["bundles", "started"]  # fixtures


def fleet_file(bundles: list[Path]) -> str:
    settings = [json.loads((folder / "settings.json").read_text()) for folder in bundles]
    robots = [
        f"  - {{name: {each['robot']}, address: '127.0.0.1:{each['peers'][each['pid']]['port']}', "
        f"control: {each['control']}}}"
        for each in settings
    ]
    path = bundles[0].parent / "fleet.yaml"
    path.write_text("\n".join(["robots:", *robots, ""]))
    (path.parent / "fleet.key").write_bytes((bundles[0] / "fleet.key").read_bytes())
    (path.parent / "fleet.key").chmod(0o600)
    return str(path)


def asked(fleet: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, Any], str]:
    capsys.readouterr()
    status = main(["status", fleet, "--format", "json"])
    said = capsys.readouterr()
    return status, json.loads(said.out), said.err


def ask_until(fleet: str, capsys: pytest.CaptureFixture[str], phase: str) -> tuple[int, dict[str, Any], str]:
    """Ask until every robot that answers is in `phase`, and all three answer."""
    limit = time.monotonic() + 60
    while True:
        status, found, said = asked(fleet, capsys)
        if all(each["answered"] and each["report"]["phase"] == phase for each in found["robots"]):
            return status, found, said
        assert time.monotonic() < limit, found


def test_every_robot_has_its_line(
    bundles: list[Path], started: list[subprocess.Popen[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = fleet_file(bundles)
    for folder in bundles:
        (folder / "RELEASE").write_text("a" * 32 + "\n")
        start(folder, started)
    status, found, said = ask_until(fleet, capsys, "running")
    assert (status, said, found["odd_releases"]) == (0, "", {})
    for name, robot in zip(NAMES, found["robots"], strict=False):
        assert robot["robot"] == name == robot["report"]["robot"]
        assert robot["report"]["host"]["disk_gb"] > 0 and robot["report"]["host"]["clock_ms"] < 1000
    assert main(["status", fleet]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:3] for line in lines[1:]] == [[name, "a" * 8, "running"] for name in NAMES[:3]]

    started[1].kill()
    started[1].wait()
    assert main(["status", fleet]) == 5
    last = capsys.readouterr()
    assert "bert" in last.out and "no agent runs at this address" in last.out
    assert "no answer from bert" in last.err and "alice" not in last.err


def test_applications_of_all_robots_are_one_table() -> None:
    """One robot runs two applications, one of which holds after a fault."""
    plain = {"pid": 0, "members": [0, 3], "stopped": False, "round": 9, "event": "", "event_round": 0, "fault": ""}
    task = {"name": "task", **plain, "fault": "task.koord:3: division by zero", "counts": {"faults": 2}}
    map_ = {"name": "map", **plain, "stopped": True, "event": "End", "event_round": 7, "counts": {}}
    head, *lines, empty = applications_table([("alice", {"applications": [map_, task]}), ("bert", {})])
    assert head.split() == ["robot", "application", "pid", "round", "last", "event", "faults", "state"]
    assert [line.split() for line in lines] == [
        ["alice", "map", "0", "of", "2", "9", "End", "(round", "7)", "0", "stopped"],
        ["alice", "task", "0", "of", "2", "9", "none", "yet", "2", "holds:", "task.koord:3:", "division", "by", "zero"],
    ]  # fmt: skip
    assert empty == "" and applications_table([("bert", {})]) == []


def test_a_robot_of_another_release_is_named(
    bundles: list[Path], started: list[subprocess.Popen[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = fleet_file(bundles)
    for folder, release in zip(bundles, "aba", strict=True):
        (folder / "RELEASE").write_text(release * 32 + "\n")
        start(folder, started)
    status, found, said = ask_until(fleet, capsys, "joining")
    assert status == 1 and "different release from most robots: bert" in said
    assert found["odd_releases"] == {"bert": "b" * 32}
    main(["status", fleet])
    assert "robots whose release differs from most: bert (bbbbbbbb)" in capsys.readouterr().out


def test_who_asks_with_another_key_gets_no_answer_and_is_told_of_it(
    bundles: list[Path], started: list[subprocess.Popen[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = fleet_file(bundles)
    start(bundles[0], started)
    ask = ["status", fleet]
    limit = time.monotonic() + 60
    while main(ask) is not None and "joining" not in capsys.readouterr().out:
        assert time.monotonic() < limit
    (Path(fleet).parent / "fleet.key").write_bytes(bytes(32))
    assert main(ask) == 5
    assert "no answer from alice, bert, cleo" in capsys.readouterr().err


@pytest.mark.parametrize("text", [None, "robots: []\n", "a: [1"])
def test_a_file_that_names_nobody_is_an_error(
    tmp_path: Path, text: str | None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if text is not None:
        Path("fleet.yaml").write_text(text)
    assert main(["status", "fleet.yaml"]) == 1
    assert "nobody was asked" in capsys.readouterr().err
