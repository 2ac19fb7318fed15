"""Bundle of a harness for an outer fleet with squads: all physical robots, and the programs of both levels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from koordgen.build.bundle.plan import (
    Files,
    Ingredients,
    as_json,
    described,
    harness_bundle,
    harness_files,
    program_files,
    scenario_of,
    scenario_robot,
)
from koordgen.build.bundle.plan_system import SystemIngredients, inner_harness
from koordgen.build.bundle.squad_budget import OUTER
from koordgen.fleet.manifest import Target
from koordgen.lang.node import Node

if TYPE_CHECKING:
    from koordgen.fleet.file import Fleet

FLEETS = "fleets"  # folder with the programs of each squad; equal to FOLDER in targets/sim/base/fleets.py (tested)
OF_FLEET = ("app", "source", "program_hash", "application_id", "delta", "geofence", "shared", "records", "drivers")


class HarnessSquad(Node):
    """Squad in the bundle of a harness.

    `inner`: its fleet. `text`: its `squad.py`. `commanded`: variable of the inner program that the outer program
    writes -> its name in the store.
    """

    name: str
    inner: SystemIngredients
    text: str
    commanded: Mapping[str, str]


def squads_harness(
    these: Ingredients, target: Target, text: bytes, squads: Sequence[HarnessSquad], agents: dict[str, Files]
) -> Files:
    """Return the bundle of a harness. `these`, `text`: of the outer program. `agents`: bundles of all robots."""
    outer, program = these.fleet, these.program
    assert outer is not None
    by_name = {squad.name: squad for squad in squads}
    robots: list[dict[str, Any]] = []
    fleets: list[dict[str, Any]] = []
    members: list[int | str] = []
    own = harness_files(these, text)
    for robot in outer.robots:
        if robot.inner is None:
            members.append(len(robots))
            robots.append(scenario_robot(robot, robot.name, len(robots), target, these.targets))
            continue
        members.append(robot.name)
        files, fleet, added = _squad(these, target, text, by_name[robot.name], len(robots))
        own |= {f"{FLEETS}/{robot.name}/{path}": data for path, data in files.items()}
        fleets.append(fleet)
        robots += added
    facts = described(these, outer)
    scenario = scenario_of(facts, outer, target, robots)
    scenario["fleets"] = [{"name": "", "members": members, **_of_fleet(facts)}, *fleets]
    named = [(robot["name"], robot["target"]) for robot in robots]
    return harness_bundle(
        these, target, named, {**own, "scenario.json": as_json(scenario)}, agents, program.name, program.path
    )


def _squad(
    these: Ingredients, target: Target, text: bytes, squad: HarnessSquad, first: int
) -> tuple[Files, dict[str, Any], list[dict[str, Any]]]:
    """Return files, description and robots of a squad. `first`: number of its first robot in the scenario."""
    files, facts = inner_harness(squad.inner)
    inner: Fleet = squad.inner.fleet
    places = range(first, first + len(inner.robots))
    robots = [
        scenario_robot(robot, f"{squad.name}.{robot.name}", place, target, these.targets)
        for robot, place in zip(inner.robots, places, strict=True)
    ]
    outer = {"name": OUTER, "members": list(range(len(inner.robots))), "variables": dict(squad.commanded)}
    fleet = {
        "name": squad.name,
        "members": list(places),
        **_of_fleet(facts),
        "applications": [*facts["applications"], outer],
    }
    return files | program_files(these, text) | {"squad.py": squad.text.encode()}, fleet, robots


def _of_fleet(facts: Mapping[str, Any]) -> dict[str, Any]:
    return {key: facts[key] for key in OF_FLEET}
