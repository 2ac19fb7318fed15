"""Motor lag: how many seconds the measured speed follows the speed that the motor was asked for, measured in motion.

A motor with a first-order lag obeys lag * dv/dt = asked - v. Integrated over a window: lag * (change of v) is the
integral of (asked - v). The lag is the least-squares solution over the last windows in which the speed changed.
"""

from __future__ import annotations

LONGEST_LAG = 0.5  # seconds: what the speed loop of a rover and the path controller were made for
LATE = 0.25  # seconds more that are measured, because the measured speed is late, too
WINDOW = 0.5  # seconds
GAP = 0.2  # seconds between two samples at most
CHANGE = 0.06  # m/s: windows in which the speed changes by less show its noise
KEPT = 0.95  # of the weight of older windows that each new one leaves them
ENOUGH, FEWEST = 0.05, 4  # (m/s)^2, and windows: the sum of squared changes from which on the estimate counts


class Lag:
    """`seconds` is the lag, None until the speed has changed enough. Speeds in m/s, signed; times in seconds."""

    def __init__(self) -> None:
        self._begin: tuple[float, float] | None = None  # time and speed at the window's begin
        self._last = (0.0, 0.0)  # time and asked - measured of the last sample
        self._error = 0.0  # integral of asked - measured over the window, m
        self._products = self._squares = 0.0
        self._count = 0  # windows in which the speed changed

    @property
    def seconds(self) -> float | None:
        counts = self._count >= FEWEST and self._squares >= ENOUGH
        return max(0.0, self._products / self._squares) if counts else None

    def reset(self) -> None:
        """Begin a new window: the brake, and not the motor, has determined the speed."""
        self._begin = None

    def note(self, asked: float, speed: float | None, now: float) -> None:
        """Take the speed that the motor was asked for and the one measured at the same time; None: nobody knows it."""
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
    """Return whether a measured lag (s) is longer than LONGEST_LAG for certain."""
    return lag > LONGEST_LAG + LATE
