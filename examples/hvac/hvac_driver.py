"""Serves the module HVAC of hvac.koord. This one stands in for real hardware: a room that cools and a heater.

Put your own sensor and relay in its place: `sense` and `command` are all that an agent calls, and neither may block.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, ClassVar

OUTSIDE = 5.0  # degrees Celsius
LOSS, HEATING = 0.02, 1.2  # of the difference to the outside, and degrees, a second


class Hvac:
    """One room."""

    sensors: ClassVar = {"temp": "float"}
    actuators: ClassVar = {"heat": "bool"}

    def __init__(self) -> None:
        self._temp = 15.0
        self._heat = False
        self._before = time.monotonic()

    def sense(self) -> dict[str, Any]:
        """All sensors, by name."""
        now = time.monotonic()
        seconds, self._before = now - self._before, now
        self._temp += seconds * (LOSS * (OUTSIDE - self._temp) + (HEATING if self._heat else 0.0))
        return {"temp": self._temp}

    def command(self, actuators: Mapping[str, Any]) -> None:
        """What an event wrote, by name."""
        self._heat = bool(actuators.get("heat", self._heat))

    def close(self) -> None:
        """The agent ends: switch off."""
        self._heat = False
