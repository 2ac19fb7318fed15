"""Checks of a robot's computer and bundle that need only Python's standard library.

The checks run before any import of a package that may be missing."""

from __future__ import annotations

import ctypes
import os
import platform
import re
import shlex
import shutil
import struct
import sys
import sysconfig
import time
from collections.abc import Callable
from contextlib import suppress
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from koordgen.runtime.vehicle.platform import Finding

SUMS, REQUIREMENTS, SETTINGS = "SHA256SUMS", "requirements.txt", "settings.json"
ROOM = 100_000_000  # a warning is shown if the disk has fewer free bytes
JUMP = 0.05  # largest deviation of the wall clock from the monotonic clock during the checks, in seconds
_REQUIREMENT = re.compile(
    r"(?P<name>[A-Za-z0-9._-]+)\s*(?P<relation>==|>=)\s*(?P<version>[0-9][^\s;]*)"
    r"(?:\s*;\s*python_version\s*(?P<when>[<>]=?)\s*'(?P<python>[0-9.]+)'"
    r"(?:\s+and\s+platform_machine\s*==\s*'(?P<machine>\w+)')?)?"
)
_UNSYNCHRONISED = 5  # TIME_ERROR of adjtimex(2)


def host(root: Path) -> list[Finding]:
    """Check the bundle in `root` and this computer, as far as the checks need no settings of the robot."""
    # The check of Python's version always passes: a Python that is too old cannot load this module.
    running = Finding("python", "ok", f"{platform.python_version()}, {sys.executable}")
    return [running, processor(), packages(root), files(root)]


def processor() -> Finding:
    """Check that the processor has 64 bits and at least two cores."""
    bits, cores = struct.calcsize("P") * 8, os.cpu_count() or 1
    told = f"{platform.machine()}, {bits} bits, {cores} core{'s' if cores > 1 else ''}"
    if bits != 64:
        return Finding(
            "processor", "fail", told, "64 bits", "the packages have no 32-bit wheels: install a 64-bit system"
        )
    if cores == 1:
        return Finding("processor", "warn", told, "2 cores or more", "planning and the control loop share the one core")
    return Finding("processor", "ok", told)


def packages(root: Path, installed: Callable[[str], str] = version) -> Finding:
    """Check that the packages of requirements.txt are installed in the tested versions."""
    try:
        lines = (root / REQUIREMENTS).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return Finding("packages", "warn", f"no {REQUIREMENTS}", why="the required packages are unknown")
    missing, others, right = [], [], 0
    for line in filter(None, map(str.strip, lines)):
        named = _REQUIREMENT.fullmatch(line)
        if named is None:
            others.append(f"{line!r} cannot be parsed")
        elif _applies(named):
            try:
                has = installed(named["name"])
            except PackageNotFoundError:
                missing.append(named["name"])
                continue
            if _fits(named, has):
                right += 1
            else:
                others.append(f"{named['name']} is {has}, not {named['version']}")
    if not missing and not others:
        return Finding("packages", "ok", f"all {right} of {REQUIREMENTS} are installed")
    told = "; ".join([f"not installed: {', '.join(missing)}"] * bool(missing) + others)
    wanted = f"the {REQUIREMENTS} packages"
    return Finding("packages", "fail" if missing else "warn", told, wanted, install_requirements(root))


def install_requirements(root: Path) -> str:
    """Return the shell command that installs the requirements of the bundle in `root`.

    If pip requires a virtual environment, the command creates one beside the bundle."""
    return pip_install(f"-r {shlex.quote(str(root / REQUIREMENTS))}", root.resolve().parent / "venv")


def pip_install(what: str, venv: Path | None = None) -> str:
    """Return the shell command that installs `what` (arguments of `pip install`) for this Python.

    On Debian and Raspberry Pi OS, pip refuses to change the system's Python (PEP 668). On these systems the command
    creates the virtual environment `venv` (default: ~/koordgen-venv), and the text names the Python to use."""
    python = shlex.quote(sys.executable)
    if _externally_managed():
        folder = venv or Path(os.path.expanduser("~/koordgen-venv"))
        own = shlex.quote(str(folder / "bin/python"))
        reason = f"pip installs nothing into {sys.executable} (externally-managed-environment)"
        command = f"{python} -m venv {shlex.quote(str(folder))} && {own} -m pip install {what}"
        return f"{command}; then start it with {own}, because {reason}"
    if find_spec("pip") is None:
        if shutil.which("uv"):
            return f"uv pip install --python {python} {what}"
        return f"{python} -m ensurepip && {python} -m pip install {what}"
    return f"{python} -m pip install {what}"


def _externally_managed() -> bool:
    """Return whether pip refuses to install packages into the running Python, by the test that pip uses."""
    in_venv = sys.prefix != sys.base_prefix
    return not in_venv and (Path(sysconfig.get_path("stdlib")) / "EXTERNALLY-MANAGED").is_file()


def needed(line: str) -> str:
    """Return the name of the package in a line of requirements.txt.

    Return "" if the markers of the line exclude this Python or computer. Raises ValueError for a line that cannot be
    parsed."""
    named = _understood(line)
    return named["name"] if _applies(named) else ""


def requirement_for(line: str, python: tuple[int, int], machine: str) -> str:
    """Return a line of requirements.txt without its markers, such as "a==1".

    Return "" if the markers exclude a computer with Python version `python` and processor `machine`. Raises ValueError
    for a line that cannot be parsed."""
    named = _understood(line)
    applies = _applies(named, python, machine)
    return f"{named['name']}{named['relation']}{named['version']}" if applies else ""


def _understood(line: str) -> re.Match[str]:
    named = _REQUIREMENT.fullmatch(line)
    if named is None:
        raise ValueError(f"{line!r} cannot be parsed")
    return named


def _applies(named: re.Match[str], python: tuple[int, int] | None = None, machine: str | None = None) -> bool:
    """Return whether the markers of a requirement match a Python version and a processor.

    Default: the Python and the processor of this computer."""
    if named["when"] is None:
        return True
    if named["machine"] not in (None, machine or platform.machine()):
        return False
    here, there = python or sys.version_info[:2], _numbers(named["python"])
    return {"<": here < there, "<=": here <= there, ">": here > there, ">=": here >= there}[named["when"]]


def _fits(named: re.Match[str], has: str) -> bool:
    return has == named["version"] or (named["relation"] == ">=" and _numbers(has) >= _numbers(named["version"]))


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", text))


def files(root: Path) -> Finding:
    """Check that the files of the bundle are complete and unchanged since the build.

    Changed settings cause a warning. Changed code causes an error, because the changed code was not tested, and robots
    with different programs refuse each other's messages."""
    try:
        whole = (root / SUMS).read_text(encoding="utf-8").splitlines()
        lines = [line for line in whole if not line.startswith("#")]
    except (OSError, UnicodeDecodeError):
        return Finding("files", "warn", f"no {SUMS}", why="the bundle cannot be verified: copy it again")
    listed = {path: digest for digest, _, path in (line.partition("  ") for line in lines)}
    wrong = [f"{path} is {state}" for path, digest in listed.items() if (state := _state(root / path, digest))]
    if not wrong:
        return Finding("files", "ok", f"{len(listed)} files as they were built")
    if wrong == [f"{SETTINGS} is changed"]:
        return Finding("files", "warn", wrong[0], why="the settings of this robot differ from the fleet file")
    more = f" and {len(wrong) - 1} more" if len(wrong) > 1 else ""
    return Finding("files", "fail", wrong[0] + more, "as they were built", "build the bundle again, and copy all of it")


def is_bundled(root: Path, module: str) -> bool:
    """Return whether a Python module is a file of the bundle as it was built."""
    try:
        lines = (root / SUMS).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return False
    path = module.replace(".", "/")
    return not {f"{path}.py", f"{path}/__init__.py"}.isdisjoint(line.partition("  ")[2] for line in lines)


def _state(path: Path, digest: str) -> str:
    try:
        return "" if sha256(path.read_bytes()).hexdigest() == digest else "changed"
    except FileNotFoundError:
        return "missing"
    except OSError as error:
        return f"not readable ({error.strerror})"


def temperature() -> float | None:
    """Return the temperature of the computer's hottest thermal zone in degrees Celsius, or None if it is unknown."""
    found = []
    for zone in Path("/sys/class/thermal").glob("thermal_zone*/temp"):
        with suppress(OSError, ValueError):
            found.append(int(zone.read_text()) / 1000)
    return max(found, default=None)


def disk(folder: Path) -> Finding:
    """Check that the robot can store its state in `folder`. The folder may be missing yet."""
    standing = next(place for place in (folder, *folder.parents) if place.exists())
    try:
        free = shutil.disk_usage(standing).free
    except OSError as error:
        return Finding("disk", "fail", f"{standing}: {error.strerror}", why="the robot stores its state in this folder")
    told = f"{free / 1e6:.0f} MB free in {standing}"
    if not os.access(standing, os.W_OK | os.X_OK):
        return Finding(
            "disk", "fail", f"{standing} cannot be written", why="the robot stores its state in this folder: `chown` it"
        )
    if free < ROOM:
        return Finding("disk", "warn", told, f"{ROOM / 1e6:.0f} MB", "free disk space: a full disk ends the trace")
    return Finding("disk", "ok", told)


class Clocks:
    """Check that the wall clock does not jump between the creation of this object and the call of `finding`.

    The wall clock is compared with the monotonic clock, which rounds use. A jump of the wall clock does not disturb
    rounds. It only makes times in logs of several computers differ."""

    def __init__(self, monotonic: Callable[[], float] = time.monotonic, wall: Callable[[], float] = time.time) -> None:
        self._monotonic, self._wall = monotonic, wall
        self._began = wall() - monotonic()

    def finding(self, synchronised: Callable[[], bool | None] | None = None) -> Finding:
        jump = self._wall() - self._monotonic() - self._began
        if abs(jump) > JUMP:
            why = "something sets the wall clock, so times in logs do not match; rounds are not affected"
            return Finding("clock", "warn", f"the wall clock jumped by {jump:+.2f} s", "no jumps", why)
        known = (synchronised or ntp)()
        told = "steady" if known is None else f"steady, {'' if known else 'not '}synchronised by NTP"
        return Finding("clock", "ok", told)


def ntp() -> bool | None:
    """Return whether the kernel considers the system's clock synchronised, or None if this is unknown.

    adjtimex(2) reads the state without changing the clock."""
    with suppress(OSError, AttributeError):
        state = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(512))  # struct timex has 208 bytes
        return None if state < 0 else bool(state != _UNSYNCHRONISED)
    return None
