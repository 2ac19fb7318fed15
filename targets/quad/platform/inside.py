"""Construction of the quad's platform for a simulator that controls time and runs in the same process."""

from __future__ import annotations

from functools import partial

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.vehicle.simulator_services import SimulatorServices
from targets.mavlink.inside import Direct
from targets.planning.process import bounded
from targets.quad.platform.platform import Quad


def made(settings: Settings, key: bytes | None, inside: SimulatorServices) -> Quad:
    """Return a quad that uses a simulator's links, clocks and planner. `key`: the fleet's key.

    `inside`: the simulator's services, described in koordgen.runtime.vehicle.simulator_services."""
    return Quad(
        settings,
        key,
        connect=lambda url: Direct(inside.exchange(url)),
        bind=inside.exchange,
        scans=inside.exchange,
        clock=inside.now,
        wall=inside.today,
        planning=partial(bounded, inside),
    )
