"""Campaign driver: submits simulation runs to an executor and stores the results of the runs."""

from __future__ import annotations

import json
import shutil
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from dataclasses import replace
from pathlib import Path

from koordgen.experiment.campaign import plots, store, table
from koordgen.experiment.campaign.executor import ClusterUnreachable, Executor
from koordgen.experiment.campaign.plan import PlannedRun
from koordgen.experiment.campaign.store import FULL, CampaignStore, RunResult
from koordgen.experiment.campaign.task import CampaignStopped, Job

LOOK = 0.5  # seconds between two checks for finished runs
Build = Callable[[Mapping[str, str], Path], None]


class DiskFull(Exception):
    """Raised if the disk is full. The results of finished runs are already stored."""


class Bundles:
    """Simulation bundles of a campaign: one for each combination of values of the varied params.

    A bundle is built before the first run that uses the bundle, and deleted after the last run that uses it.

    `folder`: holds a numbered subfolder for each combination.
    `build`: function that builds a bundle with the given params into the given subfolder.
    `name`: name of the bundle in each subfolder."""

    def __init__(self, folder: Path, name: str, build: Build, runs: Sequence[PlannedRun]) -> None:
        self._folder, self._name, self._build = folder, name, build
        self._left = Counter(_key(run.params) for run in runs)
        self._made: dict[tuple[tuple[str, str], ...], Path] = {}

    def of(self, run: PlannedRun) -> Path:
        """Return the path of a run's simulation bundle. Build the bundle if no earlier run has used the bundle.

        Exceptions of `build` are passed on."""
        key = _key(run.params)
        if key not in self._made:
            own = self._folder / str(len(self._made))
            self._build(run.params, own)
            self._made[key] = own
        return self._made[key] / self._name

    def done(self, run: PlannedRun) -> None:
        """Record that a run is finished. Delete the run's bundle if no other run needs the bundle."""
        key = _key(run.params)
        self._left[key] -= 1
        if not self._left[key]:
            shutil.rmtree(self._made[key], ignore_errors=True)


def _key(params: Mapping[str, str]) -> tuple[tuple[str, str], ...]:
    return tuple(sorted(params.items()))


def execute_runs(
    runs: Sequence[PlannedRun],
    kept: CampaignStore,
    executor: Executor,
    bundles: Bundles,
    job: Callable[[PlannedRun], Job],
    report_progress: Callable[[str], None],
    interrupted: Callable[[], bool],
) -> None:
    """Execute all runs of a campaign that have no stored result yet, and store the result of each run.

    Raises DiskFull, ClusterUnreachable, and KeyboardInterrupt if `interrupted` returns True. The executor is stopped
    before this function ends. After an exception, all results of finished runs are stored."""
    waiting = deque(run for run in runs if run.number not in kept.results)
    progress = CampaignProgress(len(runs), kept)
    under_way: dict[Future[RunResult], PlannedRun] = {}
    try:
        while waiting or under_way:
            while waiting and len(under_way) < executor.width:
                run = waiting.popleft()
                future = executor.submit(job(run), bundles.of(run), kept.run_folder(run.name))
                under_way[future] = run
            finished, _ = wait(under_way, timeout=LOOK, return_when=FIRST_COMPLETED)
            for future in finished:
                run = under_way.pop(future)
                _store_result(kept, run, future)
                bundles.done(run)
            report_progress(progress.text())
            if interrupted():
                raise KeyboardInterrupt
    except OSError as error:
        if error.errno in FULL:
            raise DiskFull from None
        raise
    finally:
        executor.stop()


def _store_result(kept: CampaignStore, run: PlannedRun, future: Future[RunResult]) -> None:
    try:
        result = future.result()
    except (CampaignStopped, CancelledError, ClusterUnreachable):
        raise
    except OSError as error:
        if error.errno in FULL:
            raise
        result = RunResult(run.number, dict(run.varied), "failed", f"{type(error).__name__}: {error}")
    except Exception as error:  # for example, a worker of the cluster died, or the result could not be sent
        result = RunResult(run.number, dict(run.varied), "failed", f"{type(error).__name__}: {error}")
    if result.outcome == "failed" and kept.full():
        raise DiskFull
    kept.add(replace(result, varied=dict(run.varied)))


class CampaignProgress:
    """Progress of a campaign as text: the number of finished runs, and the estimated remaining time.

    The estimate uses only runs that have finished since the start of the present command. A resumed campaign contains
    earlier runs, too."""

    def __init__(self, total: int, kept: CampaignStore) -> None:
        self._total, self._kept = total, kept
        self._before = len(kept.results)
        self._began = time.monotonic()

    def text(self) -> str:
        results = self._kept.results.values()
        done = len(results)
        parts = [f"{done} of {self._total} runs"]
        for outcome, said in (("violated", "violated"), ("failed", "did not run")):
            if count := sum(r.outcome == outcome for r in results):
                parts.append(f"{count} {said}")
        fresh, passed = done - self._before, time.monotonic() - self._began
        if fresh:
            parts.append(f"{_clock(passed / fresh * (self._total - done))} remaining")
        return ", ".join(parts)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def write_table(kept: CampaignStore, app: str, planned: int, cells: Sequence[Mapping[str, str]]) -> str:
    """Write the results of the finished runs: `campaign.json`, `campaign.csv`, `campaign.txt` and the plots.

    Return the content of `campaign.txt`. Raises OSError."""
    results = [kept.results[number] for number in sorted(kept.results)]
    found = table.document(app, planned, results, cells)
    text = table.as_text(found)
    store.replace(kept.folder / "campaign.json", json.dumps(found, indent=2) + "\n")
    store.replace(kept.folder / "campaign.csv", table.as_csv(results))
    store.replace(kept.folder / "campaign.txt", text)
    plots.draw(results, kept.folder / "plots")
    return text
