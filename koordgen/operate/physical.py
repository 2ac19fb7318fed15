"""Physical robots of a fleet: its ordinary robots, and the robots of its squads.

A squad is a robot that is a fleet itself. Each of its robots has the computer, the control port, the application_id and
the key of its own fleet file. The entries under `deploy` of the outer fleet file hold for all robots.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from koordgen.fleet.deployment import Login
from koordgen.fleet.file import Fleet
from koordgen.fleet.robots import FleetRobot
from koordgen.lang.node import Node


class UnknownRobot(Exception):
    """Raised if a fleet has no robot of a name. `known`: the names that it has."""

    def __init__(self, name: str, known: Sequence[str]) -> None:
        super().__init__(f"the fleet file has no robot {name!r}")
        self.name = name
        self.known = known


class PhysicalRobot(Node):
    """Robot with a computer of its own.

    name: as bundles, commands and messages name it: SQUAD.ROBOT for a robot of a squad.
    squad: robot of the outer fleet to which it belongs; empty for an ordinary robot.
    fleet, file: its own fleet, and the path of that fleet file.
    entry: its entry in that file: name, target, address, control port, host.
    """

    name: str
    squad: str
    fleet: Fleet
    file: Path
    entry: FleetRobot

    @property
    def login(self) -> Login | None:
        """Return the computer on which its agent runs; None if its fleet file names none."""
        return self.entry.login


def physical_robots(fleet: Fleet, path: str) -> tuple[PhysicalRobot, ...]:
    """Return all physical robots in the order of the fleet file. `path`: path of the fleet file."""
    found: list[PhysicalRobot] = []
    for robot in fleet.robots:
        if robot.inner is None:
            found.append(PhysicalRobot(robot.name, "", fleet, Path(path), robot))
            continue
        inner, file = fleet.inner_fleets[robot.name], Path(path).parent / robot.inner.file
        found += [PhysicalRobot(f"{robot.name}.{each.name}", robot.name, inner, file, each) for each in inner.robots]
    return tuple(found)


def named_robots(robots: Sequence[PhysicalRobot], names: Sequence[str]) -> tuple[PhysicalRobot, ...]:
    """Return the robots with these names, or all robots without a name. The name of a squad means all its robots.

    Raises UnknownRobot.
    """
    known = list(dict.fromkeys(name for robot in robots for name in (robot.squad, robot.name) if name))
    for name in names:
        if name not in known:
            raise UnknownRobot(name, known)
    return tuple([robot for robot in robots if not names or robot.name in names or robot.squad in names])
