"""Chaos in virtual time, seeded. Each test is a command: `pytest -m slow tests/chaos/test_virtual.py -k counter`."""

from __future__ import annotations

from collections import Counter
from functools import partial

import pytest

from tests.chaos import virtual
from tests.chaos.runs import Say, scaled
from tests.chaos.virtual import Ended, spread

pytestmark = pytest.mark.slow
PEER_TIMEOUT = 10  # rounds
HEALED = PEER_TIMEOUT + 20  # rounds after which a fleet has converged that was apart


def judge(ends: list[Ended], say: Say) -> None:
    wrong = [text for end in ends for text in end.wrong]
    rounds = sorted(e.rounds for e in ends)
    say(f"{sum(bool(e.wrong) for e in ends)} of {len(ends)} runs wrong; rounds {rounds[0]} to {rounds[-1]}")
    assert not wrong, "\n".join(wrong[:20])


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.3, 0.5])
def test_counter(loss: float, say: Say) -> None:
    work = partial(virtual.counter, loss=loss)
    judge(spread(work, range(scaled(2000)), say, f"counter at {loss:.0%} loss"), say)


def test_next_round(say: Say) -> None:
    ends = spread(virtual.steps, range(scaled(130)), say, "next round")
    say(f"{sum(e.reads for e in ends)} reads")
    judge(ends, say)
    assert sum(e.reads for e in ends) >= scaled(100_000)


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_kill_and_restart(loss: float, say: Say) -> None:
    work = partial(virtual.kills, loss=loss)
    ends = spread(work, range(scaled(300)), say, f"kills at {loss:.0%} loss")
    say(f"{sum(e.kills for e in ends)} kills")
    judge(ends, say)
    assert sum(e.kills for e in ends) >= scaled(1000)


def test_partition_and_heal(say: Say) -> None:
    ends = spread(virtual.parted, range(scaled(300)), say, "partition")
    judge(ends, say)
    assert max(e.rounds for e in ends) <= HEALED


@pytest.mark.parametrize(("loss", "later"), [(0.0, 5), (0.3, 15)])
def test_killed_for_good(loss: float, later: int, say: Say) -> None:
    """The others run events again within peer_timeout + 5 rounds; on a bad network the ballots take longer."""
    ends = spread(partial(virtual.removed, loss=loss), range(scaled(300)), say, f"killed for good at {loss:.0%} loss")
    judge(ends, say)
    say(f"events again after {sorted(Counter(e.rounds for e in ends).items())} rounds")
    assert max(e.rounds for e in ends) <= PEER_TIMEOUT + later
