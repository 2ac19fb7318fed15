"""Collection of robots' traces and logs from their hosts into one run folder.

A robot of a squad has a second trace on its host: that of the squad, from the times at which it hosted the squad.

A file is fetched as NAME.part. It is renamed to NAME when it is as long as the host's file was at the start.
A later collection into the same folder fetches only the missing bytes. Whenever a robot's agent starts again, its
current trace on the host is renamed to an older, numbered part (koordgen/runtime/trace/parts.py). The collection
recognises such a part by its last bytes, and does not fetch it again.
"""

from __future__ import annotations

import asyncio
import fcntl
import json
import os
import re
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple

from koordgen.lang.node import Node
from koordgen.operate.hosts import Answer, HostError, Sessions, SshSession
from koordgen.operate.logs import clock_offset
from koordgen.operate.run_folder import ROBOTS, TRACE
from koordgen.operate.run_levels import HOSTED
from koordgen.runtime.trace.parts import base_of, numbered

MARKER = ".koord-collect"  # file with the state for later collections; a simulation never clears a folder that has it
LOG = "log.txt"
PART = ".part"
AT_ONCE = 1 << 20  # largest number of bytes that one request fetches
# path of a file in a bundle that belongs to the source of a program: names become local paths
SOURCE_FILE = re.compile(r"(source/([a-z][a-z0-9_]*/)?)?[^/.][^/]*")
OVERLAP = 512  # bytes at a local file's end, fetched again to check that the host's file continues the local file


class CannotCollect(Exception):
    """Raised if the folder cannot be used, or a robot's files cannot be collected into it.

    `help` says what to do.
    """

    def __init__(self, message: str, help: str) -> None:
        super().__init__(message)
        self.help = help


class Collected(Node):
    """Number of one robot's files, and number of bytes that this collection fetched for the robot."""

    robot: str
    files: int
    fetched: int


class CollectionFolder:
    """Context manager: a run folder, locked for one collection.

    Raises CannotCollect when the folder holds files of another origin, or another collection uses it; OSError.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._marker: IO[str] | None = None
        self._known: dict[str, Any] = {}

    def __enter__(self) -> CollectionFolder:
        path = self.path
        if path.exists() and (not path.is_dir() or (any(path.iterdir()) and not (path / MARKER).is_file())):
            raise CannotCollect(
                f"{path}: contains files that `koordgen collect` did not write", "choose another folder with -o"
            )
        path.mkdir(parents=True, exist_ok=True)
        self._marker = (path / MARKER).open("a+", encoding="utf-8")
        try:
            fcntl.flock(self._marker, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._marker.close()
            raise CannotCollect(
                f"{path}: another collection runs here", "wait until the other collection has ended"
            ) from None
        self._marker.seek(0)
        with suppress(ValueError):
            found = json.loads(self._marker.read() or "{}")
            self._known = found if isinstance(found, dict) else {}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._marker is not None:
            self._marker.close()

    def robot(self, name: str) -> Path:
        """Return the folder of one robot's files; make it if it is missing."""
        folder = self.path / ROBOTS / name
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def known(self, robot: str) -> Mapping[str, Any]:
        """Return the state of a robot's log after the last collection; empty before the first one.

        next: time of the log's last line, by the host's clock.
        size: size of the log in bytes.
        """
        found = self._known.get(robot)
        return found if isinstance(found, dict) else {}

    def note(self, robot: str, **what: Any) -> None:
        """Record the state of a robot's log for later collections."""
        assert self._marker is not None
        self._known[robot] = what
        self._marker.seek(0)
        self._marker.truncate()
        json.dump(self._known, self._marker)
        self._marker.flush()


class Collection(Node):
    """Result of a collection.

    robots: files of each robot.
    missed: reason why a robot's files were not collected.
    programs: fleet -> for each release that a host still has, newest first: the files of its programs, by path. The
        fleets are "" and the squads.
    """

    robots: dict[str, Collected]
    missed: dict[str, HostError | CannotCollect | OSError]
    programs: dict[str, list[dict[str, bytes]]]


class TraceSource(NamedTuple):
    """Trace files on a host: of a robot, or of the squad that the robot hosted at times (`is_outer`)."""

    session: SshSession
    robot: str
    is_outer: bool = False

    async def call(self, verb: str, **arguments: Any) -> Answer:
        """Send a request about these files. Raises HostError."""
        if self.is_outer:
            arguments["outer"] = True
        return await self.session.call(verb, robot=self.robot, **arguments)


async def collect_all(sessions: Sessions, into: CollectionFolder, progress: Callable[[int], None]) -> Collection:
    """Fetch the traces and logs of all robots into the folder, from all hosts in parallel."""
    found: dict[str, Collected] = {}
    missed: dict[str, HostError | CannotCollect | OSError] = {
        robot: error for error in sessions.failed for robot in error.host.robots
    }
    programs: dict[str, list[dict[str, bytes]]] = {}

    async def of_host(session: SshSession) -> None:
        for robot in session.host.robots:
            try:
                ahead = (await clock_offset(session)).ahead
                try:
                    found[robot] = await collect(session, robot, into, ahead, progress)
                except CannotCollect:  # try again: the agent may have begun another part after the files were listed
                    found[robot] = await collect(session, robot, into, ahead, progress)
                squad = robot.rpartition(".")[0]
                if squad not in programs:
                    programs[squad] = await _programs(session, robot)
            except (HostError, CannotCollect, OSError) as error:
                missed[robot] = error

    await asyncio.gather(*map(of_host, sessions.reached))
    return Collection(found, missed, programs)


async def _programs(session: SshSession, robot: str) -> list[dict[str, bytes]]:
    """Return the program files of each release on the host, which are needed to replay a trace.

    The files are the program, its params and its extern functions; of several applications those of each.
    """
    deployment = (await session.call("inspect"))["deployment"]
    found = []
    for release in dict.fromkeys([deployment["confirmed"], *reversed(deployment["history"])]):
        if release is not None:
            files = (await session.call("source", id=release, robot=robot))["files"]
            found.append({name: str(text).encode() for name, text in files.items() if SOURCE_FILE.fullmatch(name)})
    return found


async def collect(
    session: SshSession, robot: str, into: CollectionFolder, ahead: float, progress: Callable[[int], None]
) -> Collected:
    """Fetch one robot's traces and log into the folder. Raises HostError, CannotCollect, OSError.

    ahead: seconds by which the host's clock is ahead of this computer's clock.
    progress: called with the number of bytes of each piece that arrives.
    """
    folder = into.robot(robot)
    files, fetched = await _fetch_traces(TraceSource(session, robot), folder, progress)
    if "." in robot:
        (folder / HOSTED).mkdir(exist_ok=True)
        more, bytes_ = await _fetch_traces(TraceSource(session, robot, True), folder / HOSTED, progress)
        files, fetched = files + more, fetched + bytes_
    fetched += await _fetch_log(session, robot, into, ahead)
    return Collected(robot, files + 1, fetched)


async def _fetch_traces(source: TraceSource, folder: Path, progress: Callable[[int], None]) -> tuple[int, int]:
    """Complete the local copies of trace files. Return the number of files, and of bytes fetched."""
    answer = await source.call("traces")
    sizes = {str(each["name"]): int(each["size"]) for each in answer["files"]}
    _must_be_plain(sizes, source.robot)
    fetched = await _recognise_current(source, folder, sizes)
    for name in sorted(sizes, key=lambda each: (base_of(folder / each)[1] is None, len(each), each)):
        fetched += await _fetch(source, folder / name, sizes[name], progress)
    return len(sizes), fetched


def _must_be_plain(names: Mapping[str, int], robot: str) -> None:
    """Raise CannotCollect unless all names are names of trace files: names become local paths."""
    for name in names:
        if "/" in name or not name.startswith(TRACE.partition(".")[0]) or not name.endswith(".jsonl"):
            raise CannotCollect(
                f"{robot}: its host lists {name!r}, which is no trace", "look at the folder traces/ on the robot's host"
            )


async def _recognise_current(source: TraceSource, folder: Path, sizes: Mapping[str, int]) -> int:
    """Rename the current trace of an earlier collection if it has become a numbered part on the host.

    Returns the number of bytes that were fetched to find out.
    """
    current = folder / TRACE
    latest = max((number for number, _ in numbered(current)), default=0)
    newer = [number for name in sizes if (number := _number(name)) > latest]
    if not newer or not current.exists():
        return 0
    name = f"{current.stem}-{latest + 1}{current.suffix}"
    fetched = 0
    if name in sizes:
        same, fetched = await _is_continued(source, name, current, sizes[name])
        if not same:
            still, more = await _is_continued(source, TRACE, current, sizes.get(TRACE, 0))
            if not still:
                raise _other(current)
            # the agent began this part during the last collection, so the local file has the right name already
            return fetched + more
    current.replace(folder / name)
    (folder / f"{TRACE}{PART}").unlink(missing_ok=True)
    return fetched


def _number(name: str) -> int:
    """Return the number in the name of an older part of a trace; 0 for the current trace."""
    _, dash, number = name.removesuffix(".jsonl").rpartition("-")
    return int(number) if dash and number.isdecimal() else 0


async def _fetch(source: TraceSource, path: Path, size: int, progress: Callable[[int], None]) -> int:
    """Complete the local copy of a file up to `size` bytes; return the number of bytes fetched.

    Raises CannotCollect when the local file is not a beginning of the file on the host.
    """
    part = path.with_name(f"{path.name}{PART}")
    here, arrived = (each.stat().st_size if each.exists() else 0 for each in (path, part))
    start = part if arrived > here else path
    same, fetched = await _is_continued(source, path.name, start, size) if start.exists() else (True, 0)
    if not same:
        raise _other(path)
    if here == size and path.exists():
        part.unlink(missing_ok=True)
        return fetched
    if start is path and here:
        shutil.copyfile(path, part)
    known = max(here, arrived)
    with part.open("ab") as file:
        for offset in range(known, size, AT_ONCE):
            length = min(AT_ONCE, size - offset)
            data = await _bytes(source, path.name, offset, length)
            file.write(data)
            fetched += len(data)
            progress(len(data))
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
    return fetched


async def _is_continued(source: TraceSource, name: str, path: Path, size: int) -> tuple[bool, int]:
    """Return whether a file of `size` bytes on the host continues the file `path`, and the bytes fetched.

    Only the last OVERLAP bytes of the local file are compared.
    """
    known = path.stat().st_size
    if not 0 < known <= size:
        return known == 0, 0
    length = min(OVERLAP, known)
    data = await _bytes(source, name, known - length, length)
    with path.open("rb") as file:
        file.seek(known - length)
        return file.read(length) == data, length


async def _bytes(source: TraceSource, name: str, offset: int, length: int) -> bytes:
    answer = await source.call("fetch", file=name, offset=offset, length=length)
    if len(answer.data) != length:
        raise CannotCollect(
            f"{source.robot}: {name} has changed while it was fetched", "run the command again; complete files are kept"
        )
    return answer.data


def _other(path: Path) -> CannotCollect:
    help = "collect into a new folder; the files in this folder are kept"
    return CannotCollect(f"{path} is of another recording than the robot's file of the same name", help)


async def _fetch_log(session: SshSession, robot: str, into: CollectionFolder, ahead: float) -> int:
    """Append a robot's new log lines, with times by this computer's clock.

    Return the number of bytes written.
    """
    path, known, fetched = into.robot(robot) / LOG, into.known(robot), 0
    with path.open("ab") as file:
        # first remove the lines after the recorded state: they are fetched again
        file.truncate(int(known.get("size", 0)))
        file.seek(0, os.SEEK_END)
        cursor = known.get("next", 0.0)
        while True:
            answer = await session.call("logs", robot=robot, since=cursor)
            if not answer["lines"]:
                return fetched
            data = "".join(f"{time - ahead:.3f} {text}\n" for time, text in answer["lines"]).encode()
            file.write(data)
            file.flush()
            fetched += len(data)
            cursor = answer["next"]
            into.note(robot, next=cursor, size=file.tell())
