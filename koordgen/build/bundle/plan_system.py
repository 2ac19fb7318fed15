"""Plan of the bundles of several applications: one bundle for each robot, with the programs of all applications.

Every robot stores the variables of all applications, so every bundle has all programs. A fleet with one application on
all robots gets the bundles of a program (plan.py)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from koordgen import __version__
from koordgen.build.bundle.plan import (
    PARAMS,
    RELEASE,
    SOURCE,
    Files,
    Ingredients,
    as_json,
    facts_of,
    finished,
    plan,
    release_of,
    requirements,
    settings_of,
)
from koordgen.build.bundle.port_calls import LONGEST, planner_budget
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
from koordgen.lang.node import Node
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

    Raises NamesClash."""
    if is_alone(these.system):
        only, part = these.system.applications[0], these.parts[0]
        return plan(
            Ingredients(
                only.program, part.source, these.targets, these.fleet, these.common, these.target_files, part.beside,
                part.params,
            ),
            wanted,
        )  # fmt: skip
    these = these_with_sizes(these)
    programs, agents = _programs(these), {t.name: t for t in these.targets if t.kind == "agent"}
    robots = {r.name: _agent(these, agents[r.target], programs, r) for r in these.fleet.robots}
    release = {RELEASE: release_of(robots)}
    chosen = set(wanted)
    bundles = {r.name: finished(robots[r.name] | release) for r in these.fleet.robots if r.target in chosen}
    facts = facts_of(_app(these.system), _hashes(these), these.fleet)
    facts["applications"] = [
        {"name": a.name, "members": [these.fleet.robots[place].name for place in a.members]}
        for a in these.system.applications
    ]
    bundles["fleet"] = finished({"fleet.json": as_json(facts)} | release)
    return bundles


def these_with_sizes(these: SystemIngredients) -> SystemIngredients:
    """Return the ingredients whose programs know the numbers of the exporters' members."""
    return SystemIngredients(
        with_sizes(these.system), these.parts, these.targets, these.fleet, these.common, these.target_files,
        these.shares,
    )  # fmt: skip


def _app(system: System) -> str:
    """Return the name that stands for all applications; equal to FleetProgram.name."""
    return "+".join(application.name for application in system.applications)


def _functions(these: SystemIngredients) -> list[bytes]:
    """Return the content of each application's functions file; empty if it has none."""
    return [
        part.beside.get(f"{functions_module(application.program)}.py", b"")
        for application, part in zip(these.system.applications, these.parts, strict=True)
    ]


def _hashes(these: SystemIngredients) -> tuple[str, str]:
    return system_hash(these.system, _functions(these)), system_interface_hash(these.system)


def _programs(these: SystemIngredients) -> Files:
    """Return the files of all applications."""
    functions = _functions(these)
    files: Files = {"applications.py": applications_text(these.system, functions, these.shares).encode()}
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


def _agent(these: SystemIngredients, target: Target, programs: Files, robot: FleetRobot) -> Files:
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
    }
    main = render(
        "main_agent.py", module=module, name=name, drivers=_drivers(these, robot.pid), properties=watched,
        applications=values["applications"],
    )  # fmt: skip
    return {
        **these.common,
        **these.target_files[target.name],
        **programs,
        "__main__.py": main.encode(),
        "requirements.txt": requirements(fleet, target),
        "README.md": render("README_agent.md", **values).encode(),
        "settings.json": as_json(settings_of(_app(system), fleet, robot, _planner_budget(these, robot.pid))),
    }


def _drivers(these: SystemIngredients, robot: int) -> list[tuple[str, str, str]]:
    """Return (module of a program, Python module, class) of each driver that a robot needs."""
    named = these.fleet.drivers
    modules = [m.name for a in these.system.applications if robot in a.members for m in a.program.modules]
    return [(name, named[name].module, named[name].name) for name in dict.fromkeys(modules) if name in named]


def _planner_budget(these: SystemIngredients, robot: int) -> float:
    """Return the seconds that each call of a port may take on a robot: the least of its applications."""
    fleet, own = these.fleet, [a for a in these.system.applications if robot in a.members]
    rest = 1.0 - sum(these.shares.get(a.name, 0.0) for a in own)
    equal = rest / max(1, sum(a.name not in these.shares for a in own))
    parts = [these.shares.get(a.name, equal) for a in own]
    found = [
        planner_budget(a.program, len(a.members), fleet.delta * part / sum(parts), fleet.planner_budget)
        for a, part in zip(own, parts, strict=True)
    ]
    return min(found, default=LONGEST)
