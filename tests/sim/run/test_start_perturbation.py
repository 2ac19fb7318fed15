"""Starts that the seed scatters."""

from __future__ import annotations

import pytest

from koordgen.runtime.trace.schema import BoxRecord
from targets.sim.base.scenario import BadScenario, GeodeticOrigin, Robot, Scenario, Start
from targets.sim.run.start_perturbation import scattered


def fleet(noise: float, wide: float = 5.0) -> Scenario:
    robots = tuple(
        Robot(f"r{pid}", pid, "car", "", "car", "drive", Start((2.0 * pid, 0.0, 0.0), 1.0)) for pid in range(2)
    )
    fence = BoxRecord((-wide, -wide, -1.0), (wide, wide, 1.0))
    return Scenario(
        "app", "app.koord", "", 0.1, GeodeticOrigin(0.0, 0.0, 0.0), fence, robots, harness={"start_noise": noise}
    )


def test_without_noise_all_start_where_the_fleet_file_says() -> None:
    assert scattered(fleet(0.0), 3) == fleet(0.0)


def test_a_seed_scatters_them_and_another_one_otherwise() -> None:
    seen = set()
    for seed in range(50):
        robots = scattered(fleet(0.3), seed).robots
        assert robots == scattered(fleet(0.3), seed).robots
        for pid, robot in enumerate(robots):
            x, y, z = robot.start.position
            assert abs(x - 2.0 * pid) <= 0.3 and abs(y) <= 0.3 and z == 0.0 and abs(robot.start.yaw - 1.0) <= 0.3
            seen.add(robot.start.position)
    assert len(seen) == 100
    assert max(x for x, _, _ in seen) > 2.25 and min(x for x, _, _ in seen) < -0.25


def test_a_start_outside_the_geofence_is_told() -> None:
    with pytest.raises(BadScenario, match="outside the geofence"):
        for seed in range(20):
            scattered(fleet(3.0, wide=2.5), seed)
