"""The simulated racecar driven by the tracker: in one process, without network and real time.

20 times a second of simulated time the tracker commands the simulated car (tyres, servo and motor that lag), from its
true pose with the noise of a motion-capture system on it.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass

from targets.car.bicycle import State, turning_radius, wrap
from targets.car.curves import Triple, reeds_shepp
from targets.car.mpc import STEP, Command, Limits, Mpc
from targets.car.navigator import LAG
from targets.car.planner import Segment, segments
from targets.car.tracker import Tracker
from targets.sim.car import SimulatedCar
from targets.sim.world import STEP as PHYSICS
from targets.sim.world import World
from tests.car.slalom import LIMITS, aside, slalom_path

PARKING = Limits(wheelbase=0.33, speed=1.0, acceleration=1.5, steering=0.4, steering_rate=3.0)  # the target's defaults
NOISE, TURNING_NOISE = 0.002, 0.005  # m, rad; standard deviations
LONGEST = 60.0  # seconds for a path
STANDS = 0.5  # seconds after the path's end at which the car is looked at


@dataclass(frozen=True, slots=True)
class Slalom:
    """Distances from the path in metres, speeds in m/s."""

    rms: float
    largest: float
    median_speed: float
    finished: bool


@dataclass(frozen=True, slots=True)
class Parked:
    """One start: metres and radians from the wished pose, and how often the gear changed."""

    start: Triple
    away: float
    turned: float
    gear_changes: int
    finished: bool


def drive(
    path: list[Segment], start: Triple, limits: Limits, seed: int,
    look: Callable[[State], None] = lambda state: None,
) -> tuple[State, bool]:  # fmt: skip
    """Drive a path to its end: the true state half a second later, and whether the end came. `look` sees the true
    state after each step of the physics."""
    dice = random.Random(seed)
    world = World()
    car = SimulatedCar(world, (start[0], start[1], 0.0), start[2], limits.wheelbase, limits.steering)
    tracker = Tracker(limits, Mpc(limits))
    tracker.take(path)
    last, ticks, ended = Command(0.0, 0.0), 0, math.inf
    while ticks * STEP < min(LONGEST, ended + STANDS):
        true = truth(car)
        if ended == math.inf:
            extra = LAG * (true.speed - last.speed)  # as navigator.py allows for the motor's lag
            yaw = true.yaw + dice.gauss(0.0, TURNING_NOISE)
            x = true.x + extra * math.cos(yaw) + dice.gauss(0.0, NOISE)
            y = true.y + extra * math.sin(yaw) + dice.gauss(0.0, NOISE)
            last = tracker.step(State(x, y, yaw, last.speed, last.steering))
            if tracker.done:
                last, ended = Command(0.0, last.steering), ticks * STEP
        car.drive(last.speed, last.steering)
        for _ in range(round(STEP / PHYSICS)):
            world.step()
            look(truth(car))
        ticks += 1
    return truth(car), ended < math.inf


def truth(car: SimulatedCar) -> State:
    """The simulated car's state; speed is that along its heading."""
    body = car.state()
    speed = body.velocity[0] * math.cos(body.yaw) + body.velocity[1] * math.sin(body.yaw)
    return State(body.position[0], body.position[1], body.yaw, speed)


def slalom(arcs: int) -> Slalom:
    path = slalom_path(arcs)
    errors: list[float] = []
    speeds: list[float] = []

    def look(state: State) -> None:
        errors.append(aside(path, state.x, state.y))
        speeds.append(state.speed)

    first = path.poses[0]
    _, finished = drive([path], (first.x, first.y, first.yaw), LIMITS, 1, look)
    rms = math.sqrt(sum(e * e for e in errors) / len(errors))
    return Slalom(rms, max(errors), sorted(speeds)[len(speeds) // 2], finished)


def parked(seed: int) -> Parked:
    """Park at the origin, heading east."""
    dice = random.Random(seed)
    radius = turning_radius(0.9 * PARKING.steering, PARKING.wheelbase)
    start = (dice.uniform(-2.5, 2.5), dice.uniform(-2.5, 2.5), dice.uniform(-math.pi, math.pi))
    path = segments(reeds_shepp(start, (0.0, 0.0, 0.0), radius))
    end, finished = drive(path, start, PARKING, seed)
    return Parked(start, math.hypot(end.x, end.y), abs(wrap(end.yaw)), len(path) - 1, finished)
