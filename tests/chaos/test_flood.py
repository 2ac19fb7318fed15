"""A million bad datagrams into a running fleet: nothing raises, nothing changes, nothing grows, rounds keep time."""

from __future__ import annotations

import gc
import time
from pathlib import Path
from typing import Any

import pytest

from benchmarks.fixtures.fleet import Fleet
from koordgen.runtime.agent.output_commit import AHEAD
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.values.points import Point
from tests.chaos.flood import Attacker
from tests.chaos.runs import Say, scaled
from tests.chaos.virtual import Still, counter_program

pytestmark = pytest.mark.slow
N = 3
BATCH = 500  # at once, a few times a round
GROWTH = 8 << 20  # bytes that may be allocated more in the second half than in the first


def fleet() -> Fleet:
    made = Fleet(n=N, seed=3, conditions=Conditions(delay=0.001), program=counter_program(10**9))
    for pid in range(N):
        made.boot(pid, Still(Point(float(pid))))
    return made


def history(of: Fleet, through: int) -> list[Any]:
    """What the robots did, without times: a clock is read more often under attack."""
    return [
        [
            (r.round, r.event, r.skipped, r.effects, r.frame and r.frame.shared)
            for r in robot.records
            if r.round < through
        ]
        for robot in of.robots.values()
    ]


def resident() -> int:
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


def test_flood(say: Say) -> None:
    quiet, attacked = fleet(), fleet()
    attacker = Attacker(attacked, 1)
    attacked.run_rounds(10)
    batches = scaled(1_000_000 // BATCH)
    began, half = time.process_time(), 0
    for batch in range(batches):
        attacker.play(batch % N, BATCH)
        attacked.run(0.0317)
        if batch == batches // 2:
            half = resident()
    spent = time.process_time() - began
    grown = resident() - half
    rounds = min(r.agent.round for r in attacked.robots.values())
    say(f"{attacker.made} in {rounds} rounds, {spent / batches / BATCH * 1e6:.1f} us each, {grown >> 10} KiB more")
    quiet.run_rounds(rounds)
    told = rounds - AHEAD  # what later rounds came to is not told before it is certain
    for robot in attacked.robots.values():
        assert robot.agent.phase == "running"
        assert not [line for line in robot.lines if "error" in line]
        assert [r.round for r in robot.records if r.round < told] == list(range(1, told))
    assert history(attacked, told - 1) == history(quiet, told - 1)
    assert grown < GROWTH
