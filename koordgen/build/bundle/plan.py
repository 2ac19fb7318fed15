"""Plan of bundles: a pure function from a checked program, targets and a fleet to the files of each bundle."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol

from koordgen import __version__
from koordgen.build.bundle.port_calls import planner_budget
from koordgen.build.bundle.write import SUMS, sums
from koordgen.build.emit.program import functions_module, interface_hash, program_hash, program_text
from koordgen.build.emit.property import has_properties, properties_text
from koordgen.build.emit.render import render
from koordgen.fleet.manifest import Target
from koordgen.lang.ir.decl import Program
from koordgen.lang.node import Node

if TYPE_CHECKING:  # importing YAML costs too much for builds without a fleet file
    from koordgen.fleet.file import Fleet
    from koordgen.fleet.robots import FleetRobot

Files = dict[str, bytes]
# Each bundle of a fleet has this file with the name of the release. An agent ignores agents of other releases.
RELEASE, RELEASE_SIZE = "RELEASE", 16  # bytes of the digest that names a release
ZENOH = "eclipse-zenoh>=1.10"
# Folder with the source, and file with the params, of every bundle and every run. A replay of traces needs both.
SOURCE, PARAMS = "source", "params.json"
COMPOSITION = "composition.json"  # in SOURCE, only with several applications: facts for the header of a run's trace


class Ingredients(Node):
    """Inputs of a plan, read from disk beforehand. Files are keyed by their path in a bundle.

    `common`: files of every bundle. `target_files`: files of each target, by its name. `beside`: the user's own Python
    files. `params`: values of params that replace their defaults.
    """

    program: Program
    source: bytes
    targets: tuple[Target, ...]
    fleet: Fleet | None
    common: Files
    target_files: dict[str, Files]
    beside: Files
    params: Mapping[str, Any]


def plan(these: Ingredients, wanted: Iterable[str]) -> dict[str, Files]:
    """Return bundle name -> relative path -> bytes, for the targets named in `wanted`.

    With a fleet: one bundle for each robot, one for each harness in `wanted`, and `fleet`. Without a fleet: one bundle
    for each target.
    """
    text = text_of(these)
    agents = {t.name: t for t in these.targets if t.kind == "agent"}
    harnesses = [t for t in these.targets if t.kind == "harness" and t.name in wanted]
    if these.fleet is None:
        built = {t.name: finished(agent_bundle(these, t, text, None)) for t in agents.values() if t.name in wanted}
        bundles = dict(built)
    else:
        parts = {r.name: agent_bundle(these, agents[r.target], text, r) for r in these.fleet.robots}
        facts: Files = {"fleet.json": as_json(program_facts(these, these.fleet))}
        release = {RELEASE: release_of(parts)}
        built = {name: finished(files | release) for name, files in parts.items()}
        bundles = {r.name: built[r.name] for r in these.fleet.robots if r.target in wanted}
        bundles["fleet"] = finished(facts | release)
    for harness in harnesses:
        bundles[harness.name] = _harness(these, harness, text, built)
    return bundles


def text_of(these: Ingredients) -> bytes:
    """Return the generated program."""
    return program_text(these.program, _functions(these)).encode()


def agent_bundle(these: Ingredients, target: Target, text: bytes, robot: FleetRobot | None) -> Files:
    """Return the files of a robot of a target, without the release. `text`: the generated program."""
    module, _, name = target.entry.partition(":")
    program, fleet = these.program, these.fleet
    values = {
        "app": program.name,
        "robot": robot.name if robot else "",
        "pid": robot.pid if robot else "",
        "key": fleet.key if fleet else "",
        "target": target.name,
        "summary": target.summary,
        "source": program.path,
        "version": __version__,
        "program_hash": program_hash(program, _functions(these)),
        "interface_hash": interface_hash(program),
        "applications": (),
        "squad": "",
        "outer_key": "",
    }
    main = render(
        "main_agent.py", module=module, name=name, drivers=_drivers(these), properties=has_properties(program),
        applications=(), squad="",
    )  # fmt: skip
    files = {
        **these.common,
        **these.target_files[target.name],
        **program_files(these, text),
        "__main__.py": main.encode(),
        "requirements.txt": requirements(fleet, target),
        "README.md": render("README_agent.md", **values).encode(),
    }
    if robot is not None and fleet is not None:
        files["settings.json"] = as_json(settings(program, fleet, robot))
    return files


def program_files(these: Ingredients, text: bytes) -> Files:
    """Return the files of the program: generated code, the user's own Python files, source and params.

    `text`: the generated program.
    """
    return {
        **these.beside,
        "program.py": text,
        **_properties(these),
        these.program.path: these.source,
        PARAMS: as_json(dict(these.params)),
    }


def release_of(parts: Mapping[str, Files]) -> bytes:
    """Return the name of the release: a digest of the files of all robots, even of those that are not built now.

    Robots have equal names exactly if they come from the same program, fleet file, params and version.
    """
    digest = sha256()
    for name, files in sorted(parts.items()):
        digest.update(f"{name}\n".encode() + sums(files))
    return f"{digest.hexdigest()[: 2 * RELEASE_SIZE]}\n".encode()


def _functions(these: Ingredients) -> bytes:
    return these.beside.get(f"{functions_module(these.program)}.py", b"")


def _properties(these: Ingredients) -> Files:
    """Return `properties.py` if the program has properties or port assumptions."""
    if not has_properties(these.program):
        return {}
    return {"properties.py": properties_text(these.program, these.fleet.drivers if these.fleet else ()).encode()}


def _drivers(these: Ingredients) -> list[tuple[str, str, str]]:
    """Return (module of the program, Python module, class) of each driver that agents need."""
    named = these.fleet.drivers if these.fleet else {}
    return [(m.name, named[m.name].module, named[m.name].name) for m in these.program.modules if m.name in named]


def _harness(these: Ingredients, target: Target, text: bytes, agents: dict[str, Files]) -> Files:
    program, fleet = these.program, these.fleet
    own = harness_files(these, text)
    if fleet is not None:
        own["scenario.json"] = as_json(_scenario(these, fleet, target))
    robots = [(r.name, r.target) for r in fleet.robots] if fleet else []
    return harness_bundle(these, target, robots, own, agents, program.name, program.path)


def harness_files(these: Ingredients, text: bytes) -> Files:
    """Return the files of the program in the bundle of a harness. `text`: the generated program."""
    program = these.program
    functions = f"{functions_module(program)}.py"
    return {
        **{path: data for path, data in these.beside.items() if path == functions},
        "program.py": text,
        **_properties(these),
        f"{SOURCE}/{program.path}": these.source,
        f"{SOURCE}/{PARAMS}": as_json(dict(these.params)),
        **{f"{SOURCE}/{path}": data for path, data in these.beside.items() if path == functions},
    }


class HarnessIngredients(Protocol):
    """Inputs of a harness's bundle that do not depend on the programs; see Ingredients."""

    @property
    def targets(self) -> tuple[Target, ...]: ...
    @property
    def common(self) -> Files: ...
    @property
    def target_files(self) -> dict[str, Files]: ...


def harness_bundle(
    these: HarnessIngredients,
    target: Target,
    robots: Sequence[tuple[str, str]],
    own: Files,
    agents: dict[str, Files],
    app: str,
    source: str,
) -> Files:
    """Return the bundle of a harness, which contains the bundles of all robots.

    `robots`: name and target of each robot. `own`: files of the programs, and the scenario. `app`, `source`: names of
    the program and its file, for people.
    """
    module, _, name = target.entry.partition(":")
    files = {
        **these.common,
        **these.target_files[target.name],
        **{path: data for name in sorted({r[1] for r in robots}) for path, data in these.target_files[name].items()},
        **own,
        "__main__.py": render("main_harness.py", module=module, name=name).encode(),
        "requirements.txt": requirements(None, target, *(t for t in these.targets if t.kind == "agent")),
        "README.md": render(
            "README_harness.md", app=app, source=source, target=target.name, summary=target.summary,
            version=__version__, robots=robots,
        ).encode(),
    }  # fmt: skip
    for agent, contents in agents.items():
        files.update({f"agents/{agent}/{path}": data for path, data in contents.items()})
    return finished(files)


def finished(files: Files) -> Files:
    return {**files, SUMS: sums(files)}


def requirements(fleet: Fleet | None, *targets: Target) -> bytes:
    """Return `requirements.txt`. `fleet`: the fleet whose network the robots use; None in a simulator (loopback)."""
    lines = dict.fromkeys(line for target in targets for line in target.requirements)
    if fleet is not None and fleet.network["transport"] == "zenoh":
        lines[ZENOH] = None
    return "".join(f"{line}\n" for line in lines).encode()


def as_json(value: Any) -> bytes:
    return (json.dumps(value, indent=2) + "\n").encode()


def program_facts(these: Ingredients, fleet: Fleet) -> dict[str, Any]:
    """Return the values that all robots of a fleet with one program have in common."""
    hashes = program_hash(these.program, _functions(these)), interface_hash(these.program)
    return facts_of(these.program.name, hashes, fleet)


def facts_of(app: str, hashes: tuple[str, str], fleet: Fleet) -> dict[str, Any]:
    """Return the values that all robots of the fleet have in common. `hashes`: of the program, of the interface."""
    return {
        "app": app,
        "program_hash": hashes[0],
        "interface_hash": hashes[1],
        "application_id": fleet.application_id,
        "delta": fleet.delta,
        "origin": fleet.origin,
        "geofence": fleet.geofence,
        "obstacles": fleet.obstacles,
        "peers": [_peer(robot) for robot in fleet.robots],
    }


def _peer(robot: FleetRobot) -> dict[str, Any]:
    """Return name and address of a robot, and the further addresses of a squad."""
    found: dict[str, Any] = {"name": robot.name, "host": robot.host, "port": robot.port}
    if robot.inner is not None:
        found["also"] = [{"host": host, "port": port} for host, port in robot.inner.addresses[1:]]
    return found


def settings(program: Program, fleet: Fleet, robot: FleetRobot) -> dict[str, Any]:
    """Return the content of the `settings.json` of a robot that runs a program."""
    budget = planner_budget(program, len(fleet.robots), fleet.delta, fleet.planner_budget)
    return settings_of(program.name, fleet, robot, budget)


def settings_of(app: str, fleet: Fleet, robot: FleetRobot, budget: float) -> dict[str, Any]:
    """Return the content of one robot's `settings.json`, which koordgen/runtime/config/settings.py reads.

    `app`: name of the program or of all applications. `budget`: seconds that a call of a port may take.
    """
    facts = facts_of(app, ("", ""), fleet)
    shared = {k: facts[k] for k in ("app", "application_id", "delta", "origin", "geofence", "obstacles", "peers")}
    return {
        "robot": robot.name,
        "pid": robot.pid,
        **shared,
        "key_file": fleet.key or None,
        "insecure": fleet.insecure,
        "network": fleet.network,
        "control": robot.control,
        "planner_budget": budget,
        "safety": fleet.safety,
        "monitors": fleet.monitors,
        "avoid": fleet.avoid,
        "body": robot.settings,
    }


def _scenario(these: Ingredients, fleet: Fleet, harness: Target) -> dict[str, Any]:
    robots = [scenario_robot(robot, robot.name, robot.pid, harness, these.targets) for robot in fleet.robots]
    return scenario_of(described(these, fleet), fleet, harness, robots)


def described(these: Ingredients, fleet: Fleet) -> dict[str, Any]:
    """Return what a scenario says of a fleet with one program, except for its robots."""
    store = {**store_facts(these.program), "drivers": _drivers(these)}
    return described_by(program_facts(these, fleet), these.program.path, store)


def described_by(facts: Mapping[str, Any], source: str, store: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a scenario says of a fleet, except for its robots.

    `facts`: see `facts_of`. `source`: files of the programs, for people. `store`: see `store_facts`, and the module of
    a program, the Python module and the class of each driver.
    """
    own = {k: facts[k] for k in ("program_hash", "application_id", "delta", "origin", "geofence", "obstacles")}
    return {"app": facts["app"], "source": source, **own, **store}


def scenario_of(
    described: Mapping[str, Any], fleet: Fleet, harness: Target, robots: list[dict[str, Any]]
) -> dict[str, Any]:
    """Return the content of a harness's `scenario.json`.

    `described`: see described_by. `robots`: see scenario_robot.
    """
    of_world = ("app", "source", "program_hash", "application_id", "delta", "origin", "geofence", "obstacles")
    return {
        **{key: described[key] for key in of_world},
        "world": fleet.world.facts,
        **{key: value for key, value in described.items() if key not in of_world},
        "harness": fleet.harness.get(harness.name) or {k: s.default for k, s in harness.settings.items()},
        "robots": robots,
    }


def scenario_robot(
    robot: FleetRobot, name: str, place: int, harness: Target, targets: Iterable[Target]
) -> dict[str, Any]:
    """Return what a scenario says of a physical robot. `name`, `place`: its name and its number in the scenario."""
    simulation = next(target.simulation for target in targets if target.name == robot.target)
    return {
        "name": name,
        "pid": place,
        "target": robot.target,
        "bundle": f"agents/{name}",
        **simulation,
        "start": robot.start,
        "settings": robot.settings,
        harness.name: robot.harness.get(harness.name, {}),
    }


def store_facts(program: Program) -> dict[str, Any]:
    """Return the shared variables and record types in the form of a scenario and of the header of a run's trace."""
    return {
        "shared": [{"name": v.name, "kind": v.kind, "type": str(v.type)} for v in program.shared],
        "records": {str(r.type): [[name, str(t)] for name, t in r.type.fields] for r in program.records},
    }


def read_ingredients(
    program: Program,
    source: bytes,
    targets: tuple[Target, ...],
    fleet: Fleet | None,
    package: Path,
    beside: Mapping[str, Path] = MappingProxyType({}),
    params: Mapping[str, Any] = MappingProxyType({}),
) -> Ingredients:
    """Read all files that are copied into bundles.

    `package`: folder of the koordgen package. `beside`: the user's own files, by their path in a bundle.
    """
    own = {path: file.read_bytes() for path, file in beside.items()}
    return Ingredients(program, source, targets, fleet, *read_common(targets, package), own, params)


def read_common(targets: tuple[Target, ...], package: Path) -> tuple[Files, dict[str, Files]]:
    """Read the files of every bundle, and those of each target by its name. `package`: see read_ingredients."""
    common = {"koordgen/__init__.py": (package / "__init__.py").read_bytes()}
    common.update(_folder(package / "runtime", "koordgen/runtime"))
    common["targets/__init__.py"] = (targets[0].folder.parent / "__init__.py").read_bytes()
    return common, {t.name: _target_files(t) for t in targets}


def _target_files(target: Target) -> Files:
    folders = (target.folder, *(target.folder.parent / name for name in target.also))
    return {path: data for folder in folders for path, data in _folder(folder, f"targets/{folder.name}").items()}


def _folder(folder: Path, prefix: str) -> Files:
    """Read the Python, C (compiled on the robot) and web files and the third-party licences of a folder."""
    found = (p for kind in ("*.py", "*.c", "*.js", "*.css", "LICENSE") for p in sorted(folder.rglob(kind)))
    return {f"{prefix}/{p.relative_to(folder).as_posix()}": p.read_bytes() for p in found}
