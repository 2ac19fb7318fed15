"""Plan of the bundles of an outer fleet with squads: robots that are fleets themselves (ADR 0056).

Each robot of an inner fleet has one bundle. It runs the inner applications and, while it is the host of its squad, the
agent of the outer robot.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from koordgen.build.bundle.plan import (
    RELEASE,
    Files,
    Ingredients,
    agent_bundle,
    as_json,
    finished,
    program_facts,
    program_files,
    release_of,
    settings,
    text_of,
)
from koordgen.build.bundle.plan_system import NamesClash, SystemIngredients, inner_bundles
from koordgen.build.bundle.squads_harness import HarnessSquad, squads_harness
from koordgen.build.emit.expr import literal
from koordgen.build.emit.names import Names
from koordgen.build.emit.property import has_properties
from koordgen.build.emit.system import module_of
from koordgen.fleet.address import control_port
from koordgen.lang.ir.decl import Program, Provided
from koordgen.lang.ir.expr import SharedRead
from koordgen.lang.node import Node

if TYPE_CHECKING:
    from koordgen.fleet.file import Fleet
    from koordgen.fleet.robots import FleetRobot

OUTER_SETTINGS = "outer.json"  # equal to the default of Squad.settings in koordgen/runtime/agent/squad.py (tested)
# Seconds without a position after which an outer robot stops. The inner robots stop by their own thresholds.
NEVER_LOST = 10000.0


class SquadIngredients(Node):
    """Inputs of the bundles of one squad's robots.

    `robot`: the squad. `inner`: its fleet. `provider`: number of the application that provides the modules.
    """

    robot: FleetRobot
    inner: SystemIngredients
    provider: int


def plan_squads(these: Ingredients, squads: Sequence[SquadIngredients], wanted: Iterable[str]) -> dict[str, Files]:
    """Return bundle name -> relative path -> bytes: `fleet`, and a bundle for each robot whose target is `wanted`.

    Also a bundle for each harness in `wanted`. The name of an inner robot's bundle is `SQUAD.ROBOT`. `these`: of the
    outer program. Raises NamesClash."""
    fleet, text, chosen = these.fleet, text_of(these), set(wanted)
    assert fleet is not None
    agents = {t.name: t for t in these.targets}
    robots = [robot for robot in fleet.robots if robot.inner is None]
    parts = {robot.name: agent_bundle(these, agents[robot.target], text, robot) for robot in robots}
    targets = {robot.name: robot.target for robot in robots}
    for squad in squads:
        inner = squad.inner.fleet
        for robot, (name, files) in zip(
            inner.robots, inner_bundles(squad.inner, squad.robot.name, fleet.key).items(), strict=True
        ):
            bundle = f"{squad.robot.name}.{name}"
            targets[bundle] = robot.target
            parts[bundle] = _joined(files, _outer_files(these, fleet, text, squad, robot.pid), squad.robot.name)
    release = {RELEASE: release_of(parts)}
    bundles = {name: finished(files | release) for name, files in parts.items() if targets[name] in chosen}
    members = [
        {"name": squad.robot.name, "robots": [robot.name for robot in squad.inner.fleet.robots]} for squad in squads
    ]
    facts = {**program_facts(these, fleet), "squads": members}
    bundles["fleet"] = finished({"fleet.json": as_json(facts)} | release)
    for target in these.targets:
        if target.kind == "harness" and target.name in chosen:
            built = {name: finished(files | release) for name, files in parts.items()}
            in_harness = [_in_harness(these.program, squad) for squad in squads]
            bundles[target.name] = squads_harness(these, target, text, in_harness, built)
    return bundles


def _in_harness(outer: Program, squad: SquadIngredients) -> HarnessSquad:
    system = squad.inner.system
    commanded = [
        each.value.name
        for _, each in used_ports(outer, system.applications[squad.provider].program)
        if each.port.direction == "actuator" and isinstance(each.value, SharedRead)
    ]
    stored = {v: f"{system.applications[system.owner(squad.provider, v)].name}.{v}" for v in commanded}
    return HarnessSquad(squad.robot.name, squad.inner, squad_text(outer, squad), stored)


def _joined(inner: Files, outer: Files, squad: str) -> Files:
    """Return the files of both levels. Raises NamesClash if they need different files of one name."""
    for path, data in outer.items():
        if inner.get(path, data) != data:
            raise NamesClash(
                f"the outer program and the fleet of {squad} need different files {path}; rename the program or the "
                "Python file of one of them"
            )
    return inner | outer


def _outer_files(these: Ingredients, fleet: Fleet, text: bytes, squad: SquadIngredients, robot: int) -> Files:
    """Return the files of the outer robot in the bundle of an inner robot. `robot`: its pid in the inner fleet."""
    return {
        **program_files(these, text),
        "squad.py": squad_text(these.program, squad).encode(),
        OUTER_SETTINGS: as_json(_outer_settings(these.program, fleet, squad, robot)),
    }


def _outer_settings(program: Program, fleet: Fleet, squad: SquadIngredients, robot: int) -> dict[str, Any]:
    """Return the settings of the outer robot on one inner robot, which receives at an address of its own."""
    found, outer = settings(program, fleet, squad.robot), squad.robot
    assert outer.inner is not None
    host, port = outer.inner.addresses[robot]
    own = {"name": outer.name, "host": host, "port": port}
    safety = {
        **found["safety"],
        "position_stale": found["safety"]["position_stale"] + 3 * squad.inner.fleet.delta,  # until it is committed
        "position_lost": NEVER_LOST,
    }
    peers = [own if place == outer.pid else peer for place, peer in enumerate(found["peers"])]
    return {**found, "peers": peers, "control": control_port(port), "safety": safety}


def squad_text(outer: Program, squad: SquadIngredients) -> str:
    """Return the text of `squad.py`: the ports of the outer robot, as functions and variables of the inner program."""
    application = squad.inner.system.applications[squad.provider]
    names, module = Names(application.program), f"program_{module_of(application)}"
    sensors, actuators = [], []
    for name, provided in used_ports(outer, application.program):
        if provided.port.direction == "sensor":
            owner, _, port = name.partition(".")
            sensors.append(f"        {literal(name)}: {module}.{names.provided[owner, port]},")
        elif isinstance(provided.value, SharedRead):
            actuators.append(f"        {literal(name)}: {literal(provided.value.name)},")
    has = has_properties(outer)
    lines = [f'"""The robot {squad.robot.name} of {outer.name}: a fleet of {application.program.name}."""', ""]
    lines += ["from koordgen.runtime.agent.squad import Squad", "", f"import {module}", "from program import PROGRAM"]
    lines += ["from properties import PROPERTIES"] * has
    lines += ["", "SQUAD = Squad(", f"    application={squad.provider},"]
    lines += ["    sensors={", *sensors, "    },", "    actuators={", *actuators, "    },", "    program=PROGRAM,"]
    return "\n".join([*lines, *["    properties=PROPERTIES,"] * has, ")", ""])


def used_ports(outer: Program, inner: Program) -> Iterator[tuple[str, Provided]]:
    """Yield what the inner program provides of the ports that the outer program uses, by "Module.port".

    A sensor that an actuator has as its value before the first command is used, even if it is not declared.
    """
    provided = {f"{module.name}.{each.port.name}": each for module in inner.provides for each in module.ports}
    used = {f"{m.name}.{name}": None for m in outer.modules for p in m.ports for name in (p.name, p.meaning.held)}
    for name in used:
        if name in provided:
            yield name, provided[name]
