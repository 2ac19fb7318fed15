"""Loader of libraries that are compiled once on the robot, cached, and called by ctypes or imported.

A library is loaded only if this user owns its file and its folder, and no other user may write them. The digest of its
content must equal the digest in its file name; a truncated or changed library is compiled again. If several agents
start at the same time on one computer, the first one compiles and the others wait for it."""

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
DIGITS = 32  # number of hexadecimal digits of a digest in a file name
TIMEOUT = 60.0  # seconds that a compilation may last, in this process or in another process that this process waits for
POLL_EVERY = 0.01  # seconds between two checks whether another process has finished its compilation


class NotCompiled(Exception):
    """Raised if a library is not available. The message names the library and the reason."""


@dataclass(frozen=True, slots=True)
class CompiledLibrary:
    """Description of how to compile and check a library.

    identity: everything that the library is made from. Another identity or another type of machine needs another
        library.
    write: function that writes the source into a folder, and returns the path of the source and the flags of the
        compiler. It may raise NotCompiled.
    prove: function that checks the loaded library. It raises NotCompiled, or AttributeError for a missing function, if
        the library must not be used.
    timeout: seconds that the compilation may last."""

    name: str
    identity: bytes
    write: Callable[[Path], tuple[Path, Sequence[str]]]
    prove: Callable[[ctypes.CDLL], None]
    timeout: float

    def find(self, cache: Path | None = None) -> ctypes.CDLL | None:
        """Return the library from the cache folder (default: `cache_folder()`), or None. Never compiles."""
        cache = cache if cache is not None else cache_folder()
        return None if cache is None or not _private(cache) else self._kept(cache)

    def load(self, cache: Path | None = None) -> ctypes.CDLL:
        """Return the library from the cache, and compile it if needed. Without a cache, compile at each start.

        Raises NotCompiled. This method blocks, so call it before a control loop begins."""
        cache = cache if cache is not None else cache_folder()
        if cache is None or not _private(cache):
            return self._make([None])
        until = time.monotonic() + self.timeout
        with _lock(cache) as acquire:
            while True:
                # Lock before the cache is read: the process that held the lock may have compiled the library.
                ours = acquire() or time.monotonic() >= until
                if (library := self._kept(cache)) is not None:
                    return library
                if ours:
                    return self._make([cache, None])
                time.sleep(POLL_EVERY)

    def fails(self, why: str) -> NotCompiled:
        return NotCompiled(f"the C code of {self.name} cannot be compiled: {why}")

    @property
    def _stem(self) -> str:
        """Beginning of the names of this library's files in the cache."""
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
        """Compile in the first folder of `places` that can be written. None: the system's temporary folder."""
        why = ""
        for place in places:
            try:
                return self._make_in(place)
            except OSError as error:  # the folder is read-only or the disk is full
                why = _description(error, place)
        raise self.fails(why)

    def _make_in(self, place: Path | None) -> ctypes.CDLL:
        """Compile in a new folder within the folder `place`, and store the library in `place`."""
        folder = Path(tempfile.mkdtemp(prefix="compiling-", dir=place))
        try:
            path = self._compile(folder)
            library = self._proven(path)  # the library stays in memory when its file is deleted
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
        # Flags (`-l`) come last, because linkers expect libraries after the objects that use them.
        command = [compiler, "-o", str(library), str(source), *flags]
        try:
            done = subprocess.run(
                command, stdin=subprocess.DEVNULL, capture_output=True, timeout=self.timeout, cwd=folder, check=False
            )
        except subprocess.TimeoutExpired:
            raise self.fails(f"{compiler} did not finish within {self.timeout:.0f} s") from None
        if done.returncode or not library.is_file():
            lines = done.stderr.decode(errors="replace").strip().splitlines() or ["no message"]
            raise self.fails(f"{compiler} failed with status {done.returncode}: {lines[0][:200]}")
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
    """Compile and load the library of one C file; see Library.load.

    flags: flags of the compiler, including `-l` flags for the linker.
    """
    try:
        text = source.read_bytes()
    except OSError as error:
        raise NotCompiled(f"the C code of {source.stem} cannot be read: {_description(error, source)}") from None

    def write(folder: Path) -> tuple[Path, Sequence[str]]:
        copy = folder / source.name
        copy.write_bytes(text)
        return copy, flags

    identity = b"\0".join([text, *(flag.encode() for flag in flags)])
    return CompiledLibrary(source.stem, identity, write, prove, TIMEOUT).load(cache)


class Compiled:
    """Library of one C file, loaded at its first use in a process.

    The first use must not be in a control loop, because it may compile the library.
    """

    def __init__(self, source: Path, flags: Sequence[str], prove: Callable[[ctypes.CDLL], None]) -> None:
        self._given = source, flags, prove

    @cached_property
    def found(self) -> ctypes.CDLL | str:
        """The loaded library, or the reason why the library is missing."""
        try:
            return load(*self._given)
        except NotCompiled as error:
            return str(error)

    def library(self) -> ctypes.CDLL | None:
        """Return the loaded library, or None if it is missing."""
        return None if isinstance(self.found, str) else self.found

    def why(self) -> str:
        """Return the reason why the library is missing, or "" if it is loaded."""
        return self.found if isinstance(self.found, str) else ""


def declare(found: ctypes.CDLL, prefix: str, functions: Mapping[str, tuple[Any, tuple[Any, ...]]]) -> None:
    """Declare result and argument types of a library's functions to ctypes.

    functions: name without `prefix` -> (type of the result, types of the arguments).
    Raises AttributeError for a missing function."""
    for name, (result, arguments) in functions.items():
        function = getattr(found, prefix + name)
        function.restype, function.argtypes = result, arguments


def cache_folder() -> Path | None:
    """Return the folder of cached libraries: `koordgen` in the user's cache folder.

    Return None if the user has no home folder. Libraries are not stored in a bundle, because a bundle must contain only
    its own files."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    try:
        return Path(given if os.path.isabs(given) else Path.home() / ".cache") / "koordgen"
    except RuntimeError:  # the user has no home folder
        return None


def can_keep() -> bool:
    """Return whether this user can write libraries to the cache folder."""
    cache = cache_folder()
    return cache is not None and _private(cache) and os.access(cache, os.W_OK)


@contextmanager
def _lock(folder: Path) -> Iterator[Callable[[], bool]]:
    """Yield a function that tries to lock the folder for compilation.

    The lock is released when the block ends. The system releases the lock of a killed process. On a file system without
    locks, every process gets the lock; then each process compiles, which only costs time."""
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


def _description(error: OSError, place: Path | None) -> str:
    return f"{error.filename or place}: {error.strerror or error}"


def _private(folder: Path) -> bool:
    """Create the folder if needed. Return whether it exists and only this user may write it."""
    with suppress(OSError):  # the folder exists already, or cannot be created
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700)
    try:
        return _ours(folder)
    except OSError:
        return False


def _ours(path: Path) -> bool:
    """Return whether a file or folder belongs to this user, and no other user may write it.

    Return False for a symbolic link, because every user may write it."""
    found = path.lstat()
    return found.st_uid == os.geteuid() and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _sound(path: Path) -> bool:
    """Return whether a library file belongs to this user and is undamaged.

    A truncated library must not be loaded, because loading it would end the process."""
    return _ours(path) and path.stem.endswith("-" + sha256(path.read_bytes()).hexdigest()[:DIGITS])
