"""Objects that agents in lockstep share: those of the run, and the network of each fleet."""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import NamedTuple

from koordgen.runtime.net.network import EACH, MemoryNetwork, MemoryTransport, Queue
from koordgen.runtime.program.runner import Limit
from koordgen.runtime.values.clock import Clock, SimulatedClock
from targets.sim.base.fleets import SimulatedFleet
from targets.sim.lockstep.squads import LockstepSquad
from targets.sim.lockstep.time_shares import TimeShares
from targets.sim.lockstep.wires import MemoryWiring


class TimedNetwork(MemoryNetwork):
    """Network in memory that measures its own processing time."""

    def __init__(self, clock: Clock, seed: int, shares: TimeShares) -> None:
        super().__init__(clock, seed)
        self._shares = shares

    def send(self, sender: int, receiver: int, datagram: bytes) -> None:
        began = self._shares.begin()
        super().send(sender, receiver, datagram)
        self._shares.end("network", began)

    def arrived(self, queue: Queue) -> list[bytes]:
        began = self._shares.begin()
        taken = super().arrived(queue)
        self._shares.end("network", began)
        return taken


class Shared:
    """Objects that all agents of a run share."""

    def __init__(self, root: Path, seed: int, key: bytes, iterations: int, limit: Limit) -> None:
        self.root, self.seed, self.key = root, seed, key
        self.iterations, self.limit = iterations, limit
        self.clock = SimulatedClock()
        self.shares = TimeShares()
        self.hub = MemoryWiring()


class LockstepFleet:
    """Objects that all agents of one fleet share.

    shared: those of the whole run.
    squad: place of the fleet in the outer fleet; None if it is no squad.
    network: its places are those of physical robots in the whole scenario."""

    def __init__(self, fleet: SimulatedFleet, shared: Shared) -> None:
        self.fleet, self.scenario, self.shared = fleet, fleet.scenario, shared
        self.squad: SquadPlace | None = None
        seed = Random("/".join(filter(None, (str(shared.seed), "network", fleet.name)))).getrandbits(32)
        self.network = TimedNetwork(shared.clock, seed, shared.shares)
        self._places = EACH if fleet.is_whole else dict(enumerate(fleet.bodies))

    def transport(self, place: int) -> MemoryTransport:
        """Return a new transport for the physical robot at a place."""
        return self.network.transport(place, self._places)


class SquadPlace(NamedTuple):
    """Place of an inner fleet in the outer fleet: it is the robot of `handle` there."""

    outer: LockstepFleet
    handle: LockstepSquad
