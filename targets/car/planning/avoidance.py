"""Obstacle avoidance of the car: requests drivable paths and refuses paths through obstacles of the fleet file.

Paths are requested for calls of the program's planner, and for driving to the program's targets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import msgspec

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.values.points import Point, transmissible
from koordgen.runtime.vehicle.platform import Finding, Unready
from targets.car.base.bicycle import BicycleState, wrap
from targets.car.base.settings import CarSettings
from targets.car.planning.curves import Curve, Triple
from targets.car.planning.ground import LEAVING, MARGIN, area, ground
from targets.car.planning.lanes import Lane
from targets.car.planning.planner import JUDGE, Plan, Point2, Wish
from targets.car.planning.reasons import unreachable
from targets.car.planning.shapes import named
from targets.planning.guard import Guard
from targets.planning.process import Planning, made
from targets.planning.standstill import ANOTHERS
from targets.planning.world import Path, Scene, World

MakePlanning = Callable[[str, World, float, str], Planning]

REMEMBERED = 8  # number of planned paths that are stored, so that the program may command one of them
BEGIN, TURNED = 0.3, 0.3  # a stored path is driven as planned if the car is within these limits (m, rad) of its start
FIRST, PATIENCE = 0.04, 0.8  # seconds: time limits for shortening a path, and for finding a first path
OWN = "rrt-smoothed"  # planner of paths to single targets; the setting `planner` names the program's planner


class CarAvoidance:
    """Path planning and path checks of one car. Positions are those of the rear axle's middle, metres, local ENU."""

    def __init__(self, settings: Settings, own: CarSettings, planning: MakePlanning) -> None:
        """Prepare two planner processes, one for the program and one for driving, so that neither delays the other."""
        world = World(
            settings.geofence, settings.obstacles, own.clearance, own.width / 2, flies=False,
            footprint=(own.length, own.width), overhang=own.overhang, height=own.height, wheelbase=own.wheelbase,
            turning_radius=own.planned_radius, reverse=own.reverse, error=own.tracking_error + own.position_error,
        )  # fmt: skip
        self.area = area(world, min(MARGIN, own.reached_radius / 2))
        self._name = own.planner
        self._ground = ground(world)
        self._kept = min(own.position_error, self._ground.least)
        self._program = planning(own.planner, world, settings.planner_budget, JUDGE)
        self._driving = planning(OWN, world, settings.planner_budget, JUDGE)
        self._guard = Guard(settings.obstacles, {"half the width": world.radius})
        self._names = dict(enumerate(peer.name for peer in settings.peers))
        self._others: tuple[Path, ...] = ()
        self._paths: dict[str, Path] = {}  # robot's name -> its published path
        self._plans: dict[Path, Curve] = {}
        self._admitted: Path | None = None
        self._log_lines: list[str] = []
        self.refusal = ""  # reason why the last command is not driven, in words; "" if it is driven
        self.blocker = ""  # description of the other robot's path that limited the result of `free` last
        self.unplanned = ""  # reason why the program's last call of the planner found no path, in words

    def start(self) -> None:
        """Start the planners' processes. Raises Unready."""
        self._program.start()
        self._driving.start()

    def poll(self) -> None:
        """Process the planners' answers without blocking. Raises Unready if a planner cannot be created."""
        self._program.poll()
        self._driving.poll()

    @property
    def waiting(self) -> str:
        """Reason why the car cannot start yet, for the log; "" once both planners are ready."""
        return "" if self._program.ready and self._driving.ready else "waiting for the planner"

    def others(self, paths: Mapping[int, Path]) -> None:
        """Store the paths that the other robots have published, by their pids."""
        self._others = tuple(paths.values())
        self._paths = {self._names.get(pid, str(pid)): path for pid, path in paths.items()}

    def plan(self, state: BicycleState, gear: int, goal: Point, obstacles: Any) -> Path:
        """Return a path for the program: points that represent a drivable curve; () if no path was found.

        The curve is stored, and driven if the program commands these points."""
        start = Point(state.x, state.y, 0.0)
        wish = msgspec.msgpack.encode(Wish(state.yaw, gear))
        path = self._program.plan(start, goal, Scene.of(obstacles, self._others), wish)
        answer = self._program.answer()
        self.unplanned = "" if path else self._unplanned((start.x, start.y), goal, answer.reason if answer else "")
        if path and answer is not None and (curve := _curve(answer.more)) is not None:
            self._plans.pop(path, None)
            self._plans[path] = curve
            while len(self._plans) > REMEMBERED:
                del self._plans[next(iter(self._plans))]
        return path

    def _unplanned(self, start: Point2, goal: Point, reason: str) -> str:
        return reason if reason in ANOTHERS else self.explained(start, (goal.x, goal.y), reason)

    def planned(self, state: BicycleState, points: Path) -> Curve | None:
        """Return the stored curve of these points; None if there is none, or the car is not at its start."""
        curve = self._plans.get(points)
        if curve is None:
            return None
        x, y, yaw = curve.start
        there = math.hypot(state.x - x, state.y - y) <= BEGIN and abs(wrap(state.yaw - yaw)) <= TURNED
        return curve if there else None

    def admits(self, points: Path) -> bool:
        """Return whether the car may drive to commanded points one after the other; if not, `refusal` is the reason.

        The line from the car to the first point is not checked, because a planner plans this path."""
        if points == self._admitted or points in self._plans or len(points) < 2 or not transmissible(points):
            self.refusal = ""
            return True
        flat = tuple(Point(p.x, p.y, 0.0) for p in points)
        trouble = self._guard.trouble(flat[0], flat[1:])
        if trouble and not self.refusal:
            self._log_lines.append(f"not driven, holding instead: {trouble}")
        self.refusal, self._admitted = trouble, None if trouble else points
        return not trouble

    def resumes(self, points: Path) -> None:
        """Admit points that the agent drove to before its restart. Paths to them are planned, so no check is needed."""
        self.refusal, self._admitted = "", points

    def ask(self, state: BicycleState, target: Point2, gear: int, arrival: float | None) -> bool:
        """Request a path to a target, which `answer` returns later. Return False if no request is possible now."""
        wish = Wish(state.yaw, gear, arrival=arrival, time_limit=PATIENCE)
        start, goal = Point(state.x, state.y, 0.0), Point(target[0], target[1], 0.0)
        return self._driving.ask(start, goal, Scene(others=self._others), msgspec.msgpack.encode(wish), FIRST)

    @property
    def asking(self) -> bool:
        """Return whether a requested path is pending."""
        return self._driving.waiting

    def answer(self) -> tuple[Curve | None, str] | None:
        """Return the answer to `ask`, once: a path, or None and the planner's reason; None while there is no answer."""
        answer = self._driving.answer()
        return None if answer is None else (_curve(answer.more) if answer.path else None, answer.reason)

    def explained(self, start: Point2, target: Point2, reason: str) -> str:
        """Return why there is no path from `start` to `target`, in words; `reason`: the one that `answer` returned."""
        fixed = (shape for *_, shape in self._ground.fixed.kept)
        return unreachable(start, target, reason, fixed, self._paths, self._ground.clearance)

    def clear(self, start: Triple, target: Point2, curve: Curve) -> bool:
        """Return whether a curve towards a target is clear of all obstacles and of the other robots' paths."""
        ground = self._ground
        seen = named(Scene(others=self._others), ground.body, start[:2], ground.clearance)
        return ground.around(start, target, seen).clear(curve)

    def strayed(self, state: BicycleState) -> bool:
        """Return whether the car is nearer to an obstacle of the fleet file than half of the clearance.

        If it is, a car that has left its path must not drive back to it without a planned path."""
        return self._nearest(state)[0] < self._ground.least

    def ahead(self, state: BicycleState, poses: Iterable[BicycleState]) -> str:
        """Return the name of an obstacle of the fleet file that is too near to the car at a pose; "" if there is none.

        The first pose with such an obstacle counts. Too near means nearer than both `position_error` (at most half of
        the clearance) and 95 % of the car's present distance from the nearest obstacle."""
        kept = min(self._kept, LEAVING * self._nearest(state)[0])
        return next((name for away, name in map(self._nearest, poses) if away < kept), "")

    def _nearest(self, state: BicycleState) -> tuple[float, str]:
        """Distance and name of the nearest obstacle of the fleet file; infinite if no obstacle is near."""
        ground, middle = self._ground, self._ground.middle
        x, y = state.x + middle * math.cos(state.yaw), state.y + middle * math.sin(state.yaw)
        shapes = (shape for *_, shape in ground.fixed.around(x, y))
        near = ((ground.body.distance(state.x, state.y, state.yaw, shape), shape.name) for shape in shapes)
        return min(near, default=(math.inf, ""))

    def free(self, curve: Curve, station: float, ahead: float) -> float:
        """Return how many metres of a curve, from a station on, are clear of the other robots' published paths.

        Return infinity if the first `ahead` metres are clear. A car that already stands in another robot's path may
        leave it: see `Lane`."""
        if not self._paths:
            return math.inf
        ground, best = self._ground, math.inf
        for name, path in self._paths.items():
            lane = Lane(path, ground.body, curve.at(station), ground.clearance)
            free = lane.free(curve, station, min(ahead, best))
            if free < best:
                best = free
                inside = f"the car stands in robot {name}'s path, and its own path does not soon lead out of it"
                self.blocker = inside if free == 0.0 and lane.inside else f"robot {name}'s path is {free:.1f} m ahead"
        return best

    def log_lines(self) -> list[str]:
        """Return messages about problems since the last call, for the log."""
        told, self._log_lines = [*self._log_lines, *self._program.log_lines(), *self._driving.log_lines()], []
        return told

    def diagnose(self, sleep: Callable[[float], None]) -> Finding:
        """Check the program's planner by starting and ending its process."""
        try:
            made(self._program, sleep)
        except Unready as error:
            return Finding.of("planner", error)
        finally:
            self._program.close()
        return Finding("planner", "ok", f"{self._name} is ready")

    def close(self) -> None:
        """End the planners' processes. Idempotent."""
        self._program.close()
        self._driving.close()


def _curve(more: bytes) -> Curve | None:
    if not more:
        return None
    plan = msgspec.msgpack.decode(more, type=Plan)
    return Curve(plan.start, plan.pieces)
