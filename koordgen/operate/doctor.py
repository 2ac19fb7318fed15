"""`koordgen doctor`: runs the checks of a robot's bundle on this computer, with this Python."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

from koordgen import __version__

_VERSION = re.compile(r'^__version__ = "([^"]*)"', re.MULTILINE)


class CannotExamine(Exception):
    """Raised if the bundle cannot be run; `help` says what to do."""

    def __init__(self, message: str, help: str) -> None:
        super().__init__(message)
        self.help = help


class NoBundle(CannotExamine):
    """Raised if the folder is not a robot's bundle built by this version of koordgen."""


def robots_bundle(path: str) -> Path:
    """Return the folder of one robot's bundle. Raises NoBundle."""
    folder = Path(path)
    build = "`koordgen build fleet.yaml`, or `koordgen build APP.koord --fleet FILE`, writes a folder for each robot"
    if not folder.is_dir():
        raise NoBundle(f"{path}: no such folder", build)
    if not (folder / "__main__.py").is_file() or not (folder / "koordgen/runtime").is_dir():
        inside = sorted(p.name for p in folder.iterdir() if _is_robots(p))
        raise NoBundle(f"{path}: not a bundle", f"name one of {', '.join(inside)} in it" if inside else build)
    if not _is_robots(folder):
        agents = ", ".join(sorted(str(p) for p in folder.glob("agents/*") if _is_robots(p)))
        help = f"the robots that it runs: {agents}" if agents else build
        raise NoBundle(f"{path}: this bundle runs a whole fleet on this computer, so it is not a robot's bundle", help)
    version = _version(folder)
    if version != __version__:
        help = f"build the bundle again, or run its own check: {sys.executable} {path} --doctor"
        raise NoBundle(f"{path}: the bundle was made by koordgen {version}, and this is koordgen {__version__}", help)
    return folder


def _is_robots(folder: Path) -> bool:
    """Return whether a folder has one robot's program, or those of its applications."""
    programs = any((folder / name).is_file() for name in ("program.py", "applications.py"))
    return programs and not (folder / "agents").is_dir()


def _version(folder: Path) -> str:
    try:
        found = _VERSION.search((folder / "koordgen/__init__.py").read_text(encoding="utf-8", errors="replace"))
    except OSError:
        found = None
    return found[1] if found else "of unknown version"


def examine(path: str, settings: str | None, form: str) -> int:
    """Run a bundle with `--doctor`, which prints the results of its checks; return its exit status.

    Raises CannotExamine.
    """
    command = [sys.executable, str(robots_bundle(path).resolve()), "--doctor", f"--format={form}"]
    if settings is not None:
        command.append(f"--settings={settings}")
    status = subprocess.run(command, check=False).returncode
    if status < 0:
        raise CannotExamine(f"{path}: the bundle was killed by {signal.Signals(-status).name}", "start it again")
    return status
