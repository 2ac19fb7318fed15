"""Facts about this host: computer, interpreter, disk, service manager."""

from __future__ import annotations

import getpass
import os
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from . import TOOL, agents, releases, service
from .deployment import Boot, Deployment
from .folder import Folder
from .lock import locked_by


def inspect(folder: Folder, boot: Boot, deployment: Deployment) -> dict[str, Any]:
    """Return the state of this host, which the operator's computer checks before it changes anything."""
    state = deployment.read()
    pending = state["pending"]
    found = agents.look(folder, releases.readable(folder, (state["confirmed"], pending and pending["id"])))
    return {
        "tool": TOOL,
        "user": getpass.getuser(),
        "home": str(Path.home()),
        "folder": str(folder.root),
        "machine": machine(),
        "libc": libc(),
        "python": list(sys.version_info[:3]),
        "free": folder.free(),
        "clock": time.time(),
        "writable": os.access(folder.root, os.W_OK),
        "systemd": service.has_systemd(),
        "linger": Path("/var/lib/systemd/linger", getpass.getuser()).exists(),
        "deployment": state,
        "current": deployment.current(),
        "releases": releases.staged(folder),
        "builds": releases.builds(folder, state["confirmed"]),
        "robots": {robot: each._asdict() for robot, each in found.items()},
        "locked": locked_by(folder),
        "boot": boot.id(),
        "uptime": boot.now(),
        "temperature": temperature(),
        "battery": None,
    }


def machine() -> str:
    """Return the processor architecture of the wheels that this Python needs.

    It differs from the kernel's architecture for a 32-bit Python on a 64-bit kernel.
    """
    name = os.uname().machine
    if sys.maxsize > 2**32:
        return name
    return {"aarch64": "armv7l", "armv8l": "armv7l", "x86_64": "i686"}.get(name, name)


def libc() -> list[str]:
    with suppress(OSError, ValueError, AttributeError):
        name, _, version = (os.confstr("CS_GNU_LIBC_VERSION") or "").partition(" ")
        if name:
            return [name, version]
    return ["musl", ""]


def temperature() -> float | None:
    """Return the temperature of the hottest thermal zone in degrees Celsius.

    Returns None if the kernel reports no temperature.
    """
    found = []
    for path in Path("/sys/class/thermal").glob("thermal_zone*/temp"):
        with suppress(OSError, ValueError):
            found.append(int(path.read_text()) / 1000)
    return max(found, default=None)
