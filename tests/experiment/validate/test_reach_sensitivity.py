"""Learning from systems with known sensitivity: coverage on fresh samples, tightness, the bound."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from koordgen.experiment.validate import tube
from koordgen.experiment.validate.statistics import needed

Array = NDArray[np.float64]
EPSILON, GAMMA = 0.05, 0.01
TIMES = np.arange(5 * 60 + 1) / 60  # seconds
Ways = tuple[Array, Array]  # (n, T, d) metres, (n, f)


def lagging(random: np.random.Generator, count: int) -> Ways:
    """x' = 1 - x, in two dimensions, from a square: |x1(t) - x0(t)| = exp(-t) |x1(0) - x0(0)|."""
    starts = random.uniform(-0.2, 0.2, (count, 2))
    return 1 + (starts[:, None] - 1) * np.exp(-TIMES)[None, :, None], starts


def steered(random: np.random.Generator, count: int) -> Ways:
    """x'' = 4 (1 - x) - x', from drawn places and speeds: it overshoots by exp(-pi/sqrt(15)), if it stood."""
    starts = np.stack([random.uniform(-0.2, 0.2, count), random.uniform(0.0, 1.0, count)], axis=1)
    w = math.sqrt(4 - 0.25)
    a = starts[:, :1] - 1
    b = (starts[:, 1:] + 0.5 * a) / w
    return (1 + np.exp(-0.5 * TIMES) * (a * np.cos(w * TIMES) + b * np.sin(w * TIMES)))[..., None], starts


def learned_of(paths: Array, starts: Array, each: int) -> tube.Tube:
    return tube.tube(TIMES, paths, starts, each, 0.05, np.eye(paths.shape[2]))


def found(of: Callable[[np.random.Generator, int], Ways], seed: int = 1) -> tube.Tube:
    each = needed(EPSILON, GAMMA)
    return learned_of(*of(np.random.default_rng(seed), 3 * each), each)


@pytest.mark.parametrize("of", [lagging, steered])
def test_fresh_ways_stay_in_the_tube_and_it_is_tight(of: Callable[[np.random.Generator, int], Ways]) -> None:
    learned = found(of)
    paths, _ = of(np.random.default_rng(99), 5000)
    box = np.minimum(np.searchsorted(learned.edges, TIMES, side="right") - 1, len(learned.lower) - 1)
    inside = ((learned.lower[box] <= paths) & (paths <= learned.upper[box])).all(axis=(1, 2))
    assert inside.mean() >= 1 - EPSILON
    assert learned.covered >= 1 - EPSILON and learned.pairs_covered >= 1 - EPSILON
    true = paths.max(axis=0) - paths.min(axis=0)
    assert float((learned.upper[box] - learned.lower[box]).mean()) < 1.25 * float(true.mean())


def test_a_first_order_lag_has_the_sensitivity_that_it_has() -> None:
    learned = found(lagging).sensitivity
    assert learned.factor == pytest.approx(1.0, abs=1e-9)
    # A segment's end has the most of both segments: they begin 0.25 s earlier, but for the first.
    assert learned.rates[1:] == pytest.approx(-1.0, abs=1e-6)
    assert learned.gains[4] == pytest.approx(math.exp(-(learned.edges[4] - 0.25)), rel=1e-6)


def test_the_sensitivity_of_a_second_order_system_is_over_the_true_one() -> None:
    learned = found(steered).sensitivity
    # The norm of the first row of exp(A t), for the state (x, x').
    w = math.sqrt(4 - 0.25)
    decay = np.exp(-0.5 * TIMES)
    row = np.stack([decay * (np.cos(w * TIMES) + 0.5 / w * np.sin(w * TIMES)), decay * np.sin(w * TIMES) / w])
    true = np.linalg.norm(row, axis=0)
    gain = learned.gain(TIMES)
    late = TIMES > 0.5
    assert (gain[late] > 0.9 * true[late]).all() and (gain[late] < 2 * true[late] + 0.1).all()


def test_the_same_samples_give_the_same_tube() -> None:
    a, b, other = found(steered), found(steered), found(steered, seed=2)
    assert (a.lower == b.lower).all() and (a.upper == b.upper).all()
    assert not (a.lower == other.lower).all()


def test_of_many_tubes_few_break_the_promise() -> None:
    """That whole ways leave it with a probability of more than epsilon happens with gamma at most, here of 20."""
    fresh, _ = lagging(np.random.default_rng(7), 2000)
    worse = 0
    for seed in range(20):
        learned = found(lagging, seed)
        box = np.minimum(np.searchsorted(learned.edges, TIMES, side="right") - 1, len(learned.lower) - 1)
        inside = ((learned.lower[box] <= fresh) & (fresh <= learned.upper[box])).all(axis=(1, 2))
        worse += bool(inside.mean() < 1 - EPSILON)
    assert worse <= 1


def test_a_way_that_left_is_told() -> None:
    each = needed(EPSILON, GAMMA)
    paths, starts = lagging(np.random.default_rng(1), 3 * each)
    plain = learned_of(paths, starts, each)
    paths[-3:, 100:150] += 1.0
    learned = learned_of(paths, starts, each)
    assert plain.covered - 3 / each - 1e-9 <= learned.covered <= 1 - 3 / each + 1e-9
    assert learned.pairs_covered == pytest.approx(1 - 3 / each)


def test_a_way_that_left_among_those_of_calibration_makes_the_tube_larger() -> None:
    each = needed(EPSILON, GAMMA)
    paths, starts = lagging(np.random.default_rng(1), 3 * each)
    plain = learned_of(paths, starts, each)
    paths[each + 3, 100] += 0.3
    wider = learned_of(paths, starts, each)
    assert wider.inflated > 2 * plain.inflated
    at = int(np.searchsorted(wider.edges, TIMES[100])) - 1
    assert (wider.upper[at] >= paths[each + 3, 100]).all()


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(ValueError, match="are too few"):
        learned_of(*lagging(np.random.default_rng(1), 20), 10)
