"""Return to the path: a leg that starts where the vehicle is, and not where its reference was, is checked first.

Such legs begin after a hold, a take-over, a time in which the agent did not run, and when the vehicle has left its
path. A leg must keep the planner's distance from the obstacles. Where it does not, the vehicle brakes and stands, and a
leg to the next point is planned, beside the control loop. Without any clear leg the vehicle holds, says so, and asks
again every RETRY seconds. Metres, seconds, local ENU.
"""

from __future__ import annotations

import enum
import math
from typing import Protocol

from koordgen.runtime.values.points import Point, distance
from targets.planning.standstill import Standstill
from targets.planning.world import Path
from targets.quad.autopilot.check import coordinates
from targets.quad.motion.reference import STANDING, Reference
from targets.quad.motion.setpoint import Aim, Shaping, runs_on
from targets.quad.motion.trajectory import Trajectory, norm

LATE = 0.3  # s without a setpoint after which the vehicle may have run on past its reference
OFF = 0.2  # m from its reference beyond which the straight line back to it is checked
# s for which the vehicle must be slow before a leg begins: an autopilot that is still braking when the kind of setpoint
# changes swings back, and then flies faster than the limit to catch up.
STILL = 0.7
BRAKING = 3.0  # s that the vehicle may need to stand; after them a leg is looked for all the same
RETRY = 1.0  # s between two attempts to find a leg
PATIENCE = 2.0  # s that a planner may take; then it is asked again
RUNNING = 0.5  # of the planner's clearance that is kept where a vehicle may be drawn to, or run on to
LEG = 0.75  # ... on a leg back to the path, which may begin a little beside it: the path itself keeps all
# m that the vehicle may be behind its reference before that one waits, where obstacles are nearer than the radius and
# this much of the clearance. (From a stand it is 0.3 m late: an autopilot begins anew with each kind of setpoint.)
TIGHT, NEARBY = 0.15, 2.0
LOOK = 1.0  # s: a reference that heads for an obstacle is no faster than the distance from it over this time,
SLOWEST = 0.15  # m/s, but always so fast
BISECTIONS = 6  # of a distance that an obstacle limits


class Ways(Protocol):
    """Obstacles, and a planner. What is nearer to a line's start than the line must keep may stay as near."""

    def clear(self, start: Point, end: Point, margin: float) -> bool:
        """Return whether a straight line keeps the body's radius, and this part of the planner's clearance, from the
        obstacles of the fleet file."""
        ...

    def apart(self, start: Point, end: Point, margin: float) -> bool:
        """Return what `clear` does, but obstacles that are near to the start must be kept away from as well."""
        ...

    def flyable(self, way: Path) -> bool:
        """Return whether the reference may go on along these points, which are its own: corners are cut already."""
        ...

    def retreat(self, position: Point) -> Point:
        """Return a place nearby that keeps the distance of a leg, from where the body may be nearer to an obstacle;
        `position` where that is far enough away, or no such place is found."""
        ...

    def leg_clear(self, start: Point, end: Point) -> bool:
        """Return whether a leg may be flown as if the planner had answered it; obstacles that the program named count,
        too."""
        ...

    def ask_leg(self, start: Point, end: Point) -> bool:
        """Request a leg, which `leg` returns. Return False if that is not possible now."""
        ...

    def leg(self) -> Path | None:
        """Return the planned leg once: () if there is none, None while no answer has come."""
        ...


class OpenSpace:
    """Implements Ways where nothing stands."""

    def clear(self, start: Point, end: Point, margin: float) -> bool:
        return True

    def apart(self, start: Point, end: Point, margin: float) -> bool:
        return True

    def flyable(self, way: Path) -> bool:
        return True

    def retreat(self, position: Point) -> Point:
        return position

    def leg_clear(self, start: Point, end: Point) -> bool:
        return True

    def ask_leg(self, start: Point, end: Point) -> bool:
        return False

    def leg(self) -> Path | None:
        return None


class Stage(enum.Enum):
    """Stage of the return to the path."""

    FLYING = enum.auto()  # along the reference
    RESUMING = enum.auto()  # the next poll checks the leg from a place near the reference
    BRAKING = enum.auto()
    ASKING = enum.auto()  # the planner, while the vehicle stands
    STANDING = enum.auto()  # no clear leg was found


class Rejoin:
    """Owns when the reference is paused. `held` is the wish of the safety layer; the reference is paused then, and
    whenever a leg is looked for. `action` is `Standstill`'s."""

    def __init__(self, reference: Reference, ways: Ways, action: str = "hold") -> None:
        self._reference, self._ways = reference, ways
        self._stage = Stage.FLYING
        self._since = 0.0  # when the stage began
        self._slow: float | None = None  # since when the vehicle has been slow
        self._polled: float | None = None
        self._standstill = Standstill(action)
        self._no_leg = ""  # why no leg is flown, in words
        self._checked: Trajectory | None = None  # the reference's, which may be flown
        self._from = Point()  # where the leg that is looked for begins: near the vehicle
        self.held = False

    def hold(self, on: bool, now: float) -> None:
        """Pause, or check the leg and resume."""
        if on == self.held:
            return
        self.held = on
        if not on and self._stage is Stage.FLYING:
            self._enter(Stage.RESUMING, now)
        self._pause(now)

    def command(self, now: float, unchecked: bool) -> None:
        """The reference follows other points now. `unchecked` says that nobody checked the leg to the first of them."""
        self._standstill.command()
        self._no_leg = ""
        if unchecked or self._stage is not Stage.FLYING:
            self._enter(Stage.BRAKING, now)
            self._pause(now)

    def drop(self, now: float) -> Point | None:
        """Another steers the vehicle, or its position is not known. See `Reference.drop`."""
        halt = self._reference.drop(now)
        self._polled = None
        return halt

    def poll(self, position: Point, velocity: Point, arrived: bool, now: float) -> None:
        """Start, check, and resume the reference. `arrived` says that the vehicle has no reason to move."""
        late = self._polled is None or now - self._polled > LATE
        self._polled = now
        if late or not self._reference.started:
            self._brake(position, velocity, now)
        self._look(position, velocity, now)
        self._reference.advance(position, now, self._most(position))
        if self._stage is Stage.FLYING and not self.held and not self._goes_clear():
            self._brake(position, velocity, now)
        moves = self._stage is Stage.FLYING and not self.held and not arrived
        if self._standstill.look(position, moves, coordinates(self._reference.ahead[0]), now):
            self._brake(position, velocity, now)

    def _look(self, position: Point, velocity: Point, now: float) -> None:
        if norm(velocity) > STANDING:
            self._slow = None
        elif self._slow is None:
            self._slow = now
        if self._strayed(position):
            self._brake(position, velocity, now)
        if self._stage is Stage.FLYING or self.held or self._standstill.holding:
            return
        if self._stage is Stage.RESUMING:
            if self._may_resume(position):
                self._enter(Stage.FLYING, now)
                self._pause(now)
                return
            self._brake(position, velocity, now)
        stands = (self._slow is not None and now - self._slow >= STILL) or now - self._since > BRAKING
        if self._stage is Stage.BRAKING and stands:
            self._choose(position, velocity, now)
        elif self._stage is Stage.ASKING:
            self._answered(position, velocity, now)
        elif self._stage is Stage.STANDING and now - self._since > RETRY:
            self._choose(position, velocity, now)

    def _goes_clear(self) -> bool:
        """Return whether the reference keeps away from obstacles. A way that is straight and clear for a vehicle that
        stands may lead one that moves into an obstacle: it turns in a bow. A target in motion is overshot."""
        if self._reference.trajectory is self._checked:
            return True
        self._checked = self._reference.trajectory
        return self._ways.flyable(self._reference.way())

    def _may_resume(self, position: Point) -> bool:
        """Return whether the reference may go on from where it was paused, at once."""
        here, goal = self._reference.at(0.0).position, self._reference.ahead[0]
        if distance(position, here) <= OFF:
            return self._ways.leg_clear(position, goal)
        return self._ways.apart(position, here, NEARBY) and self._ways.leg_clear(here, goal)

    def _strayed(self, position: Point) -> bool:
        """Return whether the vehicle cannot safely be drawn back to the reference in a straight line."""
        here = self._reference.at(0.0).position
        if distance(position, here) <= OFF:
            return False
        return not self._ways.apart(position, here, LEG)

    def _brake(self, position: Point, velocity: Point, now: float) -> None:
        """Begin anew where the vehicle is, by standing."""
        self._reference.drop(now)
        self._enter(Stage.BRAKING, now)
        self._pause(now)
        self._reference.start(position, velocity, now)

    def _choose(self, position: Point, velocity: Point, now: float) -> None:
        """From a stand: fly to the next point if the leg is clear, else have one planned. A vehicle that is near to an
        obstacle moves away from it first."""
        goal = self._reference.ahead[0]
        there = distance(position, goal) <= OFF
        self._from = position if there else self._ways.retreat(position)
        if self._ways.leg_clear(self._from, goal):
            self._resume((goal,), position, velocity, now)
        elif self._ways.ask_leg(self._from, goal):
            self._enter(Stage.ASKING, now)
            self._answered(position, velocity, now)  # it may have come at once
        else:
            self._enter(Stage.STANDING, now)

    def _answered(self, position: Point, velocity: Point, now: float) -> None:
        leg = self._ways.leg()
        if leg is None:
            if now - self._since > PATIENCE:
                self._enter(Stage.BRAKING, now)
            return
        goal = self._reference.ahead[0]
        if leg:
            self._resume((*leg[1:-1], goal), position, velocity, now)
        elif self._ways.clear(position, goal, 0.0):  # as near as a command may lead
            self._resume((goal,), position, velocity, now)
        else:
            self._enter(Stage.STANDING, now)
            self._no_leg = f"no clear way from {coordinates(position)} back to {coordinates(goal)}: holding"

    def _resume(self, leg: Path, position: Point, velocity: Point, now: float) -> None:
        """Start the reference where the vehicle is, along the leg that was found."""
        if self._from != position:
            leg = (self._from, *leg)
        self._reference.detour(leg)
        self._reference.drop(now)
        self._enter(Stage.FLYING, now)
        self._pause(now)
        self._reference.start(position, velocity, now)
        self._no_leg = ""

    def _enter(self, stage: Stage, now: float) -> None:
        self._stage, self._since = stage, now

    def _pause(self, now: float) -> None:
        paused = self.held or self._stage is not Stage.FLYING
        if paused != self._reference.paused:
            self._reference.pause(paused, now)

    def bounded(self, aim: Aim, position: Point, shaping: Shaping) -> Aim:
        """The same demand, with as much velocity as leads to no obstacle while the autopilot runs on without us. As in
        `setpoint`, velocity is exchanged for position. A position alone is not behind an obstacle."""
        if aim.velocity is None:
            return Aim(self._free(position, aim.position), None, aim.yaw)
        p, v = aim.position, aim.velocity
        level, speed, seconds = shaping.late[0], norm(v), runs_on(norm(v))
        free = distance(p, self._free(p, p + v * seconds))
        if free >= seconds * speed - 1e-9:
            return aim
        kept = v * (max(0.0, free - level * speed) / ((seconds - level) * speed))
        given = v - kept
        ahead = Point(given.x * level, given.y * level, given.z * shaping.late[1])
        return Aim(p + ahead * min(1.0, free / max(norm(ahead), 1e-9)), kept, aim.yaw)

    def _most(self, position: Point) -> float:
        """Return the rate of the reference at which `bounded` still demands all of its speed.

        At this rate the reference can also brake before its goal. Near obstacles it waits for a vehicle that is TIGHT
        behind, because a vehicle that lags cuts corners."""
        reference, state = self._reference, self._reference.at(0.0)
        speed, off = norm(state.velocity), distance(position, state.position)
        tight = 1.0
        if off > TIGHT and not self._ways.apart(position, state.position, NEARBY):
            tight = max(0.0, 2.0 - off / TIGHT)
        if speed < SLOWEST:
            return tight
        u = state.velocity / speed
        limits = reference.limits
        free = distance(state.position, self._free(state.position, state.position + u * (LOOK * limits.speed)))
        allowed = max(SLOWEST, min(free / LOOK, math.sqrt(2 * limits.acceleration * free)))
        return min(tight, reference.rate * allowed / speed)

    def _free(self, start: Point, end: Point) -> Point:
        """Return the farthest of some points on the line from `start` to `end` up to which the line is clear."""
        if self._ways.clear(start, end, RUNNING):
            return end
        low, high = 0.0, 1.0
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            if self._ways.clear(start, start + (end - start) * middle, RUNNING):
                low = middle
            else:
                high = middle
        return start + (end - start) * low

    @property
    def stall(self) -> str:
        """Why the vehicle does not go on, "" while it does: see koordgen.runtime.vehicle.platform."""
        return self._standstill.holding or self._no_leg

    def news(self) -> list[str]:
        """Return what happened since the last call, for the log."""
        return self._standstill.news()
