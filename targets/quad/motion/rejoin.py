"""Return of a vehicle to its path, along a leg that is clear of obstacles.

A leg is a straight line or a planned path from the vehicle to the next point of its path. The vehicle needs a leg after
a hold, after a pilot or a failsafe has controlled it, after a time in which the agent did not run, and when it has left
its path.

A leg must keep a share (LEG) of the planner's clearance from obstacles. If the straight line comes nearer, the vehicle
brakes and stands while the planner searches for a leg in its own process. If there is no clear leg, the vehicle holds,
reports the missing leg, and retries every RETRY seconds. Lengths are in metres, times in seconds, positions in local
ENU.
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

LATE = 0.3  # s without a setpoint after which the vehicle may have flown on past its reference
OFF = 0.2  # m between vehicle and reference beyond which the straight line between them is checked

# s for which the vehicle must be slow before a leg begins. At the beginning of a leg, setpoints change between position
# only and position with velocity. If an autopilot is still braking at this change, the vehicle swings back, and then
# exceeds the speed limit to catch up.
STILL = 0.7
BRAKING = 3.0  # s of braking after which a leg is searched for even if the vehicle does not stand still
RETRY = 1.0  # s between two attempts to find a leg
ANSWER_TIMEOUT = (
    2.0  # s to wait for the planner's answer; after that, the vehicle brakes and the planner is asked again
)

# The vehicle keeps a share of the planner's clearance from obstacles. A planned path keeps the whole clearance.
RUNNING = 0.5  # share of the clearance on lines along which the vehicle may fly on without setpoints
LEG = 0.75  # share of the clearance on a leg back to the path; below 1, because a leg may begin beside the path

# Near an obstacle, the reference slows down if the vehicle is more than TIGHT (m) behind the reference. Near means
# nearer than the vehicle's radius plus NEARBY times the clearance. (A vehicle that starts from a stand is 0.3 m behind,
# because the autopilot's controller restarts when the kind of setpoint changes.)
TIGHT, NEARBY = 0.15, 2.0
LOOK = 1.0  # s; if an obstacle is ahead, the reference's speed is at most (free distance ahead) / LOOK
SLOWEST = 0.15  # m/s; an obstacle ahead never limits the reference's speed to less than this
BISECTIONS = 6  # bisection steps in the search for the free distance up to an obstacle


class FreeSpace(Protocol):
    """Interface to the obstacles and the planner of one vehicle.

    If an obstacle is nearer to the start of a line than required, the line may stay about as near to this obstacle."""

    def clear(self, start: Point, end: Point, margin: float) -> bool:
        """Return whether a straight line keeps its distance from the obstacles of the fleet file.

        The required distance is the vehicle's radius plus `margin` times the planner's clearance."""
        ...

    def apart(self, start: Point, end: Point, margin: float) -> bool:
        """Return whether a straight line keeps the distance of `clear` also from obstacles near its start."""
        ...

    def flyable(self, way: Path) -> bool:
        """Return whether the reference may follow a trajectory with these chords.

        The trajectory has cut its corners already. So the required distance includes nothing for cut corners."""
        ...

    def retreat(self, position: Point) -> Point:
        """Return a place near `position` that has the distance from obstacles that a leg needs (LEG).

        Return `position` itself if it has that distance already, or if no place with that distance is found."""
        ...

    def leg_clear(self, start: Point, end: Point) -> bool:
        """Return whether the vehicle may fly the straight leg, so that no planner is needed.

        The leg must keep its distance from the fleet file's obstacles, and from the obstacles that the program passed
        in its last call of the planner."""
        ...

    def ask_leg(self, start: Point, end: Point) -> bool:
        """Request a leg from the planner; `leg` returns the answer.

        Return False if the planner cannot serve a request now."""
        ...

    def leg(self) -> Path | None:
        """Return the planned leg, once. () means that there is no leg, None that the planner has not answered."""
        ...


class OpenSpace:
    """Free space without obstacles: each line is clear, and there is no planner."""

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

    FLYING = enum.auto()  # the vehicle follows the reference
    RESUMING = enum.auto()  # a hold has ended; the next poll checks the leg from the place of the hold
    BRAKING = enum.auto()  # the vehicle brakes, before a leg is searched for
    ASKING = enum.auto()  # the planner searches for a leg, and the vehicle stands
    STANDING = enum.auto()  # no clear leg was found, and the vehicle stands


class Rejoin:
    """State machine of a vehicle's return to its path. It also decides when the reference is paused.

    The reference is paused while the safety layer holds the vehicle (`held`), and while a leg is searched for.
    `action`: reaction to a standstill, as in `Standstill`."""

    def __init__(self, reference: Reference, space: FreeSpace, action: str = "hold") -> None:
        self._reference, self._space = reference, space
        self._stage = Stage.FLYING
        self._since = 0.0  # time at which the present stage began
        self._slow: float | None = None  # time since which the vehicle has been slow; None while the vehicle is fast
        self._polled: float | None = None
        self._standstill = Standstill(action)
        self._no_leg = ""  # message that there is no clear leg; "" if a leg was found or is searched for
        self._checked: Trajectory | None = None  # last trajectory that was checked for obstacles
        self._from = Point()  # start of the leg that is searched for: the vehicle's position or a place near it
        self.held = False

    def hold(self, on: bool, now: float) -> None:
        """Hold the vehicle, or end the hold. After a hold, the next poll checks the leg and resumes the path."""
        if on == self.held:
            return
        self.held = on
        if not on and self._stage is Stage.FLYING:
            self._enter(Stage.RESUMING, now)
        self._pause(now)

    def command(self, now: float, unchecked: bool) -> None:
        """React to a new command. The reference already follows the command when this is called.

        `unchecked`: the leg to the first commanded point was not checked. Then the vehicle brakes, and `poll` checks
        the leg."""
        self._standstill.command()
        self._no_leg = ""
        if unchecked or self._stage is not Stage.FLYING:
            self._enter(Stage.BRAKING, now)
            self._pause(now)

    def drop(self, now: float) -> Point | None:
        """Drop the reference's trajectory, because the agent does not steer the vehicle or has no position.

        Return the place at which a pause would have stopped the reference, as `Reference.drop`."""
        halt = self._reference.drop(now)
        self._polled = None
        return halt

    def poll(self, position: Point, velocity: Point, arrived: bool, now: float) -> None:
        """Start, check, advance or resume the reference. `arrived`: the vehicle has no reason to move."""
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
        """Return whether the reference's trajectory is clear of obstacles.

        It is not enough that the straight line to the target is clear. A moving vehicle turns towards the target in an
        arc, and it may overshoot a moving target. Both may lead into an obstacle."""
        if self._reference.trajectory is self._checked:
            return True
        self._checked = self._reference.trajectory
        return self._space.flyable(self._reference.way())

    def _may_resume(self, position: Point) -> bool:
        """Return whether the paused reference may go on at once, from the place where it stands."""
        here, goal = self._reference.at(0.0).position, self._reference.ahead[0]
        if distance(position, here) <= OFF:
            return self._space.leg_clear(position, goal)
        return self._space.apart(position, here, NEARBY) and self._space.leg_clear(here, goal)

    def _strayed(self, position: Point) -> bool:
        """Return whether the vehicle cannot safely be drawn back to the reference in a straight line."""
        here = self._reference.at(0.0).position
        if distance(position, here) <= OFF:
            return False
        return not self._space.apart(position, here, LEG)

    def _brake(self, position: Point, velocity: Point, now: float) -> None:
        """Brake, and restart the reference at the vehicle's position."""
        self._reference.drop(now)
        self._enter(Stage.BRAKING, now)
        self._pause(now)
        self._reference.start(position, velocity, now)

    def _choose(self, position: Point, velocity: Point, now: float) -> None:
        """Fly the straight leg to the next point if it is clear, else ask the planner for a leg.

        The vehicle stands when this is called. A vehicle that is too near to an obstacle moves away from it first."""
        goal = self._reference.ahead[0]
        there = distance(position, goal) <= OFF
        self._from = position if there else self._space.retreat(position)
        if self._space.leg_clear(self._from, goal):
            self._resume((goal,), position, velocity, now)
        elif self._space.ask_leg(self._from, goal):
            self._enter(Stage.ASKING, now)
            self._answered(position, velocity, now)  # process an answer that the planner has given at once
        else:
            self._enter(Stage.STANDING, now)

    def _answered(self, position: Point, velocity: Point, now: float) -> None:
        leg = self._space.leg()
        if leg is None:
            if now - self._since > ANSWER_TIMEOUT:
                self._enter(Stage.BRAKING, now)
            return
        goal = self._reference.ahead[0]
        if leg:
            self._resume((*leg[1:-1], goal), position, velocity, now)
        elif self._space.clear(position, goal, 0.0):  # 0: the least distance, which a commanded path must keep
            self._resume((goal,), position, velocity, now)
        else:
            self._enter(Stage.STANDING, now)
            self._no_leg = f"no clear way from {coordinates(position)} back to {coordinates(goal)}: holding"

    def _resume(self, leg: Path, position: Point, velocity: Point, now: float) -> None:
        """Start the reference at the vehicle's position, along the leg that was found."""
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
        """Return a setpoint that leads into no obstacle even if no further setpoint arrives.

        After the last setpoint, the autopilot goes on at the setpoint's velocity for some seconds (`runs_on`). So the
        setpoint's velocity is reduced, and its position is moved forward to keep the demanded velocity, as in module
        `setpoint`. A setpoint without a velocity is moved back to a place before the obstacle."""
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
        """Return the largest rate of the reference at which `bounded` does not reduce the demanded speed.

        At this rate the reference can also brake before an obstacle ahead. Near obstacles, the reference waits for a
        vehicle that is more than TIGHT behind, because a vehicle that lags cuts corners."""
        reference, state = self._reference, self._reference.at(0.0)
        speed, off = norm(state.velocity), distance(position, state.position)
        tight = 1.0
        if off > TIGHT and not self._space.apart(position, state.position, NEARBY):
            tight = max(0.0, 2.0 - off / TIGHT)
        if speed < SLOWEST:
            return tight
        u = state.velocity / speed
        limits = reference.limits
        free = distance(state.position, self._free(state.position, state.position + u * (LOOK * limits.speed)))
        allowed = max(SLOWEST, min(free / LOOK, math.sqrt(2 * limits.acceleration * free)))
        return min(tight, reference.rate * allowed / speed)

    def _free(self, start: Point, end: Point) -> Point:
        """Return a point on the line from `start` to `end` up to which the line is clear of obstacles.

        The point is `end` if the whole line is clear, else the farthest one that BISECTIONS steps find."""
        if self._space.clear(start, end, RUNNING):
            return end
        low, high = 0.0, 1.0
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            if self._space.clear(start, start + (end - start) * middle, RUNNING):
                low = middle
            else:
                high = middle
        return start + (end - start) * low

    @property
    def stall(self) -> str:
        """Reason why the vehicle stands without a clear path, in words; "" if it has a clear path."""
        return self._standstill.holding or self._no_leg

    def log_lines(self) -> list[str]:
        """Return log lines on standstills since the last call."""
        return self._standstill.log_lines()
