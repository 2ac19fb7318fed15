"""Content store: the distinct files of all bundles, named by their SHA-256, and wheels of packages."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

from .folder import (
    PIECE,
    RESERVE,
    Folder,
    ToolError,
    checked_sha256,
    make_folder,
    sha256_of,
    sync_folder,
)

_READ_ONLY = 0o444


def missing(folder: Folder, objects: Sequence[str], wheels: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Return which of these objects and wheels are absent or damaged on this host."""
    return {
        "objects": [digest for digest in objects if sha256_of(folder.object(digest)) != digest],
        "wheels": [name for name, digest in wheels if sha256_of(folder.wheel(name)) != checked_sha256(digest)],
    }


def store(folder: Folder, kind: str, entries: Sequence[Any], pieces: Iterable[bytes]) -> int:
    """Store files that arrive concatenated and compressed; return their number.

    entries: [name, SHA-256, size in bytes] of each file.
    pieces: the contents of all files, concatenated and compressed by zlib, in pieces.
    A file gets its name only after its digest was verified.
    """
    places = [_place(folder, kind, entry) for entry in entries]
    total = sum(size for _, _, size in places)
    with folder.room(total + RESERVE):
        make_folder(folder.objects if kind == "objects" else folder.wheels)
        contents = _Contents(pieces)
        for path, digest, size in places:
            _store_one(path, digest, contents.next_file(size))
        contents.finish()
        if places:
            sync_folder(places[0][0].parent)
    return len(places)


def _place(folder: Folder, kind: str, entry: Any) -> tuple[Path, str, int]:
    if not isinstance(entry, list) or len(entry) != 3 or not isinstance(entry[2], int) or entry[2] < 0:
        raise ToolError("bad request", f"{entry!r}: an entry must be [name, SHA-256, size]")
    name, digest, size = entry
    if kind == "objects" and name == checked_sha256(digest):
        return folder.object(name), digest, size
    if kind == "wheels":
        return folder.wheel(name), checked_sha256(digest), size
    raise ToolError("bad request", f"kind {kind!r}, name {name!r}: neither an object nor a wheel")


def _store_one(path: Path, digest: str, pieces: Iterator[bytes]) -> None:
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    found = sha256()
    try:
        with open(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600), "wb") as file:
            for piece in pieces:
                found.update(piece)
                file.write(piece)
            file.flush()
            os.fchmod(file.fileno(), _READ_ONLY)
            os.fsync(file.fileno())
        if found.hexdigest() != digest:
            raise ToolError("damaged", f"{path.name}: the received content has another SHA-256", "try again")
        os.replace(beside, path)
    except BaseException:
        with suppress(OSError):
            beside.unlink()
        raise


class _Contents:
    """Decompressor of concatenated files. It holds only about PIECE bytes in memory."""

    def __init__(self, pieces: Iterable[bytes]) -> None:
        self._pieces = iter(pieces)
        self._inflate = zlib.decompressobj()
        self._input = b""

    def next_file(self, size: int) -> Iterator[bytes]:
        while size:
            piece = self._more(min(size, PIECE))
            if not piece:
                raise ToolError("damaged", "the received data are shorter than announced", "try again")
            size -= len(piece)
            yield piece

    def finish(self) -> None:
        """Raise ToolError if data remain, or if the compressed stream is incomplete."""
        if self._more(1) or not self._inflate.eof:
            raise ToolError("damaged", "the received data are longer than announced, or incomplete", "try again")

    def _more(self, most: int) -> bytes:
        """Return up to `most` decompressed bytes; returns no bytes after the end of the data."""
        try:
            while not self._inflate.eof:
                if not self._input and (piece := next(self._pieces, b"")):
                    self._input = piece
                elif not self._input:
                    return self._inflate.decompress(b"", most)
                found = self._inflate.decompress(self._input, most)
                self._input = self._inflate.unconsumed_tail
                if found:
                    return found
        except zlib.error as error:
            raise ToolError("damaged", f"the received data cannot be decompressed: {error}", "try again") from None
        return b""


def link(folder: Folder, digest: str, executable: bool, path: Path) -> None:
    """Make `path` a hard link to an object, and replace an existing file.

    Hard links share their file mode, so an executable file needs its own copy of the object.
    """
    source = folder.object(digest)
    if executable:
        source = _executable(source)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        os.link(source, beside)
        os.replace(beside, path)
    except FileNotFoundError:
        raise ToolError("missing", f"object {digest} is not on this host", "store it first") from None
    finally:
        with suppress(OSError):
            beside.unlink()  # os.replace does not remove the source if both are links to the same file


def _executable(source: Path) -> Path:
    path = source.with_name(source.name + "x")
    if sha256_of(path) != source.name:
        _store_one(path, source.name, _pieces(source))
    os.chmod(path, _READ_ONLY | 0o111)
    return path


def _pieces(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while piece := file.read(PIECE):
            yield piece


def prune(folder: Folder) -> None:
    """Remove objects to which no release links, and incomplete files of killed processes."""
    if not folder.objects.is_dir():
        return
    for path in folder.objects.iterdir():
        with suppress(OSError):
            if path.name.startswith(".") or path.stat().st_nlink == 1:
                path.unlink()
