"""Whole fleets in lockstep that hold and resume amid obstacles, and land: nothing touches, and all arrive."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.sim.run.clearance_campaign import common, ran, robot, simulated, wall_with

HALF = 0.65  # metres: half of the door's width


def tour(**event: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """A fleet whose quad bob flies through a door to the north while ann hovers, and what happens meanwhile."""
    robots = [
        {
            "name": name, "target": "quad", "address": f"127.0.0.1:{47100 + pid}", "start": {"position": [x, 1.0, 0.0]}
        }
        for pid, (name, x) in enumerate((("bob", 6.0), ("ann", 1.0)))
    ]  # fmt: skip
    fleet = {
        "delta": 0.1,
        "origin": {"latitude": 47.4, "longitude": 8.5, "altitude": 488.0},
        "geofence": {"lo": [0.0, 0.0, -0.5], "hi": [8.0, 8.0, 3.0]},
        "avoid": "ways",
        "params": {"goals": [[6.0, 6.5, 1.5], [1.0, 1.0, 1.5]], "startles": [-1, -1], "each": 1},
        "robots": robots,
        "sim": {"boot": 0.5, "fidelity": "simple"},
        "obstacles": wall_with(3.5 - HALF, 3.5 + HALF),
    }
    return fleet, {"events": [event]}


@pytest.mark.parametrize("event", [{"at": 6.0, "freeze": "ann", "for": 2.0}, {"at": 6.0, "crash": "bob", "for": 1.0}])
def test_a_quad_goes_on_behind_the_door_that_it_has_passed(tmp_path: Path, event: dict[str, Any]) -> None:
    """It holds while another robot is frozen, or its own agent begins anew, and does not fly its path again."""
    summary = simulated(tmp_path, *tour(**event), seed=0, duration=16.0)
    bob = summary["robots"][0]
    assert summary["violations"] == []
    assert bob["events"]["Arrive"] == 1 and bob["path_length"] < 10.5


def test_a_run_of_the_campaign_without_contacts(tmp_path: Path) -> None:
    """A quad is frozen before a door. `make clearance-campaign` runs many seeds, and for longer."""
    assert ran(18, tmp_path, duration=6.0)["contacts"] == []


def test_a_run_of_the_campaign_after_targets(tmp_path: Path) -> None:
    assert ran(2, tmp_path, duration=4.0, scenes=("targets",))["contacts"] == []


MEETING = """\
param List<Point> goals max 2 = [Point(0, 0, 0), Point(0, 0, 0)]

using Motion:
  actuators: Point target
  sensors:
    Point position
    bool reached

allread:
  Point places[N_SYS]

init:
  Motion.target = goals[pid]
  places[pid] = goals[pid]

Stay:
  pre: False
  eff: places[pid] = Motion.position
"""


@pytest.mark.parametrize(("lower", "height"), [("car", 0.0), ("quad", 1.5)])
def test_a_quad_that_ends_above_another_robot_lands_beside_it(tmp_path: Path, lower: str, height: float) -> None:
    robots = [robot(0, "quad", (2.0, 1.0), 0.0), robot(1, lower, (4.0, 4.0), 0.0)]
    fleet = common(robots, {"goals": [[4.0, 4.0, 2.6], [4.0, 4.0, height]]}, [])
    fleet |= {"avoid": "places", "sim": {"boot": 0.5, "fidelity": "simple"}}
    summary = simulated(tmp_path, fleet, {"events": []}, seed=0, duration=7.0, program=MEETING)
    assert summary["violations"] == []
    log = (tmp_path / "run" / "robots" / "ann" / "log.txt").read_text()
    assert "robot bob may be below: moving to (" in log
