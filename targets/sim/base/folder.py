"""Output folder of a run: claimed for one run, never taken from another owner.

The folder belongs to runs if it has the marker file and otherwise only files of runs, or files that `report` and
`export` wrote later: the marker lists those, one a line. A line that ends with `/` names the folder of an inner fleet,
which belongs to the run as a whole. Files of an earlier run are removed before a new one begins, so a failed run never
looks like the good one before it."""

from __future__ import annotations

import fcntl
import shutil
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import IO

MARKER = ".koord-run"
GIVEN = "scenario.given.yaml"  # the faults of the run, including those injected by hand
SOURCE = "source"  # the program, its params and functions, with which a trace is replayed
FILES = (
    "report.html", "summary.json", "summary.txt", "trace.jsonl", "windows.jsonl", "poses.jsonl", "fleet.key",
    "faults.json", GIVEN,
)  # fmt: skip
FOLDERS = ("plots", "robots", SOURCE)


class ForeignFolder(Exception):
    """The folder must not be used; the message names the file that prevents it."""

    hint = "choose another folder with --out"


def record(path: Path) -> None:
    """Record in the marker that koordgen wrote `path`, so that the next run may remove it.

    `path` is a file or a folder of files beside a run's marker. A path elsewhere is left alone. Raises OSError."""
    marker = path.parent / MARKER
    if not marker.is_file():
        return
    written = [path.name] if path.is_file() else [f"{path.name}/{each.name}" for each in path.iterdir()]
    new = [name for name in written if name not in _recorded(path.parent)]
    with marker.open("a", encoding="utf-8") as file:
        file.writelines(f"{name}\n" for name in new)


def _recorded(folder: Path) -> set[str]:
    """Return the files that `record` noted, relative to the folder. Files in FOLDERS are a run's anyway."""
    marker = folder / MARKER
    names = marker.read_text(encoding="utf-8").splitlines() if marker.is_file() else []
    return {name for name in names if not {"..", "/", *FOLDERS}.intersection(Path(name).parts)}


class RunFolder:
    """Context manager that claims `path` for a run. `fleets`: names of inner fleets, which get a folder each.

    Raises Foreign before anything was touched, OSError if the folder cannot be created."""

    def __init__(self, path: Path, fleets: Sequence[str] = ()) -> None:
        self.path = path
        self._fleets = fleets
        self._marker: IO[bytes] | None = None

    def __enter__(self) -> Path:
        self._refuse_foreign()
        self.path.mkdir(parents=True, exist_ok=True)
        self._marker = (self.path / MARKER).open("ab")
        try:
            fcntl.flock(self._marker, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._marker.close()
            raise ForeignFolder(f"{self.path}: another run is writing there") from None
        recorded = _recorded(self.path)
        whole = {name for name in recorded if name.endswith("/")}
        for name in {*FOLDERS, *whole}:
            if (self.path / name).exists():
                shutil.rmtree(self.path / name)
        for name in {*FILES, *recorded} - whole:
            (self.path / name).unlink(missing_ok=True)
        for name in {Path(name).parts[0] for name in recorded}:
            if (self.path / name).is_dir():
                (self.path / name).rmdir()
        self._marker.truncate(0)
        self._marker.write("".join(f"{name}/\n" for name in self._fleets).encode())
        self._marker.flush()
        for name in self._fleets:
            (self.path / name).mkdir()
        return self.path

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._marker is not None:
            self._marker.close()
            self._marker = None

    def _refuse_foreign(self) -> None:
        if self.path.is_symlink() or (self.path.exists() and not self.path.is_dir()):
            raise ForeignFolder(f"{self.path}: is not a folder, so a run cannot write there")
        if not self.path.is_dir():
            return
        found = {entry.name for entry in self.path.iterdir()}
        if found and MARKER not in found:
            raise ForeignFolder(f"{self.path}: has files that no run wrote ({sorted(found)[0]})")
        recorded = _recorded(self.path)
        strange = sorted(found - {MARKER, *FILES, *FOLDERS} - {Path(name).parts[0] for name in recorded})
        for name in recorded:  # a folder written by koordgen must have no other files
            beside = (self.path / name).parent
            if beside != self.path and beside.is_dir():
                own = (each.relative_to(self.path).as_posix() for each in beside.iterdir())
                strange += sorted(set(own) - recorded)
        if strange:
            raise ForeignFolder(f"{self.path / strange[0]}: no run wrote it, and a new run would clear the folder")
