"""Python packages of robots: wheels for each host's platform, fetched on this computer.

A platform is a processor, a C library and a version of Python. Robots may have no access to the internet. `pip
download` therefore fetches the packages of a bundle's requirements.txt, and pip itself, into a cache on this computer.
The cache holds complete sets of wheels only.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from koordgen.lang.node import Node
from koordgen.operate.release import digest_of
from koordgen.runtime.ops.host import pip_install, requirement_for

PIP = "pip"  # pip's wheel installs the packages on a host, because Debian's own Python has no ensurepip
DOWNLOAD_TIMEOUT = 900.0  # time limit for one download, in seconds
_OLDEST_GLIBC = 17  # minor version of glibc 2 that manylinux2014 requires
_PYTHONS = range(10, 15)  # minor versions of Python 3 on which agents run
_WIDE = ("x86_64", "aarch64", "riscv64", "ppc64le", "s390x", "loongarch64", "amd64", "arm64")


class CannotFetch(Exception):
    """Raised if the wheels for a platform cannot be fetched; `help` says what to do."""

    def __init__(self, message: str, help: str) -> None:
        super().__init__(message)
        self.help = help


class WheelPlatform(Node):
    """Platform for which wheels are fetched.

    machine: processor, as `uname -m` prints it.
    glibc: minor version of glibc 2; None: musl.
    python: minor version of Python 3.
    """

    machine: str
    glibc: int | None
    python: int

    @property
    def title(self) -> str:
        """Return a description of the platform for messages."""
        libc = "musl" if self.glibc is None else f"glibc 2.{self.glibc}"
        return f"{self.machine}, {libc}, Python 3.{self.python}"


class WheelSet(Node):
    """All wheels for one platform. `venv`: name of the virtual environment that is made from the wheels."""

    venv: str
    requirements: str
    files: dict[str, Path]  # file name -> path
    digests: dict[str, str]  # file name -> SHA-256


def platform_of(inspected: Mapping[str, Any]) -> WheelPlatform:
    """Return the platform of a host from its answer to `inspect`.

    Raises CannotFetch if agents cannot run on it.
    """
    machine, (libc, version) = str(inspected["machine"]), inspected["libc"]
    major, minor = inspected["python"][:2]
    if machine not in _WIDE:
        help = "the packages have no 32-bit wheels: install a 64-bit system on the host"
        raise CannotFetch(f"the host's processor is {machine}, but agents need a 64-bit processor", help)
    if major != 3 or minor not in _PYTHONS:
        help = "name an interpreter from 3.10 to 3.14 in the fleet file: `deploy: {python: python3.11}`"
        raise CannotFetch(f"the host's Python is {major}.{minor}, but agents need 3.10 to 3.14", help)
    glibc = re.fullmatch(r"2\.(\d+).*", str(version)) if libc == "glibc" else None
    return WheelPlatform(machine, int(glibc[1]) if glibc else None, minor)


def wheel_set(requirements: str, platform: WheelPlatform, folder: Path | None) -> WheelSet:
    """Return the wheels for the text of a requirements.txt. Raises CannotFetch.

    folder: folder of wheels to use; None: use the package index. Wheels that are in the cache are not fetched again.
    """
    lines = needed_lines(requirements, platform)
    if folder is not None and not folder.is_dir():
        raise CannotFetch(f"deploy.wheels: {folder}: no such folder", "the path is relative to the fleet file's folder")
    key = digest_of([lines, platform.machine, platform.glibc, platform.python, _from_folder(folder)])[:32]
    kept = _cache() / key
    if not kept.is_dir():
        _download([*lines, PIP], platform, folder, kept)
    files = {path.name: path for path in sorted(kept.glob("*.whl"))}
    digests = {name: sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    text = "".join(f"{line}\n" for line in lines)
    return WheelSet(digest_of([text, digests, platform.python])[:32], text, files, digests)


def needed_lines(requirements: str, platform: WheelPlatform) -> list[str]:
    """Return the lines of a requirements.txt that apply to a platform, without their environment markers.

    `pip download` would evaluate the markers for this computer's Python instead of the host's. Raises CannotFetch for a
    line in another format.
    """
    found: dict[str, None] = {}
    for line in filter(None, (each.partition("#")[0].strip() for each in requirements.splitlines())):
        try:
            found[requirement_for(line, (3, platform.python), platform.machine)] = None
        except ValueError as error:
            raise CannotFetch(f"requirements.txt: {error}", "write lines as NAME==VERSION or NAME>=VERSION") from None
    return sorted(filter(None, found))


def platform_tags(platform: WheelPlatform) -> list[str]:
    """Return the platform tags of wheels that run on a platform, best first."""
    machine = platform.machine
    if platform.glibc is None:
        return [f"musllinux_1_2_{machine}", f"musllinux_1_1_{machine}"]
    tags = [f"manylinux_2_{minor}_{machine}" for minor in range(platform.glibc, _OLDEST_GLIBC - 1, -1)]
    tags += [f"manylinux2014_{machine}"]
    if machine == "x86_64":
        tags += ["manylinux_2_12_x86_64", "manylinux2010_x86_64", "manylinux_2_5_x86_64", "manylinux1_x86_64"]
    return [*tags, f"linux_{machine}"]


def _from_folder(folder: Path | None) -> list[list[Any]]:
    """Return a fingerprint of a folder of wheels, which changes when a file changes."""
    if folder is None:
        return []
    found = []
    for path in sorted(folder.glob("*.whl")):
        state = path.stat()
        found.append([str(path.resolve()), state.st_size, state.st_mtime_ns])
    return found


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "koordgen/wheels"


def _download(lines: list[str], platform: WheelPlatform, folder: Path | None, kept: Path) -> None:
    """Run `pip download` into a temporary folder, and rename it to `kept` when all wheels are there."""
    where = ["--no-index", "--find-links", str(folder)] if folder is not None else []
    command = [
        sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--only-binary", ":all:",
        "--implementation", "cp", "--python-version", f"3.{platform.python}",
        "--abi", f"cp3{platform.python}", "--abi", "abi3", "--abi", "none", *where,
    ]  # fmt: skip
    for tag in platform_tags(platform):
        command += ["--platform", tag]
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=kept.parent, prefix=".fetching-") as beside:
            result = _run([*command, "--dest", f"{beside}/wheels", *lines])
            if result.returncode:
                raise _refused(result.stderr, platform, folder)
            os.rename(f"{beside}/wheels", kept)
    except OSError as error:
        if not kept.is_dir():  # if the folder exists, another process has fetched the same wheels
            help = "free disk space on this computer"
            raise CannotFetch(f"{error.filename or kept}: {error.strerror}", help) from None


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=DOWNLOAD_TIMEOUT, check=False)
    except subprocess.TimeoutExpired:
        message = f"the package index did not deliver the wheels within {DOWNLOAD_TIMEOUT:g} s"
        raise CannotFetch(message, "connect this computer to the internet, or set `deploy: {wheels: FOLDER}`") from None


def _refused(output: str, platform: WheelPlatform, folder: Path | None) -> CannotFetch:
    """Return the error for the output `output` of a pip that failed."""
    if "No module named pip" in output:
        return CannotFetch("this computer's Python has no pip, which fetches wheels", pip_install("pip"))
    missing = re.search(r"No matching distribution found for (\S+)", output)
    unreached = re.search(r"connection|resolve|timed out|network", output, re.IGNORECASE) and folder is None
    if missing and not unreached:
        place = f"in {folder}" if folder else "at the package index"
        help = "choose another Python: `deploy: {python: ...}`; or build the wheels: `deploy: {wheels: FOLDER}`"
        return CannotFetch(f"there is no wheel of {missing[1]} {place} for the host ({platform.title})", help)
    last = next((line for line in reversed(output.splitlines()) if line.strip()), "pip failed").strip()
    help = "connect this computer to the internet, or set `deploy: {wheels: FOLDER}`"
    return CannotFetch(f"wheels for {platform.title} cannot be fetched: {last}", help)
