"""Loader of libraries that are compiled on the robot: once, cached, then called by ctypes or imported.

A library is loaded only from a folder and a file that this user owns and nobody else may write, and only if its content
has the digest in its name: a truncated or changed file is compiled again. Agents that start at the same time on one
host wait for the first one, which compiles for all."""

from __future__ import annotations

import ctypes
import fcntl
import os
import platform
import shutil
import stat
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

COMPILERS = ("cc", "gcc", "clang")
DIGITS = 32  # of a digest in a file's name
PATIENCE = 60.0  # seconds for a compiler, and for waiting for another process
LOOKS = 0.01  # seconds between two checks whether that process is done


class NotCompiled(Exception):
    """A library is not available. The message names the library and the reason."""


@dataclass(frozen=True, slots=True)
class Library:
    """Recipe of a library.

    `identity` is everything that it is made from: another identity, or another machine, is another library. `write`
    writes the source into a folder and returns its path and the compiler's flags; it may raise NotCompiled. `prove`
    checks the loaded library with a known answer; it raises NotCompiled, or AttributeError for a missing function, and
    the library is not used. `patience`: seconds that compiling may take."""

    name: str
    identity: bytes
    write: Callable[[Path], tuple[Path, Sequence[str]]]
    prove: Callable[[ctypes.CDLL], None]
    patience: float

    def find(self, cache: Path | None = None) -> ctypes.CDLL | None:
        """Return the library in the cache (by default `cache_folder()`), or None. Never compiles."""
        cache = cache if cache is not None else cache_folder()
        return None if cache is None or not _private(cache) else self._kept(cache)

    def load(self, cache: Path | None = None) -> ctypes.CDLL:
        """Return the library from the cache, compiled if needed; without a cache it is compiled at each start.

        Raises NotCompiled. Blocks: call it before a control loop begins."""
        cache = cache if cache is not None else cache_folder()
        if cache is None or not _private(cache):
            return self._make([None])
        until = time.monotonic() + self.patience
        with _lock(cache) as take:
            while True:
                # Lock before looking: the process that held the lock may have left the library.
                ours = take() or time.monotonic() >= until
                if (library := self._kept(cache)) is not None:
                    return library
                if ours:
                    return self._make([cache, None])
                time.sleep(LOOKS)

    def fails(self, why: str) -> NotCompiled:
        return NotCompiled(f"the C code of {self.name} cannot be compiled: {why}")

    @property
    def _stem(self) -> str:
        """Beginning of its file names."""
        digest = sha256(self.identity + b"\0" + platform.machine().encode()).hexdigest()
        return f"{self.name}-{digest[:16]}"

    def _kept(self, cache: Path) -> ctypes.CDLL | None:
        """Return the cached library, or None. Damaged files are deleted."""
        for path in sorted(cache.glob(f"{self._stem}-*.so")):
            with suppress(NotCompiled, OSError):
                if _sound(path):
                    return self._proven(path)
            with suppress(OSError):
                path.unlink()
        return None

    def _make(self, places: Sequence[Path | None]) -> ctypes.CDLL:
        """Compile in the first folder that can be written; None is the system's temporary folder."""
        why = ""
        for place in places:
            try:
                return self._make_in(place)
            except OSError as error:  # read-only, full
                why = _told(error, place)
        raise self.fails(why)

    def _make_in(self, place: Path | None) -> ctypes.CDLL:
        """Compile in a new folder in `place`, and cache the library there."""
        folder = Path(tempfile.mkdtemp(prefix="compiling-", dir=place))
        try:
            path = self._compile(folder)
            library = self._proven(path)  # it stays in memory when its file is deleted
            if place is not None:
                digest = sha256(path.read_bytes()).hexdigest()[:DIGITS]
                with suppress(OSError):
                    path.chmod(0o700)
                    path.replace(place / f"{self._stem}-{digest}.so")
            return library
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _compile(self, folder: Path) -> Path:
        compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
        if compiler is None:
            raise self.fails(f"there is no C compiler ({', '.join(COMPILERS)})")
        source, flags = self.write(folder)
        library = folder / f"{self.name}.so"
        # linkers expect libraries after the objects that use them
        command = [compiler, "-o", str(library), str(source), *flags]
        try:
            done = subprocess.run(
                command, stdin=subprocess.DEVNULL, capture_output=True, timeout=self.patience, cwd=folder, check=False
            )
        except subprocess.TimeoutExpired:
            raise self.fails(f"{compiler} was not done after {self.patience:.0f} s") from None
        if done.returncode or not library.is_file():
            told = done.stderr.decode(errors="replace").strip().splitlines() or ["no message"]
            raise self.fails(f"{compiler} failed with status {done.returncode}: {told[0][:200]}")
        return library

    def _proven(self, path: Path) -> ctypes.CDLL:
        try:
            library = ctypes.CDLL(str(path))
            self.prove(library)
        except (OSError, AttributeError) as error:
            raise NotCompiled(f"the C code of {self.name} is compiled, but cannot be loaded: {error}") from None
        return library


def load(
    source: Path, flags: Sequence[str], prove: Callable[[ctypes.CDLL], None], cache: Path | None = None
) -> ctypes.CDLL:
    """Return the library of one C file; see Library. `flags` are the compiler's, `-l` among them."""
    try:
        text = source.read_bytes()
    except OSError as error:
        raise NotCompiled(f"the C code of {source.stem} cannot be read: {_told(error, source)}") from None

    def write(folder: Path) -> tuple[Path, Sequence[str]]:
        copy = folder / source.name
        copy.write_bytes(text)
        return copy, flags

    identity = b"\0".join([text, *(flag.encode() for flag in flags)])
    return Library(source.stem, identity, write, prove, PATIENCE).load(cache)


class Compiled:
    """Library of one C file, loaded at its first use in a process. Not in a control loop (see `load`)."""

    def __init__(self, source: Path, flags: Sequence[str], prove: Callable[[ctypes.CDLL], None]) -> None:
        self._given = source, flags, prove

    @cached_property
    def found(self) -> ctypes.CDLL | str:
        """The library, or the reason why it is missing."""
        try:
            return load(*self._given)
        except NotCompiled as error:
            return str(error)

    def library(self) -> ctypes.CDLL | None:
        """Return the library, or None."""
        return None if isinstance(self.found, str) else self.found

    def why(self) -> str:
        """Return why the library is missing; "" if it is not."""
        return self.found if isinstance(self.found, str) else ""


def declare(found: ctypes.CDLL, prefix: str, functions: Mapping[str, tuple[Any, tuple[Any, ...]]]) -> None:
    """Declare result and argument types of functions by prefix and name.

    Raises AttributeError for a missing one."""
    for name, (result, arguments) in functions.items():
        function = getattr(found, prefix + name)
        function.restype, function.argtypes = result, arguments


def cache_folder() -> Path | None:
    """Return the folder of cached libraries.

    `koordgen` in the user's cache folder, or None if there is none.

    Not beside the bundle: in the simulator that folder belongs to a bundle, which must contain only its own files."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    try:
        return Path(given if os.path.isabs(given) else Path.home() / ".cache") / "koordgen"
    except RuntimeError:  # no home
        return None


def can_keep() -> bool:
    """Return whether this user can cache libraries."""
    cache = cache_folder()
    return cache is not None and _private(cache) and os.access(cache, os.W_OK)


@contextmanager
def _lock(folder: Path) -> Iterator[Callable[[], bool]]:
    """Yield a function that tries to lock the folder for compilation, until the block ends.

    The right of a killed process is released. On a file system without locks every process gets it, which only costs
    time."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        yield lambda: True
        return
    try:
        yield lambda: _taken(handle)
    finally:
        os.close(handle)


def _taken(handle: int) -> bool:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def _told(error: OSError, place: Path | None) -> str:
    return f"{error.filename or place}: {error.strerror or error}"


def _private(folder: Path) -> bool:
    """Return whether the folder exists or was created, and only this user may write it."""
    with suppress(OSError):  # there already, or cannot be made
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700)
    try:
        return _ours(folder)
    except OSError:
        return False


def _ours(path: Path) -> bool:
    """Return whether a file belongs to this user and nobody else may write it.

    False for a link: all may write it."""
    found = path.lstat()
    return found.st_uid == os.geteuid() and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _sound(path: Path) -> bool:
    """Return whether a library belongs to this user and is undamaged.

    Loading a truncated one ends the process."""
    return _ours(path) and path.stem.endswith("-" + sha256(path.read_bytes()).hexdigest()[:DIGITS])
