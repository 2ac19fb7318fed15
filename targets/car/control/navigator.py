"""Navigator: drives the car to a target that may move.

It decides when to request a path, when to drive, when to stand, and when the target is reached. The planner runs in its
own process. Until its answer arrives, the car follows its present path.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from targets.car.base.bicycle import BicycleState
from targets.car.base.settings import CarSettings
from targets.car.control.mpc import BLIND_STEPS, STEP, Command, ControlLimits, Mpc
from targets.car.control.tracker import BRAKING, LATERAL, Tracker
from targets.car.planning.approach import Approach
from targets.car.planning.avoidance import CarAvoidance
from targets.car.planning.curves import Curve
from targets.car.planning.planner import SLIVER, Area, arc, segments
from targets.car.planning.reasons import NoWay

STANDING = 0.05  # m/s; a car that is not faster counts as standing

# A new path is requested if the target has moved by more than MOVED (m) + MOVED_SHARE * (distance of car and target).
MOVED, MOVED_SHARE = 0.02, 0.05
# A path with changes of gear is driven to its end if the target has moved by at most this share of the distance
# between car and target. If each move of the target led to a new path, the car might never reach a change of gear.
COMMIT = 0.4
ARC_REACH = 0.5  # m; to a target within this distance, the car first tries a single arc without the planner

# Maximum distance of a single arc's end from the target, in units of the reached radius. STANDING_BY: for a standing
# car; FOLLOWING: for a car on the last segment of its path.
STANDING_BY, FOLLOWING = 0.4, 1.5
LOOKAHEAD = 0.4  # m; look-ahead distance of pure pursuit towards a moving target; with a shorter one, the car sways
TRAIL = 0.3  # m; length of a moving target's travelled path from which the target's direction is estimated
STRAYED = 0.08  # m; with a larger lateral error, the car stops if an obstacle is near, and does not return to its path
OFF_PATH = 0.25  # m; with a larger lateral error, a new path is requested
BEHIND = 0.5  # m; maximum distance of a driving car from the start of a planned path when the path arrives
RETRY = 1.0  # seconds between a failed planning request and the next one

# In units of the reached radius: a car that has arrived stays within STAY of the target and drives on beyond LEAVE.
STAY, LEAVE = 0.9, 1.5
SETTLE = 1.0  # seconds at a distance between STAY and LEAVE after which the car drives on
STUCK = 2.0  # seconds without motion after which `progress` reports that a driving car does not move

# Other robots' paths are checked over the stopping distance, plus the distance driven in REACTION (seconds) at maximum
# speed, plus CAUTION (m).
REACTION, CAUTION = 0.3, 0.3
LAG = 0.15  # seconds by which the measured speed lags behind the commanded speed
SLIP = 0.5  # m/s; maximum difference of commanded and measured speed, so that a blocked car's command cannot wind up


class Trail:
    """Recently travelled path of a moving target."""

    def __init__(self) -> None:
        self._places: list[tuple[float, float]] = []

    def add(self, place: tuple[float, float]) -> None:
        """Add the target's present place. A jump of more than TRAIL starts a new trail."""
        if self._places:
            step = math.dist(self._places[-1], place)
            if step < MOVED:
                return
            if step > TRAIL:
                self._places.clear()
        self._places.append(place)
        while math.dist(self._places[0], place) > TRAIL:
            self._places.pop(0)

    def beyond(self, distance: float) -> tuple[float, float] | None:
        """Return the place `distance` metres ahead of a moving target in its direction; None if it does not move."""
        if distance <= 0 or len(self._places) < 3:
            return None
        (x0, y0), (x1, y1) = self._places[0], self._places[-1]
        way = max(math.hypot(x1 - x0, y1 - y0), MOVED)
        return (x1 + distance * (x1 - x0) / way, y1 + distance * (y1 - y0) / way)


class Navigator:
    """Navigator of one car. Positions are those of the middle of the rear axle, metres, local ENU."""

    def __init__(
        self, settings: CarSettings, area: Area, avoidance: CarAvoidance, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        """Targets are clamped into `area`. `clock` measures the solver's run time."""
        limits = ControlLimits(
            settings.wheelbase,
            settings.max_speed,
            settings.max_acceleration,
            settings.steering_limit,
            settings.max_steering_rate,
        )
        self._settings = settings
        self._area, self._avoidance = area, avoidance
        mpc = Mpc(limits, clock=clock)
        mpc.warm_up()
        self._tracker = Tracker(limits, mpc)
        self.note = mpc.note  # log line if the slower MPC solver is used, else ""
        self._target: tuple[float, float] | None = None
        self._asked_for: tuple[float, float] | None = None
        self._planned_for: tuple[float, float] | None = None
        self._considered: tuple[float, float] | None = None  # last target for which the present path was kept
        self._failed_for: tuple[float, float] | None = None
        self._arrival: float | None = None  # heading at the end of the present path
        self._retry_at = 0.0
        self._arrived = False
        self._away_since: float | None = None
        self._near_since: float | None = None
        self._near_target: tuple[float, float] | None = None
        self._last = Command(0.0, 0.0)
        self._no_way = NoWay()
        self._crossed = False  # whether another robot's path has crossed the present path
        self._approach = Approach(_cornering(limits, settings.planned_radius), settings.reached_radius)
        self._stirred = 0.0  # last time (s) at which the car moved, or had no reason to move
        self._trail = Trail()
        self._curve: Curve | None = None  # the present path
        self.waits = False  # whether the car waits because another robot's path crosses its own
        self.reached = True
        self.progress = "standing: no target yet"

    @property
    def steering(self) -> float:
        """Last commanded steering angle, radians."""
        return self._last.steering

    @property
    def target(self) -> tuple[float, float] | None:
        """Present target; None before the first."""
        return self._target

    @property
    def gear(self) -> int:
        """Direction of the path segment being driven: 1 forward, -1 reverse, 0 without a path."""
        return self._tracker.gear

    @property
    def stall(self) -> str:
        """Reason why the car has no path to its target, in words; "" if it has one. Implements `Platform.stall`."""
        return "" if self._arrived or self.reached else self._no_way.why

    def go_to(self, target: tuple[float, float]) -> None:
        """Set the target, clamped into the car's area. The area's margin is smaller than the reached radius."""
        area = self._area
        self._target = (max(area.west, min(area.east, target[0])), max(area.south, min(area.north, target[1])))
        self._trail.add(self._target)
        self._approach.aim(self._target)
        if self._near_target is None or math.dist(self._near_target, self._target) > self._settings.reached_radius / 10:
            self.reached = False
            self._near_since = None

    def follow(self, curve: Curve, state: BicycleState) -> None:
        """Follow a planned path to its end, which becomes the target.

        A car that rolls against the first gear of the path stops first, and then requests a path from its place."""
        self.go_to(curve.end[:2])
        self._asked_for = None
        if _rolls_against(state, curve):
            self._tracker.stop()
        elif self._target is not None:
            self._adopt(curve, self._target)

    def _adopt(self, curve: Curve, target: tuple[float, float]) -> None:
        self._curve = curve
        self._planned_for = self._considered = target
        self._failed_for, self._arrived = None, False
        self._arrival = curve.end[2]
        way = segments(curve)
        self._approach.record_path(curve.length, len(way), self._crossed)
        self._crossed = False
        self._tracker.set_path(way)

    def pause(self) -> None:
        """Drop the path but keep the target, because the caller brakes the car."""
        self._tracker.stop()
        self._planned_for = None
        self._last = Command(0.0, self._last.steering)

    def watch(self, state: BicycleState, standing: bool, now: float) -> None:
        """Update `reached`.

        The target is reached once the car has stood within the radius for the dwell time. It then stays reached until a
        new target arrives, even if position noise puts a car near the radius outside of it."""
        if self._target is None or self.reached:
            return
        near = math.dist((state.x, state.y), self._target) <= self._settings.reached_radius
        if not (near and standing):
            self._near_since = None
            return
        if self._near_since is None:
            self._near_since, self._near_target = now, self._target
        self.reached = now - self._near_since >= self._settings.reached_dwell

    def step(self, state: BicycleState, standing: bool, now: float) -> Command | None:
        """Return the command for the next control step, or None to brake. `state.speed` is measured."""
        self.watch(state, standing, now)
        command = self._drive(state, standing, now)
        if command is None:
            self.pause()
        else:
            self._last = command
        if command is None or not standing:
            self._stirred = now
        elif now - self._stirred > STUCK:
            self.progress = f"driving, but the car has not moved for {now - self._stirred:.0f} s"
        return command

    def _drive(self, state: BicycleState, standing: bool, now: float) -> Command | None:
        if self._target is None:
            return None
        away = math.dist((state.x, state.y), self._target)
        if self._stays(away, now):
            self.progress = "standing at the target"
            return None
        if self._tracker.done and not standing:
            self._approach.drive(STEP)  # braking counts as driving, too: otherwise slow stops could recur forever
            return None  # at the end of a path, or after a pause, the car must stand before it drives on
        if self._tracker.done and away <= self._settings.reached_radius:
            self._arrived = True
            return None
        if self._approach.failed:
            self.progress = self._approach.why(away)
            self._no_way.blocked(self._target, self.progress)
            return None
        if not self._plan(state, away, now):
            return None
        self.progress = f"driving, {away:.1f} m to go"
        speed = max(state.speed - SLIP, min(state.speed + SLIP, self._last.speed))
        # Because of LAG, the car drives `extra` metres farther than the model predicts, until it has the new speed.
        extra = LAG * (state.speed - speed)
        x, y = state.x + extra * math.cos(state.yaw), state.y + extra * math.sin(state.yaw)
        free = self._free(state, standing, now)
        command = self._tracker.step(BicycleState(x, y, state.yaw, speed, self._last.steering), free)
        if self._tracker.failures > BLIND_STEPS:
            self.progress = f"braking: {self._tracker.trouble}"
            self._no_way.blocked(self._target, f"the controller has no plan: {self._tracker.trouble}")
            return None
        if free == math.inf:
            self._approach.drive(STEP)
            if not standing:
                self._no_way.found()
        return None if self._tracker.done else command

    def _free(self, state: BicycleState, standing: bool, now: float) -> float:
        """Return how many metres ahead are free of other robots' paths; infinite if they are enough to stop.

        A car that stands before another robot's path requests a new path around it every RETRY seconds."""
        self.waits = False
        if self._curve is None:
            return math.inf
        settings = self._settings
        ahead = state.speed**2 / (2 * BRAKING * settings.max_acceleration) + settings.max_speed * REACTION + CAUTION
        free = self._avoidance.free(self._curve, self._tracker.station, ahead)
        self.waits = free < math.inf
        if free < math.inf:
            self.progress = f"another robot's path crosses this one in {free:.1f} m"
            self._stirred = now  # the car stands on purpose, so `progress` must not report it as stuck
            self._crossed = True
            if standing and self._target is not None:
                self._no_way.blocked(self._target, self._avoidance.blocker)
            if standing and now >= self._retry_at:
                self._considered, self._retry_at = None, now + RETRY
        return free

    def _stays(self, away: float, now: float) -> bool:
        """Return whether a car that has arrived stays where it is. `away`: distance to the target (m).

        The car drives on if the target is more than LEAVE radii away, or has been more than STAY radii away for SETTLE
        seconds. So it does not follow noise and small moves, but always reaches its target."""
        radius = self._settings.reached_radius
        if not self._arrived:
            return False
        if away <= STAY * radius:
            self._away_since = None
            return True
        if self._away_since is None:
            self._away_since = now
        if away <= LEAVE * radius and now - self._away_since < SETTLE:
            return True
        self._arrived, self._away_since = False, None
        return False

    def _plan(self, state: BicycleState, away: float, now: float) -> bool:
        """Return whether there is a path to follow; request one if needed."""
        target = self._target
        if target is None:
            return False
        if self._tracker.error > STRAYED and not self._tracker.done and self._avoidance.strayed(state):
            self._tracker.stop()
            self.progress = "braking: off the path, and near to an obstacle"
            return False
        self._answered(state, away, now)
        if self._tracker.done and abs(state.speed) > STANDING:
            self.progress = "braking: a path is planned when the car stands"
            return False
        driving = not self._tracker.done and self._tracker.error <= OFF_PATH
        if driving and _same(self._considered, target, MOVED + MOVED_SHARE * away):
            return True
        if _same(self._failed_for, target, MOVED) and now < self._retry_at:
            return False
        if away <= ARC_REACH and (curve := self._near(state, target)) is not None:
            self._adopt(curve, target)
            return True
        if away <= STANDING_BY * self._settings.reached_radius:
            self.progress = "standing at the target"  # to come nearer, the car would have to change gears
            return False
        if not self._avoidance.asking and self._avoidance.ask(state, target, self._gear(state), self._arrival):
            self._asked_for = target
            self._answered(state, away, now)  # the planner may have answered already
        if not self._tracker.done:
            return driving or self._asked_for is not None or self._considered == target
        if not _same(self._failed_for, target, MOVED):
            self.progress = "standing until a path is planned"
        return False

    def _gear(self, state: BicycleState) -> int:
        return self._tracker.gear or (0 if abs(state.speed) <= STANDING else int(math.copysign(1, state.speed)))

    def _near(self, state: BicycleState, target: tuple[float, float]) -> Curve | None:
        """Return a clear single arc to a near target; None if there is none.

        On the last segment towards a moving target, the arc may end beside the target (FOLLOWING): a manoeuvre would be
        outdated when it ends. A standing car has time for a manoeuvre, so its arc must end nearer (STANDING_BY)."""
        following = self._tracker.last_stretch
        close = (FOLLOWING if following else STANDING_BY) * self._settings.reached_radius
        start, away = (state.x, state.y, state.yaw), math.dist((state.x, state.y), target)
        through = self._trail.beyond(LOOKAHEAD - away) if following else None
        gear = self._gear(state)
        curve = arc(self._settings.planned_radius, start, target, gear, close, through)
        if curve is None or (curve.pieces[0][1] < 0 and not self._settings.reverse):
            return None
        return curve if self._avoidance.clear(start, target, curve) else None

    def _answered(self, state: BicycleState, away: float, now: float) -> None:
        """Follow the planned path if the planner has answered; report the reason if it found none."""
        answer, target = self._avoidance.answer(), self._asked_for
        if answer is None or target is None:
            return
        self._asked_for = None
        curve, reason = answer
        if curve is None:
            why = reason or "no path inside the geofence leads there"
            self.progress = f"standing: {why}: ({target[0]:.2f}, {target[1]:.2f})"
            self._no_way.failed(target, self._avoidance.explained((state.x, state.y), target, reason), now)
            self._failed_for, self._retry_at, self._arrival = target, now + RETRY, None
            self._tracker.stop()
            return
        if math.dist((state.x, state.y), curve.start[:2]) > (STRAYED if self._tracker.done else BEHIND):
            return
        self._considered, self._failed_for = target, None
        gears = [segment.direction for segment in segments(curve)]
        driving = not self._tracker.done and self._tracker.error <= OFF_PATH
        if driving and gears != [self._tracker.gear]:
            within = max(LEAVE * self._settings.reached_radius, COMMIT * away)
            if _same(self._planned_for, target, within):
                return
        if _rolls_against(state, curve):
            self._tracker.stop()
            return
        self._adopt(curve, target)


def _rolls_against(state: BicycleState, curve: Curve) -> bool:
    """Return whether the car rolls against the first gear of the curve. If so, the car must stop before it follows."""
    first = next((way for _, way in curve.pieces if abs(way) > SLIVER), 0.0)
    return abs(state.speed) > STANDING and state.speed * first < 0


def _cornering(limits: ControlLimits, radius: float) -> float:
    """Return the speed (m/s) that the limits allow in a curve of this radius (m)."""
    return min(limits.speed, math.sqrt(LATERAL * limits.acceleration * radius))


def _same(before: tuple[float, float] | None, target: tuple[float, float], within: float) -> bool:
    return before is not None and math.dist(before, target) <= within
