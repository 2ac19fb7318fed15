"""A few of the trials in which a deployment is disturbed; `make deploy-campaign` runs 200."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.operate.fault_trials import KINDS, campaign


@pytest.mark.slow
def test_a_deployment_that_is_disturbed_leaves_a_fleet_that_runs_one_release_or_none(tmp_path: Path) -> None:
    records = campaign(tmp_path, 2 * len(KINDS), seed=28)
    assert [each["violations"] for each in records] == [[]] * 8
