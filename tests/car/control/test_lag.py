"""A motor that is slower than the controller was made for: its lag is measured and a circling car is held."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from targets.car.control.lag import LONGEST_LAG, Lag
from targets.car.drive.links import RealLinks
from targets.car.planning.approach import Approach
from tests.car.drive.test_rover import World as Rover
from tests.car.platform.world import TestBody, World, standing

STEP = 0.05


def driven(drive: str, lag: float) -> World:
    """A car on its way to (4, 2) for 8 s."""
    body = TestBody(lag=lag)
    world = Rover(body, position="rover") if drive == "rover" else World(body)
    world.car.start(world.now)
    world.run(4.0)
    assert world.car.ready, world.car.progress
    world.go(4.0, 2.0)
    world.run(8.0)
    return world


@pytest.mark.parametrize("drive", ["vesc", "rover"])
@pytest.mark.parametrize("lag", [0.1, 0.3, 1.0, 2.0])
def test_the_lag_is_measured_in_motion(drive: str, lag: float) -> None:
    """The measured speed is some hundredths of a second late, too."""
    world = driven(drive, lag)
    log_lines, measured = world.car.log_lines(), world.car._lag.seconds
    assert measured is not None and lag < measured < 1.1 * lag + 0.12
    warned = [line for line in log_lines if "lag" in line]
    assert len(warned) == (lag > LONGEST_LAG) and all(f"a lag of {measured:.1f} s" in line for line in warned), (
        log_lines
    )


def test_noise_and_a_brake_are_no_lag() -> None:
    lag, dice = Lag(), random.Random(1)
    for i in range(400):
        lag.note(1.0, 1.0 + dice.gauss(0.0, 0.01), i * STEP)
    assert lag.seconds is None
    lag.note(0.0, None, 400 * STEP)
    lag.reset()
    assert lag.seconds is None


def test_a_car_that_circles_its_target_is_held_and_says_why() -> None:
    world = driven("rover", 2.0)
    assert world.car.stall == ""
    world.run(20.0)
    assert standing(world) and world.value("reached") is False
    assert world.car.stall.startswith("target (4.00, 2.00) is not approached: given up after "), world.car.stall
    assert "holding until another target comes; the motor's lag is 2.1 s, more than 0.5 s" in world.car.stall
    world.go(4.0, 2.0)
    world.run(2.0)
    assert standing(world), "it is the same target"
    world.go(0.0, 0.0)
    world.run(2.0)
    assert world.car.stall == "" and not standing(world)


def test_the_doctor_warns_of_what_was_measured() -> None:
    world = driven("vesc", 2.0)
    (found,) = [f for f in world.car.diagnose() if f.name == "lag"]
    assert found.state == "warn" and "when the car drove last" in found.found and found.wanted == "0.5 s or less"
    assert not [f for f in World().begin().car.diagnose() if f.name == "lag"], "it never drove"
    mended = driven("vesc", 0.1)
    (found,) = [f for f in mended.car.diagnose() if f.name == "lag"]
    assert found.state == "ok" and "lag" not in "".join(mended.car.log_lines())


def test_the_lag_is_kept_beside_the_bundle(tmp_path: Path) -> None:
    notes = tmp_path / "state/bert.lag"
    assert RealLinks(notes).remembered() is None
    RealLinks(notes).remember(2.04)
    assert RealLinks(notes).remembered() == 2.04
    notes.write_text("no number")
    assert RealLinks(notes).remembered() is None and RealLinks().remembered() is None


def test_an_approach_is_given_up_by_its_first_way_alone() -> None:
    approach = Approach(1.0, 0.1)

    def drive(seconds: float) -> bool:
        for _ in range(round(seconds / STEP)):
            approach.drive(STEP)
        return approach.failed

    approach.aim((4.0, 0.0))
    assert not drive(60.0), "no way was planned"
    approach.aim((5.0, 0.0))
    approach.record_path(4.0, 1, anew=False)
    assert not drive(15.5)
    approach.record_path(9.0, 3, anew=False)  # it has left the one before
    approach.aim((5.05, 0.0))
    assert drive(1.0)
    approach.aim((0.0, 0.0))
    approach.record_path(4.0, 1, anew=False)
    assert not drive(15.5)
    approach.record_path(4.0, 1, anew=True)  # another robot was in the way
    assert not drive(15.5) and drive(1.0)
