"""Small programs with invariants that are known to be provable or not. A wrong generator decides differently."""

from __future__ import annotations

from tests.verify.prove.battery.steps import STEPS
from tests.verify.prove.battery.values import VALUES

BATTERY = {**STEPS, **VALUES}
