"""Driver of the module HVAC of hvac.koord: in place of real hardware, it simulates a room that cools, and a heater.

For real hardware, replace `sense` and `command`: an agent calls only these, and neither may block.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, ClassVar

OUTSIDE = 5.0  # degrees Celsius
LOSS, HEATING = 0.02, 1.2  # per second: share of the difference to the outside; degrees


class Hvac:
    """One simulated room."""

    sensors: ClassVar = {"temp": "float"}
    actuators: ClassVar = {"heat": "bool"}

    def __init__(self) -> None:
        self._temp = 15.0
        self._heat = False
        self._before = time.monotonic()

    def sense(self) -> dict[str, Any]:
        """Return the values of all sensors, by name."""
        now = time.monotonic()
        seconds, self._before = now - self._before, now
        self._temp += seconds * (LOSS * (OUTSIDE - self._temp) + (HEATING if self._heat else 0.0))
        return {"temp": self._temp}

    def command(self, actuators: Mapping[str, Any]) -> None:
        """Receive the actuator values that an event wrote, by name."""
        self._heat = bool(actuators.get("heat", self._heat))

    def close(self) -> None:
        """Switch the heater off: the agent ends."""
        self._heat = False
