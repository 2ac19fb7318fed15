"""The parts of a whole agent that tests of the shared memory look at."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.fixtures.fleet import Robot
from koordgen.runtime.agent.rounds import Rounds
from koordgen.runtime.replication.replica import Replica
from koordgen.runtime.replication.state_machine import StateMachine


def replica_of(robot: Robot) -> Replica | None:
    """Return the robot's replica; None until its mission begins."""
    driver = robot.agent._driver
    return None if driver is None else driver.replica


def snapshot_of(robot: Robot) -> StateMachine | None:
    """Return the robot's copy of the store; None while it has none that counts."""
    replica = replica_of(robot)
    return None if replica is None else replica.state


def rounds_of(robot: Robot) -> Rounds | None:
    """Return the rounds of the robot's mission; None before and after it."""
    return robot.agent._rounds


def locals_of(robot: Robot) -> Mapping[str, Any]:
    """Return the robot's own variables."""
    return robot.agent._instances[0].runner.locals


def has_stopped(robot: Robot) -> bool:
    """Return whether the robot's program has stopped."""
    rounds = rounds_of(robot)
    return rounds is not None and rounds.stopped
