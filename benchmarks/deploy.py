"""Deployment of a fleet beside plain `rsync` and `ssh` in a loop: `python benchmarks/deploy.py`.

Twenty hosts are real SSH servers on loopback ports of this computer, each with a home folder and one robot; the
packages of agents are there. Measured: the deployment of a changed program, the return to the release before, and the
status of all robots. Stand-ins that speak runtime/ops/control.py answer in place of agents, at the ports and with
the key of the deployed bundles: agents without autopilots come to rest after half a minute.

The loop does what people do by hand: it builds, and for one robot after the other copies the bundle with `rsync` and
switches a link with `ssh`; it asks each robot's own `--status` with `ssh`. Deployments also verify every file, start
each new bundle once, and confirm in two phases; the loop does not.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.fixtures.deployed import Deployed, deployed, place
from koordgen.runtime.config.settings import Settings
from koordgen.runtime.ops.control import Control
from koordgen.runtime.ops.set_up import open_settings

ROOT = Path(__file__).resolve().parents[1]
HOSTS, QUICK = 20, 4


class Fleet:
    """Hosts of the fleet, with our commands and those of the rsync loop."""

    def __init__(self, fleet: Deployed) -> None:
        self._fleet = fleet
        self._build = fleet.folder / "build"
        ssh = fleet.ssh
        self._ssh = ["ssh", "-F", str(ssh.config), "-o", f"IdentityFile={ssh.identity}", "-o", "BatchMode=yes"]

    def write(self, version: int) -> None:
        """Write another version of the program."""
        self._fleet.write(version)

    def koordgen(self, *arguments: str, statuses: tuple[int, ...] = (0,)) -> tuple[float, str]:
        """Run a command on the fleet; return seconds and its standard output."""
        return _timed([sys.executable, "-m", "koordgen", *arguments, *self._fleet.ssh.arguments], statuses)

    def deploy(self) -> float:
        return self.koordgen("deploy", str(self._fleet.program), "--fleet", str(self._fleet.fleet))[0]

    def rollback(self) -> tuple[float, int]:
        """Return seconds, and bytes of data that were sent to all hosts."""
        seconds, said = self.koordgen("rollback", str(self._fleet.fleet), "--format", "json")
        return seconds, sum(host["sent_bytes"] for host in json.loads(said)["hosts"])

    @contextmanager
    def stand_ins(self) -> Iterator[None]:
        """Answer at the control ports of all robots."""
        key, ended = self._fleet.key.read_bytes(), threading.Event()
        settings = [open_settings(self._bundle(robot), None, None) for robot in self._fleet.robots]
        controls = [(each, Control.open(each, key)) for each in settings]

        def answer() -> None:
            while not ended.wait(0.001):
                for each, control in controls:
                    control.poll(time.monotonic(), "running", lambda each=each: _report(each))  # type: ignore[misc]

        thread = threading.Thread(target=answer)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()
            for _, control in controls:
                control.close()

    def status(self) -> tuple[float, int]:
        """Return seconds, and the number of agents that answered."""
        seconds, said = self.koordgen("status", str(self._fleet.fleet), "--format", "json", statuses=(0, 1, 5))
        return seconds, sum(robot["answered"] for robot in json.loads(said)["robots"])

    def loop_deploy(self) -> float:
        """Build; for each robot copy the bundle beside those that run, and switch."""
        began = time.perf_counter()
        build = ["build", str(self._fleet.program), "--fleet", str(self._fleet.fleet), "-o", str(self._build)]
        _timed([sys.executable, "-m", "koordgen", *build])
        for robot in self._fleet.robots:
            source = f"{self._build / 'line' / robot}/"
            _timed(["rsync", "-a", "--checksum", "--delete", "-e", " ".join(self._to(robot)[:-1]), source,
                    f"{self._to(robot)[-1]}:{self._place(robot)}/new/"])  # fmt: skip
            _timed([*self._to(robot), f"cd {self._place(robot)} && ln -sfn new current"])
        return time.perf_counter() - began

    def loop_status(self) -> float:
        """Ask each robot's own bundle."""
        began = time.perf_counter()
        settings = self._fleet.folder / "settings.json"  # replaces entries of the bundles' settings
        settings.write_text(json.dumps({"key_file": str(self._fleet.key)}))
        for robot in self._fleet.robots:
            options = f"--settings {settings} --status --format json"
            command = f"PYTHONDONTWRITEBYTECODE=1 {sys.executable} {self._bundle(robot)} {options}"
            _timed([*self._to(robot), command])
        return time.perf_counter() - began

    def _bundle(self, robot: str) -> Path:
        return place(self._fleet.ssh.hosts[self._fleet.robots[robot]]) / "current" / robot

    def bundle_bytes(self) -> int:
        """Return the size of all robots' bundles."""
        folders = (self._build / "line" / robot for robot in self._fleet.robots)
        return sum(path.stat().st_size for folder in folders for path in folder.rglob("*") if path.is_file())

    def _to(self, robot: str) -> list[str]:
        user, _, place = self._fleet.ssh.hosts[self._fleet.robots[robot]].login.partition("@")
        name, _, port = place.partition(":")
        return [*self._ssh, "-p", port, f"{user}@{name}"]

    def _place(self, robot: str) -> str:
        folder = self._fleet.ssh.hosts[self._fleet.robots[robot]].home / "plain"
        folder.mkdir(exist_ok=True)
        return str(folder)


def _report(settings: Settings) -> dict[str, Any]:
    """Return a report of the size that agents send."""
    peer = {"loss": 0.01, "delay_ms": {"p50": 4.1, "p99": 6.2, "max": 6.2}, "silent_ms": 98, "longest_ms": 264,
            "behind": 0, "repeats": 70}  # fmt: skip
    return {
        "robot": settings.robot, "release": settings.release, "phase": "running", "round": 600, "rounds": 600,
        "current": 598, "late_ms": {"p50": 0.3, "p99": 1.1, "max": 4.7}, "battery": 0.8,
        "peers": {str(pid): peer for pid in range(len(settings.peers))}, "monitors": {"violated": []},
        "host": {"clock_ms": 0.3, "disk_gb": 21.0, "temperature": 51.0},
    }  # fmt: skip


def _timed(command: list[str], statuses: tuple[int, ...] = (0,)) -> tuple[float, str]:
    """Run a command; return seconds and its standard output. Ends the benchmark when it fails."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    began = time.perf_counter()
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - began
    if done.returncode not in statuses:
        raise SystemExit(f"{' '.join(command)} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return seconds, done.stdout


def measured(fleet: Fleet) -> dict[str, Any]:
    """Return all figures; times in seconds."""
    figures: dict[str, Any] = {}
    fleet.write(1)
    figures["first_deploy"], figures["loop_first_deploy"] = fleet.deploy(), fleet.loop_deploy()
    fleet.write(2)
    figures["deploy"], figures["loop_deploy"] = fleet.deploy(), fleet.loop_deploy()
    figures["rollback"], figures["rollback_sent_bytes"] = fleet.rollback()
    figures["bundle_bytes"] = fleet.bundle_bytes()
    fleet.write(1)
    figures["loop_rollback"] = fleet.loop_deploy()
    with fleet.stand_ins():
        found = [fleet.status() for _ in range(3)]
        figures["status"], figures["answered"] = min(found)
        figures["loop_status"] = fleet.loop_status()
    for name in ("first_deploy", "deploy", "rollback", "status"):
        figures[f"{name}_to_loop"] = figures[name] / figures[f"loop_{name}"]
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} hosts instead of {HOSTS}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")
    arguments = parser.parse_args()
    count = QUICK if arguments.quick else HOSTS
    robots = {f"robot{number:02}": f"h{number:02}" for number in range(count)}
    folder = Path(tempfile.mkdtemp(prefix="koordgen-deploy-"))
    try:
        with deployed(folder, robots) as fleet:
            figures = measured(Fleet(fleet))
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print(f"{count} hosts on this computer; seconds")
    print(f"  {'':34}  koordgen  rsync + ssh loop  ratio")
    for name, what in (
        ("first_deploy", "first deployment"), ("deploy", "deployment of a changed program"),
        ("rollback", "return to the release before"), ("status", "status of all robots"),
    ):  # fmt: skip
        ours, loop = figures[name], figures[f"loop_{name}"]
        print(f"  {what:34}  {ours:8.2f}  {loop:16.2f}  {figures[f'{name}_to_loop']:5.2f}")
    print(f"  {figures['answered']} of {count} robots answered, as stand-ins for their agents")
    print(
        f"  the rollback sent {figures['rollback_sent_bytes']} bytes of requests to all hosts; their bundles have "
        f"{figures['bundle_bytes']} bytes"
    )
    if arguments.json is not None:
        arguments.json.write_text(json.dumps({"hosts": count, **figures}, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
