"""Squads in real time: each robot is a process, and the agent of a squad moves between them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from koordgen.cli import main
from koordgen.runtime.trace.schema import Round
from targets.sim.base.medium import Medium
from targets.sim.realtime.squads import SetAsideTail
from targets.sim.trace.files import read
from tests.build.squad_files import LINEFORM, fleet_files

ROUND = b'{"kind":"round","round":%d,"event":"Go","time":1.0,"application":"a"}\n'


def test_a_trace_that_is_set_aside_is_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "outer.jsonl"
    tail = SetAsideTail(path)
    assert tail.read() == []
    with path.open("wb", buffering=0) as first:
        first.write(b'{"kind":"header","robot":"alpha"}\n' + ROUND % 1 + (ROUND % 2)[:20])
        assert [record.round for record in tail.read() if isinstance(record, Round)] == [1]
        path.rename(tmp_path / "outer-1.jsonl")
        first.write((ROUND % 2)[20:])
        path.write_bytes(ROUND % 3)
        assert [record.round for record in tail.read() if isinstance(record, Round)] == [2, 3]
    with path.open("ab") as file:
        file.write(ROUND % 4)
    assert [record.round for record in tail.read() if isinstance(record, Round)] == [4]
    tail.close()


def test_the_medium_of_one_fleet_has_its_robots_only() -> None:
    whole = Medium(groups=(0, 0, 1, 1), cuts=((0, 2), (2, 3)), links=((3, 2, Medium().all), (0, 3, Medium().all)))
    assert whole.among([2, 3]) == Medium(groups=(1, 1), cuts=((0, 1),), links=((1, 0, Medium().all),))
    assert whole.among([0, 1, 2, 3]) == whole


@pytest.mark.slow
def test_the_outer_robot_goes_on_when_the_process_of_its_host_dies(tmp_path: Path) -> None:
    fleet_files(tmp_path)
    for file in tmp_path.glob("*.yaml"):
        text = file.read_text().replace("target: quad,", "target: quad, sim: {fidelity: simple},")
        file.write_text(text.replace("target: car,", "target: car, sim: {fidelity: simple},"))
    arguments = ["build", str(LINEFORM), "--fleet", str(tmp_path / "outer.yaml"), "--target", "sim"]
    assert main([*arguments, "-o", str(tmp_path / "build")]) == 0
    faults = {"network": {"loss": 0.05}, "events": [{"at": 3, "crash": "beta.eve"}, {"at": 3, "crash": "alpha.ann"}]}
    (tmp_path / "faults.json").write_text(json.dumps(faults))
    run, bundle = tmp_path / "run", tmp_path / "build" / "lineform" / "sim"
    command = [sys.executable, str(bundle), "--duration", "15", "--out", str(run), "--quiet", "--no-report"]
    command.append(f"--scenario={tmp_path / 'faults.json'}")
    done = subprocess.run(command, env=os.environ, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode in (0, 3, 6), done.stdout + done.stderr
    rounds = [r for r in read(run / "trace.jsonl")[1] if isinstance(r, Round)]
    for pid in range(3):
        own = [r.round for r in rounds if r.pid == pid]
        assert len(set(own)) == len(own) and max(r.t for r in rounds if r.pid == pid) > 10
    for fleet in ("", "alpha", "beta"):
        assert main(["replay", str(run / fleet)]) == 0
