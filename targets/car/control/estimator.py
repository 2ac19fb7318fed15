"""Where the car is between two samples of its position source: the bicycle runs on, samples pull it back.

A complementary filter: cheap, without a noise model to tune, and the drive's own speed makes it free of lag. Samples
that no motion explains are refused. Frame: local ENU; the point is the middle of the rear axle.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from koordgen.runtime.values.points import Pose
from targets.car.base.bicycle import State, advance, turning_radius, wrap

SMOOTHING = 0.056  # seconds, the time constant of place and heading: a gain of 0.3 at a feed's 50 Hz
# Seconds of positions through which a line is laid when speed has to be taken from them: at 50 Hz and a noise of 5 mm
# the slope's is 0.014 m/s, and a car that stands is seen to stand; it is late by half of them.
SPEED_WINDOW = 0.3
# A sample is a jump when it is farther from where the car should be than these, and what a car that slides or is
# pushed goes and turns in the time since the last believed one. Of a silence no more than WHILE counts.
JUMP, YAW_JUMP = 0.3, 0.5  # metres, radians
SLIDE, SPIN = 1.0, 2.0  # m/s, rad/s
WHILE = 0.5  # seconds
WHEEL_FRESH = 0.25  # seconds for which a speed of the drive is used


class Estimator:
    """One car's estimate; at most `speed_limit` m/s and `steering_limit` radians are driven. Times are seconds on the
    agent's clock. `time` is when the last believed sample was true, None: there has been none."""

    def __init__(self, wheelbase: float, speed_limit: float = 1.0, steering_limit: float = 0.4) -> None:
        self._wheelbase = wheelbase
        self._speed_limit = speed_limit
        self._turning_limit = speed_limit / turning_radius(steering_limit, wheelbase)
        self._state = State(0.0, 0.0, 0.0)
        self._predicted: float | None = None
        self._wheel: tuple[float, float] | None = None  # speed, when
        self._sample: tuple[Pose, float] | None = None
        self._ways: deque[tuple[float, float]] = deque()  # times, and how far it had gone along its heading by then
        self._slope = 0.0  # speed from positions, m/s
        self._refusing: float | None = None  # when the first of the present row of jumps was true
        self._anew = False
        self.jumped = 0.0  # metres that the last refused sample was off
        self.time: float | None = None

    @property
    def state(self) -> State:
        """The estimate: `speed` is measured, `steering` what was commanded."""
        return self._state

    def wheels(self, speed: float, now: float) -> None:
        """Take a speed that the drive reports, m/s."""
        if math.isfinite(speed):
            self._wheel = (speed, now)

    def speed(self, now: float) -> float | None:
        """Return the signed speed, m/s, measured by the drive or from recent positions; None if unknown."""
        if self._wheel is not None and now - self._wheel[1] <= WHEEL_FRESH:
            return self._wheel[0]
        if self._sample is not None and now - self._sample[1] <= WHEEL_FRESH:
            return self._slope
        return None

    def predict(self, now: float, steering: float) -> None:
        """Run on to `now`."""
        speed = self.speed(now) or 0.0
        self._state = replace(self._state, speed=speed, steering=steering)
        if self._predicted is not None and now > self._predicted:
            self._state = advance(self._state, now - self._predicted, self._wheelbase)
        self._predicted = now

    def correct(self, pose: Pose, measured: float, now: float) -> bool:
        """Take a finite pose that was true at `measured`, after predicting to `now`; False: it is a jump, and
        refused."""
        state = self._state
        # What was true then is brought to now by the motion since.
        since = State(pose.position.x, pose.position.y, pose.yaw, state.speed, state.steering)
        here = advance(since, max(0.0, now - measured), self._wheelbase)
        dx, dy, turned = here.x - state.x, here.y - state.y, wrap(here.yaw - state.yaw)
        seconds = math.inf if self.time is None or self._anew else max(0.0, measured - self.time)
        if seconds < math.inf and self._is_jump(math.hypot(dx, dy), turned, seconds):
            self._refusing = measured if self._refusing is None else self._refusing
            return False
        self._refusing, self.time, self._anew = None, measured, False
        self._differentiate(pose, measured)
        gain = 1.0 - math.exp(-seconds / SMOOTHING)
        yaw = wrap(state.yaw + gain * turned)
        self._state = replace(state, x=state.x + gain * dx, y=state.y + gain * dy, yaw=yaw)
        self._predicted = now
        return True

    def _is_jump(self, off: float, turned: float, seconds: float) -> bool:
        seconds = min(seconds, WHILE)
        self.jumped = off
        far = off > JUMP + (self._speed_limit + SLIDE) * seconds
        return far or abs(turned) > YAW_JUMP + (self._turning_limit + SPIN) * seconds

    def refused(self, now: float) -> float:
        """For how many seconds nothing but jumps has come; 0 while samples are believed."""
        return 0.0 if self._refusing is None else max(0.0, now - self._refusing)

    def begin_anew(self) -> None:
        """Believe the next sample, wherever it is: the car was carried there."""
        self._sample = self._refusing = None
        self._ways.clear()
        self._slope, self._anew = 0.0, True

    def _differentiate(self, pose: Pose, measured: float) -> None:
        """Lay a line through the ways of the last moments (least squares)."""
        way = 0.0
        if self._sample is not None:
            last, before = self._sample
            if measured - before < 1e-3:
                return
            moved = pose.position - last.position
            way = moved.x * math.cos(pose.yaw) + moved.y * math.sin(pose.yaw)
            way += self._ways[-1][1] if self._ways else 0.0
        self._sample = (pose, measured)
        self._ways.append((measured, way))
        while measured - self._ways[0][0] > SPEED_WINDOW:
            self._ways.popleft()
        middle = sum(time for time, _ in self._ways) / len(self._ways)
        spread = sum((time - middle) ** 2 for time, _ in self._ways)
        self._slope = sum((time - middle) * gone for time, gone in self._ways) / spread if spread > 1e-6 else 0.0
