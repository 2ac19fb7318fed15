"""Executors of runs: a pool on this host, or a Dask cluster. Both return futures of results."""

from __future__ import annotations

import io
import tempfile
import threading
import zipfile
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from koordgen.experiment.campaign.store import RunResult, cleared
from koordgen.experiment.campaign.task import Job, execute

REACHED_WITHIN = 10  # seconds within which a cluster must answer


class ClusterUnreachable(Exception):
    """Raised if no cluster answers, or the connection to it is lost. `help` names a remedy."""

    def __init__(self, message: str, help: str) -> None:
        super().__init__(message)
        self.help = help


class Executor(Protocol):
    """Executor of jobs.

    `width`: number of jobs that may be submitted at the same time.
    `stop`: ends running jobs as far as possible."""

    @property
    def width(self) -> int: ...

    def submit(self, job: Job, bundle: Path, folder: Path) -> Future[RunResult]: ...

    def stop(self) -> None: ...

    def close(self) -> None: ...


class LocalPool:
    """Pool of threads in this process. Each thread waits for one run's process at a time."""

    def __init__(self, jobs: int) -> None:
        self.width = jobs
        self._pool = ThreadPoolExecutor(jobs)
        self._stopping = threading.Event()

    def submit(self, job: Job, bundle: Path, folder: Path) -> Future[RunResult]:
        return self._pool.submit(self._run, job, bundle, folder)

    def _run(self, job: Job, bundle: Path, folder: Path) -> RunResult:
        return execute(job, bundle, cleared(folder), self._stopping.is_set)

    def stop(self) -> None:
        self._stopping.set()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def close(self) -> None:
        self.stop()


class DaskCluster:
    """Dask cluster as an executor of runs.

    Its workers must have the same version of koordgen, and the packages of its simulator. Bundles and run folders are
    sent over the cluster's own connections, so no shared disk is needed."""

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client
        except ModuleNotFoundError as error:
            from koordgen.runtime.ops.host import pip_install

            way = pip_install("'koordgen[cluster]'")
            raise ClusterUnreachable(f"--cluster needs the package {error.name}", way) from None
        try:
            self._client = Client(address, timeout=REACHED_WITHIN, set_as_default=False)
        except (OSError, ValueError) as error:
            way = "start one with `dask scheduler` and `dask worker`, and name the scheduler, as tcp://HOST:8786"
            raise ClusterUnreachable(
                f"no Dask scheduler answers at {address}: {str(error) or 'timeout'}", way
            ) from None
        self._executor: Any = self._client.get_executor(pure=False)
        self._sent: tuple[Path, Any] | None = None

    @property
    def width(self) -> int:
        """Return twice the number of jobs that the workers can execute, so that no worker waits for a job."""
        threads: dict[str, int] = self._client.nthreads()
        return 2 * max(1, sum(threads.values()))

    def submit(self, job: Job, bundle: Path, folder: Path) -> Future[RunResult]:
        if self._client.status != "running":
            raise ClusterUnreachable("the connection to the Dask scheduler is lost", "start it again, and resume")
        if self._sent is None or self._sent[0] != bundle:
            self._sent = bundle, self._client.scatter(packed(bundle), hash=False)
        text = Path(job.verdict).read_text(encoding="utf-8") if job.verdict else ""
        task: Future[tuple[RunResult, bytes]] = self._executor.submit(remote, job, self._sent[1], text)
        done: Future[RunResult] = Future()

        def arrived(finished: Future[tuple[RunResult, bytes]]) -> None:
            try:
                result, files = finished.result()
                unpacked(files, cleared(folder))
                done.set_result(result)
            # An exception of the worker, the connection or this disk. The future passes it to the caller of result().
            except BaseException as error:
                done.set_exception(error)

        task.add_done_callback(arrived)
        return done

    def stop(self) -> None:
        """Cancel waiting jobs. Running jobs continue on their workers, but their results are dropped."""
        with suppress(Exception):
            self._executor.shutdown(wait=False, cancel_futures=True)

    def close(self) -> None:
        with suppress(Exception):
            self._executor.shutdown(wait=False)
            self._client.close()


def remote(job: Job, bundle: bytes, verdict: str) -> tuple[RunResult, bytes]:
    """Execute a job on a worker. Return its result and all files of the run's folder."""
    with tempfile.TemporaryDirectory(prefix="koordgen-") as own:
        root = Path(own)
        unpacked(bundle, root / "bundle")
        if verdict:
            (root / "verdict.py").write_text(verdict, encoding="utf-8")
            job = replace(job, verdict=str(root / "verdict.py"))
        (root / "run").mkdir()
        result = execute(job, root / "bundle", root / "run" / "run", _never)
        return result, packed(root / "run" / "run")


def _never() -> bool:
    return False


def packed(folder: Path) -> bytes:
    """Return a folder's files as a zip archive. Each file keeps its path relative to the folder."""
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")) if folder.exists() else ():
            if path.is_file():
                archive.write(path, path.relative_to(folder).as_posix())
    return held.getvalue()


def unpacked(files: bytes, folder: Path) -> None:
    """Extract an archive into a new folder. Raises OSError."""
    folder.mkdir(parents=True)
    with zipfile.ZipFile(io.BytesIO(files)) as archive:
        archive.extractall(folder)
