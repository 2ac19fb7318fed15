"""Reference: the desired position and velocity of the vehicle, now and in the near future.

The reference advances along a trajectory with time. It slows down when the vehicle falls behind, and stands when its
distance from the vehicle reaches a limit, the leash.

A program may command a new target again and again. The reference then assumes that the target moves on as before, and
moves along with the target instead of stopping at each commanded place. If no new target arrives for a while, the
reference returns to the last commanded target.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise

from koordgen.runtime.values.points import Point, distance
from koordgen.runtime.vehicle.safety import clamp
from targets.planning.world import Path
from targets.quad.motion.trajectory import ZERO, MotionLimits, MotionState, Trajectory, norm, plan, standing

# s, m. The leash is LEASH_LENGTH + LEASH_TIME * maximum speed: at this distance from the vehicle, the reference stands.
LEASH_TIME, LEASH_LENGTH = 0.5, 0.5
LONGEST_STEP = 0.5  # s; maximum time by which the reference advances in one step
CREEP = 0.05  # rate (reference time per real time) below which the reference stands
FASTER = 1.0  # 1/s; growth of the reference's rate after the caller of `advance` has limited the rate
PAUSE = 0.5  # s; a paused reference stops at most this time of flight ahead: an autopilot needs about as far to brake
STANDING = 0.25  # m/s; slower vehicles count as standing. The estimated speed of a hovering vehicle stays below this
WINDOW = 0.4  # s; the velocity of a moving target is estimated from its places in this last period

# A moving target must be faster than PACE (m/s), and its displacement must be at least STRAIGHT times the length of the
# path through its places. Otherwise the motion counts as noise in measured places.
PACE, STRAIGHT = 0.1, 0.7
SLOW = 0.1  # m/s; a trajectory with a lower peak speed, for example one of a centimetre, counts as no motion
SETTLED = 0.5  # s that the vehicle may need to come to a stand after the reference has come to a stand
RHYTHM = 0.6  # s; a target that is commanded later than this after the last one counts as new, not as a moving target


class Pursuit:
    """Prediction of a moving target: its velocity and acceleration (m/s, m/s^2) from its last places.

    Both are computed from the parabola through the first, the middle and the last place in the WINDOW."""

    def __init__(self, limits: MotionLimits) -> None:
        self._limits = limits
        self._seen: deque[tuple[float, Point]] = deque(maxlen=64)
        self.forget()

    def forget(self) -> None:
        """Assume that the target stands still."""
        self._seen.clear()
        self.velocity = self.acceleration = ZERO
        self.until = -math.inf  # time at which the target counts as standing, unless a new place arrives

    def note(self, target: Point, now: float) -> None:
        """Record a new place of the target, and update the prediction."""
        if self._seen:
            last, place = self._seen[-1]
            # 0.1 s is added because the program's rounds, which command the places, are not regular.
            if now - last > RHYTHM or distance(target, place) > self._limits.speed * (now - last + 0.1):
                self.forget()
        if self._seen and now <= self._seen[-1][0]:
            self._seen.pop()
        self._seen.append((now, target))
        while len(self._seen) > 3 and now - self._seen[1][0] >= WINDOW:
            self._seen.popleft()
        if len(self._seen) < 3:
            return
        (t0, p0), (t1, p1), (t2, p2) = self._seen[0], self._seen[len(self._seen) // 2], self._seen[-1]
        early, late = (p1 - p0) / (t1 - t0), (p2 - p1) / (t2 - t1)
        turn = (late - early) * (2 / (t2 - t0))
        size = norm(turn)
        self.acceleration = turn * min(1.0, self._limits.acceleration / size) if size > 0 else ZERO
        self.velocity = self._limits.limited(late + self.acceleration * ((t2 - t1) / 2))
        steps = sum(distance(p, q) for (_, p), (_, q) in pairwise(self._seen))
        if norm(self.velocity) < PACE or distance(p0, p2) < STRAIGHT * steps:
            self.velocity = self.acceleration = ZERO
        self.until = now + max(1.6 * (t2 - t0) / (len(self._seen) - 1), 0.1)


class Reference:
    """Reference state of one vehicle.

    Points must be finite and inside the box `limits.box`. Times are in seconds on any clock."""

    def __init__(self, limits: MotionLimits) -> None:
        self.limits = limits
        self._leash = LEASH_LENGTH + LEASH_TIME * limits.speed
        self._pursuit = Pursuit(limits)
        self._points: tuple[Point, ...] = ()
        self._passed = 0  # number of points that were passed when the trajectory was planned
        self._trajectory: Trajectory | None = None
        self._elapsed = 0.0  # s that the reference has advanced on the trajectory
        self._rate = 1.0  # trajectory time per real time, 0 to 1
        self._time = 0.0  # real time to which the reference has advanced
        self._limited = False  # whether the caller of `advance` limited the rate, which then grows slowly
        self.paused = False
        self.alone = True  # whether to send setpoints without a velocity: the reference stands, is paused, or waits

    @property
    def started(self) -> bool:
        return self._trajectory is not None

    @property
    def final(self) -> bool:
        """Return whether only the last waypoint is ahead."""
        return self._behind() >= len(self._points) - 1

    @property
    def ahead(self) -> tuple[Point, ...]:
        """Waypoints that are not passed yet, always with the last one; () before the first command or start."""
        return self._points[min(self._behind(), len(self._points) - 1) :] if self._points else ()

    @property
    def stood(self) -> float:
        """Seconds since the reference came to a final stand; negative while it moves.

        Infinite if the trajectory has no motion at all."""
        trajectory = self._trajectory
        if trajectory is None or trajectory.peak == 0.0:
            return math.inf
        return -math.inf if trajectory.end.velocity != ZERO else self._elapsed - trajectory.seconds

    @property
    def rate(self) -> float:
        """Trajectory time per real time, 0 to 1."""
        return self._rate

    @property
    def waits(self) -> bool:
        """Return whether the reference stands because the vehicle is too far from it."""
        return self._rate == 0.0

    def start(self, position: Point, velocity: Point, now: float) -> None:
        """Plan a trajectory from the vehicle's position and velocity to the points ahead.

        If there are no points, or the reference is paused, plan a stop."""
        at = clamp(self.limits.box, position)
        climb = velocity.z if at.z == position.z else 0.0  # no vertical velocity if the height was clamped to the box
        state = MotionState(at, self.limits.limited(Point(velocity.x, velocity.y, climb)))
        if norm(state.velocity) < STANDING or not self.limits.safe(state):
            state = MotionState(state.position)
        self._time, self._rate = now, 1.0
        self._points = self._points or (self.limits.stop(state),)
        self._replan(MotionState(self._halt(state)) if self.paused else state)

    def drop(self, now: float) -> Point | None:
        """Drop the trajectory, because the vehicle no longer follows it; `start` plans a new one.

        Return the place where the reference would have stood if it had been paused instead; None if not started."""
        state = self._run(now)
        self._passed, self._trajectory = self._behind(), None
        self._pursuit.forget()
        return None if state is None else self._halt(state)

    @property
    def trajectory(self) -> Trajectory | None:
        """Present trajectory. Each new command replaces the trajectory by another object."""
        return self._trajectory

    def way(self) -> Path:
        """Return places ahead on the trajectory, which stays near the straight lines between these places.

        `Trajectory.chords` gives the largest deviation. The places include the pursuit of a moving target up to the
        time when the target counts as standing. `start` must be called first."""
        trajectory = self._trajectory
        assert trajectory is not None
        way = trajectory.chords(self._elapsed)
        if trajectory.end.velocity != ZERO:
            until = self._elapsed + self._pursuit.until - self._time
            way.append(trajectory.at(max(trajectory.seconds, until)).position)
        return tuple(way)

    def follow(self, points: tuple[Point, ...], now: float) -> None:
        """Follow these points from now on; without points, stop."""
        state = self._run(now)
        if len(points) == 1:
            self._pursuit.note(points[0], now)
        else:
            self._pursuit.forget()
        self._passed = 0
        self._points = points or (() if state is None else (self.limits.stop(state),))
        if state is not None:
            self._replan(state)

    def detour(self, points: tuple[Point, ...]) -> None:
        """Insert `points` before the next waypoint. The last of `points` is this waypoint.

        The reference must be paused."""
        self._points, self._passed = (*points, *self.ahead[1:]), 0

    def pause(self, on: bool, now: float) -> None:
        """Stop the reference as soon as possible, or let it resume its trajectory."""
        state = self._run(now)
        if on:
            self._passed = self._behind()  # computed before `paused` is set, because a paused reference passes no point
        self.paused = on
        if state is None:
            return
        if on:
            self._pursuit.forget()
            state = MotionState(self._halt(state))
        self._replan(state)

    def advance(self, position: Point, now: float, most: float = 1.0) -> None:
        """Advance the reference to `now`, and set its rate by its distance from the vehicle.

        `most`: upper limit of the rate."""
        since = max(0.0, now - self._time)
        state = self._run(now)
        if state is None:
            return
        behind = distance(position, state.position) / self._leash
        rate = min(1.0, 2.0 - 2.0 * behind, most)
        if most < 1.0 or self._limited:
            rate = min(rate, self._rate + since * FASTER)
        self._limited = rate < min(1.0, 2.0 - 2.0 * behind)
        self._rate = rate if rate > CREEP else 0.0
        if now >= self._pursuit.until > -math.inf:
            self._pursuit.forget()
            self._replan(state)
        short = self._trajectory is not None and self._trajectory.peak < SLOW
        self.alone = self.paused or self.waits or self.stood >= SETTLED or (self.alone and short)

    def at(self, seconds: float) -> MotionState:
        """Return the predicted reference state `seconds` from now. `start` must be called first."""
        assert self._trajectory is not None
        state, turn = self._trajectory.at(self._elapsed + self._rate * seconds), self._pursuit.acceleration
        return MotionState(
            state.position + turn * (self._rate * seconds * seconds / 2),
            (state.velocity + turn * seconds) * self._rate,
        )

    def _halt(self, state: MotionState) -> Point:
        return state.position + state.velocity * min(norm(state.velocity) / (2 * self.limits.acceleration), PAUSE)

    def _run(self, now: float) -> MotionState | None:
        if self._trajectory is None:
            return None
        self._elapsed += self._rate * max(0.0, min(now - self._time, LONGEST_STEP))
        self._time = max(now, self._time)
        return self._trajectory.at(self._elapsed)

    def _behind(self) -> int:
        """Return the number of waypoints that the reference has passed."""
        if self._trajectory is None or self.paused:
            return self._passed
        return min(self._passed + self._trajectory.ahead(self._elapsed), len(self._points))

    def _replan(self, state: MotionState) -> None:
        self._elapsed = 0.0
        if self.paused:
            self._trajectory = standing(state.position)
            return
        self._passed = min(self._passed, len(self._points) - 1)
        ahead = self._points[self._passed :]
        if len(ahead) == 1 and self._pursuit.velocity != ZERO:
            self._trajectory = plan(state, ahead, self.limits, self._pursuit.velocity)
            if self._kept(self._trajectory):
                return
            self._pursuit.forget()
        self._trajectory = plan(state, ahead, self.limits)

    def _kept(self, trajectory: Trajectory) -> bool:
        """Return whether the reference can always brake inside the box while it pursues a moving target.

        The trajectory is checked up to the time when the target counts as standing."""
        seconds = self._pursuit.until - self._time + 0.1
        steps = math.ceil(seconds / 0.1)
        return all(self.limits.safe(trajectory.at(seconds * i / steps)) for i in range(steps + 1))
