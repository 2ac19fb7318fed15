"""The folder that a run leaves: claimed for one run, never taken from anyone else.

It is ours when the marker is in it and nothing but what runs write, or what `report` and `export` put there later: the
marker names those files, one a line. What an earlier run left is removed before the new one begins, so a run that
fails never looks like the good one before it.
"""

from __future__ import annotations

import fcntl
import shutil
from pathlib import Path
from types import TracebackType
from typing import IO

MARKER = ".koord-run"
GIVEN = "scenario.given.yaml"  # the faults of the run, those that were given by hand among them
SOURCE = "source"  # the program, its params and functions: what a trace is replayed with
FILES = (
    "report.html", "summary.json", "summary.txt", "trace.jsonl", "windows.jsonl", "poses.jsonl", "fleet.key",
    "faults.json", GIVEN,
)  # fmt: skip
FOLDERS = ("plots", "robots", SOURCE)


class Foreign(Exception):
    """The folder must not be used; the message names what is in the way."""

    hint = "choose another folder with --out"


def record(path: Path) -> None:
    """Note that koordgen wrote `path`, a file or a folder of files, so that the next run may remove it. Only beside a
    run's marker; a path elsewhere is its owner's. Raises OSError."""
    marker = path.parent / MARKER
    if not marker.is_file():
        return
    written = [path.name] if path.is_file() else [f"{path.name}/{each.name}" for each in path.iterdir()]
    new = [name for name in written if name not in _recorded(path.parent)]
    with marker.open("a", encoding="utf-8") as file:
        file.writelines(f"{name}\n" for name in new)


def _recorded(folder: Path) -> set[str]:
    """The files that `record` noted in a folder, relative to it; those in FOLDERS are a run's anyway."""
    marker = folder / MARKER
    names = marker.read_text(encoding="utf-8").splitlines() if marker.is_file() else []
    return {name for name in names if not {"..", "/", *FOLDERS}.intersection(Path(name).parts)}


class RunFolder:
    """Claim `path` for a run, as a context manager. Raises Foreign before anything was touched, OSError when the
    folder cannot be made."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._marker: IO[bytes] | None = None

    def __enter__(self) -> Path:
        self._refuse_foreign()
        self.path.mkdir(parents=True, exist_ok=True)
        self._marker = (self.path / MARKER).open("ab")
        try:
            fcntl.flock(self._marker, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._marker.close()
            raise Foreign(f"{self.path}: another run is writing there") from None
        recorded = _recorded(self.path)
        for name in {*FILES, *recorded}:
            (self.path / name).unlink(missing_ok=True)
        for name in {Path(name).parts[0] for name in recorded}:
            if (self.path / name).is_dir():
                (self.path / name).rmdir()
        for name in FOLDERS:
            if (self.path / name).exists():
                shutil.rmtree(self.path / name)
        self._marker.truncate(0)
        return self.path

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._marker is not None:
            self._marker.close()
            self._marker = None

    def _refuse_foreign(self) -> None:
        if self.path.is_symlink() or (self.path.exists() and not self.path.is_dir()):
            raise Foreign(f"{self.path}: in the way, and not the folder of a run")
        if not self.path.is_dir():
            return
        found = {entry.name for entry in self.path.iterdir()}
        if found and MARKER not in found:
            raise Foreign(f"{self.path}: holds files, and they are not of a run ({sorted(found)[0]})")
        recorded = _recorded(self.path)
        strange = sorted(found - {MARKER, *FILES, *FOLDERS} - {Path(name).parts[0] for name in recorded})
        for name in recorded:  # a folder is ours as far as its files are
            beside = (self.path / name).parent
            if beside != self.path and beside.is_dir():
                own = (each.relative_to(self.path).as_posix() for each in beside.iterdir())
                strange += sorted(set(own) - recorded)
        if strange:
            raise Foreign(f"{self.path / strange[0]}: not written by a run, and a new one would clear the folder")
