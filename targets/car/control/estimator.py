"""Pose estimator of the car: the bicycle model predicts, samples of the position source correct.

It is a complementary filter: cheap, and without a noise model to tune. The prediction uses the speed that the drive
measures, so the estimate has no lag. A sample that jumps, that is, moves farther than any motion explains, is rejected.
Frame: local ENU. The estimated position is that of the middle of the rear axle.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from koordgen.runtime.values.points import Pose
from targets.car.base.bicycle import BicycleState, advance, turning_radius, wrap

SMOOTHING = 0.056  # seconds, time constant of the correction of position and yaw: a gain of 0.3 at a feed's 50 Hz

# Seconds of positions from which the speed is estimated by a line fit if the drive measures none. At 50 Hz, a noise of
# 5 mm in the positions gives a noise of 0.014 m/s in the speed, so a standing car is seen to stand. The speed is late
# by half of this time.
SPEED_WINDOW = 0.3
# A sample is a jump if it is farther from the prediction than JUMP + (speed limit + SLIDE) * t, or its yaw differs by
# more than YAW_JUMP + (limit of the yaw rate + SPIN) * t. In both, t is the time since the last accepted sample, at
# most WHILE. SLIDE and SPIN allow for a car that slides or is pushed.
JUMP, YAW_JUMP = 0.3, 0.5  # metres, radians
SLIDE, SPIN = 1.0, 2.0  # m/s, rad/s
WHILE = 0.5  # seconds; longest time that counts in these limits
WHEEL_FRESH = 0.25  # seconds for which a measured speed counts as current


class Estimator:
    """Pose and speed estimator of one car. Times are seconds on the agent's clock.

    `speed_limit`, `steering_limit`: largest commanded speed (m/s) and steering angle (rad).
    `time`: time of measurement of the last accepted sample; None before the first."""

    def __init__(self, wheelbase: float, speed_limit: float = 1.0, steering_limit: float = 0.4) -> None:
        self._wheelbase = wheelbase
        self._speed_limit = speed_limit
        self._turning_limit = speed_limit / turning_radius(steering_limit, wheelbase)
        self._state = BicycleState(0.0, 0.0, 0.0)
        self._predicted: float | None = None
        self._wheel: tuple[float, float] | None = None  # last measured speed (m/s) and its time
        self._sample: tuple[Pose, float] | None = None  # last accepted sample, and the time of its measurement

        # For each recent sample: its time, and the distance (m) driven along the heading until then.
        self._distances: deque[tuple[float, float]] = deque()
        self._slope = 0.0  # speed estimated from positions, m/s
        self._refusing: float | None = None  # time of the first jump since the last accepted sample
        self._anew = False  # whether the next sample is accepted wherever it is
        self.jumped = 0.0  # metres between the last sample checked for a jump and the prediction
        self.time: float | None = None

    @property
    def state(self) -> BicycleState:
        """Present estimate of the car's state; its `speed` is measured, its `steering` is the commanded angle."""
        return self._state

    def wheels(self, speed: float, now: float) -> None:
        """Process a speed (m/s) that the drive has measured."""
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
        """Predict the state at `now` with the bicycle model."""
        speed = self.speed(now) or 0.0
        self._state = replace(self._state, speed=speed, steering=steering)
        if self._predicted is not None and now > self._predicted:
            self._state = advance(self._state, now - self._predicted, self._wheelbase)
        self._predicted = now

    def correct(self, pose: Pose, measured: float, now: float) -> bool:
        """Correct the estimate by a finite pose measured at time `measured`, after `predict` to `now`.

        Return False if the pose is rejected as a jump."""
        state = self._state
        # Extrapolate the measured pose by the motion since its measurement.
        since = BicycleState(pose.position.x, pose.position.y, pose.yaw, state.speed, state.steering)
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
        """Return for how many seconds all samples have been rejected as jumps; 0 if the last one was accepted."""
        return 0.0 if self._refusing is None else max(0.0, now - self._refusing)

    def begin_anew(self) -> None:
        """Accept the next sample wherever it is, because the car was carried there."""
        self._sample = self._refusing = None
        self._distances.clear()
        self._slope, self._anew = 0.0, True

    def _differentiate(self, pose: Pose, measured: float) -> None:
        """Estimate the speed by a least-squares line through the driven distances of the last SPEED_WINDOW seconds."""
        way = 0.0
        if self._sample is not None:
            last, before = self._sample
            if measured - before < 1e-3:
                return
            moved = pose.position - last.position
            way = moved.x * math.cos(pose.yaw) + moved.y * math.sin(pose.yaw)
            way += self._distances[-1][1] if self._distances else 0.0
        self._sample = (pose, measured)
        self._distances.append((measured, way))
        while measured - self._distances[0][0] > SPEED_WINDOW:
            self._distances.popleft()
        middle = sum(time for time, _ in self._distances) / len(self._distances)
        spread = sum((time - middle) ** 2 for time, _ in self._distances)
        self._slope = sum((time - middle) * gone for time, gone in self._distances) / spread if spread > 1e-6 else 0.0
