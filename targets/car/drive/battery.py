"""Whether a supply looks empty: cars run on lithium polymer cells, and how many there are only the voltage tells."""

from __future__ import annotations

import math

EMPTY, _FULL = 3.4, 4.25  # volts of a cell that should be charged, and that no cell exceeds


def doubt(volts: float) -> str:
    """Return advice about the voltage; "" if it is in range or unknown (0)."""
    cells = max(1, math.ceil(volts / _FULL))
    if 0.0 < volts / cells < EMPTY:
        return f"{volts / cells:.1f} V a cell, were it {cells} of lithium polymer: charge the battery"
    return ""
