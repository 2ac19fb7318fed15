"""Keeps the quad clear of what stands in the fleet file: plans ways around it, and refuses ways through it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import msgspec

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.values.points import Point, transmissible
from koordgen.runtime.vehicle.platform import Finding, Unready
from koordgen.runtime.vehicle.safety import clamp, inside
from targets.planning.guard import Guard
from targets.planning.process import Planning, made
from targets.planning.room import Room, fixed
from targets.planning.room import room as room_of
from targets.planning.world import Path, Scene, World
from targets.quad.motion.motion import room
from targets.quad.motion.rejoin import LEG, RUNNING
from targets.quad.motion.trajectory import BULGE, CORNER

LEG_SECONDS = 0.2  # that a leg back to the path may take to plan: the vehicle stands meanwhile
RETREATS = (0.1, 0.2, 0.3, 0.4)  # m, how far away from an obstacle places are looked for,
DIRECTIONS = 16  # ... and in how many directions

MakePlanning = Callable[[str, World, float], Planning]


@dataclass(frozen=True, slots=True)
class Size:
    """Metres that a commanded way keeps from obstacles, added up. The settings have the same names."""

    radius: float
    tracking_error: float = 0.0
    position_error: float = 0.0


class Avoidance:
    """Metres. `height` is that which targets are raised to: the quad plans where it flies, from there upwards."""

    def __init__(
        self, settings: Settings, height: float, size: Size, clearance: float, planner: str, planning: MakePlanning
    ) -> None:
        self._fence, self._room = settings.geofence, room(settings.geofence, height)
        self._name = planner
        error = size.tracking_error + size.position_error
        world = World(self._room, settings.obstacles, clearance, size.radius, error=error)
        self._world, self._standing = world, fixed(settings.obstacles)
        self._planning = planning(planner, world, settings.planner_budget)
        self._guard = Guard(settings.obstacles, asdict(size))
        # Of a tracking error, the reference cuts corners by as much itself.
        self._swerving = size.radius + size.position_error + max(0.0, size.tracking_error - CORNER) - BULGE
        self._names = dict(enumerate(peer.name for peer in settings.peers))
        self.published: dict[str, Path] = {}  # the other robots' paths, by their names
        self._named = Scene()  # what the program named when it called the planner last
        self._asked = False  # for a leg
        self._admitted: Path | None = None  # what was commanded last and may be flown
        self._news: list[str] = []
        self.refusal = ""  # why what was commanded last is not flown, in words
        self.unplanned = ""  # why the program's planner found no way last, in words

    def start(self) -> None:
        """Begin to make the planner. Raises Unready."""
        self._planning.start()

    def poll(self) -> None:
        """Raises Unready when there is no such planner."""
        self._planning.poll()

    @property
    def waiting(self) -> str:
        """What the quad still waits for; "" if nothing."""
        return "" if self._planning.ready else "waiting for the planner"

    def others(self, paths: Mapping[int, Path]) -> None:
        """What the other robots have published."""
        self.published = {self._names.get(pid, str(pid)): path for pid, path in paths.items()}

    @property
    def _others(self) -> tuple[Path, ...]:
        return tuple(self.published.values())

    @property
    def spacing(self) -> float:
        """The distance that planned paths keep from those of other robots."""
        return self._world.radius + self._world.kept

    def may_land(self, position: Point, place: Point) -> bool:
        """Return whether the quad may land at `place` (see `landing.Surroundings`). It may land on an obstacle only
        if an obstacle is under it already."""
        lifted = self._lifted(place)
        within = (lifted.x, lifted.y) == (place.x, place.y)
        way = self.clear(position, place, RUNNING)
        return within and way and (self._has_ground(place) or not self._has_ground(position))

    def _has_ground(self, place: Point) -> bool:
        """Return whether no obstacle is below a place."""
        return self.apart(place, Point(place.x, place.y, self._fence.lo.z), 0.0)

    def plan(self, position: Point | None, goal: Point, named: Any) -> Path:
        """A way from `position` to `goal` around the fleet file's obstacles, those that the program names, and the
        others; () when there is none: a goal on the ground or outside the fence is infeasible. What is planned is what
        would be flown: a way to a goal below the flight height, say, ends above it."""
        self.unplanned = ""
        if position is None or goal.z <= 0.0:
            return ()
        if not inside(self._fence, goal):
            self.unplanned = "is outside the geofence"
            return ()
        self._named, self._asked = Scene.of(named, ()), False
        path = self._planning.plan(position, self._lifted(goal), Scene.of(named, self._others))
        answer = self._planning.answer()
        if not path:
            self.unplanned = self._explained(position, answer.reason if answer else "")
        return (*path[:-1], goal) if path else ()

    def _explained(self, position: Point, reason: str) -> str:
        """Why the planner found no way from here, to follow the goal."""
        past = f", past the paths of {', '.join(sorted(self.published))}" if self.published else ""
        here = f"({position.x:.2f}, {position.y:.2f}, {position.z:.2f})"
        return f"has no path: {reason}" if reason else f"has no path from {here}{past}"

    def admits(self, position: Point | None, points: Path) -> bool:
        """Whether the way from `position` along commanded points may be flown; if not, `refusal` and `news` say why.
        Points that are not finite are another's business."""
        if points == self._admitted or position is None or not transmissible(points):
            self.refusal = ""
            return True
        trouble = self._guard.trouble(position, tuple(map(self._lifted, points)))
        if trouble and not self.refusal:
            self._news.append(f"not flown, holding instead: {trouble}")
        self.refusal, self._admitted = trouble, None if trouble else points
        return not trouble

    def resumes(self, points: Path, passed: int) -> bool:
        """As `admits`, of a path that an earlier life of this agent followed: of its points so many are behind, and the
        leg to the next one is looked at later."""
        self._admitted = None
        if not self.admits(points[passed], points[passed + 1 :]):
            return False
        self._admitted = points
        return True

    def clear(self, start: Point, end: Point, margin: float) -> bool:
        """See `rejoin.Ways`."""
        here = Room(start)
        here.keep(self._standing, self._kept(margin), self._world.least)
        return here.clear(start, end)

    def apart(self, start: Point, end: Point, margin: float) -> bool:
        """See `rejoin.Ways`."""
        kept = self._kept(margin)
        return all(thing.distance(start, end, kept) >= kept for thing in self._standing)

    def flyable(self, way: Path) -> bool:
        """See `rejoin.Ways`."""
        here = Room(way[0])
        here.keep(self._standing, self._swerving)
        return all(here.clear(a, b) for a, b in pairwise(way))

    def _kept(self, margin: float) -> float:
        return max(self._world.least, self._world.radius + margin * self._world.clearance)

    def retreat(self, position: Point) -> Point:
        """See `rejoin.Ways`."""
        if self.apart(position, position, LEG):
            return position
        for far in RETREATS:
            for i in range(DIRECTIONS):
                turn = math.tau * i / DIRECTIONS
                place = position + Point(far * math.cos(turn), far * math.sin(turn))
                if inside(self._room, place) and self.apart(place, place, LEG) and self.clear(position, place, LEG):
                    return place
        return position

    def leg_clear(self, start: Point, end: Point) -> bool:
        """See `rejoin.Ways`."""
        world = msgspec.structs.replace(self._world, clearance=LEG * self._world.clearance)
        return room_of(world, self._standing, self._named, start).clear(start, end)

    def ask_leg(self, start: Point, end: Point) -> bool:
        """See `rejoin.Ways`."""
        scene = msgspec.structs.replace(self._named, others=self._others)
        self._asked = self._planning.ask(start, end, scene, b"", LEG_SECONDS)
        return self._asked

    def leg(self) -> Path | None:
        """See `rejoin.Ways`."""
        answer = self._planning.answer() if self._asked else None
        if answer is None:
            return None
        self._asked = False
        return answer.path

    def _lifted(self, p: Point) -> Point:
        """Return the actual target of the quad for the commanded target p."""
        return clamp(self._room, p)

    def news(self) -> list[str]:
        """Return problems since the last call, for the log."""
        told, self._news = [*self._news, *self._planning.news()], []
        return told

    def diagnose(self, sleep: Callable[[float], None]) -> Finding:
        """Makes the planner and ends it again."""
        try:
            made(self._planning, sleep)
        except Unready as error:
            return Finding.of("planner", error)
        finally:
            self._planning.close()
        return Finding("planner", "ok", f"{self._name} is ready")

    def close(self) -> None:
        """End the planner's process. Idempotent."""
        self._planning.close()
