"""Folder of a campaign: stores the plan, the results, the folder of each run, and the table of results.

When a run ends, its files are written first, and its line in `results.jsonl` last. Only a run with a complete line
counts as finished. So a campaign can be resumed after any kind of interruption.
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
    """Raised if a folder cannot store a campaign. `help` is advice for the user."""

    def __init__(self, message: str, help: str) -> None:
        super().__init__(message)
        self.help = help


@dataclass(frozen=True)
class RunResult:
    """Result of one simulation run.

    `run`: number of the run in the campaign's plan.
    `varied`: name -> value of each quantity that the campaign varies.
    `outcome`: "held", "violated", or "failed" if the run could not be executed.
    `why`: reason for the first violation or for the failure.
    `mission`: duration of the mission in seconds; None if the run did not report it.
    `separation`: smallest distance between two robots in metres; None if the run did not report it.
    `late_rounds`: sum over all robots; None if the run did not report it.
    `wall`: duration of the run on the host's clock, in seconds.
    `figures`: numbers that the user's verdict script printed."""

    run: int
    varied: dict[str, str]
    outcome: str
    why: str = ""
    what: str = ""  # kind of the first violation, such as "separation" or "collision"
    mission: float | None = None
    separation: float | None = None
    late_rounds: int | None = None
    wall: float = 0.0
    figures: dict[str, float] = field(default_factory=dict)


class CampaignStore:
    """Folder of a campaign that this process has opened, with the results of all finished runs by run number.

    Only one process can use the folder at a time. The context manager `claimed` opens the folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.results: dict[int, RunResult] = {}

    def run_folder(self, name: str) -> Path:
        """Return the path of the folder in which a run stores its files. `name`: the run's number in four digits."""
        return self.folder / RUNS / name

    def add(self, result: RunResult) -> None:
        """Append the result of a finished run to `results.jsonl`.

        Raises OSError; the file then keeps its former content if the disk allows it."""
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
        """Return whether the disk is full, which may be the reason for a failed run. Writes 1 MiB as a test."""
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
    """Open the folder of a campaign, and lock it against other processes until the context ends.

    The folder is new or empty, or it stores a campaign with an equal plan and `resume` is true. Raises FolderUnusable,
    OSError."""
    if not folder.exists() and resume:
        raise FolderUnusable(f"{folder}: there is no {plan.what} to resume", "leave out --resume")
    if folder.exists() and not folder.is_dir():
        raise FolderUnusable(f"{folder}: is not a folder", "choose another folder with --out")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / LOCK).exists():
        raise FolderUnusable(f"{folder}: contains files, but no {plan.what}", "choose another folder with --out")
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("ab") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            way = "wait until it ends, or choose another folder with --out"
            raise FolderUnusable(f"{folder}: another koordgen process uses this folder", way) from None
        yield _opened(folder, plan, resume)


def _opened(folder: Path, plan: CampaignPlan, resume: bool) -> CampaignStore:
    store = CampaignStore(folder)
    if (folder / PLAN).exists():
        stored = _object(folder / PLAN)
        if (what := made_for(stored)) != plan.what:
            raise FolderUnusable(f"{folder}: contains a {what}, not a {plan.what}", "choose another folder with --out")
        if not resume:
            way = f"continue the {what} with --resume, or choose another folder with --out"
            raise FolderUnusable(f"{folder}: already contains a {what}", way)
        if why := difference(stored, plan):
            raise FolderUnusable(
                f"{folder}: contains a {what} with another plan: {why}", "choose another folder with --out"
            )
        store.results = _finished(folder / RESULTS)
    else:
        replace(folder / PLAN, json.dumps(plan.json(), indent=2) + "\n")
    (folder / RUNS).mkdir(exist_ok=True)
    return store


def _object(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FolderUnusable(f"{path}: cannot be read: {error}", "choose another folder with --out") from None
    return value if isinstance(value, dict) else {}


def _finished(path: Path) -> dict[int, RunResult]:
    """Return the results stored in `results.jsonl` by run number. Results of failed runs are omitted.

    An interrupted write can leave an incomplete last line. This line is removed from the file."""
    if not path.exists():
        return {}
    text = path.read_bytes()
    whole = text[: text.rfind(b"\n") + 1]
    if len(whole) < len(text):
        os.truncate(path, len(whole))
    try:
        found = [RunResult(**json.loads(line)) for line in whole.splitlines()]
    except (ValueError, TypeError) as error:
        raise FolderUnusable(f"{path}: cannot be read: {error}", "choose another folder with --out") from None
    return {result.run: result for result in found if result.outcome != "failed"}


def replace(path: Path, text: str) -> None:
    """Write a text file atomically: readers find either the old text or the new text. Raises OSError."""
    new = path.with_name(f".{path.name}.new")
    try:
        new.write_text(text, encoding="utf-8")
        new.replace(path)
    except OSError:
        with suppress(OSError):
            new.unlink()
        raise


def cleared(folder: Path) -> Path:
    """Delete the folder of a run, which an interrupted run may have left. Return the folder's path. Raises OSError."""
    if folder.exists():
        shutil.rmtree(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    return folder
