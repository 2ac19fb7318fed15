"""Bounds and intervals compared with published values."""

from __future__ import annotations

import math

import pytest

from koordgen.experiment.validate.statistics import clopper_pearson, needed, shown_epsilon


@pytest.mark.parametrize(
    ("epsilon", "gamma", "runs"),
    [(0.05, 0.05, 60), (0.05, 0.01, 93), (0.1, 0.05, 30), (0.01, 0.05, 300),
     (0.1, 0.1, 24), (0.01, 0.001, 691), (0.5, 0.5, 2)],
)  # fmt: skip
def test_so_many_runs_are_needed(epsilon: float, gamma: float, runs: int) -> None:
    assert needed(epsilon, gamma) == runs
    assert (1 - epsilon) ** runs <= gamma, "without a violation that is how likely they are at most"
    assert shown_epsilon(runs, gamma) <= epsilon


@pytest.mark.parametrize(("epsilon", "gamma"), [(0.0, 0.1), (1.0, 0.1), (0.1, 0.0), (0.1, 1.5)])
def test_what_is_no_part_is_refused(epsilon: float, gamma: float) -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        needed(epsilon, gamma)


def test_what_so_many_runs_show() -> None:
    assert shown_epsilon(59, 0.05) == pytest.approx(1 - 0.05 ** (1 / 59), abs=1e-12)
    assert shown_epsilon(0, 0.05) == 1.0


@pytest.mark.parametrize(
    ("violated", "runs", "low", "high"),
    # Quantiles of the beta distribution by scipy 1.17.1.
    [
        (0, 10, 0.0, 0.3084971), (10, 10, 0.6915029, 1.0), (5, 10, 0.1870860, 0.8129140), (1, 20, 0.0012651, 0.2487328),
        (0, 60, 0.0, 0.0596295), (3, 60, 0.0104323, 0.1392432), (1, 1, 0.025, 1.0), (0, 0, 0.0, 1.0),
    ],
)  # fmt: skip
def test_clopper_pearson(violated: int, runs: int, low: float, high: float) -> None:
    assert clopper_pearson(violated, runs, 0.05) == pytest.approx((low, high), abs=2e-7)


def test_its_ends_are_where_the_tails_are_half_of_gamma() -> None:
    low, high = clopper_pearson(7, 300, 0.01)
    weights = [math.comb(300, k) for k in range(301)]
    at_least = sum(w * low**k * (1 - low) ** (300 - k) for k, w in enumerate(weights) if k >= 7)
    at_most = sum(w * high**k * (1 - high) ** (300 - k) for k, w in enumerate(weights) if k <= 7)
    assert at_least == pytest.approx(0.005, rel=1e-6) and at_most == pytest.approx(0.005, rel=1e-6)
