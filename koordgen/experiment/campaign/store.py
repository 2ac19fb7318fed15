"""The folder of a campaign: its plan, a line for each finished run, the runs' own folders, the table.

A run is finished when its line stands in `results.jsonl`, whole; the line is written last. So whatever ends a campaign,
it can be resumed, and no half run counts.
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

from koordgen.experiment.campaign.plan import Plan, difference, made_for

PLAN, RESULTS, RUNS, LOCK = "plan.json", "results.jsonl", "runs", ".koord-campaign"
FULL = (errno.ENOSPC, errno.EDQUOT)


class Unusable(Exception):
    """The folder cannot be used for that campaign; `help` says the way out."""

    def __init__(self, message: str, help: str) -> None:
        super().__init__(message)
        self.help = help


@dataclass(frozen=True)
class Result:
    """What came of a run: `outcome` is held, violated or failed (it did not run), `why` the first reason. Seconds,
    metres; None is what the run did not tell. `figures` are the verdict script's own, `wall` is the host's time."""

    run: int
    varied: dict[str, str]
    outcome: str
    why: str = ""
    what: str = ""  # of the first violation: separation, collision, ...
    mission: float | None = None
    separation: float | None = None
    late_rounds: int | None = None
    wall: float = 0.0
    figures: dict[str, float] = field(default_factory=dict)


class Store:
    """The folder, claimed for one process. Made by `claimed`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.results: dict[int, Result] = {}

    def run_folder(self, name: str) -> Path:
        """Where a run writes."""
        return self.folder / RUNS / name

    def add(self, result: Result) -> None:
        """A run is finished. Raises OSError."""
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
        """Whether the disk takes no more: a run that failed has found its reason."""
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
def claimed(folder: Path, plan: Plan, resume: bool) -> Iterator[Store]:
    """The campaign's folder, new, or with what was finished of the same plan. Raises Unusable, OSError."""
    if not folder.exists() and resume:
        raise Unusable(f"{folder}: there is no {plan.what} to go on with", "leave out --resume")
    if folder.exists() and not folder.is_dir():
        raise Unusable(f"{folder}: in the way, and no folder", "choose another with --out")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / LOCK).exists():
        raise Unusable(f"{folder}: holds files, and they are not of a {plan.what}", "choose another with --out")
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("ab") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Unusable(f"{folder}: another call is writing there", "wait, or choose another --out") from None
        yield _opened(folder, plan, resume)


def _opened(folder: Path, plan: Plan, resume: bool) -> Store:
    store = Store(folder)
    if (folder / PLAN).exists():
        stored = _object(folder / PLAN)
        if (what := made_for(stored)) != plan.what:
            raise Unusable(f"{folder}: holds a {what}, not a {plan.what}", "choose another with --out")
        if not resume:
            way = "--resume goes on with it; or choose another with --out"
            raise Unusable(f"{folder}: holds a {what} already", way)
        if why := difference(stored, plan):
            raise Unusable(f"{folder}: holds another {what}: {why}", "choose another with --out")
        store.results = _finished(folder / RESULTS)
    else:
        replace(folder / PLAN, json.dumps(plan.json(), indent=2) + "\n")
    (folder / RUNS).mkdir(exist_ok=True)
    return store


def _object(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise Unusable(f"{path}: cannot be read: {error}", "choose another with --out") from None
    return value if isinstance(value, dict) else {}


def _finished(path: Path) -> dict[int, Result]:
    """The runs that need not be repeated. What a killed campaign left of a line is cut off."""
    if not path.exists():
        return {}
    text = path.read_bytes()
    whole = text[: text.rfind(b"\n") + 1]
    if len(whole) < len(text):
        os.truncate(path, len(whole))
    try:
        found = [Result(**json.loads(line)) for line in whole.splitlines()]
    except (ValueError, TypeError) as error:
        raise Unusable(f"{path}: cannot be read: {error}", "choose another with --out") from None
    return {result.run: result for result in found if result.outcome != "failed"}


def replace(path: Path, text: str) -> None:
    """Write a file whole or not at all. Raises OSError."""
    new = path.with_name(f".{path.name}.new")
    try:
        new.write_text(text, encoding="utf-8")
        new.replace(path)
    except OSError:
        with suppress(OSError):
            new.unlink()
        raise


def cleared(folder: Path) -> Path:
    """A folder of nothing: what a half run left in it goes. Raises OSError."""
    if folder.exists():
        shutil.rmtree(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    return folder
