"""Folder of a campaign: its plan, one line per finished run, the folders of runs, the table.

The line of a run in `results.jsonl` is written last. Only a run with a complete line counts as finished. So a campaign
can be resumed after any kind of interruption, and an incomplete run never counts.
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
    """Raised if the folder cannot be used for this campaign. `help` names a remedy."""

    def __init__(self, message: str, help: str) -> None:
        super().__init__(message)
        self.help = help


@dataclass(frozen=True)
class RunResult:
    """Result of one run.

    Times are in seconds, distances in metres; None if the run did not report the value.

    `outcome`: "held", "violated", or "failed" if the run could not be executed.
    `why`: the first reason for a violation or a failure.
    `figures`: numbers that the user's verdict script returned.
    `wall`: duration of the run on the host's clock."""

    run: int
    varied: dict[str, str]
    outcome: str
    why: str = ""
    what: str = ""  # kind of the first violation, such as separation or collision
    mission: float | None = None
    separation: float | None = None
    late_rounds: int | None = None
    wall: float = 0.0
    figures: dict[str, float] = field(default_factory=dict)


class CampaignStore:
    """Folder of a campaign, which only one process uses at a time. The function `claimed` opens it."""

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
        """Return whether the disk is full. This explains why a run failed."""
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
    """Open the campaign's folder for this process alone.

    The folder is new, or contains finished runs of the same plan. Raises FolderUnusable, OSError."""
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
    """Return the results of finished runs, by number.

    A last line that is incomplete is removed from the file."""
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
    """Replace a file by a new text, either completely or not at all. Raises OSError."""
    new = path.with_name(f".{path.name}.new")
    try:
        new.write_text(text, encoding="utf-8")
        new.replace(path)
    except OSError:
        with suppress(OSError):
            new.unlink()
        raise


def cleared(folder: Path) -> Path:
    """Delete a folder that an incomplete run may have left. Return the folder's path. Raises OSError."""
    if folder.exists():
        shutil.rmtree(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    return folder
