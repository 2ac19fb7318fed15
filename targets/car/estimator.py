"""Where the car is between two samples of the position feed: the bicycle runs on, samples pull it back.

A complementary filter: cheap, without a noise model to tune, and the drive's own speed makes it free of lag.
Frame: local ENU; the point is the middle of the rear axle.
"""

from __future__ import annotations

import math
from dataclasses import replace

from koordgen.runtime.values import Pose
from targets.car.bicycle import State, advance, wrap

POSITION_GAIN, YAW_GAIN = 0.3, 0.3  # at the feed's 50 Hz: time constants of about 60 ms
SPEED_SMOOTHING = 0.15  # seconds, when speed has to be taken from positions
JUMP = 0.5  # metres: a sample farther off is believed at once; the filter has been wrong
WHEEL_FRESH = 0.25  # seconds for which a speed of the drive is used


class Estimator:
    """One car's estimate. Times are seconds on the agent's clock."""

    def __init__(self, wheelbase: float) -> None:
        self._wheelbase = wheelbase
        self._state = State(0.0, 0.0, 0.0)
        self._time: float | None = None
        self._wheel: tuple[float, float] | None = None  # speed, when
        self._sample: tuple[Pose, float] | None = None
        self._slope = 0.0  # speed from positions, m/s

    @property
    def state(self) -> State:
        """The estimate: `speed` is measured, `steering` what was commanded."""
        return self._state

    def wheels(self, speed: float, now: float) -> None:
        """Take a speed that the drive reports, m/s."""
        self._wheel = (speed, now)

    def speed(self, now: float) -> float | None:
        """The measured speed, m/s, signed: the drive's, or else from recent positions; None: nobody knows."""
        if self._wheel is not None and now - self._wheel[1] <= WHEEL_FRESH:
            return self._wheel[0]
        if self._sample is not None and now - self._sample[1] <= WHEEL_FRESH:
            return self._slope
        return None

    def predict(self, now: float, steering: float) -> None:
        """Run on to `now`."""
        speed = self.speed(now) or 0.0
        self._state = replace(self._state, speed=speed, steering=steering)
        if self._time is not None and now > self._time:
            self._state = advance(self._state, now - self._time, self._wheelbase)
        self._time = now

    def correct(self, pose: Pose, measured: float, now: float) -> None:
        """Take a pose that was true at `measured`, after predicting to `now`."""
        first = self._sample is None
        self._differentiate(pose, measured)
        state = self._state
        # What was true then is brought to now by the motion since.
        since = State(pose.position.x, pose.position.y, pose.yaw, state.speed, state.steering)
        here = advance(since, max(0.0, now - measured), self._wheelbase)
        dx, dy, turned = here.x - state.x, here.y - state.y, wrap(here.yaw - state.yaw)
        lost = first or math.hypot(dx, dy) > JUMP
        gain, yaw_gain = (1.0, 1.0) if lost else (POSITION_GAIN, YAW_GAIN)
        yaw = wrap(state.yaw + yaw_gain * turned)
        self._state = replace(state, x=state.x + gain * dx, y=state.y + gain * dy, yaw=yaw)
        self._time = now

    def _differentiate(self, pose: Pose, measured: float) -> None:
        if self._sample is not None:
            last, before = self._sample
            seconds = measured - before
            if seconds < 1e-3:
                return
            moved = pose.position - last.position
            along = (moved.x * math.cos(pose.yaw) + moved.y * math.sin(pose.yaw)) / seconds
            share = min(1.0, seconds / SPEED_SMOOTHING)
            self._slope += share * (along - self._slope)
        self._sample = (pose, measured)
