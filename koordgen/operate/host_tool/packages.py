"""Packages of agents: virtual environments, made without network from wheels that a deployment stored."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from .folder import RESERVE, Folder, ToolError, make_folder, read_json, remove_tree, write_file, write_json

_GROWTH = 5  # upper bound of an installed package's size, with its compiled modules, divided by the size of its wheel
_TIME = 1800.0  # time limit of one command in seconds: a small computer may have to unpack hundreds of megabytes
_COMPLETE = "wheels.json"  # list of an environment's wheels, written last: it marks a complete environment


def make(folder: Folder, digest: str, requirements: str, wheels: Sequence[str]) -> bool:
    """Make the virtual environment `digest` from stored wheels; return False if it exists already.

    One of the wheels must be pip's, because Debian's own Python has no ensurepip.
    """
    place = folder.venv(digest)
    paths = [folder.wheel(name) for name in wheels]
    if (place / _COMPLETE).exists() and (place / "bin" / "python").exists():
        return False
    absent = [path.name for path in paths if not path.exists()]
    if absent:
        raise ToolError("missing", f"wheels are missing on this host: {', '.join(absent)}", "store them first")
    pip = next((path for path in paths if path.name.startswith("pip-")), None)
    if pip is None:
        raise ToolError("bad request", "the wheels contain no wheel of pip")
    with folder.room(_GROWTH * sum(path.stat().st_size for path in paths) + RESERVE):
        make_folder(folder.venvs)
        remove_tree(place)
        try:
            _fill(place, pip, requirements, paths)
            write_json(place / _COMPLETE, sorted(wheels))
        except BaseException:
            remove_tree(place)
            raise
    return True


def wheels_of(place: Path) -> list[str]:
    """Return the names of the wheels of an environment."""
    found = read_json(place / _COMPLETE)
    return [str(each) for each in found] if isinstance(found, list) else []


def _fill(place: Path, pip: Path, requirements: str, wheels: Sequence[Path]) -> None:
    _run([sys.executable, "-I", "-m", "venv", "--without-pip", str(place)])
    # this folder contains only the wheels of this environment, so pip cannot find other wheels
    source = place / "wheels"
    source.mkdir()
    for path in wheels:
        os.link(path, source / path.name)
    write_file(place / "requirements.txt", requirements.encode())
    options = ["--isolated", "--no-index", "--no-cache-dir", "--disable-pip-version-check", "--no-input"]
    python = str(place / "bin" / "python")
    wanted = ["--find-links", str(source), "-r", str(place / "requirements.txt")]
    _run([python, str(source / pip.name / "pip"), "install", *options, *wanted])
    remove_tree(source)


def _run(command: Sequence[str]) -> None:
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PIP_", "PYTHON"))}
    try:
        done = subprocess.run(
            command, env=kept, timeout=_TIME, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace"
        )
    except subprocess.TimeoutExpired:
        raise ToolError("packages", f"the packages are still not installed after {_TIME:.0f} s", "try again") from None
    if done.returncode:
        said = (done.stderr or done.stdout).strip()
        if "No space left on device" in said:
            raise OSError(28, "No space left on device")
        raise ToolError("packages", f"the packages cannot be installed: {said[-1000:]}")
