"""Real processes of two squads and an ordinary robot: the outer fleet goes on when inner robots are killed."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest

from koordgen.build.bundle.write import write
from koordgen.build.pipeline import plan_file
from koordgen.cli import main
from tests.build.squad_files import OUTER, fleet_files
from tests.runtime.agent.test_process import started
from tests.runtime.net.transports import free_ports

__all__ = ["started"]
MAIN = str(Path(__file__).with_name("robot_main.py"))
COUNT = """
using Motion:
  sensors: Point position
  actuators: Point target
allread: int own[N_SYS]
local: int k
init:
  own[pid] = 0
Count:
  pre: True
  eff:
    k += 1
    own[pid] = k
    Motion.target = Point(k % 3, 0, 1)
"""


class Processes:
    """Processes of all robots of both levels, from real bundles on fake bodies."""

    def __init__(self, folder: Path, running: list[subprocess.Popen[str]]) -> None:
        (folder / "count.koord").write_text(COUNT)
        outer = fleet_files(folder, OUTER.replace("delta: 0.3", "delta: 0.4"))
        _, bundles = plan_file(str(folder / "count.koord"), None, str(outer), {}, squads=True)
        write(bundles, folder / "bundles")
        self.folders = {name: folder / "bundles" / name for name in bundles if name != "fleet"}
        self._running, self.processes = running, dict[str, subprocess.Popen[str]]()
        self._move_ports()
        for name in self.folders:
            self.start(name)

    def _move_ports(self) -> None:
        """Give all robots free ports, and a trace of each level."""
        files = [p for f in self.folders.values() for p in (f / "settings.json", f / "outer.json") if p.exists()]
        used = sorted({int(n) for path in files for n in re.findall(r'(?:"port"|"control"): (\d+)', path.read_text())})
        moved = dict(zip(used, free_ports(len(used)), strict=True))
        for path in files:
            found = json.loads(path.read_text())
            for peer in found["peers"]:
                for each in (peer, *peer.get("also", ())):
                    each["port"] = moved[each["port"]]
            found["control"] = moved[found["control"]]
            found["trace"] = str(path.parent.with_name(f"{path.parent.name}.{path.stem}.jsonl"))
            found["state"] = f"state/{path.parent.name}"
            path.write_text(json.dumps(found))

    def start(self, name: str) -> None:
        command = [sys.executable, MAIN, str(self.folders[name])]
        with (self.folders[name].parent / f"{name}.log").open("a") as log:
            process = subprocess.Popen(command, stderr=log, stdout=log, text=True)
        self._running.append(process)
        self.processes[name] = process

    def kill(self, name: str) -> None:
        self.processes[name].kill()
        self.processes[name].communicate()

    def status(self, name: str) -> dict[str, Any]:
        asked = subprocess.run(
            [sys.executable, MAIN, str(self.folders[name]), "--status", "--format", "json"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        return json.loads(asked.stdout) if asked.returncode == 0 else {}

    def counts(self, name: str) -> dict[int, int]:
        """Return outer round -> `k` of the recorded events of an outer robot, from the traces of all its hosts."""
        found: dict[int, int] = {}
        for path in sorted(self.folders[name].parent.glob("*.jsonl*") if name in self.folders else self._traces(name)):
            for line in path.read_text().rpartition("\n")[0].splitlines():
                record = json.loads(line)
                if record["kind"] == "round" and record["event"] == "Count":
                    assert found.get(record["round"], record["locals"]["k"]) == record["locals"]["k"], record
                    found[record["round"]] = record["locals"]["k"]
        return found

    def _traces(self, squad: str) -> list[Path]:
        folder = next(iter(self.folders.values())).parent
        return [path for path in folder.glob(f"{squad}.*.outer*.jsonl*") if path.is_file()]


def until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    limit = time.monotonic() + seconds
    while not condition() and time.monotonic() < limit:
        time.sleep(0.2)
    assert condition()


def survives(processes: Processes, kills: int, seed: int) -> None:
    """Kill and restart random inner robots. Check that no event of an outer robot is lost or counts twice."""
    dice = Random(seed)
    until(lambda: min(len(processes.counts(squad)) for squad in ("alpha", "beta")) >= 3)
    for _ in range(kills):
        squad = dice.choice(["alpha", "beta"])
        name = dice.choice([n for n in processes.folders if n.startswith(squad)])
        time.sleep(dice.uniform(0.0, 1.0))
        processes.kill(name)
        time.sleep(dice.uniform(0.5, 4.0))
        processes.start(name)
        last = max(processes.counts("alpha" if squad == "beta" else "beta"), default=0)
        until(lambda squad=squad, last=last: max(processes.counts(squad), default=0) > last + 2)  # type: ignore[misc]
    for squad in ("alpha", "beta"):
        found = processes.counts(squad)
        values = [found[round_] for round_ in sorted(found)]
        assert values == sorted(set(values)), (squad, values)


@pytest.mark.slow
def test_an_outer_fleet_of_processes_survives_the_loss_of_a_host_and_is_stopped(
    tmp_path: Path, started: list[subprocess.Popen[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    processes = Processes(tmp_path, started)
    until(lambda: len(processes.counts("alpha")) >= 3)
    report = processes.status("alpha.bob")
    host = ["alpha.ann", "alpha.bob", "alpha.cyd"][report["outer"]["host"]]
    assert processes.status(host)["outer"]["phase"] == "running" and "phase" in report
    last = max(processes.counts("alpha"))
    processes.kill(host)
    until(lambda: max(processes.counts("alpha")) > last + 4)
    found = processes.counts("alpha")
    values = [found[round_] for round_ in sorted(found)]
    assert values == sorted(set(values)) and processes.status("alpha.cyd")["outer"]["host"] != report["outer"]["host"]
    shutil.rmtree(processes.folders.pop(host))
    assert main(["estop", str(tmp_path / "bundles"), "--format", "json"]) == 0
    stopped = {each["robot"] for each in json.loads(capsys.readouterr().out)["robots"]}
    assert stopped == set(processes.folders), "the robots of all levels"
    assert all(processes.processes[name].wait(timeout=60) == 0 for name in processes.folders)


@pytest.mark.slow
def test_ten_kills_in_real_time(tmp_path: Path, started: list[subprocess.Popen[str]]) -> None:
    survives(Processes(tmp_path, started), 10, 7)
