"""Obstacle avoidance of the quad: plans paths around the fleet file's obstacles, and refuses paths through them."""

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

LEG_SECONDS = 0.2  # seconds of planning for a leg back to the path; short, because the vehicle waits for the answer
RETREATS = (0.1, 0.2, 0.3, 0.4)  # m from the vehicle to the places that are tried for a retreat from an obstacle
DIRECTIONS = 16  # number of directions in which these places are tried

MakePlanning = Callable[[str, World, float], Planning]


@dataclass(frozen=True, slots=True)
class Size:
    """Distance that a commanded path keeps from obstacles: the sum of these lengths in metres.

    The fields are the settings of the same names."""

    radius: float
    tracking_error: float = 0.0
    position_error: float = 0.0


class Avoidance:
    """Path planner and path check of one quad. Lengths in metres, in the fleet's ENU frame.

    `height`: minimum flight height, to which targets are raised. So paths are planned from there upwards.
    `clearance`: distance that planned paths keep from obstacles, beyond `size`.
    `planner`: name of the planner. `planning`: makes the process that runs it.
    """

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
        # Distance of the reference trajectory's chords from obstacles. CORNER is subtracted from the tracking error,
        # because the trajectory has cut its corners already; BULGE, as the trajectory may deviate from its chords.
        self._swerving = size.radius + size.position_error + max(0.0, size.tracking_error - CORNER) - BULGE
        self._names = dict(enumerate(peer.name for peer in settings.peers))
        self.published: dict[str, Path] = {}  # the other robots' paths, by their names
        self._named = Scene()  # obstacles that the program passed in its last call of the planner
        self._asked = False  # whether the planner is at work on a leg
        self._admitted: Path | None = None  # the last command, if it may be flown
        self._news: list[str] = []
        self.refusal = ""  # reason why the last command is not flown, in words; "" if it is
        self.unplanned = ""  # reason why the program's last call of the planner found no path, in words

    def start(self) -> None:
        """Start the planner's process. Raises Unready."""
        self._planning.start()

    def poll(self) -> None:
        """Process the planner's start-up. Raises Unready if there is no planner of that name."""
        self._planning.poll()

    @property
    def waiting(self) -> str:
        """Reason why the quad cannot start yet, for the log; "" once the planner is ready."""
        return "" if self._planning.ready else "waiting for the planner"

    def others(self, paths: Mapping[int, Path]) -> None:
        """Store the paths that the other robots have published, by their pids."""
        self.published = {self._names.get(pid, str(pid)): path for pid, path in paths.items()}

    @property
    def _others(self) -> tuple[Path, ...]:
        return tuple(self.published.values())

    @property
    def spacing(self) -> float:
        """The distance that planned paths keep from those of other robots."""
        return self._world.radius + self._world.kept

    def may_land(self, position: Point, place: Point) -> bool:
        """Return whether the quad may fly to `place` and land there (see `landing.Surroundings`).

        It may land on an obstacle only if an obstacle is below it already."""
        lifted = self._lifted(place)
        within = (lifted.x, lifted.y) == (place.x, place.y)
        way = self.clear(position, place, RUNNING)
        return within and way and (self._has_ground(place) or not self._has_ground(position))

    def _has_ground(self, place: Point) -> bool:
        """Return whether no obstacle is below a place."""
        return self.apart(place, Point(place.x, place.y, self._fence.lo.z), 0.0)

    def plan(self, position: Point | None, goal: Point, named: Any) -> Path:
        """Return a path from `position` to `goal`, or () if there is none.

        It avoids the fleet file's obstacles, those that the program passes as `named`, and the other robots' paths. A
        goal on the ground or outside the geofence has no path.

        The path is planned as it will be flown. For example, the path to a goal below the flight height is planned to
        the point above the goal at flight height; only its last point is then replaced by the goal."""
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
        """Return why the planner found no path from `position`, worded to follow the goal's coordinates."""
        past = f", past the paths of {', '.join(sorted(self.published))}" if self.published else ""
        here = f"({position.x:.2f}, {position.y:.2f}, {position.z:.2f})"
        return f"has no path: {reason}" if reason else f"has no path from {here}{past}"

    def admits(self, position: Point | None, points: Path) -> bool:
        """Return whether the path from `position` along the commanded points may be flown.

        If not, `refusal` and `news` give the reason. Points that are not finite are admitted, since `Motion` refuses
        them."""
        if points == self._admitted or position is None or not transmissible(points):
            self.refusal = ""
            return True
        trouble = self._guard.trouble(position, tuple(map(self._lifted, points)))
        if trouble and not self.refusal:
            self._news.append(f"not flown, holding instead: {trouble}")
        self.refusal, self._admitted = trouble, None if trouble else points
        return not trouble

    def resumes(self, points: Path, passed: int) -> bool:
        """Return whether the rest of a path may be flown that the agent followed before its restart.

        The first `passed` points are behind the vehicle. The leg from the vehicle to the next point is not checked
        here; `Rejoin` checks it later."""
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
        """Check the planner by starting and ending its process."""
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
