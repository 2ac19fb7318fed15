"""Figures of a run: bounded, cheap, right within a bucket."""

from __future__ import annotations

import random

import pytest

from koordgen.runtime.net.metrics import Histogram, Metrics


def test_quantiles_are_right_within_a_bucket() -> None:
    rng, histogram = random.Random(1), Histogram()
    values = sorted(10 ** rng.uniform(-5, 1) for _ in range(5000))
    for value in values:
        histogram.add(value)
    for share in (0.01, 0.5, 0.9, 0.99, 1.0):
        exact = values[max(0, int(share * len(values)) - 1)]
        assert exact <= histogram.quantile(share) * (1 + 1e-9) and histogram.quantile(share) <= exact * 1.1
    assert histogram.snapshot()["max"] == pytest.approx(values[-1] * 1e3, abs=1e-3)


@pytest.mark.parametrize("value", [0.0, -1.0, 1e-9, 1e9])
def test_extremes_are_counted(value: float) -> None:
    histogram = Histogram()
    histogram.add(value)
    assert histogram.count() == 1 and histogram.quantile(0.99) <= max(value, 1e-6)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_what_is_no_number_is_not_counted(value: float) -> None:
    histogram = Histogram()
    histogram.add(value)
    assert histogram.count() == 0 and histogram.snapshot() == {}


def test_nothing_was_heard_yet() -> None:
    found = Metrics(0, 2).snapshot(5.0, {})
    assert found["peers"] == {
        "1": {"loss": None, "delay_ms": {}, "silent_ms": None, "longest_silence_ms": 0.0, "behind": 0, "repeats": 0}
    }
    assert found["late_ms"] == {} and found["rounds"] == 0


def test_loss_is_what_is_missing_and_late_ones_are_not() -> None:
    metrics = Metrics(0, 2)
    newest = 0
    for sequence in (1, 2, 5, 4, 6, 10):  # 3, 7, 8, 9 never come
        metrics.heard([(1, sequence - newest, None)], float(sequence))
        newest = max(newest, sequence)
    assert metrics.snapshot(11.0, {})["peers"]["1"]["loss"] == 0.4


def test_loss_is_that_of_late() -> None:
    metrics, rng, now = Metrics(0, 2), random.Random(1), 0.0
    for lost in (0.0, 0.3):
        ahead = 1
        for _ in range(5000):
            now += 0.1
            if rng.random() < lost:
                ahead += 1
            else:
                metrics.heard([(1, ahead, 0.001)], now)
                ahead = 1
        found = metrics.snapshot(now, {})["peers"]["1"]["loss"]
        assert found == pytest.approx(lost, abs=0.07)


def test_silence_delay_and_what_is_behind() -> None:
    metrics = Metrics(1, 3)
    for now in (1.0, 1.1, 3.1, 3.2):
        metrics.heard([(2, 1, 0.004)], now)
    metrics.held((0, 9, 7))
    metrics.held((0, 9, 5))
    metrics.repeated(2)
    metrics.round(10, 0.002, None, None, True)
    peer = metrics.snapshot(3.7, {"malformed": 2})["peers"]["2"]
    assert (peer["longest_silence_ms"], peer["silent_ms"], peer["behind"], peer["repeats"]) == (2000.0, 500.0, 2, 1)
    assert peer["delay_ms"]["p50"] == pytest.approx(4.0, rel=0.1)


def test_rounds_are_counted_and_reasons_do_not_grow_without_bound() -> None:
    metrics = Metrics(0, 1)
    for number in range(1, 1001):
        skipped = f"reason {number}" if number % 2 else None
        metrics.round(number, 0.001 * (number == 1000), None if skipped else "Move", skipped, number % 2 == 0)
    found = metrics.snapshot(0.0, {})
    assert (found["rounds"], found["current"], found["events"]) == (1000, 500, 500)
    assert len(found["skipped"]) == 32
    assert found["late_ms"] == {"p50": pytest.approx(0.001, rel=0.2), "p99": pytest.approx(0.001, rel=0.2), "max": 1.0}
