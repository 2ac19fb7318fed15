"""Speed control of a rover by its throttle, and conversion of throttle and steering to RC channel values."""

from __future__ import annotations

import math

# Microseconds of an RC channel: its middle, half of its range, and the dead zone to either side of the middle.
NEUTRAL, SPAN, DEAD_ZONE = 1500, 500, 30
# Gains of the PI controller: shares of full throttle for the relative error, which is (error in m/s) / (speed at full
# throttle), and for the integral (s) of the relative error. A car's speed follows its throttle with a lag of some
# tenths of a second. With these gains, the loop does not overshoot for lags of up to lag.LONGEST_LAG.
_PROPORTIONAL, _INTEGRAL = 0.5, 1.0
_MOST = 0.3  # largest share of full throttle that the integral term may add


class SpeedLoop:
    """PI controller with feedforward: computes the throttle (-1 to 1) for a wanted speed.

    `full`: speed at full throttle (m/s). The feedforward term is the wanted speed divided by `full`."""

    def __init__(self, full: float) -> None:
        self._full = full
        self._integral = 0.0

    def reset(self) -> None:
        """Reset the integral term, because neutral was commanded."""
        self._integral = 0.0

    def throttle(self, wanted: float, speed: float | None, seconds: float) -> float:
        """Return the throttle for the next step of `seconds`. Raises ValueError if `wanted` is not finite.

        `wanted`, `speed`: wanted and measured speed, m/s; without a measured speed (None), the error counts as 0."""
        if not math.isfinite(wanted):
            raise ValueError(f"not a speed: {wanted}")
        share = wanted / self._full
        error = 0.0 if speed is None else wanted - speed
        asked = share + _PROPORTIONAL * error / self._full + self._integral
        if abs(asked) < 1.0 or asked * error < 0.0:  # anti-windup: at full throttle, the integral may only shrink
            self._integral += _INTEGRAL * error / self._full * seconds
            self._integral = max(-_MOST, min(_MOST, self._integral))
        return max(-1.0, min(1.0, asked))


def channel(share: float) -> int:
    """Return the RC value (microseconds) for a share (-1 to 1) of a channel's range beyond its dead zone.

    ArduPilot computes the share as (value - 1530) / (2000 - 1530), and likewise below the middle
    (RC_Channel::pwm_to_angle_dz)."""
    if not math.isfinite(share):
        raise ValueError(f"not a share: {share}")
    steps = round(max(-1.0, min(1.0, share)) * (SPAN - DEAD_ZONE))
    return NEUTRAL + steps + (DEAD_ZONE if steps > 0 else -DEAD_ZONE if steps < 0 else 0)
