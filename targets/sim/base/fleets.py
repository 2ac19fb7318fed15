"""Fleets of a run: the only fleet, or an outer fleet with squads and the inner fleet of each squad.

All fleets move in one world. A fleet numbers its robots by pids of its own. The world, and the faults of a run, number
the physical robots of all fleets by their places in the scenario."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from msgspec.structs import replace

from targets.sim.base.bodies import BodyState, Vector
from targets.sim.base.scenario import FleetDescription, Robot, Scenario, Start

SQUAD = "squad"  # target of a robot that is a squad, in traces
FOLDER = "fleets"  # folder of a sim bundle with the programs of each inner fleet
OF_FLEET = tuple(name for name in FleetDescription.__struct_fields__ if name not in ("name", "members"))


@dataclass(frozen=True)
class SimulatedFleet:
    """One fleet of a run.

    name: "" for the only fleet and for the outer fleet; otherwise the squad that the fleet is.
    scenario: scenario of this fleet alone. Its robots have the pids of the fleet, and the names of the whole scenario.
        The `body` of a squad is the program of its fleet.
    bodies: robot by pid -> places of its physical robots in the whole scenario; a squad has several.
    members: pid of a squad, name of one of its robots in its own fleet, and the robot's place; of all squads.
    """

    name: str
    scenario: Scenario
    bodies: tuple[tuple[int, ...], ...]
    members: tuple[tuple[int, str, int], ...] = ()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the robots by pid, as in the whole scenario."""
        return tuple(robot.name for robot in self.scenario.robots)

    @cached_property
    def is_whole(self) -> bool:
        """True if the pids of the fleet are the places of physical robots in the scenario."""
        return self.bodies == tuple((place,) for place in range(len(self.bodies)))

    def programs(self, bundle: Path) -> Path:
        """Return the folder with the programs of the fleet in a sim bundle."""
        return bundle / FOLDER / self.name if self.name else bundle

    def own_name(self, name: str) -> str:
        """Return a robot's name in the fleet's own file, given its name in the whole scenario."""
        return name.removeprefix(f"{self.name}.") if self.name else name

    def is_squad(self, pid: int) -> bool:
        """Return whether a robot of the fleet is a squad."""
        return self.scenario.robots[pid].target == SQUAD

    def states(self, states: list[BodyState]) -> list[BodyState]:
        """Return the true states by pid, given those of all physical robots.

        Position and velocity of a squad are the means of its members. It has no heading: its yaw is 0."""
        if self.is_whole and len(states) == len(self.bodies):
            return states
        return [states[own[0]] if len(own) == 1 else _mean([states[body] for body in own]) for own in self.bodies]


def fleets_of(scenario: Scenario) -> tuple[SimulatedFleet, ...]:
    """Return the fleets of a scenario, the outer fleet first."""
    if not scenario.fleets:
        return (SimulatedFleet("", scenario, tuple((place,) for place in range(len(scenario.robots)))),)
    squads = {each.name: tuple(_physical(each)) for each in scenario.fleets if each.name}
    return tuple(_fleet(scenario, each, squads) for each in scenario.fleets)


def own_settings(scenario: Scenario) -> list[tuple[str, int]]:
    """Return the name and the application id in the settings of each physical robot, in the order of the scenario."""
    found = {
        own[0]: (fleet.own_name(name), fleet.scenario.application_id)
        for fleet in fleets_of(scenario)
        for pid, (name, own) in enumerate(zip(fleet.names, fleet.bodies, strict=True))
        if not fleet.is_squad(pid)
    }
    return [found[place] for place in range(len(scenario.robots))]


def _physical(described: FleetDescription) -> list[int]:
    return [member for member in described.members if isinstance(member, int)]


def _fleet(scenario: Scenario, described: FleetDescription, squads: dict[str, tuple[int, ...]]) -> SimulatedFleet:
    robots: list[Robot] = []
    bodies: list[tuple[int, ...]] = []
    members: list[tuple[int, str, int]] = []
    for pid, member in enumerate(described.members):
        if isinstance(member, str):
            bodies.append(squads[member])
            members += [(pid, scenario.robots[b].name.removeprefix(f"{member}."), b) for b in squads[member]]
            start = Start(_middle([scenario.robots[body].start.position for body in squads[member]]))
            robots.append(
                Robot(member, pid, SQUAD, "", next(f.app for f in scenario.fleets if f.name == member), "", start)
            )
        else:
            bodies.append((member,))
            robots.append(replace(scenario.robots[member], pid=pid))
    own = {field: getattr(described, field) for field in OF_FLEET}
    return SimulatedFleet(
        described.name, replace(scenario, robots=tuple(robots), fleets=(), **own), tuple(bodies), tuple(members)
    )


def _mean(states: Sequence[BodyState]) -> BodyState:
    return BodyState(_middle([s.position for s in states]), _middle([s.velocity for s in states]), 0.0, 0.0)


def _middle(vectors: Sequence[Vector]) -> Vector:
    x, y, z = (sum(each) / len(vectors) for each in zip(*vectors, strict=True))
    return x, y, z
