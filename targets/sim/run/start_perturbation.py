"""Start perturbation: random start poses near those of the fleet file, determined by the seed."""

from __future__ import annotations

from random import Random

from msgspec.structs import replace

from targets.sim.base.scenario import Robot, Scenario, check_starts


def scattered(scenario: Scenario, seed: int) -> Scenario:
    """Perturb each start uniformly by at most `start_noise`: metres in x and y, radians in yaw.

    Raises BadScenario if a perturbed start is not possible."""
    most = scenario.number("start_noise", 0.0)
    if not most:
        return scenario
    moved = replace(
        scenario, robots=tuple(_moved(robot, most, Random(f"{seed}/{robot.pid}/start")) for robot in scenario.robots)
    )
    check_starts(moved)
    return moved


def _moved(robot: Robot, most: float, random: Random) -> Robot:
    (x, y, z), yaw = robot.start.position, robot.start.yaw
    east, north, turn = (random.uniform(-most, most) for _ in range(3))
    return replace(robot, start=replace(robot.start, position=(x + east, y + north, z), yaw=yaw + turn))
