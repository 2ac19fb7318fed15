"""Statistics of independent samples: the number of samples that is needed, and confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Callable

HALVINGS = 60


def needed(epsilon: float, gamma: float) -> int:
    """Return the number of samples that show a claim, if none of them exceeds a threshold.

    The claim: with confidence 1 - gamma, at most a fraction epsilon of all future samples exceeds the threshold. The
    samples must be independent. The number is the least n >= ln(1/gamma)/epsilon, because (1 - epsilon)^n <= exp(-n
    epsilon) <= gamma. The same number applies to runs without a violation. Raises ValueError."""
    if not (0 < epsilon < 1 and 0 < gamma < 1):
        raise ValueError(f"epsilon {epsilon:g} and gamma {gamma:g} must be between 0 and 1")
    return math.ceil(math.log(1.0 / gamma) / epsilon)


def shown_epsilon(runs: int, gamma: float) -> float:
    """Return the epsilon that `runs` runs without a violation show at confidence 1 - gamma.

    It solves (1 - epsilon)^runs = gamma."""
    return 1.0 if runs < 1 else -math.expm1(math.log(gamma) / runs)


def clopper_pearson(violated: int, runs: int, gamma: float) -> tuple[float, float]:
    """Return a confidence interval of the probability of a violation (Clopper and Pearson 1934).

    The interval contains the true probability with confidence 1 - gamma or more. A probability p is in the interval
    unless the observation would be rare with p: unless `violated` or more violations, or `violated` or fewer
    violations, have a probability below gamma/2. Without runs, the interval is [0, 1]."""
    low = 0.0 if not violated else _where(lambda p: 1.0 - _at_most(violated - 1, runs, p) < gamma / 2)
    high = 1.0 if violated == runs else _where(lambda p: _at_most(violated, runs, p) > gamma / 2)
    return low, high


def _at_most(k: int, n: int, p: float) -> float:
    """Return the probability of at most k out of n, each with probability p in (0, 1)."""
    log_p, log_q = math.log(p), math.log1p(-p)
    return math.fsum(
        math.exp(math.lgamma(n + 1) - math.lgamma(i + 1) - math.lgamma(n - i + 1) + i * log_p + (n - i) * log_q)
        for i in range(k + 1)
    )


def _where(below: Callable[[float], bool]) -> float:
    """Return the largest probability for which a condition is true, found by bisection.

    The condition must be true below this probability and false above it."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if below(middle) else (low, middle)
    return (low + high) / 2
