"""Small programs whose invariants are known to be provable, or not to be: a wrong generator tells otherwise."""

from __future__ import annotations

from tests.prove.battery_steps import STEPS
from tests.prove.battery_values import VALUES

BATTERY = {**STEPS, **VALUES}
