"""Files of one robot's trace: the current part and older parts beside it, together within a limit.

`trace.jsonl` is the current part. A full part, and the part that an earlier start of the agent left, become
`trace-1.jsonl`, `trace-2.jsonl` and so on; the highest number is the newest. If a record would exceed the limit, the
oldest parts are deleted first. A part of another robot is neither counted nor deleted."""

from __future__ import annotations

import re
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import IO

import msgspec

from koordgen.runtime.trace.schema import HEADER

PARTS = 8  # a part is full at 1/PARTS of the limit, so that 7/8 of the limit stay readable
LONGEST_HEADER = 1 << 16  # largest size in bytes of a header that is read to find the robot of a part
MEGABYTE = 1_000_000


def numbered(path: Path) -> list[tuple[int, Path]]:
    """Return the older parts of the trace at `path` with their numbers, oldest first. Raises OSError."""
    pattern = re.compile(rf"{re.escape(path.stem)}-([0-9]{{1,15}}){re.escape(path.suffix)}")
    beside = path.parent.iterdir() if path.parent.is_dir() else ()
    named = ((pattern.fullmatch(each.name), each) for each in beside)
    return sorted((int(match[1]), each) for match, each in named if match and each.is_file())


def size_of(path: Path) -> int:
    """Return the size in bytes of the trace at `path` with its older parts. Raises OSError."""
    parts = [path] if path.is_file() else []
    return sum(part.stat().st_size for part in [*parts, *(each for _, each in numbered(path))])


def base_of(path: Path) -> tuple[Path, int | None]:
    """Return the path of the current part, and the number of the older part at `path`.

    The number is None if `path` is the current part or another file. Raises OSError."""
    match = re.fullmatch(r"(.+)-([0-9]{1,15})", path.stem)
    if match is None or numbered(path):  # a name that ends in a number may be the current part
        return path, None
    return path.with_stem(match[1]), int(match[2])


def set_aside(path: Path) -> None:
    """Rename the part at `path`, if there is one, to the next number. Raises OSError."""
    if path.is_file() and path.stat().st_size:
        number = max((number for number, _ in numbered(path)), default=0) + 1
        path.rename(path.with_stem(f"{path.stem}-{number}"))


class Parts:
    """Writer of the current part. `limit`: bytes of all parts together.

    The limit holds after every write, unless the current part alone exceeds it: a part has at most its initial records,
    `limit / PARTS` bytes more, and the records of one round. All methods raise OSError."""

    def __init__(self, path: Path, robot: str, limit: int) -> None:
        self._path, self._limit = path, limit
        set_aside(path)
        older = [(each, each.stat().st_size) for _, each in numbered(path) if _is_of(each, robot)]
        self._older = deque(older)  # oldest first, with their bytes
        self._total = sum(size for _, size in older)
        self._file: IO[bytes] = path.open("wb")
        self._size = self._began = 0  # bytes of the current part, and of its initial records

    @property
    def full(self) -> bool:
        return self._size - self._began >= self._limit // PARTS

    def write(self, data: bytes) -> None:
        """Write a record, after deleting the oldest parts if all would exceed the limit."""
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
        """Close the current part, rename it to the next number, and begin another one."""
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
        """Record that the initial records of the current part are written."""
        self._began = self._size

    def close(self) -> None:
        self._file.close()


def _is_of(path: Path, robot: str) -> bool:
    """Return whether a file is a part of this robot's trace; true if its only line is cut off."""
    with path.open("rb") as file:
        line = file.readline(LONGEST_HEADER)
    if not line.endswith(b"\n"):
        return line.startswith(HEADER)
    with suppress(msgspec.DecodeError):
        header = msgspec.json.decode(line)
        return isinstance(header, dict) and header.get("kind") == "header" and header.get("robot") == robot
    return False
