"""systemd user units of agents: one unit for each robot, without root privileges.

The units do not use `ProtectSystem=`. In a user unit it needs a user namespace, in which an agent would lose the groups
that let it open serial ports. The units use only limits that need no namespace.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterable, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

from . import logs
from .deployment import Boot
from .entry import command
from .folder import Folder, ToolError, checked_robot, make_folder, write_file
from .releases import to_document

WATCHDOG = 20  # an agent is killed if its round loop sends no watchdog message for this many seconds
STOP = 300  # seconds that a robot may take to land or to brake before its agent is killed
NO_RESTART = (0, 1, 2, 3, 130)  # a restart would not help after these exit statuses of an agent
_START = 300  # time limit in seconds until an agent is ready: it compiles C code and opens its links first
_TIME = 30.0  # time limit in seconds of systemctl commands that only pass a request to systemd


def runtime_folder() -> Path:
    """Return the user's runtime folder, which contains the socket of the user's systemd manager."""
    return Path(os.environ.get("XDG_RUNTIME_DIR") or f"/run/user/{os.getuid()}")


def has_systemd() -> bool:
    """Return whether a systemd manager of this user runs."""
    return (runtime_folder() / "systemd" / "private").exists()


def unit_name(folder: Folder, robot: str) -> str:
    """Return the name of a robot's unit.

    The name contains a hash of the fleet's folder, so that fleets on one host have different units.
    """
    name = re.sub(r"[^A-Za-z0-9_]", "_", folder.root.name)
    return f"koordgen-{name}-{sha256(os.fsencode(folder.root)).hexdigest()[:6]}-{checked_robot(robot)}.service"


def unit_text(folder: Folder, boot: Boot, robot: str) -> str:
    """Return the text of a robot's unit file. The text does not depend on the release."""
    start = " ".join(_quoted(word) for word in command(folder, boot, "launch", robot))
    return f"""[Unit]
Description=koordgen: agent of robot {robot}
StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
ExecStart={start}
WorkingDirectory={_escaped(str(folder.root))}
Environment={_quoted("PATH=" + os.environ.get("PATH", os.defpath))}
Restart=on-failure
RestartSec=1
RestartPreventExitStatus={" ".join(str(status) for status in NO_RESTART if status)}
WatchdogSec={WATCHDOG}
TimeoutStartSec={_START}
TimeoutStopSec={STOP}
KillMode=mixed
KillSignal=SIGTERM
UMask=0077
NoNewPrivileges=yes
RestrictSUIDSGID=yes
LimitNOFILE=4096
LimitCORE=0
TasksMax=256

[Install]
WantedBy=default.target
"""


def _escaped(text: str) -> str:
    return text.replace("%", "%%")


def _quoted(word: str) -> str:
    for character in ("\\", '"'):
        word = word.replace(character, "\\" + character)
    return f'"{_escaped(word).replace("$", "$$")}"'


def start(folder: Folder, boot: Boot, robots: Sequence[str]) -> None:
    """Write the units, start them, and enable them for each boot. Wait until all agents are ready."""
    if not has_systemd():
        raise ToolError(
            "no systemd",
            f"no systemd manager of this user runs (nothing listens in {runtime_folder()})",
            "run `sudo loginctl enable-linger $USER` on the host once, or set `service: none` in the fleet file",
        )
    place = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "systemd" / "user"
    make_folder(place)
    units = [unit_name(folder, robot) for robot in robots]
    for robot, unit in zip(robots, units, strict=True):
        write_file(place / unit, unit_text(folder, boot, robot).encode())
    _systemctl("daemon-reload")
    for arguments in (("start", *units), ("enable", *units)):
        status, _, said = _systemctl(*arguments, seconds=_START + _TIME)
        if status:
            raise ToolError("not started", said.strip()[-500:] or "systemctl failed", "`koordgen logs` shows why")


def stop(folder: Folder, robots: Sequence[str]) -> None:
    """Disable the units and request systemd to stop the agents, without waiting for their end."""
    units = [unit_name(folder, robot) for robot in robots]
    _systemctl("disable", *units)
    _systemctl("stop", "--no-block", *units)


def active(folder: Folder, robots: Iterable[str]) -> set[str]:
    """Return the robots whose units are running, starting, stopping or about to be restarted."""
    names = {unit_name(folder, robot): robot for robot in robots}
    if not names or not has_systemd():
        return set()
    _, said, _ = _systemctl("show", "--property=Id,ActiveState", *names)
    found = set()
    for block in said.split("\n\n"):
        values = dict(line.partition("=")[::2] for line in block.splitlines())
        if values.get("ActiveState") in ("active", "activating", "deactivating", "reloading"):
            found |= {names[each] for each in (values.get("Id", ""),) if each in names}
    return found


def journal(folder: Folder, robot: str, most: int, since: float | None) -> list[logs.Line]:
    """Return the log lines of a robot's unit, oldest first."""
    limit = ["--since", f"@{int(since)}"] if since is not None else ["--lines", str(most)]
    arguments = ["journalctl", "--user", "--no-pager", "--output", "json", "--unit", unit_name(folder, robot)]
    status, said, errors = _run([*arguments, *limit], _TIME)
    if status:
        raise ToolError(
            "no journal", errors.strip()[-500:] or "journalctl failed", "check that systemd stores its journal on disk"
        )
    found = []
    for line in said.splitlines():
        entry = to_document(line)
        if isinstance(entry, dict) and "__REALTIME_TIMESTAMP" in entry:
            found.append((int(entry["__REALTIME_TIMESTAMP"]) / 1e6, _message(entry.get("MESSAGE"))))
    return found


def _message(value: Any) -> str:
    """Return the text of a journal entry; journalctl prints text that is not UTF-8 as a list of bytes."""
    return bytes(value).decode("utf-8", "replace") if isinstance(value, list) else str(value or "")


def _systemctl(*arguments: str, seconds: float = _TIME) -> tuple[int, str, str]:
    return _run(["systemctl", "--user", *arguments], seconds)


def _run(command: Sequence[str], seconds: float) -> tuple[int, str, str]:
    runtime = runtime_folder()
    environment = os.environ | {
        "XDG_RUNTIME_DIR": str(runtime),
        "DBUS_SESSION_BUS_ADDRESS": os.environ.get("DBUS_SESSION_BUS_ADDRESS", f"unix:path={runtime}/bus"),
    }
    try:
        done = subprocess.run(
            command, env=environment, timeout=seconds, stdin=subprocess.DEVNULL, capture_output=True, text=True,
            errors="replace",
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return 124, "", f"{command[0]} did not end in {seconds:.0f} s"
    except OSError as error:
        return 127, "", f"{command[0]}: {error.strerror}"
    return done.returncode, done.stdout, done.stderr
