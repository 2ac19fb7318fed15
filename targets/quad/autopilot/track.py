"""Track filter for a position source: estimates the velocity, and rejects samples that jump.

The velocity is that of a critically damped g-h filter, which has no lag at constant velocity (E. Brookner, Tracking and
Kalman Filtering Made Easy, 1998, chapter 1). Frame: local ENU, metres, radians; times are seconds on the agent's clock.
"""

from __future__ import annotations

import math

from koordgen.runtime.values.points import Point, Pose, distance

# Time constant of the filter, seconds. At 50 samples per second, noise of 5 mm in the positions gives 0.024 m/s in the
# velocity, and under acceleration the velocity lags by 0.11 s.
MEMORY = 0.06
# A sample is a jump if its distance from the extrapolated position exceeds SLACK + (maximum speed + GUSTS) * t. Here t
# is the time since the previous sample, accepted or rejected, and WHILE at most. GUSTS allows for wind and falling. The
# limit grows neither in a longer silence nor while samples are rejected; otherwise each jump would be accepted later.
SLACK, WHILE, GUSTS = 0.25, 0.5, 2.0  # SLACK in metres, WHILE in seconds, GUSTS in m/s
YAW_SLACK, YAW_RATE = 0.5, 6.0  # radians, rad/s: a change of yaw of more than YAW_SLACK + YAW_RATE * t is a jump, too


class PositionTrack:
    """Track of a vehicle whose own speed is `max_speed` (m/s) at most.

    `pose`, `velocity` (m/s) and `time` belong to the last accepted sample."""

    def __init__(self, max_speed: float) -> None:
        self._speed = max_speed + GUSTS
        self._last = -math.inf  # time of the last sample, accepted or rejected
        self._refusing: float | None = None  # time of the first rejected sample since the last accepted one
        self._filtered = Point()  # filtered position
        self.pose: Pose | None = None
        self.velocity = Point()
        self.time = -math.inf
        self.jumps = 0  # number of rejected samples

    def add(self, pose: Pose, time: float) -> bool:
        """Process a sample, and return whether it is accepted.

        A sample that is not newer than the last one is ignored, and does not count as a jump."""
        if time <= self._last:
            return False
        since, self._last = time - self._last, time
        if self.pose is not None and self._jumps(self.pose, pose, time, min(since, WHILE)):
            self.jumps += 1
            self._refusing = time if self._refusing is None else self._refusing
            return False
        self._filter(pose.position, time - self.time)
        self.pose, self.time, self._refusing = pose, time, None
        return True

    def _jumps(self, last: Pose, pose: Pose, time: float, seconds: float) -> bool:
        expected = last.position + self.velocity * min(time - self.time, WHILE)
        turned = abs(math.remainder(pose.yaw - last.yaw, math.tau))
        far = distance(pose.position, expected)
        return far > SLACK + self._speed * seconds or turned > YAW_SLACK + YAW_RATE * seconds

    def _filter(self, measured: Point, seconds: float) -> None:
        if self.pose is None:
            self._filtered, self.velocity = measured, Point()
            return
        kept = math.exp(-seconds / MEMORY)
        predicted = self._filtered + self.velocity * seconds
        off = measured - predicted
        self._filtered = predicted + off * (1.0 - kept * kept)
        self.velocity = self.velocity + off * ((1.0 - kept) ** 2 / seconds)

    def refused(self, now: float) -> float:
        """Return for how many seconds all samples have been rejected; 0 if the last sample was accepted."""
        return 0.0 if self._refusing is None else now - self._refusing

    def forget(self) -> None:
        """Accept the next sample at any place, because the vehicle was carried to another place."""
        self.pose, self._refusing = None, None

    def at(self, time: float) -> Point | None:
        """Return the position extrapolated to `time`, by WHILE seconds at most; None before the first sample."""
        if self.pose is None:
            return None
        return self.pose.position + self.velocity * max(-WHILE, min(WHILE, time - self.time))
