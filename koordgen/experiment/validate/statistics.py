"""Statistics of independent samples: numbers of samples needed for a claim, and confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Callable

HALVINGS = 60


def needed(epsilon: float, gamma: float) -> int:
    """Return how many runs without a violation show that a violation has a probability below epsilon.

    The claim holds with confidence 1 - gamma, if the runs are independent. The number is the least n >=
    ln(1/gamma)/epsilon, because (1 - epsilon)^n <= exp(-n epsilon) <= gamma. The number also applies to samples that
    stay below a threshold. Raises ValueError if epsilon or gamma is not between 0 and 1."""
    if not (0 < epsilon < 1 and 0 < gamma < 1):
        raise ValueError(f"epsilon {epsilon:g} and gamma {gamma:g} must be between 0 and 1")
    return math.ceil(math.log(1.0 / gamma) / epsilon)


def shown_epsilon(runs: int, gamma: float) -> float:
    """Return the upper bound epsilon of a violation's probability that runs without a violation show.

    `runs`: number of independent runs. The bound has confidence 1 - gamma and solves (1 - epsilon)^runs = gamma."""
    return 1.0 if runs < 1 else -math.expm1(math.log(gamma) / runs)


def clopper_pearson(violated: int, runs: int, gamma: float) -> tuple[float, float]:
    """Return a confidence interval of the probability of a violation (Clopper and Pearson 1934).

    `violated` of `runs` independent runs had a violation. The interval contains the true probability with confidence
    1 - gamma or more. A probability p is outside the interval if the observation is unlikely for p: at least `violated`
    violations, or at most `violated` violations, then have a probability below gamma/2. Without runs, the interval is
    [0, 1]."""
    low = 0.0 if not violated else _where(lambda p: 1.0 - _at_most(violated - 1, runs, p) < gamma / 2)
    high = 1.0 if violated == runs else _where(lambda p: _at_most(violated, runs, p) > gamma / 2)
    return low, high


def _at_most(k: int, n: int, p: float) -> float:
    """Return the probability of at most k successes in n independent trials with success probability p in (0, 1)."""
    log_p, log_q = math.log(p), math.log1p(-p)
    return math.fsum(
        math.exp(math.lgamma(n + 1) - math.lgamma(i + 1) - math.lgamma(n - i + 1) + i * log_p + (n - i) * log_q)
        for i in range(k + 1)
    )


def _where(below: Callable[[float], bool]) -> float:
    """Return the largest p in [0, 1] for which a condition is true, found by bisection.

    The condition must be true for all smaller p and false for all larger p."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if below(middle) else (low, middle)
    return (low + high) / 2
