"""What a fleet's agents must have seen, computed centrally from what they did."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.fixtures.fleet import STARTS, Fleet


def stores(fleet: Fleet) -> dict[int, Mapping[str, Any]]:
    """S_r for every round, from the recorded effects: writes of round r are in S_{r+1}, by ascending pid."""
    n = fleet.n
    store: dict[str, Any] = {"x": tuple(STARTS[i % len(STARTS)] for i in range(n)), "last": n - 1}
    effects = {(rec.round, pid): rec.effects for pid, r in fleet.robots.items() for rec in r.records}
    last = max(r.agent.round for r in fleet.robots.values())
    found: dict[int, Mapping[str, Any]] = {}
    for round_ in range(1, last + 1):
        found[round_] = dict(store)
        for pid in range(n):
            did = effects.get((round_, pid))
            if did is None:
                continue
            if "x" in did.shared:
                slots = list(store["x"])
                slots[pid] = did.shared["x"]
                store["x"] = tuple(slots)
            if "last" in did.shared:
                store["last"] = did.shared["last"]
    return found


def check_visibility(fleet: Fleet) -> int:
    """Every event saw exactly S_r; returns how many did."""
    expected = stores(fleet)
    seen = 0
    told = min(robot.records[-1].round for robot in fleet.robots.values())  # of later rounds not all is certain yet
    for pid, robot in fleet.robots.items():
        rounds = [record.round for record in robot.records]
        assert rounds == sorted(set(rounds))
        for record in robot.records:
            if record.frame is not None and record.round <= told + 1:
                assert record.frame.shared == expected[record.round], (pid, record.round)
                seen += 1
    return seen
