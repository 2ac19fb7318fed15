"""Low-battery check by the supply voltage, for lithium polymer batteries.

The check estimates the number of cells in series from the voltage, because no setting gives it."""

from __future__ import annotations

import math

EMPTY, _FULL = 3.4, 4.25  # volts: a cell below EMPTY should be charged; no cell exceeds _FULL


def doubt(volts: float) -> str:
    """Return a warning if the supply voltage is low; "" if it is in range or unknown (0)."""
    cells = max(1, math.ceil(volts / _FULL))
    if 0.0 < volts / cells < EMPTY:
        return f"{volts / cells:.1f} V per cell, if it has {cells} lithium polymer cells: charge the battery"
    return ""
