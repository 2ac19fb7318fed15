"""Deployments that something goes wrong with: seeded trials on three hosts with real SSH servers.

    python -m tests.operate.fault_trials --count 200 --folder build/fault-trials

In each trial a release is deployed (or rolled back), and at a random moment of a random phase the deploying process is
killed, a link is cut, a disk is filled, or a host is rebooted. Afterwards every host must have a whole release that it
may run, agents of two releases must never start, and a second deployment must end well. Results are kept in the folder;
run again, the campaign goes on where it ended.

Each host is a process namespace of its own with its own boot id and its own small disk, which needs root. A reboot
kills all its processes at once and gives it another boot id.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from random import Random
from typing import Any
from uuid import UUID

from benchmarks.fixtures.deployed import Deployed, place, state
from benchmarks.fixtures.ssh_hosts import SshFleet, SshHost
from koordgen import cli
from koordgen.build.bundle.write import SUMS, sums
from koordgen.cli.base import building
from koordgen.operate.deploy import Phases
from tests.operate.fake_host import MAIN
from tests.runtime.net.transports import free_ports

ROBOTS = {"alice": "a", "bert": "b", "cleo": "c", "dora": "c"}
PHASES = ("connect", "lock", "inspect", "send", "verify", "switch", "prepare", "confirm")
KINDS = ("deployer killed", "link cut", "disk full", "host rebooted")
OUTCOMES = ("old release", "new release", "mixed")
DISK = "96m"  # the tool leaves 64 MB free
PATIENCE = 180.0  # seconds for one command
STARTS = 4  # in every so many trials the repaired fleet is started as well
TRIES = 3  # of the second deployment: the session of a process that was killed may hold its lock for some seconds

_BOOT = 'mount --bind "$0" /proc/sys/kernel/random/boot_id && exec "$@"'


class IsolatedHost(SshHost):
    """A host whose processes, boot id and disk are its own."""

    def __init__(self, name: str, folder: Path, user_key: str) -> None:
        super().__init__(name, folder, user_key)
        self.boot = folder / "boot_id"
        self._random = Random(name)
        self._new_boot()
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", str(self.home)], check=True)

    def command(self, config: Path) -> list[str]:
        isolated = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc"]
        return [*isolated, "sh", "-c", _BOOT, str(self.boot), *super().command(config)]

    def reboot(self, seconds: float) -> None:
        """Kill all processes, stay off for some seconds, start again."""
        self.stop()
        self._new_boot()
        time.sleep(seconds)
        self.start()

    def stop(self) -> None:
        """Kill all processes of the host at once."""
        if self._server is not None:
            inner = children(self._server.pid)
            self._server.kill()
            self._server.wait()
            while any(Path(f"/proc/{process}").exists() for process in inner):
                time.sleep(0.01)
            self._server = None

    def cut(self) -> None:
        """Kill the server's processes of all connections; the tool's processes go on."""
        for server in children(self._server.pid if self._server else 0):
            for connection in children(server):
                for process in [connection, *children(connection)]:
                    if name_of(process).startswith("sshd"):
                        kill(process)

    def fill(self) -> None:
        """Leave no byte on the disk."""
        with (self.home / "filler").open("wb") as file:
            while free := shutil.disk_usage(self.home).free:
                with suppress(OSError):
                    os.posix_fallocate(file.fileno(), file.seek(0, os.SEEK_END), free)
                    file.truncate(file.seek(0, os.SEEK_END))

    def empty(self) -> None:
        (self.home / "filler").unlink(missing_ok=True)

    def close(self) -> None:
        self.stop()
        subprocess.run(["umount", "--lazy", str(self.home)], check=True)

    def _new_boot(self) -> None:
        self.boot.write_text(f"{UUID(int=self._random.getrandbits(128))}\n")

    @property
    def runs(self) -> list[str]:
        """Releases of all agents that were ever started here."""
        path = place(self) / "runs.jsonl"
        return [json.loads(line)["release"] for line in path.read_text().splitlines()] if path.exists() else []


def children(parent: int) -> list[int]:
    with suppress(OSError):
        return [int(pid) for pid in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]
    return []


def name_of(process: int) -> str:
    with suppress(OSError):
        return Path(f"/proc/{process}/comm").read_text().strip()
    return ""


def kill(process: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(process, signal.SIGKILL)


class Trials:
    """The fleet of a campaign, and one trial after another on it."""

    def __init__(self, fleet: Deployed, log: Path) -> None:
        self.fleet = fleet
        self.log = log
        self.hosts: dict[str, IsolatedHost] = fleet.ssh.hosts  # type: ignore[assignment]
        self._ports = dict(zip(ROBOTS, free_ports(len(ROBOTS)), strict=True))
        self._phases = log.with_name("phases")

    def _planned(self, *_: object, **__: object) -> tuple[dict[str, dict[str, bytes]], str]:
        """Return bundles of agents that only tell which release they are of."""
        bundles = {}
        for robot, port in self._ports.items():
            settings = {"robot": robot, "pid": 0, "control": port, "peers": [{"host": "127.0.0.1", "port": port}]}
            files = {
                "__main__.py": MAIN.encode(),
                "line.koord": self.fleet.program.read_bytes(),
                "requirements.txt": b"",
                "settings.json": json.dumps({**settings, "insecure": False}).encode(),
            }
            bundles[robot] = {**files, SUMS: sums(files)}
        return bundles, "line"

    def _attempt(self, original: Callable[..., Any]) -> Callable[..., Any]:
        """Return `Phases.attempt` that records each phase in a file."""

        def attempt(phases: Phases, name: str, *arguments: Any, **named: Any) -> Any:
            with self._phases.open("a") as file:
                file.write(f"{name}\n")
            return original(phases, name, *arguments, **named)

        return attempt

    def begin(self, *command: str) -> int:
        """Start a command of koordgen as a process of its own; return its process id."""
        self._phases.write_text("connect\n")
        pid = os.fork()
        if pid:
            return pid
        status = 70
        try:
            output = os.open(self.log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(output, 1)
            os.dup2(output, 2)
            building.planned = self._planned
            Phases.attempt = self._attempt(Phases.attempt)  # type: ignore[method-assign]
            status = cli.main(list(command))
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)

    def run(self, *command: str) -> int:
        """Run a command of koordgen to its end; return its exit status."""
        return ended(self.begin(*command))

    def operation(self, name: str) -> list[str]:
        fleet = str(self.fleet.fleet)
        own = [str(self.fleet.program), "--fleet", fleet] if name == "deploy" else [fleet]
        return [name, *own, *self.fleet.ssh.arguments]

    def trial(self, number: int, seed: int) -> dict[str, Any]:
        """Run one trial; return its record. `violations` is empty when everything held."""
        chance = Random(f"{seed} {number}")
        kind = KINDS[number % len(KINDS)]
        operation = "rollback" if chance.random() < 0.2 else "deploy"
        victim = self.hosts[chance.choice(sorted(self.hosts))]
        # Most phases take some hundredths of a second: the fault comes as soon in most trials.
        aim, after, off = chance.choice(PHASES), 0.3 * chance.random() ** 3, chance.uniform(0.0, 1.0)
        old = self.confirmed()
        self.fleet.write(version=1000 * seed + number)
        process = self.begin(*self.operation(operation))
        while aim not in self.phases() and not has_ended(process):
            time.sleep(0.005)
        time.sleep(after)
        phase = "ended" if has_ended(process) else self.phases()[-1]
        self.harm(kind, process, victim, off)
        status = ended(process)
        said = self.log.read_text()
        victim.empty()
        violations = self.harmed_releases()
        found = self.confirmed()
        outcome = "mixed" if len(found) > 1 else "old release" if found == old else "new release"
        violations += self.starts_one_release_or_none(found)
        tries = self.repair(violations, number % STARTS == 0)
        return {
            "number": number, "kind": kind, "operation": operation, "victim": victim.name, "aim": aim,
            "after": round(after, 3), "phase": phase, "status": status, "outcome": outcome, "tries": tries,
            "violations": violations, "said": said if violations else "",
        }  # fmt: skip

    def harm(self, kind: str, process: int, victim: IsolatedHost, off: float) -> None:
        if kind == "deployer killed":
            kill(process)
        elif kind == "link cut":
            victim.cut()
        elif kind == "disk full":
            victim.fill()
        else:
            victim.reboot(off)

    def phases(self) -> list[str]:
        """Return the phases that the command has begun."""
        return self._phases.read_text().splitlines()

    def confirmed(self) -> set[str | None]:
        return self.fleet.confirmed()

    def harmed_releases(self) -> list[str]:
        """Return what is wrong with the confirmed releases of the hosts."""
        wrong = []
        for name, host in self.hosts.items():
            found = state(host)
            confirmed = found["confirmed"] if found else None
            if confirmed is None:
                wrong.append(f"{name}: no confirmed release")
                continue
            folder = place(host) / "releases" / confirmed
            files = json.loads((folder / "files.json").read_text()) if folder.is_dir() else {}
            if set(files) != {robot for robot, where in ROBOTS.items() if where == name}:
                wrong.append(f"{name}: release {confirmed} is not whole")
            for robot, bundle in files.items():
                for path, (digest, _) in bundle.items():
                    if sha256((folder / robot / path).read_bytes()).hexdigest() != digest:
                        wrong.append(f"{name}: {robot}/{path} is damaged")
        return wrong

    def starts_one_release_or_none(self, confirmed: set[str | None]) -> list[str]:
        """Start the fleet as a user would, and stop it; return the faults of the agents that started."""
        before = {name: len(host.runs) for name, host in self.hosts.items()}
        status = self.run(*self.operation("start"))
        started = {release for name, host in self.hosts.items() for release in host.runs[before[name] :]}
        if started:
            self.run(*self.operation("stop"))
        wrong = []
        if len(started) > 1:
            wrong.append(f"agents of several releases started: {sorted(started)}")
        if started - confirmed:
            wrong.append(f"an agent of an unconfirmed release started: {sorted(started)}")
        if started and len(confirmed) > 1:
            wrong.append("agents of a mixed fleet started")
        if status == 0 and not started:
            wrong.append("`start` says that agents run, and none does")
        return wrong

    def repair(self, violations: list[str], start: bool) -> int:
        """Deploy once more, and start the whole fleet if asked; add to `violations` what is wrong.

        Returns the tries.
        """
        tries, status = 0, -1
        while status and tries < TRIES:
            tries += 1
            status = self.run(*self.operation("deploy"))
            if status:
                time.sleep(2.0)
        said = self.log.read_text()
        states = [state(host) or {} for host in self.hosts.values()]
        confirmed = {each.get("confirmed") for each in states}
        if status != 0 or len(confirmed) != 1 or any(each.get("pending") for each in states):
            violations.append(f"the second deployment does not end well (status {status}): {said}")
            return tries
        if {each["current"] for each in states} != {f"releases/{release}" for release in confirmed}:
            violations.append("`current` names another release than the confirmed one")
        if not start:
            return tries
        before = sum(len(host.runs) for host in self.hosts.values())
        if self.run(*self.operation("start")) or sum(len(host.runs) for host in self.hosts.values()) - before != 4:
            violations.append(f"the repaired fleet does not start: {self.log.read_text()}")
        if self.run(*self.operation("stop")):
            violations.append(f"the repaired fleet does not stop: {self.log.read_text()}")
        return tries


def has_ended(process: int) -> bool:
    """Return whether a child has ended, and leave it to be waited for."""
    return os.waitid(os.P_PID, process, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def ended(process: int) -> int:
    """Wait for a process; return its exit status, that of a signal negative. One that takes too long is killed."""
    end = time.monotonic() + PATIENCE
    while True:
        found, status = os.waitpid(process, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > end:
            kill(process)
        time.sleep(0.01)


@contextmanager
def hosts_in(folder: Path) -> Iterator[SshFleet]:
    """Run isolated hosts below an empty folder."""
    Path("/run/sshd").mkdir(exist_ok=True)  # sshd wants it
    fleet = SshFleet(folder, sorted(set(ROBOTS.values())), IsolatedHost)
    with ExitStack() as opened:  # closes the other hosts also when an interrupt comes while one is closed
        for host in fleet.hosts.values():
            assert isinstance(host, IsolatedHost)
            opened.callback(host.close)
            host.start()
        fleet.write()
        yield fleet


def table(records: Sequence[dict[str, Any]]) -> str:
    """Return a line for each kind of fault: outcomes before the second deployment, and violations."""
    lines = [f"{'fault':<16} trials  " + "  ".join(f"{each:>11}" for each in OUTCOMES) + "  tries > 1  violations"]
    for kind in KINDS:
        own = [each for each in records if each["kind"] == kind]
        counts = Counter(each["outcome"] for each in own)
        cells = "  ".join(f"{counts[each]:>11}" for each in OUTCOMES)
        again, wrong = sum(each["tries"] > 1 for each in own), sum(bool(each["violations"]) for each in own)
        lines.append(f"{kind:<16} {len(own):>6}  {cells}  {again:>9}  {wrong:>10}")
    phases = Counter(each["phase"] for each in records)
    lines.append("phases at the fault: " + ", ".join(f"{phase} {count}" for phase, count in phases.most_common()))
    return "\n".join(lines)


def campaign(folder: Path, count: int, seed: int) -> list[dict[str, Any]]:
    """Run the trials from 0 to `count` whose records are not in the folder yet; return all records."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"trials-{seed}.jsonl"
    records = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    done = {each["number"] for each in records}
    waiting = [number for number in range(count) if number not in done]
    if not waiting:
        return records
    work = folder / f"hosts-{os.getpid()}"
    with hosts_in(work / "ssh") as ssh, path.open("a") as file:
        trials = Trials(Deployed(work, ssh, ROBOTS), work / "said")
        for version in (1, 2):
            trials.fleet.write(version)
            assert trials.run(*trials.operation("deploy")) == 0, trials.log.read_text()
        for number in waiting:
            record = trials.trial(number, seed)
            records.append(record)
            file.write(json.dumps(record) + "\n")
            file.flush()
            shown = " | ".join(record["violations"]) or "held"
            print(f"{number}: {record['kind']} in {record['phase']}: {record['outcome']}; {shown}", flush=True)
    shutil.rmtree(work, ignore_errors=True)
    return records


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.operate.fault_trials")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=Path("build/fault-trials"))
    options = parser.parse_args()
    records = campaign(options.folder.resolve(), options.count, options.seed)
    print(table(records))
    return 1 if any(each["violations"] for each in records) else 0


if __name__ == "__main__":
    raise SystemExit(main())
