"""Common functions of commands that use SSH: hosts of the fleet, connection options, failures."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from koordgen.cli.base import console
from koordgen.cli.base.parser import nearest

if TYPE_CHECKING:
    from koordgen.fleet.file import Fleet
    from koordgen.operate.hosts import Host, HostError, Options
    from koordgen.operate.physical import PhysicalRobot

# codes of HostError for hosts that were not reached
UNREACHABLE = ("unreachable", "unknown key", "changed key", "refused key", "settings", "link")


def read_fleet(path: str) -> Fleet:
    """Read a fleet file and those of its squads, without programs. Raises Rejected."""
    from koordgen.build import pipeline
    from koordgen.fleet import manifest

    return pipeline.read_fleet(path, {name: manifest.load(name) for name in manifest.available()}, None, squads=True)[0]


def chosen_robots(fleet: Fleet, path: str, names: Sequence[str]) -> tuple[PhysicalRobot, ...]:
    """Return the robots that a command line names, or all robots without a name. Raises Failure for an unknown name."""
    from koordgen.operate.physical import UnknownRobot, named_robots, physical_robots

    try:
        return named_robots(physical_robots(fleet, path), names)
    except UnknownRobot as error:
        near = nearest(error.name, error.known)
        help = (f"did you mean {near}? " if near else "") + f"the robots are {', '.join(error.known)}"
        raise console.Failure(console.USAGE, str(error), help) from None


def fleet_hosts(fleet: Fleet, path: str, robots: Sequence[PhysicalRobot]) -> tuple[Host, ...]:
    """Return the hosts of robots of a fleet.

    Raises Failure if the fleet file names no host for a robot, or asyncssh is missing.
    """
    from koordgen.operate.hosts import NoHosts, hosts_of, require_asyncssh

    try:
        require_asyncssh()
        return hosts_of(robots, fleet.deployment)
    except NoHosts as error:
        if error.is_file_wrong:
            raise console.Failure(console.WRONG, f"{path}: {error}", error.help) from None
        raise console.Failure(console.SURROUNDINGS, str(error), error.help) from None


def connection(options: Namespace) -> Options:
    """Return the connection options from the command line. Raises Failure if a named file is missing."""
    from koordgen.operate.hosts import Options

    for path in (options.ssh_config, options.known_hosts, options.identity):
        if path is not None and not Path(path).is_file():
            raise console.Failure(
                console.WRONG, f"{path}: no such file", "correct --ssh-config, --known-hosts or --identity"
            )
    return Options(options.ssh_config, options.known_hosts, options.identity)


def describe(errors: Iterable[HostError]) -> str:
    """Return one line for each error, followed by a line with its help."""
    return "\n".join(f"{error}" + (f"\n  help: {error.help}" if error.help else "") for error in errors)


def status_of(errors: Iterable[HostError]) -> int:
    """Return the exit status for errors: SURROUNDINGS if a host was not reached, else WRONG."""
    return console.SURROUNDINGS if any(error.code in UNREACHABLE for error in errors) else console.WRONG
