"""The contact engines as parameters of tests. One that is not installed is skipped, and pytest says so."""

from __future__ import annotations

import pytest

from targets.sim.base.scenario import PACKAGES, PYBULLET
from targets.sim.physics.contacts import is_installed


def _missing(engine: str) -> str:
    return f"the package {PACKAGES[engine]} is not installed for this Python"


ENGINES = [
    pytest.param(engine, marks=pytest.mark.skipif(not is_installed(engine), reason=_missing(engine)))
    for engine in PACKAGES
]
needs_both = pytest.mark.skipif(
    not all(map(is_installed, PACKAGES)), reason="; ".join(_missing(e) for e in PACKAGES if not is_installed(e))
)
needs_pybullet = pytest.mark.skipif(not is_installed(PYBULLET), reason=_missing(PYBULLET))
