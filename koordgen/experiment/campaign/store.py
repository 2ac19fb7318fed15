"""Folder of a campaign: its plan, one line per finished run, the runs' own folders, the table.

A run is finished when its complete line is in `results.jsonl`; the line is written last. So a campaign can be resumed
whatever ended it, and an incomplete run never counts.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from koordgen.experiment.campaign.plan import CampaignPlan, difference, made_for

PLAN, RESULTS, RUNS, LOCK = "plan.json", "results.jsonl", "runs", ".koord-campaign"
FULL = (errno.ENOSPC, errno.EDQUOT)


class FolderUnusable(Exception):
    """The folder cannot be used for this campaign; `help` names a remedy."""

    def __init__(self, message: str, help: str) -> None:
        super().__init__(message)
        self.help = help


@dataclass(frozen=True)
class RunResult:
    """Result of one run.

    `outcome`: held, violated or failed (it could not be executed); `why`: the first reason. Times in seconds, distances
    in metres; None if the run did not report the value. `figures`: numbers from the verdict script; `wall`: time on the
    host."""

    run: int
    varied: dict[str, str]
    outcome: str
    why: str = ""
    what: str = ""  # kind of the first violation: separation, collision, ...
    mission: float | None = None
    separation: float | None = None
    late_rounds: int | None = None
    wall: float = 0.0
    figures: dict[str, float] = field(default_factory=dict)


class CampaignStore:
    """Folder of a campaign, claimed for one process. `claimed` opens it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.results: dict[int, RunResult] = {}

    def run_folder(self, name: str) -> Path:
        """Return the folder of a run."""
        return self.folder / RUNS / name

    def add(self, result: RunResult) -> None:
        """Store the result of a finished run. Raises OSError."""
        line = json.dumps(asdict(result)) + "\n"
        with (self.folder / RESULTS).open("ab") as file:
            before = file.tell()
            try:
                file.write(line.encode())
                file.flush()
                os.fsync(file.fileno())
            except OSError:
                with suppress(OSError):
                    os.truncate(self.folder / RESULTS, before)
                raise
        self.results[result.run] = result

    def full(self) -> bool:
        """Return whether the disk is full, which explains a run that failed."""
        probe = self.folder / ".probe"
        try:
            probe.write_bytes(bytes(1 << 20))
        except OSError as error:
            return error.errno in FULL
        finally:
            with suppress(OSError):
                probe.unlink()
        return False


@contextmanager
def claimed(folder: Path, plan: CampaignPlan, resume: bool) -> Iterator[CampaignStore]:
    """Claim the campaign's folder, a new one or one with finished runs of the same plan.

    Raises FolderUnusable, OSError."""
    if not folder.exists() and resume:
        raise FolderUnusable(f"{folder}: there is no {plan.what} to go on with", "leave out --resume")
    if folder.exists() and not folder.is_dir():
        raise FolderUnusable(f"{folder}: exists and is no folder", "choose another with --out")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / LOCK).exists():
        raise FolderUnusable(f"{folder}: holds files that are not of a {plan.what}", "choose another with --out")
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("ab") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FolderUnusable(f"{folder}: another call is writing there", "wait, or choose another --out") from None
        yield _opened(folder, plan, resume)


def _opened(folder: Path, plan: CampaignPlan, resume: bool) -> CampaignStore:
    store = CampaignStore(folder)
    if (folder / PLAN).exists():
        stored = _object(folder / PLAN)
        if (what := made_for(stored)) != plan.what:
            raise FolderUnusable(f"{folder}: holds a {what}, not a {plan.what}", "choose another with --out")
        if not resume:
            way = "--resume goes on with it; or choose another with --out"
            raise FolderUnusable(f"{folder}: holds a {what} already", way)
        if why := difference(stored, plan):
            raise FolderUnusable(f"{folder}: holds another {what}: {why}", "choose another with --out")
        store.results = _finished(folder / RESULTS)
    else:
        replace(folder / PLAN, json.dumps(plan.json(), indent=2) + "\n")
    (folder / RUNS).mkdir(exist_ok=True)
    return store


def _object(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FolderUnusable(f"{path}: cannot be read: {error}", "choose another with --out") from None
    return value if isinstance(value, dict) else {}


def _finished(path: Path) -> dict[int, RunResult]:
    """Return the results of finished runs. A line that a killed campaign left incomplete is cut off."""
    if not path.exists():
        return {}
    text = path.read_bytes()
    whole = text[: text.rfind(b"\n") + 1]
    if len(whole) < len(text):
        os.truncate(path, len(whole))
    try:
        found = [RunResult(**json.loads(line)) for line in whole.splitlines()]
    except (ValueError, TypeError) as error:
        raise FolderUnusable(f"{path}: cannot be read: {error}", "choose another with --out") from None
    return {result.run: result for result in found if result.outcome != "failed"}


def replace(path: Path, text: str) -> None:
    """Write a file completely or not at all. Raises OSError."""
    new = path.with_name(f".{path.name}.new")
    try:
        new.write_text(text, encoding="utf-8")
        new.replace(path)
    except OSError:
        with suppress(OSError):
            new.unlink()
        raise


def cleared(folder: Path) -> Path:
    """Delete a folder that an incomplete run may have left, and return its path. Raises OSError."""
    if folder.exists():
        shutil.rmtree(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    return folder
