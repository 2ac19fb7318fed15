"""Time until an outer robot goes on after the loss of an inner robot, on the simulated clock."""

from __future__ import annotations

import pytest

from tests.squads.levels import INNER, Levels
from tests.squads.test_hosts import COUNT, LINE

TIMEOUT = 10  # inner rounds
WITHIN = (TIMEOUT + 5) * INNER


@pytest.mark.parametrize("seed", range(3))
def test_another_host_runs_the_outer_agent_soon_after_the_death_of_the_first(seed: int) -> None:
    levels = Levels(COUNT, [3, 3, 0], seed)
    levels.run_rounds(4 + seed)
    levels.run(0.07 * seed)
    killed = levels.time.time
    levels.kill(0)
    assert levels.run(WITHIN, lambda: levels.host(0) is not None), levels.time.time - killed


@pytest.mark.parametrize("seed", range(3))
def test_the_outer_robot_sends_again_soon_after_the_death_of_another_inner_robot(seed: int) -> None:
    levels = Levels(COUNT, [3, 3, 0], seed)
    levels.run_rounds(4 + seed)
    levels.run(0.07 * seed)
    levels.kill(2)
    host = levels.host(0)
    assert host is not None and host.host is not None
    store, sender = host.host._store, host.host._sender
    assert store is not None and sender is not None
    levels.run(4 * INNER)
    version = store.version
    assert levels.run(WITHIN - 4 * INNER, lambda: sender._committed >= version), "its messages leave"


def test_the_outer_robot_holds_soon_after_the_loss_of_the_inner_majority() -> None:
    levels = Levels(LINE, [0, 3, 0])
    levels.run_rounds(6)
    host = levels.host(1)
    assert host is not None and host.host is not None and host.host._platform is not None
    levels.kill(2)
    levels.kill(3)
    assert levels.run(
        WITHIN, lambda: host.host is not None and host.host._platform is not None and host.host._platform._held
    )
