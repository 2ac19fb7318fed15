"""Plan of the bundles of several applications: one bundle for each robot, with the programs of all applications.

Every robot stores the variables of all applications, so every bundle has all programs. A fleet with one application on
all robots gets the bundles of a program (plan.py)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from koordgen import __version__
from koordgen.build.bundle.plan import (
    COMPOSITION,
    PARAMS,
    RELEASE,
    SOURCE,
    Files,
    Ingredients,
    as_json,
    described_by,
    facts_of,
    finished,
    harness_bundle,
    plan,
    read_common,
    release_of,
    requirements,
    scenario_of,
    scenario_robot,
    settings_of,
)
from koordgen.build.bundle.port_calls import LONGEST, check_calls, planner_budget
from koordgen.build.emit.program import functions_module, program_text
from koordgen.build.emit.property import has_properties, properties_text
from koordgen.build.emit.render import render
from koordgen.build.emit.system import (
    applications_text,
    is_alone,
    module_of,
    system_hash,
    system_interface_hash,
    with_sizes,
)
from koordgen.fleet.manifest import Target
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.node import Node, replace
from koordgen.lang.semantics.composition import System

if TYPE_CHECKING:  # importing YAML costs too much for builds without a fleet file
    from koordgen.fleet.file import Fleet
    from koordgen.fleet.robots import FleetRobot


class NamesClash(Exception):
    """Raised if two applications need different files of the same name in a bundle. The message names both."""


class ApplicationFiles(Node):
    """Files of one application, read from disk beforehand.

    `source`: the program's text. `beside`: the user's own Python files by their path in a bundle. `params`: values of
    params that replace their defaults, except for sizes of exporters.
    """

    source: bytes
    beside: Files
    params: Mapping[str, Any]


class SystemIngredients(Node):
    """Inputs of a plan for several applications. Other fields: see Ingredients.

    `parts`: the files of each application, in the order of the system. `shares`: name of an application -> part of the
    time for events that it may use; an application that is not named shares the rest equally.
    """

    system: System
    parts: tuple[ApplicationFiles, ...]
    targets: tuple[Target, ...]
    fleet: Fleet
    common: Files
    target_files: dict[str, Files]
    shares: Mapping[str, float]


def plan_system(these: SystemIngredients, wanted: Iterable[str]) -> dict[str, Files]:
    """Return bundle name -> relative path -> bytes: `fleet`, and a bundle for each robot whose target is `wanted`.

    Each harness in `wanted` has a bundle, too. Raises NamesClash."""
    if is_alone(these.system):
        only, part = these.system.applications[0], these.parts[0]
        fleet = without_application(these.fleet, only.name)
        return plan(
            Ingredients(
                only.program, part.source, these.targets, fleet, these.common, these.target_files, part.beside,
                part.params,
            ),
            wanted,
        )  # fmt: skip
    these = these_with_sizes(these)
    programs, agents = _programs(these), {t.name: t for t in these.targets if t.kind == "agent"}
    robots = {r.name: _agent(these, agents[r.target], programs, r) for r in these.fleet.robots}
    release = {RELEASE: release_of(robots)}
    chosen = set(wanted)
    built = {name: finished(files | release) for name, files in robots.items()}
    bundles = {r.name: built[r.name] for r in these.fleet.robots if r.target in chosen}
    facts = facts_of(_app(these.system), _hashes(these), these.fleet)
    facts["applications"] = [
        {"name": a.name, "members": [these.fleet.robots[place].name for place in a.members]}
        for a in these.system.applications
    ]
    bundles["fleet"] = finished({"fleet.json": as_json(facts)} | release)
    for target in these.targets:
        if target.kind == "harness" and target.name in chosen:
            bundles[target.name] = _harness(these, target, programs, built)
    return bundles


def without_application(fleet: Fleet, application: str) -> Fleet:
    """Return the fleet with the names of variables and properties as they are in a program that runs alone."""
    prefix, world = f"{application}.", fleet.world
    listed = world.facts.get("marker_list")
    if listed is not None:
        listed = {**listed, "variable": listed["variable"].removeprefix(prefix)}
        world = replace(world, facts={**world.facts, "marker_list": listed})
    monitors = {name.removeprefix(prefix): action for name, action in fleet.monitors.items()}
    return replace(fleet, avoid=fleet.avoid.removeprefix(prefix), monitors=monitors, world=world)


def _harness(these: SystemIngredients, target: Target, programs: Files, agents: dict[str, Files]) -> Files:
    system, fleet = these.system, these.fleet
    robots = [scenario_robot(robot, robot.name, robot.pid, target, these.targets) for robot in fleet.robots]
    scenario = scenario_of(_described(these), fleet, target, robots)
    own = {**_harness_files(these, programs), "scenario.json": as_json(scenario)}
    named = [(r.name, r.target) for r in fleet.robots]
    return harness_bundle(these, target, named, own, agents, _app(system), _source(system))


def _source(system: System) -> str:
    """Return the files of all programs, for people."""
    return ", ".join(dict.fromkeys(a.program.path for a in system.applications))


def _harness_files(these: SystemIngredients, programs: Files) -> Files:
    """Return the files of all applications in the bundle of a harness."""
    own = dict(programs)
    for application, part in zip(these.system.applications, these.parts, strict=True):
        functions = f"{functions_module(application.program)}.py"
        if functions in part.beside:
            own[f"{SOURCE}/{application.name}/{functions}"] = part.beside[functions]
    return own


def _described(these: SystemIngredients) -> dict[str, Any]:
    """Return what a scenario says of the fleet, except for its robots."""
    drivers = {driver: None for robot in these.fleet.robots for driver in _drivers(these, robot.pid)}
    store = {**_store_facts(these.system), "drivers": list(drivers)}
    facts = facts_of(_app(these.system), _hashes(these), these.fleet)
    return described_by(facts, _source(these.system), store)


def _store_facts(system: System) -> dict[str, Any]:
    """Return the variables of the store and the applications, in the form of a scenario and of a trace's header.

    If two applications declare record types with the same name, `records` has the fields of the last one.
    """
    records: dict[str, Any] = {}
    for application in system.applications:
        records |= {str(r.type): [[name, str(t)] for name, t in r.type.fields] for r in application.program.records}
    return {
        "shared": [
            {"name": f"{application.name}.{v.name}", "kind": v.kind, "type": str(v.type)}
            for index, application in enumerate(system.applications)
            for v in system.own(index)
        ],
        "records": records,
        "applications": [
            {
                "name": application.name,
                "members": application.members,
                "variables": {
                    v.name: f"{system.applications[system.owner(index, v.name)].name}.{v.name}"
                    for v in application.program.shared
                },
            }
            for index, application in enumerate(system.applications)
        ],
    }


def read_system_ingredients(
    system: System,
    parts: tuple[ApplicationFiles, ...],
    targets: tuple[Target, ...],
    fleet: Fleet,
    package: Path,
    shares: Mapping[str, float],
) -> SystemIngredients:
    """Read all files that are copied into bundles. `package`: folder of the koordgen package."""
    return SystemIngredients(system, parts, targets, fleet, *read_common(targets, package), shares)


def these_with_sizes(these: SystemIngredients) -> SystemIngredients:
    """Return the ingredients with the number of each exporter's members as a param of the importing programs."""
    return SystemIngredients(
        with_sizes(these.system), these.parts, these.targets, these.fleet, these.common, these.target_files,
        these.shares,
    )  # fmt: skip


def _app(system: System) -> str:
    """Return one name for all applications together. It is equal to FleetProgram.name."""
    return "+".join(application.name for application in system.applications)


def _functions(these: SystemIngredients) -> list[bytes]:
    """Return the content of each application's functions file; b"" for an application without such a file."""
    return [
        part.beside.get(f"{functions_module(application.program)}.py", b"")
        for application, part in zip(these.system.applications, these.parts, strict=True)
    ]


def _hashes(these: SystemIngredients) -> tuple[str, str]:
    return system_hash(these.system, _functions(these)), system_interface_hash(these.system)


def _programs(these: SystemIngredients) -> Files:
    """Return the files of all applications."""
    functions = _functions(these)
    facts = {"program_hash": _hashes(these)[0], **_store_facts(these.system)}
    files: Files = {
        "applications.py": applications_text(these.system, functions, these.shares).encode(),
        f"{SOURCE}/{COMPOSITION}": as_json(facts),
    }
    owners: dict[str, str] = {}
    for application, part, own in zip(these.system.applications, these.parts, functions, strict=True):
        program, end = application.program, module_of(application)
        made = {
            f"program_{end}.py": program_text(program, own).encode(),
            f"{SOURCE}/{application.name}/{program.path}": part.source,
            f"{SOURCE}/{application.name}/{PARAMS}": as_json(dict(part.params)),
            **part.beside,
        }
        if has_properties(program):
            made[f"properties_{end}.py"] = properties_text(program, these.fleet.drivers, f"program_{end}").encode()
        _add(files, made, application.name, owners)
    return files


def _add(files: Files, made: Files, application: str, owners: dict[str, str]) -> None:
    """Add the files of an application. Raises NamesClash."""
    for path, data in made.items():
        if files.get(path, data) != data:
            raise NamesClash(
                f"the applications {owners.get(path, 'of the fleet')} and {application} need different files {path}; "
                "rename the program or the Python file of one of them"
            )
        files[path] = data
        owners.setdefault(path, application)


def inner_bundles(these: SystemIngredients, squad: str, key: str) -> dict[str, Files]:
    """Return the files of each robot of a fleet that is the robot `squad` of an outer fleet, without the outer program.

    A fleet with one application has the same files as one with several: the outer program is one more application.
    `key`: name of the outer fleet's key file. Raises NamesClash.
    """
    these = these_with_sizes(these)
    programs, agents = _programs(these), {t.name: t for t in these.targets if t.kind == "agent"}
    more = "" if key == these.fleet.key else key
    return {r.name: _agent(these, agents[r.target], programs, r, squad, more) for r in these.fleet.robots}


def inner_harness(these: SystemIngredients) -> tuple[Files, dict[str, Any]]:
    """Return what the bundle of a harness has of a squad's fleet: its files, and what the scenario says of it."""
    these = these_with_sizes(these)
    return _harness_files(these, _programs(these)), _described(these)


def _agent(
    these: SystemIngredients, target: Target, programs: Files, robot: FleetRobot, squad: str = "", key: str = ""
) -> Files:
    """Return the files of one robot, without the release.

    `squad`: the squad of the robot; "" for none. `key`: the outer fleet's key file, if it differs from that of this
    fleet.
    """
    module, _, name = target.entry.partition(":")
    system, fleet, hashes = these.system, these.fleet, _hashes(these)
    watched = [(a.name, module_of(a)) for a in system.applications if has_properties(a.program)]
    values = {
        "app": _app(system),
        "robot": robot.name,
        "pid": robot.pid,
        "key": fleet.key,
        "target": target.name,
        "summary": target.summary,
        "source": ", ".join(a.program.path for a in system.applications),
        "version": __version__,
        "program_hash": hashes[0],
        "interface_hash": hashes[1],
        "applications": [a.name for a in system.applications],
        "squad": squad,
        "outer_key": key,
    }
    main = render(
        "main_agent.py", module=module, name=name, drivers=_drivers(these, robot.pid), properties=watched,
        applications=values["applications"], squad=squad,
    )  # fmt: skip
    settings = settings_of(_app(system), fleet, robot, _planner_budget(these, robot.pid))
    if squad:  # bundles of robots of several squads may lie in one folder, and the robots may have equal names
        settings["state"] = f"state/{squad}"
    return {
        **these.common,
        **these.target_files[target.name],
        **programs,
        "__main__.py": main.encode(),
        "requirements.txt": requirements(fleet, target),
        "README.md": render("README_agent.md", **values).encode(),
        "settings.json": as_json(settings),
    }


def _drivers(these: SystemIngredients, robot: int) -> list[tuple[str, str, str]]:
    """Return (module of a program, Python module, class) of each driver that a robot needs."""
    named = these.fleet.drivers
    modules = [m.name for a in these.system.applications if robot in a.members for m in a.program.modules]
    return [(name, named[name].module, named[name].name) for name in dict.fromkeys(modules) if name in named]


def slow_calls(these: SystemIngredients) -> list[tuple[int, Diagnostic]]:
    """Return a warning for each event whose port calls may take more than its application's part of half a round.

    Each warning comes with the number of the application; see check_calls.
    """
    found = []
    for index, application in enumerate(these.system.applications):
        for robot in application.members:
            part = these.fleet.delta * _parts_of_round(these, robot)[application.name]
            slow = check_calls(application.program, len(application.members), part, _planner_budget(these, robot))
            if slow:
                found += [(index, d) for d in slow]
                break
    return found


def _planner_budget(these: SystemIngredients, robot: int) -> float:
    """Return the seconds that each call of a port may take on a robot: the least of its applications."""
    fleet, parts = these.fleet, _parts_of_round(these, robot)
    found = [
        planner_budget(a.program, len(a.members), fleet.delta * parts[a.name], fleet.planner_budget)
        for a in these.system.applications
        if a.name in parts
    ]
    return min(found, default=LONGEST)


def _parts_of_round(these: SystemIngredients, robot: int) -> dict[str, float]:
    """Return the part of the time for events that each application of a robot may use; the parts add up to 1."""
    own = [a.name for a in these.system.applications if robot in a.members]
    rest = 1.0 - sum(these.shares.get(name, 0.0) for name in own)
    equal = rest / max(1, sum(name not in these.shares for name in own))
    parts = {name: these.shares.get(name, equal) for name in own}
    return {name: part / sum(parts.values()) for name, part in parts.items()}
