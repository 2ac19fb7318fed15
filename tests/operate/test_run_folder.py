"""A flight's traces, each on its robot's own clock, become a run folder that all readers take as it is."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from koordgen import cli
from koordgen.build.bundle.plan import store_facts
from koordgen.build.pipeline import check_file, read_fleet
from koordgen.fleet.file import Fleet
from koordgen.lang.analyze.params import with_params
from koordgen.lang.ir.decl import Program
from koordgen.operate.basestation import all_targets
from koordgen.operate.run_folder import flown, write_trace
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.trace.schema import BadTrace
from tests.verify.replay.parts import Kept
from tests.verify.replay.runs import Run

PROGRAM = """\
using Motion:
  sensors:
    Point position
  actuators:
    Point target
allread:
  Point x[N_SYS]
allwrite:
  int sum
local: int n
Go:
  pre: sum < 1000
  eff: atomic:
    sum += 1
    n += 1
    x[pid] = Motion.position
    Motion.target = Motion.position
invariant Few: forall i in ID: n[i] >= 0
invariant Small: sum < 1000
"""
ROBOTS = ("alice", "bert", "cleo")


def fleet_of(folder: Path, names: tuple[str, ...] = ROBOTS) -> Fleet:
    robots = "".join(
        f"  - {{name: {name}, target: quad, address: '127.0.0.1:{47100 + 10 * pid}', "
        f"start: {{position: [{3.0 * pid}, 0.0, 0.0]}}}}\n"
        for pid, name in enumerate(names)
    )
    path = folder / "fleet.yaml"
    path.write_text(
        "delta: 0.1\norigin: {latitude: 0.0, longitude: 0.0, altitude: 0.0}\n"
        f"geofence: {{lo: [-9, -9, -1], hi: [9, 9, 9]}}\nrobots:\n{robots}"
    )
    return read_fleet(str(path), all_targets(), None)[0]


def program_of(folder: Path) -> Program:
    return with_params(check_file(str(folder / "source/app.koord")).program, {})


def flight(folder: Path, run: Run) -> Path:
    """Fly, let bert die and come back in between, and give each robot's clock another zero."""
    run.run(2.0)
    run.fleet.network._queues.pop(1, None)
    run.fleet.robots[1].wake = 1e9
    run.run(0.7)
    run.boot(1)
    run.run(2.5).save()
    for pid, robot in enumerate(ROBOTS):
        for path in (folder / "robots" / robot).glob("*.jsonl"):
            path.write_bytes(b"".join(_later(line, 1000.0 * pid) for line in path.read_bytes().splitlines()))
    return folder


def _later(line: bytes, seconds: float) -> bytes:
    record = json.loads(line)
    if "time" in record:
        record["time"] += seconds
    return json.dumps(record, separators=(",", ":")).encode() + b"\n"


def merged(folder: Path) -> list[dict[str, Any]]:
    whole = flown(folder)
    write_trace(folder, whole, store_facts(program_of(folder)), fleet_of(folder))
    return [json.loads(line) for line in (folder / "trace.jsonl").read_bytes().splitlines()]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return flight(tmp_path, Kept(tmp_path, PROGRAM, 20000, conditions=Conditions(loss=0.1, delay=0.001)))


def test_all_records_stand_in_the_order_of_fleet_time(folder: Path) -> None:
    assert len(list((folder / "robots").rglob("*.jsonl"))) > 4, "robots wrote several parts"
    header, *records = merged(folder)
    assert [robot["name"] for robot in header["robots"]] == list(ROBOTS)
    assert [each["t"] for each in records] == sorted(each["t"] for each in records)
    rounds = [each for each in records if each["kind"] == "round"]
    assert len({(each["pid"], each["round"]) for each in rounds}) == len(rounds)
    for each in rounds:
        assert each["t"] == pytest.approx((each["round"] - 1) * 0.1 + each["late"], abs=1e-5)
    assert {each["pid"] for each in rounds} == {0, 1, 2}
    end = next(each for each in records if each["kind"] == "end")
    assert end["t"] == pytest.approx(0.1 * max(each["round"] for each in rounds), abs=0.11)
    poses = [each for each in records if each["kind"] == "pose" and each["pid"] == 2]
    assert poses[0]["position"][0] == pytest.approx(4.0, abs=1.0)
    views = [json.dumps(each) for each in records if each["kind"] == "view"]
    assert len(views) == len(set(views)), "what later parts repeat stands there once"


def test_init_stays_behind_the_start_of_its_agent(folder: Path) -> None:
    """An agent whose vehicle is ready at once runs `init` on sensors that are older than the record of its start."""
    path = min((folder / "robots/alice").glob("*.jsonl"), key=lambda path: b'"init"' not in path.read_bytes())
    lines = [json.loads(line) for line in path.read_bytes().splitlines()]
    first = min(each["time"] for each in lines if "time" in each)
    next(each for each in lines if each["kind"] == "init")["time"] = first - 0.001
    path.write_text("".join(json.dumps(each) + "\n" for each in lines))
    merged(folder)
    kinds = [each["kind"] for each in merged(folder) if each.get("pid") == 0 and each["kind"] in ("phase", "init")]
    assert kinds[:2] == ["phase", "phase"] and "init" in kinds


def test_all_readers_take_the_folder(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    merged(folder)
    assert cli.main(["replay", str(folder)]) == 0
    assert "no differences from the program" in capsys.readouterr().out
    assert cli.main(["audit", str(folder), "--format", "json"]) in (0, 4)
    whole = json.loads(capsys.readouterr().out)
    assert cli.main(["audit", str(folder / "robots"), "--format", "json"]) in (0, 4)
    apart = json.loads(capsys.readouterr().out)
    for one, other in zip(whole["properties"], apart["properties"], strict=True):
        assert (one["name"], one["verdict"]) == (other["name"], other["verdict"])
    assert cli.main(["show", str(folder)]) == 0
    assert "alice" in capsys.readouterr().out
    assert cli.main(["report", str(folder)]) == 0 and (folder / "report.html").stat().st_size > 10_000
    assert cli.main(["export", str(folder), "--to", "mcap"]) == 0 and (folder / "trace.mcap").is_file()
    assert cli.main(["export", str(folder), "--to", "csv"]) == 0
    assert len((folder / "csv/poses.csv").read_text().splitlines()) > 100


def test_traces_of_another_fleet_are_refused(folder: Path) -> None:
    fleet = fleet_of(folder, ("alice", "bert", "dora"))
    with pytest.raises(BadTrace, match=r"of the robots alice, bert, cleo, but the fleet file lists alice, bert, dora"):
        write_trace(folder, flown(folder), store_facts(program_of(folder)), fleet)
    assert not (folder / "trace.jsonl").exists()


def test_a_robot_without_a_trace_keeps_its_place(folder: Path) -> None:
    for path in (folder / "robots/bert").glob("*.jsonl"):
        path.unlink()
    header, *records = merged(folder)
    assert [robot["name"] for robot in header["robots"]] == list(ROBOTS)
    assert {each["pid"] for each in records if each["kind"] == "round"} == {0, 2}
