"""`koordgen key list`: shows which keys the robots of a fleet need, and where these keys are."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from koordgen.cli.base import console
from koordgen.cli.operate.ssh import read_fleet
from koordgen.fleet.file import Fleet
from koordgen.operate.physical import physical_robots
from koordgen.operate.release import key_id
from koordgen.runtime.net.seal import BadKey, load_key

COLUMNS = ("robot", "fleet file", "key file", "id")


class NeededKey(NamedTuple):
    """Key that a robot needs.

    fleet: the fleet file that names it. file: the key file; empty for a fleet without a key.
    id: id of the key, as releases have it; empty if there is none. trouble: reason why the key cannot be read.
    """

    robot: str
    fleet: str
    file: str
    id: str
    trouble: str


def list_keys(options: Namespace) -> int:
    """Print the keys that each robot of a fleet needs. Raises Failure if one of them cannot be read.

    A robot of a squad needs the key of its own fleet and that of the outer fleet.
    """
    fleet = read_fleet(options.file)
    found = list(_needed(fleet, options))
    if options.format == "json":
        print(json.dumps({"keys": [each._asdict() for each in found]}, indent=2))
    else:
        rows = [COLUMNS, *[(each.robot, each.fleet, each.file or "none", each.id or "-") for each in found]]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        for row in rows:
            print("  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip())
    if wrong := dict.fromkeys(each.trouble for each in found if each.trouble):
        help = "`koordgen key new FILE` makes a key; copy the key of a deployed fleet from where it was made"
        raise console.Failure(console.WRONG, "\n".join(wrong), help)
    return console.HOLDS


def _needed(fleet: Fleet, options: Namespace) -> Iterator[NeededKey]:
    for robot in physical_robots(fleet, options.file):
        yield _key(robot.name, robot.fleet, robot.file, "" if robot.squad else options.key)
        if robot.squad:
            yield _key(robot.name, fleet, Path(options.file), options.key)


def _key(robot: str, fleet: Fleet, file: Path, given: str | None) -> NeededKey:
    """Return the key of a fleet. `given`: key file from the command line, if any."""
    if not fleet.key:
        return NeededKey(robot, str(file), "", "", "")
    path = Path(given) if given else file.parent / fleet.key
    try:
        return NeededKey(robot, str(file), str(path), key_id(load_key(path)), "")
    except BadKey as error:
        return NeededKey(robot, str(file), str(path), "", str(error))
