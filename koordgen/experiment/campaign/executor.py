"""Executors of simulation runs: a thread pool on this host, or a Dask cluster. Both return futures of results."""

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

REACHED_WITHIN = 10  # seconds to wait for the answer of a Dask scheduler


class ClusterUnreachable(Exception):
    """Raised if a Dask cluster cannot be used: `distributed` is not installed, or the connection fails.

    `help` is advice for the user."""

    def __init__(self, message: str, help: str) -> None:
        super().__init__(message)
        self.help = help


class Executor(Protocol):
    """Interface of an executor. A job is one simulation run.

    `width`: largest number of jobs that may be submitted and not finished.
    `submit`: starts a job or queues it; the run writes its files into `folder`.
    `stop`: cancels queued jobs, and ends running jobs if the executor can.
    `close`: releases the executor's threads or connection."""

    @property
    def width(self) -> int: ...

    def submit(self, job: Job, bundle: Path, folder: Path) -> Future[RunResult]: ...

    def stop(self) -> None: ...

    def close(self) -> None: ...


class LocalPool:
    """Executor on this host: a pool of threads. Each thread starts a run as a process and waits for its end."""

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
    """Executor on a Dask cluster.

    The cluster's workers must have the same version of koordgen as this host, and the packages of the simulator.
    Bundles and run folders are sent over Dask's connections, so no shared disk is needed."""

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
            way = "start `dask scheduler` and `dask worker`; give the scheduler's address, --cluster tcp://HOST:8786"
            raise ClusterUnreachable(
                f"no Dask scheduler answers at {address}: {str(error) or 'timeout'}", way
            ) from None
        self._executor: Any = self._client.get_executor(pure=False)
        self._sent: tuple[Path, Any] | None = None

    @property
    def width(self) -> int:
        """Return how many jobs to submit at once: twice the number of threads of all workers of the cluster.

        Each worker then has a queued job and starts the queued job without delay."""
        threads: dict[str, int] = self._client.nthreads()
        return 2 * max(1, sum(threads.values()))

    def submit(self, job: Job, bundle: Path, folder: Path) -> Future[RunResult]:
        if self._client.status != "running":
            raise ClusterUnreachable(
                "the connection to the Dask scheduler is lost", "start the scheduler again, then use --resume"
            )
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
            # The cluster's worker, the connection or the local disk can fail. The future `done` passes the exception
            # to the caller of `done.result()`.
            except BaseException as error:
                done.set_exception(error)

        task.add_done_callback(arrived)
        return done

    def stop(self) -> None:
        """Cancel queued jobs. Running jobs continue on the cluster's workers, but their results are dropped."""
        with suppress(Exception):
            self._executor.shutdown(wait=False, cancel_futures=True)

    def close(self) -> None:
        with suppress(Exception):
            self._executor.shutdown(wait=False)
            self._client.close()


def remote(job: Job, bundle: bytes, verdict: str) -> tuple[RunResult, bytes]:
    """Execute a simulation run on a worker of a Dask cluster. A worker calls this function.

    `bundle`: zip archive of the simulation bundle.
    `verdict`: text of the user's verdict script; "" if there is none.
    Return the result, and a zip archive of the run's folder."""
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
    """Return all files in a folder as a zip archive. Each file keeps its path relative to the folder."""
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")) if folder.exists() else ():
            if path.is_file():
                archive.write(path, path.relative_to(folder).as_posix())
    return held.getvalue()


def unpacked(files: bytes, folder: Path) -> None:
    """Extract a zip archive into a new folder. Raises OSError if the folder exists or cannot be written."""
    folder.mkdir(parents=True)
    with zipfile.ZipFile(io.BytesIO(files)) as archive:
        archive.extractall(folder)
