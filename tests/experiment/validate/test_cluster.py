"""A validation on a Dask cluster of two local workers gives the same samples."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.experiment.validate.test_command import faked, validate

__all__ = ["faked"]

distributed = pytest.importorskip("distributed")


@pytest.mark.slow
def test_the_workers_samples_are_judged_here(capsys: pytest.CaptureFixture[str]) -> None:
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        words = ("--seed", "100", "--samples", "6", "--format", "json")
        assert validate(*words, "--cluster", cluster.scheduler_address) == 3
    found = json.loads(capsys.readouterr().out)
    assert found["finished"] == 6 and [a["runs"] for a in found["assumptions"]] == [6, 6]
    assert found["assumptions"][1]["violated"] == 3
    assert all((Path("out/runs") / f"{k:04d}" / "windows.jsonl").exists() for k in range(6))


def test_no_cluster_is_told(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("koordgen.experiment.campaign.executor.REACHED_WITHIN", 0.5)
    assert validate("--samples", "1", "--cluster", "tcp://127.0.0.1:9") == 5
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in capsys.readouterr().err
