"""C code as a library: compiled once on the robot, kept in a cache, called by ctypes.

A library is loaded from a folder and a file of our own only, which nobody else may write, and when its content has the
digest that its name tells: what is truncated or was changed is compiled anew. Agents that start at the same time on
one host wait for the first of them, which compiles for all.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import platform
import re
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
PATIENCE = 60.0  # seconds that a compiler may take, and that another process is waited for
_OWN_HEADER = re.compile(rb'^#include "(\w+\.h)"$', re.MULTILINE)
LOOKS = 0.01  # seconds between looks whether that one is done


class NotCompiled(Exception):
    """There is no library: says of what, and why."""


def load(
    source: Path, flags: Sequence[str], prove: Callable[[ctypes.CDLL], None], cache: Path | None = None
) -> ctypes.CDLL:
    """The library of one C file, with the headers beside it that it includes, out of the cache (by default
    `cache_folder()`), compiled if need be: that takes parts of a second or a few, once. Where no cache can be kept, it
    is compiled at each start.

    `flags` are the compiler's, `-l` among them. `prove` asks the library something whose answer is known, and raises
    NotCompiled (or AttributeError: the library lacks a function) where it answers otherwise; such a library is not
    used. Raises NotCompiled. Waits: call it before a control loop begins.
    """
    try:
        code = _Code(source.stem, _whole(source), tuple(flags), prove)
    except OSError as error:
        raise NotCompiled(f"the C code of {source.stem} cannot be read: {_told(error, source)}") from None
    cache = cache if cache is not None else cache_folder()
    if cache is None or not _private(cache):
        return _make(code, [None])
    until = time.monotonic() + PATIENCE
    with _lock(cache) as take:
        while True:
            ours = take() or time.monotonic() >= until  # first: who had it may have left the library
            if (library := _kept(code, cache)) is not None:
                return library
            if ours:
                return _make(code, [cache, None])
            time.sleep(LOOKS)


class Compiled:
    """The library of one C file, loaded at its first use in a process (see `load`): not in a control loop."""

    def __init__(self, source: Path, flags: Sequence[str], prove: Callable[[ctypes.CDLL], None]) -> None:
        self._given = source, flags, prove

    @cached_property
    def found(self) -> ctypes.CDLL | str:
        """It, or why there is none."""
        try:
            return load(*self._given)
        except NotCompiled as error:
            return str(error)

    def library(self) -> ctypes.CDLL | None:
        """It, or None."""
        return None if isinstance(self.found, str) else self.found

    def why(self) -> str:
        """Why there is no library; empty when there is one."""
        return self.found if isinstance(self.found, str) else ""


def declare(found: ctypes.CDLL, prefix: str, functions: Mapping[str, tuple[Any, tuple[Any, ...]]]) -> None:
    """What its functions, by their names behind the prefix, return and take. Raises AttributeError: it lacks one."""
    for name, (result, arguments) in functions.items():
        function = getattr(found, prefix + name)
        function.restype, function.argtypes = result, arguments


def cache_folder() -> Path | None:
    """Where libraries are kept: koordgen in the user's cache folder, like other programs' caches. None without one.

    Not beside the bundle: in the simulator that is a folder of a bundle, which must hold nothing but its own files.
    """
    given = os.environ.get("XDG_CACHE_HOME", "")
    try:
        return Path(given if os.path.isabs(given) else Path.home() / ".cache") / "koordgen"
    except RuntimeError:  # no home
        return None


def _whole(source: Path) -> bytes:
    """A C file, in it the headers of its own folder in place of the lines that include them; compilers still tell of
    each by its own name and lines. Raises OSError."""
    text = source.read_bytes()

    def header(found: re.Match[bytes]) -> bytes:
        name, following = found[1], text.count(b"\n", 0, found.end()) + 2
        own = source.with_name(name.decode()).read_bytes()
        return b'#line 1 "%b"\n%b\n#line %d "%b"' % (name, own, following, source.name.encode())

    return _OWN_HEADER.sub(header, text)


@dataclass(frozen=True, slots=True)
class _Code:
    name: str
    text: bytes
    flags: tuple[str, ...]
    prove: Callable[[ctypes.CDLL], None]

    @property
    def stem(self) -> str:
        """How the names of its libraries begin: another source, flag or machine has another."""
        parts = [self.text, *(flag.encode() for flag in self.flags), platform.machine().encode()]
        return self.name + "-" + sha256(b"\0".join(parts)).hexdigest()[:16]

    def fails(self, why: str) -> NotCompiled:
        return NotCompiled(f"the C code of {self.name} cannot be compiled: {why}")


@contextmanager
def _lock(folder: Path) -> Iterator[Callable[[], bool]]:
    """What tries to be the only process that compiles into the folder, until the block ends; also when a process is
    killed amid it. On a file system that knows no locks everybody is, which costs time and does no harm."""
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


def _kept(code: _Code, cache: Path) -> ctypes.CDLL | None:
    """The library in the cache; what is spoilt there goes."""
    for path in sorted(cache.glob(f"{code.stem}-*.so")):
        with suppress(NotCompiled, OSError):
            if _sound(path):
                return _proven(code, path)
        with suppress(OSError):
            path.unlink()
    return None


def _make(code: _Code, places: Sequence[Path | None]) -> ctypes.CDLL:
    """Compiled in the first place where that can be. None: the system's own folder for temporary files."""
    why = ""
    for place in places:
        try:
            return _make_in(code, place)
        except OSError as error:  # read-only, full
            why = _told(error, place)
    raise code.fails(why)


def _make_in(code: _Code, place: Path | None) -> ctypes.CDLL:
    """Compile in a new folder in `place`, and leave the library there for the next time."""
    folder = Path(tempfile.mkdtemp(prefix="compiling-", dir=place))
    try:
        path = _compile(code, folder)
        library = _proven(code, path)  # it stays in memory when its file goes
        if place is not None:
            digest = sha256(path.read_bytes()).hexdigest()[:DIGITS]
            with suppress(OSError):
                path.chmod(0o700)
                path.replace(place / f"{code.stem}-{digest}.so")
        return library
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _compile(code: _Code, folder: Path) -> Path:
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    if compiler is None:
        raise code.fails(f"there is no C compiler ({', '.join(COMPILERS)})")
    text, library = folder / f"{code.name}.c", folder / f"{code.name}.so"
    text.write_bytes(code.text)
    command = [compiler, "-o", str(library), str(text), *code.flags]  # linkers want libraries after what needs them
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=PATIENCE, cwd=folder, check=False
        )
    except subprocess.TimeoutExpired:
        raise code.fails(f"{compiler} was not done after {PATIENCE:.0f} s") from None
    if done.returncode or not library.is_file():
        told = done.stderr.decode(errors="replace").strip().splitlines() or ["no message"]
        raise code.fails(f"{compiler} failed with status {done.returncode}: {told[0][:200]}")
    return library


def _proven(code: _Code, path: Path) -> ctypes.CDLL:
    try:
        library = ctypes.CDLL(str(path))
        code.prove(library)
    except (OSError, AttributeError) as error:
        raise NotCompiled(f"the C code of {code.name} is compiled, but cannot be loaded: {error}") from None
    return library


def _told(error: OSError, place: Path | None) -> str:
    return f"{error.filename or place}: {error.strerror or error}"


def _private(folder: Path) -> bool:
    """Whether the folder is there or could be made, is ours, and cannot be written by others."""
    with suppress(OSError):  # there already, or cannot be made
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700)
    try:
        return _ours(folder)
    except OSError:
        return False


def _ours(path: Path) -> bool:
    """Whether it is ours, and nobody else may write it; a link never is, for all may write one."""
    found = path.lstat()
    return found.st_uid == os.geteuid() and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _sound(path: Path) -> bool:
    """Whether a library is ours, and the file that was written: loading a truncated one would end the process."""
    return _ours(path) and path.stem.endswith("-" + sha256(path.read_bytes()).hexdigest()[:DIGITS])
