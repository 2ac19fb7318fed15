"""Log files of agents, which are bounded in size, and reading of log lines and trace files."""

from __future__ import annotations

import os
import stat
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

from .folder import Folder, ToolError, checked_path

_PART = 4_000_000  # size in bytes at which a log file is rotated
_PARTS = 4  # largest number of log files of one robot; a rotation deletes the oldest file
_LONGEST = 4000  # longest line in characters; the rest of a longer line is dropped
MOST_LINES = 5000  # largest number of log lines in one answer
_MOST_BYTES = 16 * 1024 * 1024  # largest part of a trace file in one answer, in bytes

Line = tuple[float, str]


class AgentLog:
    """Log of one robot. Each line begins with its Unix time; times increase.

    If the disk is full, lines are lost, and their number is logged later. No exception is raised.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: TextIO | None = None
        self._last = 0.0
        self._lost = 0

    def write(self, text: str) -> None:
        if self._lost:
            lost, self._lost = self._lost, 0
            self._append(f"{lost} lines were lost: the disk was full")
        self._append(text)

    def close(self) -> None:
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            self._file = None

    def _append(self, text: str) -> None:
        self._last = max(time.time(), self._last + 1e-6)
        try:
            if self._file is None:
                self._file = self._path.open("a", encoding="utf-8", errors="replace", buffering=1)
            self._file.write(f"{self._last:.6f} {text[:_LONGEST]}\n")
            if self._file.tell() >= _PART:
                self._set_aside()
        except OSError:
            self._lost += 1
            self.close()

    def _set_aside(self) -> None:
        self.close()
        for number in range(_PARTS - 1, 0, -1):
            with suppress(FileNotFoundError):
                os.replace(_part(self._path, number - 1), _part(self._path, number))


def _part(path: Path, number: int) -> Path:
    return path.with_name(f"{path.name}.{number}") if number else path


def read_log(path: Path) -> Iterator[Line]:
    """Return all lines of a log, oldest first."""
    for number in range(_PARTS - 1, -1, -1):
        with suppress(FileNotFoundError), _part(path, number).open(encoding="utf-8", errors="replace") as file:
            for line in file:
                stamp, _, text = line.rstrip("\n").partition(" ")
                with suppress(ValueError):  # skip a line without a time: it was cut because the disk was full
                    yield float(stamp), text


def selected(lines: Iterable[Line], most: int, since: float | None) -> dict[str, Any]:
    """Return up to `most` log lines: the first ones after Unix time `since`, or the last ones if None.

    To request the lines that follow, pass the result's `next` as `since`.
    """
    most = max(0, min(most, MOST_LINES))
    if since is None:
        found = list(deque(lines, most))
    else:
        found = list(islice((line for line in lines if line[0] > since), most))
    return {"lines": [list(line) for line in found], "next": found[-1][0] if found else since or 0.0}


def traces(folder: Folder, robot: Any, is_outer: bool) -> list[dict[str, Any]]:
    """Return the name, the size in bytes and the Unix time of the last change of a robot's trace files.

    is_outer: list the traces of the squad to which the robot belongs, which it wrote while it hosted the squad.
    """
    place, listed = folder.trace_folder(robot, is_outer), []
    for path in sorted(place.iterdir()) if place.is_dir() else []:
        with suppress(OSError):
            state = path.lstat()
            if stat.S_ISREG(state.st_mode):
                listed.append({"name": path.name, "size": state.st_size, "modified": state.st_mtime})
    return listed


class Fetching:
    """Reader of trace files in pieces.

    A file stays open between two pieces, so the reader can go on after the file was renamed.
    """

    def __init__(self, folder: Folder) -> None:
        self._folder = folder
        # the open trace file, and the offset after the piece that was read last
        self._next: tuple[Path, int] | None = None
        self._file = -1

    def fetch(self, robot: Any, is_outer: bool, name: Any, offset: int, length: int) -> bytes:
        """Return up to `length` bytes of a robot's trace file, from `offset` on. `is_outer`: see `traces`.

        The file is opened again unless the request continues the previous request.
        """
        place = self._folder.trace_folder(robot, is_outer)
        path = place / checked_path(name)
        if path.parent != place or offset < 0 or length < 0:
            raise ToolError("bad request", f"{name!r}, byte {offset}: this is not in a file that `traces` lists")
        if (path, offset) != self._next:
            self.close()
            try:
                self._file = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
            except OSError as error:
                raise ToolError("missing", f"{name}: {error.strerror}", "request the list of traces again") from None
        data = os.pread(self._file, min(length, _MOST_BYTES), offset)
        self._next = (path, offset + len(data))
        return data

    def close(self) -> None:
        if self._file >= 0:
            os.close(self._file)
        self._file, self._next = -1, None
