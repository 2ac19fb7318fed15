"""Settings of random tests and signals, and the table of times after a run of the slow tests."""

from __future__ import annotations

import os
import signal
from collections import Counter, defaultdict

import pytest
from hypothesis import settings

# Random tests are the same at every run of the everyday suite; HYPOTHESIS_PROFILE=random makes them new each time.
settings.register_profile("everyday", derandomize=True, deadline=None)
settings.register_profile("random", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "everyday"))

# A shell starts commands in the background with SIGINT ignored, and processes that tests start would inherit that.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

OUTCOMES = ("passed", "failed", "error", "skipped")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print each group's outcomes and the seconds that its slow tests took; a group is a folder of tests/."""
    if config.option.markexpr != "slow" or config.option.collectonly:
        return
    counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
    seconds: defaultdict[str, float] = defaultdict(float)
    for outcome, reports in terminalreporter.stats.items():
        for report in reports:
            if not isinstance(report, pytest.TestReport):
                continue
            group = report.nodeid.split("/")[1]
            seconds[group] += report.duration
            if outcome in OUTCOMES:
                counts[group][outcome] += 1
    terminalreporter.section("slow tests by group")
    terminalreporter.line(f"{'group':12}" + "".join(f"{outcome:>9}" for outcome in OUTCOMES) + f"{'seconds':>10}")
    for group in sorted(counts):
        row = "".join(f"{counts[group][outcome]:9}" for outcome in OUTCOMES)
        terminalreporter.line(f"{group:12}{row}{seconds[group]:10.0f}")
    row = "".join(f"{sum(each[outcome] for each in counts.values()):9}" for outcome in OUTCOMES)
    terminalreporter.line(f"{'all':12}{row}{sum(seconds.values()):10.0f}")
