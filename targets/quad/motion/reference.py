"""The reference: the state that the vehicle is to have now and shortly, as targets, pauses and the vehicle itself
change.

It runs along a trajectory by the clock, slower when the vehicle falls behind, and stands when that is a leash away. A
target that is commanded anew again and again is taken to go on as it went, and is accompanied instead of being stopped
at each time; when nothing new has come of it for a while, the reference returns to where it was last.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise

from koordgen.runtime.values.points import Point, distance
from koordgen.runtime.vehicle.safety import clamp
from targets.planning.world import Path
from targets.quad.motion.trajectory import ZERO, Limits, State, Trajectory, norm, plan, standing

LEASH_TIME, LEASH_LENGTH = 0.5, 0.5  # s, m: the leash is LEASH_LENGTH + LEASH_TIME * speed
LONGEST_STEP = 0.5  # s; the reference runs on by no more than that at once
CREEP = 0.05  # of its rate, below which it stands
FASTER = 1.0  # 1/s, by which the rate grows again after the trajectory was slowed
PAUSE = 0.5  # s of running on at most when it is paused: as far as an autopilot needs to brake
STANDING = 0.25  # m/s, above what a hovering vehicle's estimate shows
WINDOW = 0.4  # s of a target's last places from which its way is told
# What is slower, or goes to and fro, is the noise of measured places and no motion: m/s, and the share of what its
# steps add up to by which it must have come further.
PACE, STRAIGHT = 0.1, 0.7
SLOW = 0.1  # m/s; a way that is never faster, a centimetre, is no motion
SETTLED = 0.5  # s that the vehicle may need to stand, after the reference
RHYTHM = 0.6  # s between two targets at most for the second to be the first one's motion


class Pursuit:
    """Where a target is going, from its last places: the parabola through the first, the middle and the last of
    them."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._seen: deque[tuple[float, Point]] = deque(maxlen=64)
        self.forget()

    def forget(self) -> None:
        """It stands."""
        self._seen.clear()
        self.velocity = self.acceleration = ZERO
        self.until = -math.inf  # when it counts as standing unless something new has come

    def note(self, target: Point, now: float) -> None:
        """It is here now, and was not before."""
        if self._seen:
            last, place = self._seen[-1]
            # A tenth of a second more: rounds are not that regular.
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
    """Points must be finite and within the limits' box; times in seconds of any clock."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._leash = LEASH_LENGTH + LEASH_TIME * limits.speed
        self._pursuit = Pursuit(limits)
        self._points: tuple[Point, ...] = ()
        self._passed = 0  # of the points, when the trajectory was planned
        self._trajectory: Trajectory | None = None
        self._elapsed = 0.0  # of the trajectory's time
        self._rate = 1.0  # of its time to ours
        self._time = 0.0
        self._slowed = False  # by `most`, which the rate leaves slowly
        self.paused = False
        self.alone = True  # whether a position says all: it is at rest, to hold, or waits

    @property
    def started(self) -> bool:
        return self._trajectory is not None

    @property
    def final(self) -> bool:
        """Return whether only the last waypoint is ahead."""
        return self._behind() >= len(self._points) - 1

    @property
    def ahead(self) -> tuple[Point, ...]:
        """The points that are not behind; the last one stays. None before the first command or start."""
        return self._points[min(self._behind(), len(self._points) - 1) :] if self._points else ()

    @property
    def stood(self) -> float:
        """For how many seconds it has stood, and will unless something new comes; negative while it moves."""
        trajectory = self._trajectory
        if trajectory is None or trajectory.peak == 0.0:
            return math.inf
        return -math.inf if trajectory.end.velocity != ZERO else self._elapsed - trajectory.seconds

    @property
    def rate(self) -> float:
        """Of its time to ours."""
        return self._rate

    @property
    def waits(self) -> bool:
        """Return whether the vehicle is too far from the reference for it to move."""
        return self._rate == 0.0

    def start(self, position: Point, velocity: Point, now: float) -> None:
        """From where the vehicle is and as it moves, towards what is ahead; where nothing is, or paused, to a stop."""
        at = clamp(self.limits.box, position)
        climb = velocity.z if at.z == position.z else 0.0  # below the box, as when a climb ends, it comes up by itself
        state = State(at, self.limits.limited(Point(velocity.x, velocity.y, climb)))
        if norm(state.velocity) < STANDING or not self.limits.safe(state):
            state = State(state.position)
        self._time, self._rate = now, 1.0
        self._points = self._points or (self.limits.stop(state),)
        self._replan(State(self._halt(state)) if self.paused else state)

    def drop(self, now: float) -> Point | None:
        """The vehicle goes its own ways; `start` begins anew. Where it would have stood if it had been paused
        instead."""
        state = self._run(now)
        self._passed, self._trajectory = self._behind(), None
        self._pursuit.forget()
        return None if state is None else self._halt(state)

    @property
    def trajectory(self) -> Trajectory | None:
        """The present trajectory; each new command replaces it by another object."""
        return self._trajectory

    def way(self) -> Path:
        """Return places ahead on the trajectory, which is near to the straight lines between them: see
        `Trajectory.chords`. A target in motion is accompanied until it counts as standing. Only when it was started."""
        trajectory = self._trajectory
        assert trajectory is not None
        way = trajectory.chords(self._elapsed)
        if trajectory.end.velocity != ZERO:
            until = self._elapsed + self._pursuit.until - self._time
            way.append(trajectory.at(max(trajectory.seconds, until)).position)
        return tuple(way)

    def follow(self, points: tuple[Point, ...], now: float) -> None:
        """Go by these points from now on; none: stop."""
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
        """Go by these points, the last of which is the next one ahead, and then on as before. Only while paused."""
        self._points, self._passed = (*points, *self.ahead[1:]), 0

    def pause(self, on: bool, now: float) -> None:
        """Stand as soon as can be, or go on."""
        state = self._run(now)
        if on:
            self._passed = self._behind()  # before `paused` is set: a paused reference passes no point
        self.paused = on
        if state is None:
            return
        if on:
            self._pursuit.forget()
            state = State(self._halt(state))
        self._replan(state)

    def advance(self, position: Point, now: float, most: float = 1.0) -> None:
        """The vehicle is there now. The trajectory runs on at `most` times its own pace, at most."""
        since = max(0.0, now - self._time)
        state = self._run(now)
        if state is None:
            return
        behind = distance(position, state.position) / self._leash
        rate = min(1.0, 2.0 - 2.0 * behind, most)
        if most < 1.0 or self._slowed:
            rate = min(rate, self._rate + since * FASTER)
        self._slowed = rate < min(1.0, 2.0 - 2.0 * behind)
        self._rate = rate if rate > CREEP else 0.0
        if now >= self._pursuit.until > -math.inf:
            self._pursuit.forget()
            self._replan(state)
        short = self._trajectory is not None and self._trajectory.peak < SLOW
        self.alone = self.paused or self.waits or self.stood >= SETTLED or (self.alone and short)

    def at(self, seconds: float) -> State:
        """Return the predicted state after this many seconds. Only after the start."""
        assert self._trajectory is not None
        state, turn = self._trajectory.at(self._elapsed + self._rate * seconds), self._pursuit.acceleration
        return State(
            state.position + turn * (self._rate * seconds * seconds / 2),
            (state.velocity + turn * seconds) * self._rate,
        )

    def _halt(self, state: State) -> Point:
        return state.position + state.velocity * min(norm(state.velocity) / (2 * self.limits.acceleration), PAUSE)

    def _run(self, now: float) -> State | None:
        if self._trajectory is None:
            return None
        self._elapsed += self._rate * max(0.0, min(now - self._time, LONGEST_STEP))
        self._time = max(now, self._time)
        return self._trajectory.at(self._elapsed)

    def _behind(self) -> int:
        """Return the number of passed points."""
        if self._trajectory is None or self.paused:
            return self._passed
        return min(self._passed + self._trajectory.ahead(self._elapsed), len(self._points))

    def _replan(self, state: State) -> None:
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
        """Return whether it can be braked within the box as long as it may be followed without anything new."""
        seconds = self._pursuit.until - self._time + 0.1
        steps = math.ceil(seconds / 0.1)
        return all(self.limits.safe(trajectory.at(seconds * i / steps)) for i in range(steps + 1))
