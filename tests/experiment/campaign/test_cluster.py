"""A campaign on a Dask cluster of two local workers gives the same results."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli.base import console
from koordgen.experiment.campaign.executor import packed, unpacked
from tests.experiment.campaign.test_campaign import campaign, faked, results

__all__ = ["faked"]

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as running:
        yield running


def test_the_workers_execute_the_runs(cluster: Any, capsys: pytest.CaptureFixture[str]) -> None:
    Path("verdict.py").write_text(
        "import json, os, sys\nprint(json.dumps({'worker': os.getppid(), 'there': os.path.exists(sys.argv[1])}))\n"
    )
    words = ("--vary", "seed=1:4,loss=0,0.3,param.extra=0,100", "--verdict", "verdict.py")
    assert campaign(*words, "--cluster", cluster.scheduler_address) == 3
    assert "16 runs: 8 held, 8 violated" in capsys.readouterr().out
    found = sorted(results(), key=lambda r: int(r["run"]))
    assert [r["mission"] for r in found[:4]] == [11.0, 111.0, 11.0, 111.0]
    assert {int(r["figures"]["worker"]) for r in found} == {w["pid"] for w in _workers(cluster)}
    assert all((Path("out/runs") / f"{k:04d}" / "summary.json").exists() for k in range(16))


def _workers(cluster: Any) -> list[dict[str, Any]]:
    with distributed.Client(cluster) as client:
        return [{"pid": pid} for pid in client.run(_pid).values()]


def _pid() -> int:
    import os

    return os.getpid()


def test_a_worker_tells_what_did_not_run_and_it_is_repeated_here(cluster: Any) -> None:
    words = ("--vary", "mode=held,crash")
    assert campaign(*words, "--cluster", cluster.scheduler_address) == 5
    assert {r["run"]: r["outcome"] for r in results()} == {0: "held", 1: "failed"}
    assert campaign(*words, "--resume") == 5
    assert len(results()) == 3, "the run that held is not repeated, wherever it was"


def test_no_cluster_is_told(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("koordgen.experiment.campaign.executor.REACHED_WITHIN", 0.5)
    assert campaign("--vary", "seed=1:2", "--cluster", "tcp://127.0.0.1:9") == 5
    err = capsys.readouterr().err
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in err and "dask scheduler" in err
    assert campaign("--vary", "seed=1:2", "--cluster", "nonsense:x") == 5
    assert "no Dask scheduler answers at nonsense:x" in capsys.readouterr().err


def test_a_missing_package_is_told(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert campaign("--vary", "seed=1:2", "--cluster", "tcp://127.0.0.1:8786") == 5
    assert "pip install 'koordgen[cluster]'" in capsys.readouterr().err
    assert campaign("--vary", "seed=1:2") == console.HOLDS


def test_a_folder_goes_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "a/b").mkdir(parents=True)
    (tmp_path / "a/b/x.json").write_text(json.dumps({"ä": 1}))
    (tmp_path / "a/.koord-run").touch()
    unpacked(packed(tmp_path / "a"), tmp_path / "c")
    assert sorted(p.relative_to(tmp_path / "c").as_posix() for p in (tmp_path / "c").rglob("*")) == [
        ".koord-run", "b", "b/x.json",
    ]  # fmt: skip
