"""The folder that a run leaves: claimed for one run, never taken from anyone else.

It is ours when the marker is in it and nothing but what runs write. What an earlier run left is removed before the
new one begins, so a run that fails never looks like the good one before it.
"""

from __future__ import annotations

import fcntl
import shutil
from pathlib import Path
from types import TracebackType
from typing import IO

MARKER = ".koord-run"
SOURCE = "source"  # the program, its params and functions: what a trace is replayed with
FILES = ("report.html", "summary.json", "summary.txt", "trace.jsonl", "poses.jsonl", "fleet.key", "faults.json")
FOLDERS = ("plots", "robots", SOURCE)


class Foreign(Exception):
    """The folder must not be used; the message names what is in the way."""

    hint = "choose another folder with --out"


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
        for name in FILES:
            (self.path / name).unlink(missing_ok=True)
        for name in FOLDERS:
            if (self.path / name).exists():
                shutil.rmtree(self.path / name)
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
        strange = sorted(found - {MARKER, *FILES, *FOLDERS})
        if strange:
            raise Foreign(f"{self.path / strange[0]}: not written by a run, and a new one would clear the folder")
