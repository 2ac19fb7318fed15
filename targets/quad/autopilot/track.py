"""A position source's samples as one motion: velocity from them, and what is no motion, a jump, refused.

Velocity is that of a critically damped g-h filter, free of lag at constant velocity (E. Brookner, Tracking and Kalman
Filtering Made Easy, 1998, chapter 1). Frame: local ENU, metres, radians; times are seconds on the agent's clock.
"""

from __future__ import annotations

import math

from koordgen.runtime.values.points import Point, Pose, distance

MEMORY = 0.06  # seconds; at 50 samples a second, noise of 5 mm becomes 0.024 m/s, and an acceleration lags by 0.11 s
# A sample is a jump when it is farther than SLACK, and what a vehicle is blown or falls in the time since the sample
# before (a jump itself, perhaps), from where the motion so far leads. Of a silence no more than WHILE counts, nor does
# the time that nothing but jumps has come: or each of them would be believed in the end.
SLACK, WHILE, GUSTS = 0.25, 0.5, 2.0  # metres, seconds, m/s
YAW_SLACK, YAW_RATE = 0.5, 6.0  # radians, rad/s


class Track:
    """Takes samples of a vehicle that flies at most `max_speed` (m/s) by itself. `pose`, `velocity` (m/s) and `time`
    are of the last sample that was believed."""

    def __init__(self, max_speed: float) -> None:
        self._speed = max_speed + GUSTS
        self._last = -math.inf  # when the last sample was, believed or not
        self._refusing: float | None = None  # since when nothing but jumps has come
        self._filtered = Point()
        self.pose: Pose | None = None
        self.velocity = Point()
        self.time = -math.inf
        self.jumps = 0  # samples refused

    def take(self, pose: Pose, time: float) -> bool:
        """Return whether the sample is accepted. One not newer than the last is neither accepted nor a jump."""
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
        """For how many seconds nothing but jumps has come."""
        return 0.0 if self._refusing is None else now - self._refusing

    def forget(self) -> None:
        """The next sample is believed, wherever it is: the vehicle was carried there."""
        self.pose, self._refusing = None, None

    def at(self, time: float) -> Point | None:
        """Return the extrapolated position, within WHILE seconds of the last sample."""
        if self.pose is None:
            return None
        return self.pose.position + self.velocity * max(-WHILE, min(WHILE, time - self.time))
