"""Follows a planned path: where on it the car is, how fast it may go there, and what the MPC shall aim at.

A path is driven segment by segment; at the end of each the car stands before the next one, in the other gear, begins.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise

from targets.car.base.bicycle import State, wrap
from targets.car.control.mpc import STEP, STEPS, Command, Limits, Mpc
from targets.car.planning.planner import Segment

LATERAL = 0.6  # of the acceleration limit may be used sideways on a curve
BRAKING = 0.6  # ... and for braking: the rest is for errors
APPROACH = 3.0  # 1/s: speed over distance in the last centimetres to a stop, or a lagging drive overshoots
SHORT = 0.05  # metres kept to what is in the way, for the lag of motor and brake
NEAR = 0.02  # metres before its end at which a segment counts as driven, when the car is
SLOW = 0.05  # m/s or slower
LOOK_BACK, LOOK_AHEAD = 0.2, 0.6  # metres around the last place in which the present one is looked for


class Track:
    """One segment, its stations (metres from its begin) and its speed profile (m/s, unsigned)."""

    def __init__(self, segment: Segment, limits: Limits) -> None:
        self.segment = segment
        self._limits = limits
        poses = segment.poses
        self._stations = [0.0]
        for a, b in pairwise(poses):
            self._stations.append(self._stations[-1] + math.hypot(b.x - a.x, b.y - a.y))
        # Squares of speeds: under constant braking they fall linearly along the way.
        self._squares = [limits.speed**2] * len(poses)
        for i, pose in enumerate(poses):
            if abs(pose.curvature) > 1e-6:
                self._squares[i] = min(self._squares[i], LATERAL * limits.acceleration / abs(pose.curvature))
        self._squares[-1] = 0.0
        for i in range(len(poses) - 2, -1, -1):
            way = self._stations[i + 1] - self._stations[i]
            braking = self._squares[i + 1] + 2 * BRAKING * limits.acceleration * way
            self._squares[i] = min(self._squares[i], braking)
        self.station = 0.0
        self.error = 0.0  # metres from the path

    @property
    def length(self) -> float:
        return self._stations[-1]

    def locate(self, state: State) -> None:
        """Find the car's place on the path, near the last one: a path may cross itself."""
        lo, hi = self.station - LOOK_BACK, self.station + LOOK_AHEAD
        best, self.error = self.station, math.inf
        poses = self.segment.poses
        for i, (a, b) in enumerate(pairwise(poses)):
            begin, end = self._stations[i], self._stations[i + 1]
            if end < lo or begin > hi:
                continue
            dx, dy = b.x - a.x, b.y - a.y
            along = ((state.x - a.x) * dx + (state.y - a.y) * dy) / max(dx * dx + dy * dy, 1e-12)
            along = max(0.0, min(1.0, along))
            away = math.hypot(state.x - a.x - along * dx, state.y - a.y - along * dy)
            if away < self.error:
                best, self.error = begin + along * (end - begin), away
        self.station = best

    def reference(self, speed: float, yaw: float, clear: float = math.inf) -> list[State]:
        """The states to be in after 1 to 20 steps, gathering speed from `speed` (m/s, signed) as the limits allow, and
        losing it so as to stand before `clear` metres on (a NaN is 0). Yaw runs on from the car's own."""
        station, halt = self.station, min(self.length, self.station + max(0.0, clear - SHORT))
        direction = self.segment.direction
        pace = max(0.0, direction * speed)
        wished = []
        for _ in range(STEPS):
            pace = min(pace + self._limits.acceleration * STEP, self._allowed(station))
            rest = max(0.0, halt - station)
            pace = min(pace, APPROACH * rest, math.sqrt(2 * BRAKING * self._limits.acceleration * rest))
            station += pace * STEP
            wished.append(self._state(station, direction * pace, yaw))
        return wished

    def _allowed(self, station: float) -> float:
        i, share = self._place(station)
        return math.sqrt(self._squares[i] + share * (self._squares[i + 1] - self._squares[i]))

    def _state(self, station: float, speed: float, yaw: float) -> State:
        i, share = self._place(station)
        a, b = self.segment.poses[i], self.segment.poses[i + 1]
        turned = a.yaw + share * (b.yaw - a.yaw)
        return State(
            a.x + share * (b.x - a.x),
            a.y + share * (b.y - a.y),
            yaw + wrap(turned - yaw),
            speed,
            math.atan(self._limits.wheelbase * b.curvature),
        )

    def _place(self, station: float) -> tuple[int, float]:
        i = min(max(bisect_right(self._stations, station) - 1, 0), len(self._stations) - 2)
        begin, end = self._stations[i], self._stations[i + 1]
        return i, max(0.0, min(1.0, (station - begin) / max(end - begin, 1e-9)))


class Tracker:
    """Drives along paths with one MPC; `done` when the last segment of the present path has been driven, `error` the
    distance (m) from it."""

    def __init__(self, limits: Limits, mpc: Mpc) -> None:
        self._limits = limits
        self._mpc = mpc
        self._tracks: list[Track] = []
        self._driven = 0.0  # metres of the path in the segments that are behind the car
        self.done = True

    def take(self, path: Sequence[Segment]) -> None:
        """Follow this path from now on. The MPC keeps its plan: a path made anew on the way begins like the old one."""
        self._tracks = [Track(segment, self._limits) for segment in path]
        self._driven = 0.0
        self.done = not self._tracks

    def stop(self) -> None:
        """Forget path and plan: the car is being braked."""
        self._tracks = []
        self._mpc.reset()
        self.done = True

    @property
    def gear(self) -> int:
        """The direction of the segment being driven; 0: none is."""
        return self._tracks[0].segment.direction if self._tracks and not self.done else 0

    @property
    def last_stretch(self) -> bool:
        """Return whether the segment that ends the path is being driven."""
        return len(self._tracks) == 1 and not self.done

    @property
    def error(self) -> float:
        return self._tracks[0].error if self._tracks else 0.0

    @property
    def station(self) -> float:
        """How many metres of the path have been driven."""
        return self._driven + (self._tracks[0].station if self._tracks else 0.0)

    @property
    def failures(self) -> int:
        """How many control steps in a row had no new plan."""
        return self._mpc.failures

    @property
    def trouble(self) -> str:
        """Why the last step had no new plan, in words; "" when it had."""
        return self._mpc.trouble

    def step(self, state: State, clear: float = math.inf) -> Command:
        """The command of the next step; only while not `done`. Speed and steering are those last commanded. `clear` is
        how many metres of the path, from the car's reference point on, are free: it slows down so as to stand before
        they end, and goes on when there are more."""
        track = self._tracks[0]
        track.locate(state)
        if track.length - track.station < NEAR and abs(state.speed) < SLOW:
            if len(self._tracks) > 1:
                self._driven += self._tracks.pop(0).length
                track = self._tracks[0]
                track.locate(state)
            else:
                self.done = True
        return self._mpc.follow(state, track.reference(state.speed, state.yaw, clear))
