"""Files of one robot's trace: the current part and older parts in the same folder, with a limit on all their bytes.

`trace.jsonl` is the current part. A full part is renamed to `trace-1.jsonl`, `trace-2.jsonl` and so on, as is the part
that an earlier start of the agent left. The highest number is the newest part. If a record would exceed the limit, the
oldest parts are deleted before the record is written. Parts of another robot are neither counted nor deleted."""

from __future__ import annotations

import re
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import IO

import msgspec

from koordgen.runtime.trace.schema import HEADER

PARTS = 8  # a part is full at 1/PARTS of the limit, so deleting the oldest part leaves about 7/8 of the limit
LONGEST_HEADER = 1 << 16  # bytes; longer headers are cut off when the robot of a part is looked up
MEGABYTE = 1_000_000


def numbered(path: Path) -> list[tuple[int, Path]]:
    """Return the older parts of the trace at `path` as (number, file), the oldest part first. Raises OSError."""
    pattern = re.compile(rf"{re.escape(path.stem)}-([0-9]{{1,15}}){re.escape(path.suffix)}")
    beside = path.parent.iterdir() if path.parent.is_dir() else ()
    named = ((pattern.fullmatch(each.name), each) for each in beside)
    return sorted((int(match[1]), each) for match, each in named if match and each.is_file())


def size_of(path: Path) -> int:
    """Return the size in bytes of the trace at `path`, including its older parts. Raises OSError."""
    parts = [path] if path.is_file() else []
    return sum(part.stat().st_size for part in [*parts, *(each for _, each in numbered(path))])


def base_of(path: Path) -> tuple[Path, int | None]:
    """Return the path of the current part of the trace that `path` belongs to, and the number of the part at `path`.

    The number is None if `path` is not an older part. Raises OSError."""
    match = re.fullmatch(r"(.+)-([0-9]{1,15})", path.stem)
    if match is None or numbered(path):  # a numbered name with older parts is a current part
        return path, None
    return path.with_stem(match[1]), int(match[2])


def set_aside(path: Path) -> None:
    """Rename the part at `path` to the next free number; do nothing if the file is missing or empty. Raises OSError."""
    if path.is_file() and path.stat().st_size:
        number = max((number for number, _ in numbered(path)), default=0) + 1
        path.rename(path.with_stem(f"{path.stem}-{number}"))


class TraceFileParts:
    """Writer of the current part of a trace. `limit`: most bytes of all parts of the trace together.

    The limit holds after every write, unless the current part alone exceeds it. A part contains at most its initial
    records, `limit / PARTS` more bytes, and the records of one round. All methods raise OSError."""

    def __init__(self, path: Path, robot: str, limit: int) -> None:
        self._path, self._limit = path, limit
        set_aside(path)
        older = [(each, each.stat().st_size) for _, each in numbered(path) if _is_of(each, robot)]
        self._older = deque(older)  # older parts with their sizes in bytes, the oldest part first
        self._total = sum(size for _, size in older)
        self._file: IO[bytes] = path.open("wb")
        self._size = self._began = 0  # bytes of the current part; bytes of its initial records

    @property
    def full(self) -> bool:
        return self._size - self._began >= self._limit // PARTS

    def write(self, data: bytes) -> None:
        """Write a record. Delete the oldest parts first, while the record would exceed the limit."""
        while self._older and self._total + len(data) > self._limit:
            oldest, size = self._older.popleft()
            oldest.unlink(missing_ok=True)
            self._total -= size
        self._file.write(data)
        self._size += len(data)
        self._total += len(data)

    def flush(self) -> None:
        self._file.flush()

    def turn(self) -> None:
        """Close the current part, rename it to the next free number, and begin a new current part."""
        self._file.close()
        number = max((number for number, _ in numbered(self._path)), default=0) + 1
        older = self._path.with_stem(f"{self._path.stem}-{number}")
        try:
            self._path.rename(older)
            self._older.append((older, self._size))
        except FileNotFoundError:  # the user has moved or deleted the part
            self._total -= self._size
        self._file = self._path.open("wb")
        self._size = self._began = 0

    def began(self) -> None:
        """Note that all initial records of the current part are written."""
        self._began = self._size

    def close(self) -> None:
        self._file.close()


def _is_of(path: Path, robot: str) -> bool:
    """Return whether a file is a part of this robot's trace.

    If the first line is cut off, the robot is not known: True if the line begins as a header does."""
    with path.open("rb") as file:
        line = file.readline(LONGEST_HEADER)
    if not line.endswith(b"\n"):
        return line.startswith(HEADER)
    with suppress(msgspec.DecodeError):
        header = msgspec.json.decode(line)
        return isinstance(header, dict) and header.get("kind") == "header" and header.get("robot") == robot
    return False
