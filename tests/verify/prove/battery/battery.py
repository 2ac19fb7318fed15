"""Small programs whose invariants are known to be provable, or not to be: a wrong generator tells otherwise."""

from __future__ import annotations

from tests.verify.prove.battery.steps import STEPS
from tests.verify.prove.battery.values import VALUES

BATTERY = {**STEPS, **VALUES}
