"""Random tests are the same at every run of the everyday suite; HYPOTHESIS_PROFILE=random makes them new each time."""

from __future__ import annotations

import os

from hypothesis import settings

settings.register_profile("everyday", derandomize=True, deadline=None)
settings.register_profile("random", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "everyday"))
