"""Path tracking: locates the car on a planned path, and computes the speed profile and the MPC's reference states.

A path is driven segment by segment. At the end of each segment the car stops before it starts the next one, in the
other gear.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise

from targets.car.base.bicycle import BicycleState, wrap
from targets.car.control.mpc import STEP, STEPS, Command, ControlLimits, Mpc
from targets.car.planning.planner import Segment

LATERAL = 0.6  # share of the acceleration limit that the profile uses for lateral acceleration in a curve
BRAKING = 0.6  # share of the acceleration limit that the profile uses for braking; the rest is for correcting errors
APPROACH = 3.0  # 1/s; before a stop, speed <= APPROACH * remaining distance, else a lagging drive overshoots
SHORT = 0.05  # metres by which the car stops short of an obstruction, because motor and brake lag
NEAR = 0.02  # metres: a segment is complete if less than this is left of it, and the car is slower than SLOW
SLOW = 0.05  # m/s
LOOK_BACK, LOOK_AHEAD = 0.2, 0.6  # metres behind and ahead of the last station: search range for the present station


class TrackedPath:
    """Path segment with a speed profile (m/s, unsigned) over its stations (arc lengths from the start, m).

    `station`: the car's present station (m). `error`: the car's distance from the segment (m)."""

    def __init__(self, segment: Segment, limits: ControlLimits) -> None:
        self.segment = segment
        self._limits = limits
        poses = segment.poses
        self._stations = [0.0]
        for a, b in pairwise(poses):
            self._stations.append(self._stations[-1] + math.hypot(b.x - a.x, b.y - a.y))
        # Squares of the speeds are stored, because under constant braking they fall linearly along the path.
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
        self.error = 0.0

    @property
    def length(self) -> float:
        return self._stations[-1]

    def locate(self, state: BicycleState) -> None:
        """Update the car's station. The search covers only places near the last station: a path may cross itself."""
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

    def reference(self, speed: float, yaw: float, clear: float = math.inf) -> list[BicycleState]:
        """Return the MPC's reference: the desired states after 1 to 20 steps.

        The speed starts at `speed` (m/s, signed), grows as the limits allow, and falls so that the car stops less than
        `clear` metres beyond its present station (NaN counts as 0). Yaw is continuous with `yaw`, the car's yaw."""
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

    def _state(self, station: float, speed: float, yaw: float) -> BicycleState:
        i, share = self._place(station)
        a, b = self.segment.poses[i], self.segment.poses[i + 1]
        turned = a.yaw + share * (b.yaw - a.yaw)
        return BicycleState(
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
    """Path tracker with one MPC.

    `done`: the last segment of the present path is complete. `error`: the car's distance from the path, m."""

    def __init__(self, limits: ControlLimits, mpc: Mpc) -> None:
        self._limits = limits
        self._mpc = mpc
        self._tracks: list[TrackedPath] = []
        self._driven = 0.0  # total length (m) of the completed segments
        self.done = True

    def set_path(self, path: Sequence[Segment]) -> None:
        """Replace the path to be followed.

        The MPC keeps its plan, because a path that is replanned while the car drives begins like the old path."""
        self._tracks = [TrackedPath(segment, self._limits) for segment in path]
        self._driven = 0.0
        self.done = not self._tracks

    def stop(self) -> None:
        """Drop the path and the MPC's plan, because the car is being braked."""
        self._tracks = []
        self._mpc.reset()
        self.done = True

    @property
    def gear(self) -> int:
        """Direction of the segment being driven: 1 forward, -1 reverse, 0 if there is none."""
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
        """Metres of the path that have been driven."""
        return self._driven + (self._tracks[0].station if self._tracks else 0.0)

    @property
    def failures(self) -> int:
        """Number of successive control steps for which the MPC had no new plan."""
        return self._mpc.failures

    @property
    def trouble(self) -> str:
        """Reason why the MPC had no new plan in the last step, in words; "" if it had one."""
        return self._mpc.trouble

    def step(self, state: BicycleState, clear: float = math.inf) -> Command:
        """Return the command of the next control step. The caller must not call it once `done`.

        `state`: pose of the car, with the speed and steering commanded last.
        `clear`: metres of the path ahead of the car's reference point that are free. The car slows down so that it
        stands before the free stretch ends, and drives on when this stretch grows."""
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
