"""Launch of agents, and detection of the agents that run on this host.

An agent that the tool launched holds the lock of `running/<robot>.lock` until its process ends. An agent that was
started by hand is detected by its control port, which is then in use on this host.
"""

from __future__ import annotations

import ipaddress
import os
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from . import releases, service
from .deployment import Deployment
from .folder import Folder, ToolError, checked_robot, make_folder, read_json
from .lock import deciding, is_locked, try_lock
from .releases import Release

# seconds after which a bundle's --status is ended; --status itself waits 2 s for the agent's answer
_TIME_FOR_STATUS = 30.0


class Found(NamedTuple):
    """State of one robot's agent.

    running: True if an agent of the robot runs.
    phase: phase that the agent reports; None if no agent answers at the control port.
    pid: the agent's process id; None if unknown.
    """

    running: bool
    phase: str | None
    pid: int | None


NOT_RUNNING = Found(False, None, None)


def lock_file(folder: Folder, robot: str) -> Path:
    """Return the lock file that a robot's agent holds until it ends.

    It contains the agent's process id as text.
    """
    return folder.running / f"{checked_robot(robot)}.lock"


def supervisor_lock(folder: Folder, robot: str) -> Path:
    """Return the lock file that the supervisor of a robot's agent holds, on hosts without systemd."""
    return folder.running / f"{checked_robot(robot)}.supervisor"


def write_pid(file: int) -> None:
    """Write this process's id into an open lock file."""
    os.ftruncate(file, 0)
    os.pwrite(file, str(os.getpid()).encode(), 0)


def pid_in(path: Path) -> int | None:
    """Return the id of the process that holds a lock file; None if no process holds it."""
    with suppress(OSError, ValueError):
        if is_locked(path):
            return int(path.read_text())
    return None


def look(folder: Folder, known: Sequence[Release], ask: bool = True) -> dict[str, Found]:
    """Return the agents' states, for all robots that a release in `known` or a lock file names.

    ask: also request each agent's phase, by the bundle in the first release that has the robot.
    """
    of_release: dict[str, Release] = {}
    for release in known:
        for robot in release.robots:
            of_release.setdefault(robot, release)
    names = sorted(of_release.keys() | _with_lock_file(folder))
    used = _used_udp()
    units = service.active(folder, [name for name, release in of_release.items() if release.service == "systemd"])

    def find(robot: str) -> Found:
        release = of_release.get(robot)
        running = robot in units or _runs(folder, robot) or _has_control_port(folder, release, robot, used)
        return _ask(folder, release, robot, ask) if running else NOT_RUNNING

    with ThreadPoolExecutor(max_workers=8) as pool:
        found = pool.map(find, names)
        return dict(zip(names, found, strict=True))


def check_none_runs(folder: Folder, known: Sequence[Release]) -> None:
    """Raise ToolError "in flight" if agents run; the message names the robots and their phases."""
    running = {robot: found for robot, found in look(folder, known).items() if found.running}
    if running:
        named = ", ".join(
            f"{robot} ({found.phase or 'its agent runs, but nothing answers at its control port'})"
            for robot, found in running.items()
        )
        raise ToolError("in flight", f"agents run on this host: {named}", "stop them first")


def _with_lock_file(folder: Folder) -> set[str]:
    if not folder.running.is_dir():
        return set()
    return {p.stem for p in folder.running.iterdir() if p.suffix in (".lock", ".supervisor")}


def _runs(folder: Folder, robot: str) -> bool:
    return is_locked(lock_file(folder, robot)) or is_locked(supervisor_lock(folder, robot))


def _ask(folder: Folder, release: Release | None, robot: str, ask: bool) -> Found:
    phase = None
    if release is not None and ask:
        options = ("--status", "--format", "json")
        status, output, _ = releases.run(folder, release, robot, *options, seconds=_TIME_FOR_STATUS)
        document = releases.to_document(output) if status == 0 else None
        phase = str(document.get("phase")) if isinstance(document, dict) else None
    return Found(True, phase, pid_in(lock_file(folder, robot)) or pid_in(supervisor_lock(folder, robot)))


def _has_control_port(folder: Folder, release: Release | None, robot: str, used: Iterable[tuple[str, int]]) -> bool:
    """Return whether a process on this host has a UDP socket at a robot's control port."""
    place = control_place(folder, release, robot) if release is not None else None
    if place is None:
        return False
    host, port = place
    return any(number == port and (not host or address in (host, "0.0.0.0", "::")) for address, number in used)


def control_place(folder: Folder, release: Release, robot: str) -> tuple[str, int] | None:
    """Return the address and UDP port of a robot's control port.

    The address is empty if the settings contain a host name instead.

    The port is chosen as by `Settings.control_port` in the bundle's runtime.
    """
    settings = read_json(folder.bundle(release.id, robot) / "settings.json")
    try:
        peer = settings["peers"][settings["pid"]]
        port, host = int(peer["port"]), str(settings.get("bind") or peer["host"])
        control = settings.get("control") or (port + 1000 if port + 1000 <= 65535 else port - 1000)
    except (AttributeError, KeyError, IndexError, TypeError, ValueError):
        return None
    try:
        return str(ipaddress.ip_address(host)), int(control)
    except ValueError:
        return "", int(control)


def _used_udp() -> set[tuple[str, int]]:
    """Return the address and port of each UDP socket of this host, from the kernel's tables."""
    used = set()
    for name in ("udp", "udp6"):
        with suppress(OSError):
            for line in Path("/proc/self/net", name).read_text(encoding="ascii").splitlines()[1:]:
                address, _, port = line.split()[1].partition(":")
                words = [int(address[i : i + 8], 16).to_bytes(4, sys.byteorder) for i in range(0, len(address), 8)]
                used.add((str(ipaddress.ip_address(b"".join(words))), int(port, 16)))
    return used


def launch(folder: Folder, deployment: Deployment, robot: str) -> None:
    """Replace this process by the agent of `robot`, from the confirmed release. Raises ToolError.

    The lock file stays open across exec, so the agent's process holds the lock until it ends.
    """
    path = lock_file(folder, robot)
    with deciding(folder):
        # ignore disk errors: a confirmed release must run even if the disk is full or read-only
        with suppress(OSError):
            deployment.repair()
        release = releases.read_release(folder, deployment.runnable())
        if robot not in release.robots:
            raise ToolError("unknown robot", f"release {release.id} has no robot {robot} on this host", "deploy again")
        wanted = releases.command(folder, release, robot)
        make_folder(folder.running)
        file = try_lock(path)
        if file is None:
            raise ToolError("running", f"robot {robot}: its agent runs already as process {pid_in(path)}")
        write_pid(file)
        os.set_inheritable(file, True)
        os.execve(wanted[0], wanted, releases.environment(folder))
