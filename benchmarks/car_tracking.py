"""How well the car's controller keeps to a path, with PyBullet's racecar: `python benchmarks/car_tracking.py`.

In one process, without network and real time: the tracker commands the simulated car (tyres, servo and motor that lag)
20 times a second of simulated time, from its true pose with the noise of a motion-capture system on it.
Slalom: arcs of 1 m radius, to the left and to the right in turn, at 1.5 m/s; the distance of the true rear axle's
middle from the path, 240 times a second. Parking: Reeds-Shepp curves to one pose from seeded starts around it; where
the true car stands in the end. Exit status 1: a wanted figure was not reached.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from targets.car.bicycle import State, turning_radius, wrap
from targets.car.mpc import STEP, Command, Limits, Mpc
from targets.car.navigator import LAG
from targets.car.planner import Area, Planner, Segment, Triple
from targets.car.tracker import Tracker
from targets.sim.car import SimulatedCar
from targets.sim.world import STEP as PHYSICS
from targets.sim.world import World
from tests.car.slalom import LIMITS, PACE, RADIUS, aside, slalom_path

PARKING = Limits(wheelbase=0.33, speed=1.0, acceleration=1.5, steering=0.4, steering_rate=3.0)  # the target's defaults
NOISE, TURNING_NOISE = 0.002, 0.005  # m, rad; standard deviations
STARTS = 20
WANTED_RMS, WANTED_PLACE, WANTED_HEADING = 0.05, 0.10, 0.15  # m, m, rad
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


class PosePlanner(Planner):
    """The target's planner, held to one heading at the goal."""

    def to_pose(self, start: Triple, goal: Triple) -> list[Segment]:
        """The Reeds-Shepp curve, or the Dubins one when that has a piece too short to be told from its neighbours;
        [] when both have."""
        for kind in (1, 0):
            begin, end, _ = self._states[kind]
            for state, (x, y, yaw) in ((begin, start), (end, goal)):
                state.setXY(x, y)
                state.setYaw(yaw)
            path = self._sample(kind, start, goal, self._spaces[kind].distance(begin, end))
            if path:
                return path
        return []


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
            car.step()
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
    planner = PosePlanner(radius, Area(-10.0, -10.0, 10.0, 10.0))
    path: list[Segment] = []
    while not path:
        start = (dice.uniform(-2.5, 2.5), dice.uniform(-2.5, 2.5), dice.uniform(-math.pi, math.pi))
        path = planner.to_pose(start, (0.0, 0.0, 0.0))
    end, finished = drive(path, start, PARKING, seed)
    return Parked(start, math.hypot(end.x, end.y), abs(wrap(end.yaw)), len(path) - 1, finished)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="fewer arcs and starts")
    parser.add_argument("--json", metavar="FILE", help="write the figures there, too")
    arguments = parser.parse_args()
    began = time.perf_counter()
    winding = slalom(4 if arguments.quick else 12)
    starts = [parked(seed) for seed in range(4 if arguments.quick else STARTS)]
    good = [p for p in starts if p.finished and p.away <= WANTED_PLACE and p.turned <= WANTED_HEADING]
    print(f"slalom, radius {RADIUS:g} m at {PACE:g} m/s: RMS {1e3 * winding.rms:.1f} mm, largest "
          f"{1e3 * winding.largest:.1f} mm, median speed {winding.median_speed:.2f} m/s"
          f" (wanted: RMS {1e3 * WANTED_RMS:.0f} mm)")  # fmt: skip
    print(f"parking: {len(good)} of {len(starts)} within {WANTED_PLACE:g} m and {WANTED_HEADING:g} rad; largest "
          f"{1e3 * max(p.away for p in starts):.0f} mm, {max(p.turned for p in starts):.3f} rad; "
          f"{sum(p.gear_changes for p in starts)} changes of gear")  # fmt: skip
    print(f"{time.perf_counter() - began:.0f} s")
    if arguments.json:
        figures = {"slalom": asdict(winding), "parking": [asdict(p) for p in starts]}
        Path(arguments.json).write_text(json.dumps(figures, indent=1) + "\n")
    sound = winding.finished and winding.rms <= WANTED_RMS and winding.median_speed >= 0.95 * PACE
    return 0 if sound and len(good) == len(starts) else 1


if __name__ == "__main__":
    sys.exit(main())
