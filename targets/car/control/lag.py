"""Estimator of the motor's lag: the time (s) by which the measured speed follows the commanded speed.

A motor with a first-order lag obeys lag * dv/dt = asked - v, where v is the speed and `asked` the commanded speed.
Integrated over a window, lag * (change of v) is the integral of (asked - v). The estimate is the least-squares solution
over the last windows in which the speed changed.
"""

from __future__ import annotations

LONGEST_LAG = 0.5  # seconds; longest lag for which a rover's speed loop and the path controller are designed
LATE = 0.25  # seconds by which the estimate may exceed the true lag, because the measured speed itself arrives late
WINDOW = 0.5  # length of a window, in seconds
GAP = 0.2  # maximum time between two samples of a window, in seconds
CHANGE = 0.06  # m/s; windows with a smaller change of speed are ignored, because they show noise
KEPT = 0.95  # factor by which each new window reduces the weight of the older ones

# The estimate is valid if the weighted sum of squared changes of speed is at least ENOUGH, (m/s)^2, from FEWEST windows
# or more.
ENOUGH, FEWEST = 0.05, 4


class Lag:
    """Lag estimator. `seconds`: the lag, None until the speed has changed enough.

    Speeds in m/s, signed; times in seconds."""

    def __init__(self) -> None:
        self._begin: tuple[float, float] | None = None  # time (s) and speed (m/s) at the start of the window
        self._last = (0.0, 0.0)  # last sample: time (s), commanded minus measured speed (m/s)
        self._error = 0.0  # integral of commanded minus measured speed over the window, m
        self._products = self._squares = 0.0
        self._count = 0  # number of windows in which the speed changed enough

    @property
    def seconds(self) -> float | None:
        counts = self._count >= FEWEST and self._squares >= ENOUGH
        return max(0.0, self._products / self._squares) if counts else None

    def reset(self) -> None:
        """Begin a new window, because the brake, and not the motor, has determined the speed."""
        self._begin = None

    def note(self, asked: float, speed: float | None, now: float) -> None:
        """Add a sample: the speed commanded to the motor, and the speed measured at the same time (None if unknown)."""
        if speed is None or self._begin is None or not 0.0 < now - self._last[0] <= GAP:
            self._begin = None if speed is None else (now, speed)
            self._last, self._error = (now, 0.0 if speed is None else asked - speed), 0.0
            return
        then, error = self._last
        self._last = now, asked - speed
        self._error += (error + asked - speed) / 2 * (now - then)
        began, before = self._begin
        if now - began < WINDOW:
            return
        change = speed - before
        if abs(change) >= CHANGE:
            self._products = KEPT * self._products + self._error * change
            self._squares = KEPT * self._squares + change * change
            self._count += 1
        self._begin, self._error = (now, speed), 0.0


def is_long(lag: float) -> bool:
    """Return whether an estimated lag (s) is certainly longer than LONGEST_LAG, despite the estimate's error."""
    return lag > LONGEST_LAG + LATE
