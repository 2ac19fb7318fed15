"""Cost of one step of the world, beside other simulators with the same step; part of benchmarks/sim.py.

Times are CPU time of this process, so other load on the computer counts little. Our steps and those of the others
alternate, and the median is taken.
"""

from __future__ import annotations

import contextlib
import io
import math
import random
import statistics
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fixtures.rays import to_obstacle
from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Point
from targets.sim.base.scenario import PYBULLET
from targets.sim.physics.bullet import Bullet
from targets.sim.physics.car import SimulatedCar
from targets.sim.physics.first_order import SimpleCarBody, SimpleQuadrotor
from targets.sim.physics.quadrotor import SimulatedQuadrotor
from targets.sim.physics.ray_casting import LidarMount
from targets.sim.physics.world import STEP, SimulatedWorld

Step = Callable[[], object]


@dataclass(frozen=True, slots=True)
class Pair:
    """Milliseconds of a step: ours, and the other's."""

    name: str
    ours: float
    other: str
    theirs: float
    least: float  # least ratio of their time to ours

    @property
    def ratio(self) -> float:
        return self.theirs / self.ours


def timed(steps: list[Step], turns: int, each: int) -> list[float]:
    """Return CPU milliseconds of one call of each, measured in turns of so many calls."""
    found: list[list[float]] = [[] for _ in steps]
    for step in steps:
        for _ in range(each):
            step()
    for _ in range(turns):
        for step, told in zip(steps, found, strict=True):
            began = time.process_time()
            for _ in range(each):
                step()
            told.append((time.process_time() - began) / each * 1e3)
    return [statistics.median(told) for told in found]


def grid(count: int, height: float) -> list[tuple[float, float, float]]:
    """Return positions 2 m apart."""
    side = math.ceil(math.sqrt(count))
    return [(2.0 * (k % side), 2.0 * (k // side), height) for k in range(count)]


def quads(count: int) -> tuple[SimulatedWorld, Step]:
    """Return quads with full dynamics that fly to and fro; each gets a command and returns its state in every step."""
    world = SimulatedWorld()
    flown = [SimulatedQuadrotor(world, place, 0.1) for place in grid(count, 20.0)]
    for quad in flown:
        quad.motors(True)

    def step() -> None:
        push = 0.5 * math.sin(2.0 * world.time)
        for quad in flown:
            quad.accelerate((push, 0.1, 0.0), 0.1)
        world.step()
        for quad in flown:
            quad.state()

    return world, step


def simple_quads(count: int) -> tuple[SimulatedWorld, Step]:
    """Return quads with simple dynamics, used as `quads`."""
    world = SimulatedWorld()
    flown = [SimpleQuadrotor(world, place, 0.1) for place in grid(count, 20.0)]
    for quad in flown:
        quad.motors(True)

    def step() -> None:
        speed = 0.5 * math.sin(2.0 * world.time)
        for quad in flown:
            quad.fly((speed, 0.1, 0.0), 0.1)
        world.step()
        for quad in flown:
            quad.state()

    return world, step


def cars(count: int, make: type[SimulatedCar] | type[SimpleCarBody]) -> tuple[SimulatedWorld, Step]:
    """Return cars that drive in circles; each gets a command and returns its state in every step."""
    world = SimulatedWorld()
    driven = [make(world, place, 0.1, 0.33, 0.4) for place in grid(count, 0.0)]

    def step() -> None:
        for car in driven:
            car.drive(0.8, 0.35)
        world.step()
        for car in driven:
            car.state()

    return world, step


def gym_drones(folder: Path, count: int) -> Step:
    """Return gym-pybullet-drones from a checkout. Raises ImportError.

    Each step is `CtrlAviary.step` of the CF2X with its usual physics (Physics.PYB), at 240 Hz and as many control
    steps, in free air, with an action for each drone; it returns the states.
    """
    sys.path.insert(0, str(folder))
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from gym_pybullet_drones.envs.CtrlAviary import CtrlAviary  # type: ignore[import-not-found]
        from gym_pybullet_drones.utils.enums import DroneModel, Physics  # type: ignore[import-not-found]

        world = CtrlAviary(
            DroneModel.CF2X, count, initial_xyzs=np.array(grid(count, 20.0)), physics=Physics.PYB,
            pyb_freq=240, ctrl_freq=240, gui=False, user_debug_gui=False,
        )  # fmt: skip
        world.reset()
    action = np.full((count, 4), world.HOVER_RPM)
    return lambda: world.step(action)


def racecars(count: int) -> tuple[Callable[[], None], Step]:
    """Return a function that ends PyBullet's racecar/racecar.urdf, and one that runs a step.

    A step sets a velocity for each of four wheels and a position for each of two hinges, and reads position and
    velocity.
    """
    from targets.sim.physics.bullet import _pybullet

    bullet = _pybullet()
    import pybullet_data

    client = bullet.connect(bullet.DIRECT)
    own = {"physicsClientId": client}
    bullet.setGravity(0, 0, -9.81, **own)
    bullet.setTimeStep(STEP, **own)
    bullet.setAdditionalSearchPath(pybullet_data.getDataPath(), **own)
    bullet.loadURDF("plane.urdf", **own)
    driven = [bullet.loadURDF("racecar/racecar.urdf", (x, y, 0.1), **own) for x, y, _ in grid(count, 0.0)]

    def step() -> None:
        for car in driven:
            for wheel in (2, 3, 5, 7):
                bullet.setJointMotorControl2(car, wheel, bullet.VELOCITY_CONTROL, targetVelocity=16, force=10, **own)
            for hinge in (4, 6):
                bullet.setJointMotorControl2(car, hinge, bullet.POSITION_CONTROL, targetPosition=0.35, **own)
        bullet.stepSimulation(**own)
        for car in driven:
            bullet.getBasePositionAndOrientation(car, **own)
            bullet.getBaseVelocity(car, **own)

    return lambda: bullet.disconnect(**own), step


MILLIMETRE = 1e-3
RAYS = 1080
WAYS = [(math.cos(a), math.sin(a)) for a in (math.tau * i / RAYS for i in range(RAYS))]
ROOM: tuple[Obstacle, ...] = (
    *(Block(Point(x, y, 0), Point(x + 0.6, y + 0.4, 1)) for x, y in ((-4, -3), (-2, 3), (3, 3), (2, -4), (-1, -2.5))),
    *(Cylinder(Point(x, y, 0), 0.3, 1.2) for x, y in ((-3, 1), (1.5, 2), (4, -1), (-1.5, -4), (0.5, 4.5))),
    *(Sphere(Point(x, y, 0.2), 0.4) for x, y in ((-2, -1), (2.5, 0.5), (0.5, -2), (-4, 4))),
    *(
        Mesh((Point(x, y, 0), Point(x + 1, y + 0.5, 0), Point(x + 0.5, y, 1.5)), ((0, 1, 2),))
        for x, y in ((-5, 0), (4, 4), (0, 3), (3, -2.5))
    ),
)


@dataclass(frozen=True, slots=True)
class Lidars:
    """Times of a turn of 1,080 rays of 6 m for each of many cars, between one another and 18 obstacles.

    Ours casts all rays at once, PyBullet one turn after the other. Also: the greatest difference (m) of ours from plane
    geometry, and the share of PyBullet's rays within a millimetre of ours, for angles over 10 degrees, at faces and at
    round bodies.
    """

    pair: Pair
    single: float  # ms, one turn alone, of ours
    geometry: float
    faces: float
    round: float


def lidars(count: int, turns: int) -> Lidars:
    """Measure a turn of the lidars, see Lidars."""
    world = SimulatedWorld(engine=PYBULLET)
    for obstacle in ROOM:
        world.obstacle(obstacle)
    driven: list[SimulatedCar] = []
    dice = random.Random(1)
    while len(driven) < count:
        place = (dice.uniform(-5.0, 5.0), dice.uniform(-5.0, 5.0), 0.0)
        room = min(to_obstacle((*place[:2], 0.07), math.tau * i / 60, o) for i in range(60) for o in ROOM)
        if room > 0.5 and all(math.dist(place, car.state().position) > 0.8 for car in driven):
            driven.append(SimulatedCar(world, place, dice.uniform(-3.0, 3.0), 0.33, 0.4))
    world.step()
    assert isinstance(world.engine, Bullet)
    bullet, own = world.engine.bullet, {"physicsClientId": world.engine.client}
    eyes = []
    for car in driven:
        motion = car.motion()
        eyes.append(LidarMount((*car.state().position[:2], motion.position[2] + 1e-3), RAYS, 6.0, car.rigid.number))
        world.engine.set_pose(
            car.rigid.number, motion.position, motion.orientation
        )  # PyBullet's rays use the poses in the engine

    def theirs() -> list[list[float]]:
        return [_cast(world, bullet, own, eye) for eye in eyes]

    ours, single, other = timed([lambda: world.cast_rays(eyes), lambda: world.cast_rays(eyes[:1]), theirs], turns, 2)
    pair = Pair(f"lidars, {RAYS} rays", ours / count, "rayTestBatch", other / count, 30.0)
    worst = [
        _apart(eye, one.tolist(), two) for eye, one, two in zip(eyes, world.cast_rays(eyes), theirs(), strict=True)
    ]
    world.close()
    geometry, faces, rounded = zip(*worst, strict=True)
    return Lidars(pair, single, max(geometry), _near(faces), _near(rounded))


def _near(apart: Sequence[list[float]]) -> float:
    """Return the share of differences within a millimetre."""
    each = [a for found in apart for a in found]
    return sum(a < MILLIMETRE for a in each) / len(each)


def _cast(world: SimulatedWorld, bullet: Any, own: dict[str, int], eye: LidarMount) -> list[float]:
    """Cast PyBullet's rays, with the robot itself hidden from them."""
    x, y, z = eye.place
    assert isinstance(world.engine, Bullet)
    number = world.engine.number(eye.unseen)
    bullet.setCollisionFilterGroupMask(number, -1, 0, 0, **own)
    ends = [(x + eye.range * c, y + eye.range * s, z) for c, s in WAYS]
    found = bullet.rayTestBatch([eye.place] * len(ends), ends, **own)
    bullet.setCollisionFilterGroupMask(number, -1, 1, 7, **own)
    return [share * eye.range if hit >= 0 else math.inf for hit, _, share, *_ in found]


def _apart(eye: LidarMount, ours: list[float], theirs: list[float]) -> tuple[float, list[float], list[float]]:
    """Return the greatest difference of ours from plane geometry, and theirs from ours at faces and at round bodies.

    See Lidars. Rays that meet a car are not compared.
    """
    geometry = 0.0
    faces: list[float] = []
    rounded: list[float] = []
    for i, one in enumerate(ours):
        ways = [to_obstacle(eye.place, math.tau * i / eye.rays, obstacle) for obstacle in ROOM]
        nearest = min(ways)
        if one < nearest - 1e-6 or not math.isfinite(one):
            continue  # the ray meets a car or nothing
        geometry = max(geometry, abs(one - nearest))
        if max(_slope(ours, i), _slope(theirs, i)) >= 1 / math.tan(math.radians(10)):
            continue  # the ray grazes a surface or passes an edge
        flat = isinstance(ROOM[ways.index(nearest)], (Block, Mesh))
        (faces if flat else rounded).append(abs(one - theirs[i]))
    return geometry, faces, rounded


def _slope(ranges: list[float], i: int) -> float:
    """Return how much steeper than perpendicular to its ray the surface is, estimated from the neighbouring rays."""
    beside = ranges[i - 1], ranges[(i + 1) % len(ranges)]
    if not all(map(math.isfinite, (ranges[i], *beside))) or ranges[i] <= 0.0:
        return math.inf
    return max(abs(b - ranges[i]) for b in beside) / (ranges[i] * math.tau / len(ranges))


def peers(count: int, turns: int, drones: Path | None) -> tuple[list[Pair], list[str]]:
    """Compare ours with the peers at so many robots. Return the pairs, and the peers that were left out."""
    pairs, left = [], []
    world, simple = cars(count, SimpleCarBody)
    end, step = racecars(count)
    ours, theirs = timed([simple, step], turns, 20)
    pairs.append(Pair("cars, simple", ours, "racecar URDF", theirs, 25.0))
    world.close()
    end()
    if drones is None:
        left.append("gym-pybullet-drones: give its checkout by --gym-pybullet-drones PATH")
        return pairs, left
    try:
        step = gym_drones(drones, count)
    except ImportError as error:
        left.append(f"gym-pybullet-drones: {error}")
        return pairs, left
    flown, full = quads(count)
    plain, light = simple_quads(count)
    ours, first_order, theirs = timed([full, light, step], turns, 40)
    pairs.append(Pair("quads, full", ours, "gym-pybullet-drones", theirs, 5.0))
    pairs.append(Pair("quads, simple", first_order, "gym-pybullet-drones", theirs, 10.0))
    flown.close()
    plain.close()
    return pairs, left


def factors(counts: tuple[int, ...], turns: int) -> dict[str, dict[int, float]]:
    """Return the factor to real time of the physics alone, by kind and number of robots."""
    kinds: dict[str, Callable[[int], tuple[SimulatedWorld, Step]]] = {
        "quads, full": quads,
        "quads, simple": simple_quads,
        "cars, full": lambda count: cars(count, SimulatedCar),
        "cars, simple": lambda count: cars(count, SimpleCarBody),
    }
    found: dict[str, dict[int, float]] = {}
    for name, make in kinds.items():
        for count in counts:
            world, step = make(count)
            (cost,) = timed([step], turns, 40)
            found.setdefault(name, {})[count] = STEP * 1e3 / cost
            world.close()
    return found
