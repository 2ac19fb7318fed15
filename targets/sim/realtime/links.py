"""Addresses of one fleet's robots on this host, with a relay between them if a run disturbs the network."""

from __future__ import annotations

from random import Random
from typing import Any

from targets.sim.base.fleets import SimulatedFleet
from targets.sim.base.medium import Medium
from targets.sim.base.ports import NUMBERS
from targets.sim.realtime.relay import LOOPBACK, Relay


class FleetLinks:
    """Addresses of the robots of a fleet: a port for each physical robot, those of squads included.

    `medium`: of all physical robots of the run; None: the robots send to each other directly."""

    def __init__(self, fleet: SimulatedFleet, seed: int, medium: Medium | None) -> None:
        self._fleet = fleet
        self._places = [place for own in fleet.bodies for place in own]
        self._ports = {place: NUMBERS.allocate() for place in self._places}
        self._relay: Relay | None = None
        self._seen = self._ports  # where other robots send to
        if medium is not None:
            seed = Random(f"{seed}/{fleet.name}").getrandbits(32) if fleet.name else seed
            self._relay = Relay(list(self._ports.values()), seed, medium.among(self._places))
            self._seen = dict(zip(self._places, self._relay.ports, strict=True))

    def peers(self, place: int) -> list[dict[str, Any]]:
        """Return the `peers` in the settings of the physical robot at a place, which listens on its own port."""
        found = []
        for name, own in zip(self._fleet.names, self._fleet.bodies, strict=True):
            ports = [self._ports[place]] if place in own else [self._seen[body] for body in own]
            peer: dict[str, Any] = {"name": self._fleet.own_name(name), "host": LOOPBACK, "port": ports[0]}
            if len(ports) > 1:
                peer["also"] = [{"host": LOOPBACK, "port": port} for port in ports[1:]]
            found.append(peer)
        return found

    def change(self, medium: Medium) -> None:
        """Change the medium of a fleet with a relay. Raises OSError."""
        if self._relay is not None:
            self._relay.change(medium.among(self._places))

    def close(self) -> None:
        """End the relay, and give the ports back. Idempotent."""
        if self._relay is not None:
            self._relay.close()
        while self._ports:
            NUMBERS.give_back(self._ports.popitem()[1])
