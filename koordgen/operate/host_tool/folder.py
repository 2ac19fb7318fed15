"""Folder of one fleet on one host: layout, atomic writes, checks of names, and the tool's exception."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from hashlib import blake2s, sha256
from pathlib import Path
from typing import Any

RESERVE = 64 * 1024 * 1024  # number of bytes that a deployment leaves free on the disk
SMALL = 1024 * 1024  # free bytes that a request for small files needs
PIECE = 1024 * 1024  # number of bytes that are read in one call

_NAME = r"[a-z][a-z0-9_-]{0,31}"
_ROBOT = re.compile(rf"{_NAME}(?:\.{_NAME})?")  # a robot of a squad is called SQUAD.ROBOT
OUTER = "outer"  # of a robot of a squad: name of the settings, and of the folder of traces, of the outer robot
_RELEASE = re.compile(r"[0-9a-f]{16}")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_DIGEST = re.compile(r"[0-9a-f]{16,64}")
_WHEEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.!+-]{0,250}\.whl")
_PART = re.compile(r"[A-Za-z0-9_.@+,=-][A-Za-z0-9_.@+,= -]{0,254}")


class ToolError(Exception):
    """Raised if the tool refuses a request.

    code: identifies the error for programs.
    message: describes the error for users.
    help: tells users what to do.
    """

    def __init__(self, code: str, message: str, help: str = "") -> None:
        super().__init__(message)
        self.code, self.message, self.help = code, message, help


class Folder:
    """Paths of the fleet's folder `root`, an absolute path without symbolic links."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.objects = root / "objects"
        self.releases = root / "releases"
        self.current = root / "current"
        self.deployment = root / "deployment.json"
        self.deployment_lock = root / "deployment.lock"
        self.lock = root / "lock"
        self.lock_owner = root / "lock.json"
        self.keys = root / "keys"
        self.settings = root / "settings"
        self.state = root / "state"
        self.traces = root / "traces"
        self.logs = root / "logs"
        self.venvs = root / "venvs"
        self.wheels = root / "wheels"
        self.pycache = root / "pycache"
        self.running = root / "running"

    def release(self, release: str) -> Path:
        return self.releases / checked_release(release)

    def bundle(self, release: str, robot: str) -> Path:
        return self.release(release) / checked_robot(robot)

    def key(self, key: str) -> Path:
        return self.keys / f"{checked(_RELEASE, key, 'a key id has 16 hex digits')}.key"

    def venv(self, digest: str) -> Path:
        return self.venvs / checked(_DIGEST, digest, "a digest of packages has 16 to 64 hex digits")

    def wheel(self, name: str) -> Path:
        return self.wheels / checked(_WHEEL, name, "a wheel's name must be a file name that ends in .whl")

    def object(self, digest: str) -> Path:
        return self.objects / checked_sha256(digest)

    def overlay(self, release: str, robot: str) -> Path:
        """Return the file of settings that override those of a robot's bundle.

        A robot of a squad has a folder of its own, because its bundle has two files of settings.
        """
        name = checked_robot(robot)
        return self.settings / checked_release(release) / (f"{name}/settings.json" if "." in name else f"{name}.json")

    def state_of(self, robot: str) -> Path:
        """Return the folder with the checkpoint of a robot. Robots of different squads may have equal names."""
        return self.state.joinpath(*checked_robot(robot).split(".")[:-1])

    def trace_folder(self, robot: str, is_outer: bool = False) -> Path:
        """Return the folder of a robot's traces, or of those of the squad that it hosted (`is_outer`)."""
        place = self.traces / checked_robot(robot)
        return place / OUTER if is_outer else place

    def log(self, robot: str) -> Path:
        return self.logs / f"{checked_robot(robot)}.log"

    def free(self) -> int:
        """Return how many bytes this user may still write to the disk."""
        return shutil.disk_usage(self.root).free

    @contextmanager
    def room(self, needed: int = SMALL) -> Iterator[None]:
        """Context manager for writing up to `needed` bytes. Raises ToolError "no space".

        The error is raised before the block if the bytes are not free, or when the disk becomes full during the block.
        """

        def full() -> ToolError:
            free = self.free()
            return ToolError(
                "no space",
                f"no space in {self.root}: {needed} bytes are needed and {free} are free",
                "delete files on this host, then try again",
            )

        if self.free() < needed:
            raise full()
        try:
            yield
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                raise full() from None
            raise


def checked(pattern: re.Pattern[str], value: Any, rule: str) -> str:
    """Return `value` if it is a string that matches `pattern`; else raise ToolError with `rule`."""
    if not isinstance(value, str) or not pattern.fullmatch(value):
        raise ToolError("bad request", f"{value!r}: {rule}")
    return value


def checked_robot(name: Any) -> str:
    if name in ("fleet", "state"):
        raise ToolError("bad request", f"{name!r}: no robot has this name")
    return checked(_ROBOT, name, "a robot's name has at most 32 characters: lower-case letters, digits, _ and -")


def checked_release(release: Any) -> str:
    return checked(_RELEASE, release, "a release id has 16 hex digits")


def checked_sha256(digest: Any) -> str:
    return checked(_SHA256, digest, "a SHA-256 has 64 hex digits")


def checked_path(path: Any) -> str:
    """Return `path` if it is a relative path that does not leave a folder; else raise ToolError."""
    parts = path.split("/") if isinstance(path, str) else []
    if not parts or len(path) > 1000 or not all(_PART.fullmatch(p) and p not in (".", "..") for p in parts):
        raise ToolError("bad request", f"{path!r}: not a relative path inside a bundle")
    return str(path)


def key_id(key: bytes) -> str:
    """Return the id of a key, a hash that does not reveal the key."""
    return blake2s(key, person=b"koordgen", digest_size=8).hexdigest()


def sha256_of(path: Path) -> str | None:
    """Return the SHA-256 of a regular file's content; None if the file is missing or cannot be read."""
    digest = sha256()
    try:
        with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC), "rb") as file:
            while piece := file.read(PIECE):
                digest.update(piece)
    except OSError:
        return None
    return digest.hexdigest()


def make_folder(path: Path, mode: int = 0o755) -> None:
    """Make a folder and its missing parents, and sync their directory entries to the disk."""
    if path.is_dir():
        return
    make_folder(path.parent)
    with suppress(FileExistsError):
        path.mkdir(mode=mode)
    sync_folder(path.parent)


def sync_folder(path: Path) -> None:
    folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def write_file(path: Path, content: bytes, mode: int = 0o644) -> None:
    """Replace a file atomically. After a power loss it has either its old content or all of `content`."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with open(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, mode), "wb") as file:
            os.fchmod(file.fileno(), mode)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    except OSError:
        with suppress(OSError):
            beside.unlink()
        raise
    sync_folder(path.parent)


def write_json(path: Path, value: Any, mode: int = 0o644) -> None:
    write_file(path, json.dumps(value, indent=1).encode() + b"\n", mode)


def read_json(path: Path) -> Any:
    """Return the content of a JSON file; None if it is missing or damaged."""
    try:
        return json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None


def remove_tree(path: Path) -> None:
    """Remove a folder or a file; errors are ignored."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()
