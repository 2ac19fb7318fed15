"""From speeds and angles to a rover's sticks: a speed loop of our own, and RC channels with their dead zones."""

from __future__ import annotations

import math

NEUTRAL, SPAN, DEAD_ZONE = 1500, 500, 30  # microseconds: a channel's middle, half its range, what counts as the middle
# Of the throttle, times the speed at full throttle: for an error in m/s, and for its integral. A car follows its
# throttle with some tenths of a second; this closes the loop without an overshoot for lags of up to lag.LONGEST_LAG.
_PROPORTIONAL, _INTEGRAL = 0.5, 1.0
_MOST = 0.3  # of the throttle, that the integral may add


class SpeedLoop:
    """Throttle (-1 to 1) for a speed; `full` is the speed in m/s at full throttle. What the vehicle should need is fed
    forward; the measured speed mends the rest."""

    def __init__(self, full: float) -> None:
        self._full = full
        self._integral = 0.0

    def reset(self) -> None:
        """Neutral was commanded: begin anew."""
        self._integral = 0.0

    def throttle(self, wanted: float, speed: float | None, seconds: float) -> float:
        """For the next step; `speed` is measured, None: nobody knows. Raises ValueError for what is not finite."""
        if not math.isfinite(wanted):
            raise ValueError(f"not a speed: {wanted}")
        share = wanted / self._full
        error = 0.0 if speed is None else wanted - speed
        asked = share + _PROPORTIONAL * error / self._full + self._integral
        if abs(asked) < 1.0 or asked * error < 0.0:  # at its end the integral would only wind up
            self._integral += _INTEGRAL * error / self._full * seconds
            self._integral = max(-_MOST, min(_MOST, self._integral))
        return max(-1.0, min(1.0, asked))


def channel(share: float) -> int:
    """The RC value (microseconds) for a share (-1 to 1) of a channel's range beyond its dead zone: ArduPilot takes
    (value - 1530) / (2000 - 1530) for it, and the same below the middle (RC_Channel::pwm_to_angle_dz)."""
    if not math.isfinite(share):
        raise ValueError(f"not a share: {share}")
    steps = round(max(-1.0, min(1.0, share)) * (SPAN - DEAD_ZONE))
    return NEUTRAL + steps + (DEAD_ZONE if steps > 0 else -DEAD_ZONE if steps < 0 else 0)
