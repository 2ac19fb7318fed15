"""Obstacle avoidance of the quad.

It plans paths around the obstacles of the fleet file, and refuses commanded paths that lead into them.
"""

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

LEG_SECONDS = 0.2  # seconds for planning a leg back to the path; short, because the vehicle waits for the planner
RETREATS = (0.1, 0.2, 0.3, 0.4)  # m from the vehicle to the places that are tried for a retreat from an obstacle
DIRECTIONS = 16  # number of directions in which a place for a retreat from an obstacle is tried

MakePlanning = Callable[[str, World, float], Planning]


@dataclass(frozen=True, slots=True)
class Size:
    """Lengths (m) whose sum is the distance that a commanded path must keep from obstacles.

    Each field is the quad's setting of the same name."""

    radius: float
    tracking_error: float = 0.0
    position_error: float = 0.0


class QuadAvoidance:
    """Path planner and path check of one quad. Lengths in metres, in the fleet's ENU frame.

    `height`: minimum flight height. Targets are raised to it, and paths are planned at this height or above.
    `size`: distance that commanded paths keep from obstacles.
    `clearance`: distance that planned paths keep between the quad's body and obstacles.
    `planner`: name of the planner. `planning`: function that makes the planner's process.
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
        # Distance that the chords of the reference trajectory must keep from obstacles. CORNER is subtracted from the
        # tracking error, because the trajectory has cut its corners already. BULGE is subtracted, because the
        # trajectory and its chords differ by up to BULGE.
        self._swerving = size.radius + size.position_error + max(0.0, size.tracking_error - CORNER) - BULGE
        self._names = dict(enumerate(peer.name for peer in settings.peers))
        self.published: dict[str, Path] = {}  # paths that the other robots have published, by robot name
        self._named = Scene()  # obstacles that the program passed in its last call of the planner
        self._asked = False  # whether the planner is planning a leg back to the path
        self._admitted: Path | None = None  # points of the last command if it may be flown, else None
        self._log_lines: list[str] = []
        self.refusal = ""  # reason why the last command is not flown, in words; "" if the quad flies it
        self.unplanned = ""  # reason why the program's last call of the planner found no path; "" if it found a path

    def start(self) -> None:
        """Start the planner's process. Raises Unready."""
        self._planning.start()

    def poll(self) -> None:
        """Process the messages of the planner's process. Raises Unready if the planner cannot be created."""
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
        """Distance (m) that planned paths keep from the paths of other robots."""
        return self._world.radius + self._world.kept

    def may_land(self, position: Point, place: Point) -> bool:
        """Return whether the straight line to `place`, and a landing there, are clear of geofence and obstacles.

        The quad may land on an obstacle only if it is above an obstacle already."""
        lifted = self._lifted(place)
        within = (lifted.x, lifted.y) == (place.x, place.y)
        way = self.clear(position, place, RUNNING)
        return within and way and (self._has_ground(place) or not self._has_ground(position))

    def _has_ground(self, place: Point) -> bool:
        """Return whether the ground, and no obstacle, is below a place."""
        return self.apart(place, Point(place.x, place.y, self._fence.lo.z), 0.0)

    def plan(self, position: Point | None, goal: Point, named: Any) -> Path:
        """Return a path from `position` to `goal`, or () if there is none.

        The path avoids the obstacles of the fleet file, the obstacles `named` that the program passes, and the paths of
        other robots. A goal on the ground or outside the geofence has no path.

        The quad flies at flight height or above. So the path to a lower goal is planned to the point above the goal at
        flight height, and then the goal replaces the last point of the path."""
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
        """Return why the planner found no path from `position`.

        The caller puts the goal in front of this text, as the subject of the sentence."""
        past = f", past the paths of {', '.join(sorted(self.published))}" if self.published else ""
        here = f"({position.x:.2f}, {position.y:.2f}, {position.z:.2f})"
        return f"has no path: {reason}" if reason else f"has no path from {here}{past}"

    def admits(self, position: Point | None, points: Path) -> bool:
        """Return whether the path from `position` along the commanded points may be flown.

        If the path may not be flown, `refusal` and `log_lines` give the reason. Points that are not finite are admitted
        here, because `Motion` refuses them."""
        if points == self._admitted or position is None or not transmissible(points):
            self.refusal = ""
            return True
        trouble = self._guard.trouble(position, tuple(map(self._lifted, points)))
        if trouble and not self.refusal:
            self._log_lines.append(f"the commanded path is not flown, holding instead: {trouble}")
        self.refusal, self._admitted = trouble, None if trouble else points
        return not trouble

    def resumes(self, points: Path, passed: int) -> bool:
        """Return whether the quad may resume a path that it followed before the agent restarted.

        The vehicle has passed the first `passed` points. This method checks the path from the next point on. `Rejoin`
        later checks the leg from the vehicle to the next point."""
        self._admitted = None
        if not self.admits(points[passed], points[passed + 1 :]):
            return False
        self._admitted = points
        return True

    def clear(self, start: Point, end: Point, margin: float) -> bool:
        """Return whether a straight line keeps its distance from the fleet file's obstacles.

        `margin`: share of the planner's clearance to keep. `rejoin.FreeSpace.clear` gives the rule for obstacles
        near the start of the line."""
        here = Room(start)
        here.keep(self._standing, self._kept(margin), self._world.least)
        return here.clear(start, end)

    def apart(self, start: Point, end: Point, margin: float) -> bool:
        """Return whether a straight line keeps its distance also from obstacles near its start."""
        kept = self._kept(margin)
        return all(thing.distance(start, end, kept) >= kept for thing in self._standing)

    def flyable(self, way: Path) -> bool:
        """Return whether a reference trajectory with these chords keeps its distance from obstacles."""
        here = Room(way[0])
        here.keep(self._standing, self._swerving)
        return all(here.clear(a, b) for a, b in pairwise(way))

    def _kept(self, margin: float) -> float:
        return max(self._world.least, self._world.radius + margin * self._world.clearance)

    def retreat(self, position: Point) -> Point:
        """Return a place near `position` with the distance from obstacles that a leg needs, else `position`."""
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
        """Return whether the straight leg is clear of the fleet file's and the program's obstacles."""
        world = msgspec.structs.replace(self._world, clearance=LEG * self._world.clearance)
        return room_of(world, self._standing, self._named, start).clear(start, end)

    def ask_leg(self, start: Point, end: Point) -> bool:
        """Request a leg from the planner. Return False if the planner cannot serve a request now."""
        scene = msgspec.structs.replace(self._named, others=self._others)
        self._asked = self._planning.ask(start, end, scene, b"", LEG_SECONDS)
        return self._asked

    def leg(self) -> Path | None:
        """Return the planned leg, once; () if there is no leg, None if the planner has not answered."""
        answer = self._planning.answer() if self._asked else None
        if answer is None:
            return None
        self._asked = False
        return answer.path

    def _lifted(self, p: Point) -> Point:
        """Return the place to which the quad flies for the commanded target `p`: the nearest one in its box."""
        return clamp(self._room, p)

    def log_lines(self) -> list[str]:
        """Return log lines on refused commands and on the planner since the last call."""
        told, self._log_lines = [*self._log_lines, *self._planning.log_lines()], []
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
