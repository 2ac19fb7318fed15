"""Scenes to plan in, the same for every planner: a room of 7 m by 8 m with 8 to 20 boxes and cylinders in it."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import msgspec

from koordgen.runtime.obstacles import Block, Cylinder, Obstacle
from koordgen.runtime.settings import Box
from koordgen.runtime.values import Point
from targets.car.ask import Asked
from targets.car.curves import Curve, Triple
from targets.car.planner import Plan, Wish
from targets.car.settings import CarSettings
from targets.planning.pipe import Answer, Question
from targets.planning.world import Scene, World

ROOM = Box(Point(0.0, 0.0, -1.0), Point(7.0, 8.0, 3.0))
CAR = CarSettings()


@dataclass(frozen=True, slots=True)
class Case:
    """From a pose to a pose."""

    start: Triple
    goal: Triple
    obstacles: tuple[Obstacle, ...]

    def world(self, reverse: bool = True, seed: int | None = None, iterations: int | None = None) -> World:
        return world(self.obstacles, reverse, seed, iterations)


def world(
    obstacles: tuple[Obstacle, ...] = (), reverse: bool = True, seed: int | None = None, iterations: int | None = None,
    arena: Box = ROOM,
) -> World:  # fmt: skip
    return World(
        arena, obstacles, CAR.clearance, CAR.width / 2, flies=False, footprint=(CAR.length, CAR.width),
        overhang=CAR.overhang, height=CAR.height, wheelbase=CAR.wheelbase, turning_radius=CAR.planned_radius,
        reverse=reverse, seed=seed, iterations=iterations,
    )  # fmt: skip


def case(seed: int) -> Case:
    """From one corner of the room to the opposite one, either pose turned anyhow."""
    dice = random.Random(seed)
    start = (0.7, 0.7, dice.uniform(-math.pi, math.pi))
    goal = (6.3, 7.3, dice.uniform(-math.pi, math.pi))
    bodies: list[Obstacle] = []
    for _ in range(dice.randint(8, 20)):
        while True:
            x, y, size = dice.uniform(0.0, 7.0), dice.uniform(0.0, 8.0), dice.uniform(0.15, 0.5)
            if min(math.dist((x, y), start[:2]), math.dist((x, y), goal[:2])) > size + 0.9:
                break
        if dice.random() < 0.5:
            bodies.append(Cylinder(Point(x, y, 0.0), size, 1.0))
        else:
            bodies.append(Block(Point(x - size, y - size, 0.0), Point(x + size, y + size, 1.0)))
    return Case(start, goal, tuple(bodies))


EMPTY = Scene()


def ask(
    asked: Asked, start: Triple, goal: Point, scene: Scene = EMPTY, seconds: float = 0.1,
    heading: float | None = None, gear: int = 0, patience: float = 5.0,
) -> Answer:  # fmt: skip
    wish = msgspec.msgpack.encode(Wish(start[2], gear, heading, None, patience))
    return asked.serve(Question(1, Point(start[0], start[1], 0.0), goal, scene, seconds, wish))


def curve(answer: Answer) -> Curve:
    plan = msgspec.msgpack.decode(answer.more, type=Plan)
    return Curve(plan.start, plan.pieces)
