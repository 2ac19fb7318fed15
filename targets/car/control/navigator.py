"""Brings the car to a point that may move: when to have a way planned, when to drive, when to stand, and what counts as
reached. Planning goes on beside it; until an answer comes, the car goes on along the way that it has."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from targets.car.base.bicycle import State
from targets.car.base.settings import CarSettings
from targets.car.control.mpc import BLIND_STEPS, STEP, Command, Limits, Mpc
from targets.car.control.tracker import BRAKING, LATERAL, Tracker
from targets.car.planning.approach import Approach
from targets.car.planning.avoidance import Avoidance
from targets.car.planning.curves import Curve
from targets.car.planning.planner import SLIVER, Area, arc, segments
from targets.car.planning.reasons import NoWay

STANDING = 0.05  # m/s or slower is standing
MOVED, MOVED_SHARE = 0.02, 0.05  # a target that moved by these metres and this share of its distance needs a new path
# A manoeuvre that has begun is ended, if its goal is off by no more than this share of the distance: planned anew each
# time the target moves, its changes of gear would recede for ever.
COMMIT = 0.4
ARC_REACH = 0.5  # metres: a target so near is first tried by a single arc
STANDING_BY, FOLLOWING = 0.4, 1.5  # radii: as close as an arc has to come, from a stand and on the last stretch
LOOKAHEAD = 0.4  # metres at which a moving target is steered for: pure pursuit of a nearer point sways
TRAIL = 0.3  # metres of a target's way that tell where it is heading
STRAYED = 0.08  # metres from the path beyond which the way back to it is not driven near to obstacles
OFF_PATH = 0.25  # metres from the path that call for a new one
BEHIND = 0.5  # metres that the car may have gone on from where an answer's way begins
RETRY = 1.0  # seconds until a plan that failed is tried again
STAY, LEAVE = 0.9, 1.5  # radii from the target within which an arrived car stays, beyond which it goes on at once
SETTLE = 1.0  # seconds between these two after which it goes on, too
STUCK = 2.0  # seconds without motion after which a driving car says so
REACTION, CAUTION = 0.3, 0.3  # seconds and metres besides the way to a stop in which others' paths matter
LAG = 0.15  # seconds in which the measured speed follows the commanded one
SLIP = 0.5  # m/s between commanded and measured speed, at most: a blocked car must not wind up


class Trail:
    """Where a moving target has been of late."""

    def __init__(self) -> None:
        self._places: list[tuple[float, float]] = []

    def add(self, place: tuple[float, float]) -> None:
        """Take the target's present place; a jump begins a new trail."""
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
        """Return the place so many metres on, if the target has been moving and goes on straight."""
        if distance <= 0 or len(self._places) < 3:
            return None
        (x0, y0), (x1, y1) = self._places[0], self._places[-1]
        way = max(math.hypot(x1 - x0, y1 - y0), MOVED)
        return (x1 + distance * (x1 - x0) / way, y1 + distance * (y1 - y0) / way)


class Navigator:
    """One car's way to its target. Positions are of the rear axle's middle, metres, local ENU."""

    def __init__(
        self, settings: CarSettings, area: Area, avoidance: Avoidance, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        """Targets are brought inside the area; `clock` times the solver."""
        limits = Limits(
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
        self.note = mpc.note  # for the log: why the controller is the slower one, or ""
        self._target: tuple[float, float] | None = None
        self._asked_for: tuple[float, float] | None = None
        self._planned_for: tuple[float, float] | None = None
        self._considered: tuple[float, float] | None = None  # for this one, that path was found good enough
        self._failed_for: tuple[float, float] | None = None
        self._arrival: float | None = None  # heading at the end of the present path
        self._retry_at = 0.0
        self._arrived = False
        self._away_since: float | None = None
        self._near_since: float | None = None
        self._near_target: tuple[float, float] | None = None
        self._last = Command(0.0, 0.0)
        self._no_way = NoWay()
        self._crossed = False  # whether another robot's path has met the way that is driven
        self._approach = Approach(_cornering(limits, settings.planned_radius), settings.reached_radius)
        self._stirred = 0.0  # when the car moved last, or had no reason to
        self._trail = Trail()
        self._curve: Curve | None = None  # the way that is driven
        self.waits = False  # for another robot to leave its way
        self.reached = True
        self.progress = "standing: no target yet"

    @property
    def steering(self) -> float:
        """The angle commanded last, radians."""
        return self._last.steering

    @property
    def target(self) -> tuple[float, float] | None:
        """The place to drive to."""
        return self._target

    @property
    def gear(self) -> int:
        """The direction in which it drives; 0: it stands."""
        return self._tracker.gear

    @property
    def stall(self) -> str:
        """See koordgen.runtime.vehicle.platform: why there is no way to the target now."""
        return "" if self._arrived or self.reached else self._no_way.why

    def go_to(self, target: tuple[float, float]) -> None:
        """Take a target; it is brought inside the margin to the geofence, which is smaller than the radius."""
        area = self._area
        self._target = (max(area.west, min(area.east, target[0])), max(area.south, min(area.north, target[1])))
        self._trail.add(self._target)
        self._approach.aim(self._target)
        if self._near_target is None or math.dist(self._near_target, self._target) > self._settings.reached_radius / 10:
            self.reached = False
            self._near_since = None

    def follow(self, curve: Curve, state: State) -> None:
        """Drive a way that has been planned, to its end, which is the target. A car that rolls against the first gear
        of the way stops first, and then has a way planned from there."""
        self.go_to(curve.end[:2])
        self._asked_for = None
        if _rolls_against(state, curve):
            self._tracker.stop()
        elif self._target is not None:
            self._take(curve, self._target)

    def _take(self, curve: Curve, target: tuple[float, float]) -> None:
        self._curve = curve
        self._planned_for = self._considered = target
        self._failed_for, self._arrived = None, False
        self._arrival = curve.end[2]
        way = segments(curve)
        self._approach.take(curve.length, len(way), self._crossed)
        self._crossed = False
        self._tracker.take(way)

    def pause(self) -> None:
        """The car is being braked by others: drop the path, keep the target."""
        self._tracker.stop()
        self._planned_for = None
        self._last = Command(0.0, self._last.steering)

    def watch(self, state: State, standing: bool, now: float) -> None:
        """Judge whether the target is reached: the car stands within the radius, and has for the dwell time; from then
        on it is, until a new target comes, whatever noise says of a car that stands near the radius."""
        if self._target is None or self.reached:
            return
        near = math.dist((state.x, state.y), self._target) <= self._settings.reached_radius
        if not (near and standing):
            self._near_since = None
            return
        if self._near_since is None:
            self._near_since, self._near_target = now, self._target
        self.reached = now - self._near_since >= self._settings.reached_dwell

    def step(self, state: State, standing: bool, now: float) -> Command | None:
        """Return the command of the next step, None to brake. `state.speed` is measured."""
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

    def _drive(self, state: State, standing: bool, now: float) -> Command | None:
        if self._target is None:
            return None
        away = math.dist((state.x, state.y), self._target)
        if self._stays(away, now):
            self.progress = "standing at the target"
            return None
        if self._tracker.done and not standing:
            self._approach.drive(STEP)  # a car that is slow to stop would else circle its target for ever
            return None  # the end of a path, or of a pause: stand first
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
        # Until the speed has become the commanded one, the car will have gone this much farther than the model thinks.
        extra = LAG * (state.speed - speed)
        x, y = state.x + extra * math.cos(state.yaw), state.y + extra * math.sin(state.yaw)
        free = self._free(state, standing, now)
        command = self._tracker.step(State(x, y, state.yaw, speed, self._last.steering), free)
        if self._tracker.failures > BLIND_STEPS:
            self.progress = f"braking: {self._tracker.trouble}"
            self._no_way.blocked(self._target, f"the controller has no plan: {self._tracker.trouble}")
            return None
        if free == math.inf:
            self._approach.drive(STEP)
            if not standing:
                self._no_way.found()
        return None if self._tracker.done else command

    def _free(self, state: State, standing: bool, now: float) -> float:
        """How many metres of the way are free of the others', as far as it takes to stop. A car that stands before
        another's way has one around it planned again and again."""
        self.waits = False
        if self._curve is None:
            return math.inf
        settings = self._settings
        ahead = state.speed**2 / (2 * BRAKING * settings.max_acceleration) + settings.max_speed * REACTION + CAUTION
        free = self._avoidance.free(self._curve, self._tracker.station, ahead)
        self.waits = free < math.inf
        if free < math.inf:
            self.progress = f"another robot's path crosses this one in {free:.1f} m"
            self._stirred = now  # it knows why it stands
            self._crossed = True
            if standing and self._target is not None:
                self._no_way.blocked(self._target, self._avoidance.blocker)
            if standing and now >= self._retry_at:
                self._considered, self._retry_at = None, now + RETRY
        return free

    def _stays(self, away: float, now: float) -> bool:
        """Whether a car that has arrived stays where it is. It goes on when the target is 1.5 radii away, or has been
        nearly a radius away for a while: noise and small moves are not followed, yet no target is left unreached."""
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

    def _plan(self, state: State, away: float, now: float) -> bool:
        """Return whether there is a path to follow; request one if needed."""
        target = self._target
        if target is None:
            return False
        if self._tracker.error > STRAYED and not self._tracker.done and self._avoidance.strayed(state):
            self._tracker.stop()
            self.progress = "braking: off its way, and near to an obstacle"
            return False
        self._answered(state, away, now)
        if self._tracker.done and abs(state.speed) > STANDING:
            self.progress = "braking: its way is planned when the car stands"
            return False
        driving = not self._tracker.done and self._tracker.error <= OFF_PATH
        if driving and _same(self._considered, target, MOVED + MOVED_SHARE * away):
            return True
        if _same(self._failed_for, target, MOVED) and now < self._retry_at:
            return False
        if away <= ARC_REACH and (curve := self._near(state, target)) is not None:
            self._take(curve, target)
            return True
        if away <= STANDING_BY * self._settings.reached_radius:
            self.progress = "standing at the target"  # nearer would take a manoeuvre
            return False
        if not self._avoidance.asking and self._avoidance.ask(state, target, self._gear(state), self._arrival):
            self._asked_for = target
            self._answered(state, away, now)  # it may have come at once
        if not self._tracker.done:
            return driving or self._asked_for is not None or self._considered == target
        if not _same(self._failed_for, target, MOVED):
            self.progress = "standing until a way is planned"
        return False

    def _gear(self, state: State) -> int:
        return self._tracker.gear or (0 if abs(state.speed) <= STANDING else int(math.copysign(1, state.speed)))

    def _near(self, state: State, target: tuple[float, float]) -> Curve | None:
        """A single arc to a target close by. On the last stretch to a target that moves on, a little beside it is
        better than a manoeuvre, which would be out of date when it ends; from a stand there is time for one."""
        following = self._tracker.last_stretch
        close = (FOLLOWING if following else STANDING_BY) * self._settings.reached_radius
        start, away = (state.x, state.y, state.yaw), math.dist((state.x, state.y), target)
        through = self._trail.beyond(LOOKAHEAD - away) if following else None
        gear = self._gear(state)
        curve = arc(self._settings.planned_radius, start, target, gear, close, through)
        if curve is None or (curve.pieces[0][1] < 0 and not self._settings.reverse):
            return None
        return curve if self._avoidance.clear(start, target, curve) else None

    def _answered(self, state: State, away: float, now: float) -> None:
        """Take what was planned, if an answer has come."""
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
        self._take(curve, target)


def _rolls_against(state: State, curve: Curve) -> bool:
    """Return whether the car rolls against the first gear of the curve. Such a car must stop before it can follow."""
    first = next((way for _, way in curve.pieces if abs(way) > SLIVER), 0.0)
    return abs(state.speed) > STANDING and state.speed * first < 0


def _cornering(limits: Limits, radius: float) -> float:
    """Return the speed, m/s, in a curve of this radius, metres."""
    return min(limits.speed, math.sqrt(LATERAL * limits.acceleration * radius))


def _same(before: tuple[float, float] | None, target: tuple[float, float], within: float) -> bool:
    return before is not None and math.dist(before, target) <= within
