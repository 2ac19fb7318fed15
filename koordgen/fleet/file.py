"""Fleet file: the robots of a fleet, their world, and settings that all robots share. See docs/reference/fleet.md."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from koordgen.fleet.applications import ApplicationSettings, read_applications
from koordgen.fleet.deployment import DeploymentSettings, read_deployment
from koordgen.fleet.manifest import Target
from koordgen.fleet.medium import Medium, read_link, read_network
from koordgen.fleet.mocap import Mocap, read_mocap
from koordgen.fleet.obstacles import Obstacle, read_box, read_obstacles
from koordgen.fleet.robots import FleetRobot, actions_of, read_robots
from koordgen.fleet.settings import DriverClass, NameChecks, ValueCheck, as_driver, read_settings
from koordgen.fleet.starts import check_starts
from koordgen.fleet.world import FleetWorld, read_world
from koordgen.fleet.yaml_reader import Report, YamlNode, YamlReader
from koordgen.lang.node import Node
from koordgen.lang.source import Source, Span

# Thresholds of the safety layer. Defaults are equal to those of koordgen/runtime/config/settings.py (tested).
SAFETY: dict[str, Any] = {
    "position_stale": 0.5,
    "position_lost": 2.0,
    "missed_rounds": 10,
    "missed_action": "hold",
    "peer_timeout": 10,
    "outside_fence": 0.5,
}
MISSED_ACTIONS = ("hold", "stop")  # equal to those of settings.py (tested)
MONITOR_ACTIONS = ("off", "log", "hold", "land", "stop")  # equal to those of settings.py (tested)
LEAST_TIMEOUT = 3  # rounds: a lost datagram is requested one round later, and the answer may be lost as well
GOING_ON = 5  # rounds after `peer_timeout` within which the other robots have removed a dead robot and continue


class Fleet(Node):
    """A checked fleet file, as plain values of the bundles' JSON files.

    params: numbers, bools, texts, lists and tables, by the param's name. drivers: by module. harness: settings of
    harnesses, by the target's name. applications: empty if the command line names the only program of the fleet.
    inner_fleets: the fleet of each squad, by the squad's name; empty before the inner fleet files are read.
    """

    application_id: int
    delta: float
    origin: dict[str, float]
    geofence: dict[str, list[float]]
    obstacles: tuple[Obstacle, ...]  # those that the file lists, then the walls of the world
    world: FleetWorld
    avoid: str  # name of the allread variable in which robots publish their paths, or ""
    key: str  # name of the key's file; "" for an insecure fleet
    insecure: bool
    params: dict[str, Any]
    safety: dict[str, Any]
    monitors: dict[str, str]  # action of the robots when a property is violated, by the property's name
    planner_budget: float | None  # seconds of one port call; None: the default of bundle/port_calls.py
    drivers: dict[str, DriverClass]
    robots: tuple[FleetRobot, ...]
    harness: dict[str, dict[str, Any]]
    link: Medium | None  # None if the file has no `link`
    network: dict[str, Any]  # `transport`, and its settings
    mocap: Mocap
    deployment: DeploymentSettings
    applications: tuple[ApplicationSettings, ...] = ()
    inner_fleets: Mapping[str, Fleet] = MappingProxyType({})

    @property
    def squads(self) -> tuple[FleetRobot, ...]:
        """Robots that are fleets themselves."""
        return tuple([robot for robot in self.robots if robot.inner is not None])


def read(
    source: Source,
    targets: Mapping[str, Target],
    params: Mapping[str, ValueCheck] | None,
    report: Report,
    known: NameChecks = NameChecks(),  # noqa: B008  (it does not change)
) -> Fleet | None:
    """Read and check a fleet file. Return None if an error was reported.

    `targets`: all existing targets, by name. `params`: a check for each param of the program; None skips these checks.
    """
    mistakes: list[tuple[str, str, Span, str]] = []
    fleet = _read(
        YamlReader(source, lambda *mistake: mistakes.append(mistake)), source, targets, params, known, mistakes
    )
    for mistake in sorted(mistakes, key=lambda m: (m[2].line, m[2].column)):
        report(*mistake)
    return None if mistakes else fleet


def _read(
    reader: YamlReader,
    source: Source,
    targets: Mapping[str, Target],
    params: Mapping[str, ValueCheck] | None,
    known: NameChecks,
    mistakes: list[Any],
) -> Fleet:
    harnesses = sorted(name for name, t in targets.items() if t.kind == "harness")
    optional = ["application_id", "key", "insecure", "params", "safety", "obstacles", "modules", "applications"]
    optional += ["monitors", "planner_budget", "avoid", "link", "network", "mocap", "world", "deploy", *harnesses]
    top = reader.table(reader.document(), "the fleet file", ["delta", "origin", "geofence", "robots"], optional)
    origin = reader.table(top.get("origin"), "origin", ["latitude", "longitude", "altitude"], [])
    geofence = read_box(reader, top.get("geofence"), "geofence")
    obstacles = read_obstacles(reader, top.get("obstacles"), Path(source.path).parent)
    world = read_world(reader, top.get("world"), known)
    roster = read_robots(reader, top.get("robots"), targets, known)
    if not mistakes:
        check_starts(reader, roster, targets, geofence, world, obstacles)
    applications = read_applications(reader, top.get("applications"), [robot.name for robot in roster.robots])
    if applications and "params" in top:
        help = "move each param into the entry of its application, under `params:`"
        reader.report("F005", "params of several applications do not stand here", top["params"], help)
    insecure = bool(reader.scalar(top.get("insecure"), "insecure", bool))
    return Fleet(
        application_id=reader.number(top.get("application_id"), "application_id", 0, 65535, int) or 0,
        delta=reader.number(top.get("delta"), "delta", 0.005, 60.0),
        origin={
            "latitude": reader.number(origin.get("latitude"), "latitude (degrees)", -90, 90),
            "longitude": reader.number(origin.get("longitude"), "longitude (degrees)", -180, 180),
            "altitude": reader.number(origin.get("altitude"), "altitude (metres)", -1000, 10000),
        },
        geofence=geofence,
        obstacles=(*obstacles, *(wall.obstacle() for wall in world.walls)),
        world=world,
        avoid=_avoid(reader, top.get("avoid"), known.avoid),
        key=_key(reader, top.get("key"), insecure),
        insecure=insecure,
        params={} if params is None or applications else _params(reader, top.get("params"), params),
        safety=_safety(reader, top.get("safety")),
        monitors=_monitors(reader, top.get("monitors"), known, roster.robots, targets),
        planner_budget=reader.number(top.get("planner_budget"), "planner_budget (seconds)", 0.0005, 1.0),
        drivers=_drivers(reader, top.get("modules")),
        robots=roster.robots,
        harness={n: read_settings(reader, top[n], n, targets[n].settings, known) for n in harnesses if n in top},
        link=read_link(reader, top.get("link")),
        network=read_network(reader, top.get("network")),
        mocap=read_mocap(reader, top.get("mocap")),
        deployment=read_deployment(reader, top.get("deploy")),
        applications=applications,
    )


def _key(reader: YamlReader, node: YamlNode | None, insecure: bool) -> str:
    """Read the name of the key's file. The user copies the key beside `settings.json`; no bundle contains it."""
    name: str | None = reader.scalar(node, "key", str)
    if name and node is not None and ("/" in name or "\\" in name or name.startswith(".")):
        help = "write the name of a file in the folder of `settings.json`, for example fleet.key"
        reader.report("F005", f"key must be a file name without folders, not {name!r}", node, help)
    if insecure and node is not None:
        reader.report("F005", "a fleet has a key or is insecure, not both", node, "remove `key` or `insecure`")
    return "" if insecure else name or "fleet.key"


def _avoid(reader: YamlReader, node: YamlNode | None, fits: ValueCheck) -> str:
    name: str | None = reader.scalar(node, "avoid", str)
    if name is None or node is None:
        return ""
    if misfit := fits(name):
        reader.report("F005", misfit, node)
    return name


def _params(reader: YamlReader, node: YamlNode | None, known: Mapping[str, ValueCheck]) -> dict[str, Any]:
    found = {}
    for name, value in reader.table(node, "params", [], known).items():
        found[name] = reader.plain(value, f"param {name}")
        misfit = known[name](found[name])
        if misfit:
            reader.report("F004", misfit, value)
    return found


def _drivers(reader: YamlReader, node: YamlNode | None) -> dict[str, DriverClass]:
    found: dict[str, DriverClass] = {}
    named = [key.value for key, _ in node.value] if isinstance(node, yaml.MappingNode) else []
    for module, value in reader.table(node, "modules", [], named).items():
        text: str = reader.scalar(value, f"the driver of {module}", str) or "a:A"
        driver = as_driver(text)
        if driver is None:
            help = "write MODULE:CLASS, for example drivers.hvac:Hvac"
            reader.report("F005", f"{text!r} does not name a driver class", value, help)
        else:
            found[module] = driver
    return found


def _safety(reader: YamlReader, node: YamlNode | None) -> dict[str, Any]:
    found, given = dict(SAFETY), reader.table(node, "safety", [], SAFETY)
    for key, value in given.items():
        what = f"safety.{key}"
        match key:
            case "missed_action":
                found[key] = reader.choice(value, what, MISSED_ACTIONS, {"rest": "stop"})
            case "missed_rounds":
                found[key] = reader.number(value, f"{what} (rounds)", 1, 10000, int)
            case "peer_timeout":
                found[key] = reader.number(value, f"{what} (rounds)", LEAST_TIMEOUT, 10000, int)
            case _:
                found[key] = reader.number(value, f"{what} (seconds)", 0.05, 10000.0)
    if None in found.values() or found["missed_action"] != "stop":
        return found
    recovery, missed = found["peer_timeout"] + GOING_ON, found["missed_rounds"]
    if missed <= recovery:
        message = (
            f"missed_action stop after {missed} rounds would stop all robots when one robot is lost: the others miss "
            f"up to peer_timeout + {GOING_ON} = {recovery} rounds before they continue without it"
        )
        help = f"write `missed_rounds: {recovery + 1}` or more, or a shorter peer_timeout"
        reader.report("F005", message, given["missed_action"], help)
    return found


def _monitors(
    reader: YamlReader,
    node: YamlNode | None,
    known: NameChecks,
    robots: tuple[FleetRobot, ...],
    targets: Mapping[str, Target],
) -> dict[str, str]:
    named = [key.value for key, _ in node.value] if isinstance(node, yaml.MappingNode) else []
    there = named if known.properties is None else known.properties
    found = {}
    for name, value in reader.table(node, "monitors", [], ["default", *there]).items():
        # In YAML 1.1 an unquoted `off` is the bool false.
        bare = isinstance(value, yaml.ScalarNode) and value.value == "off"
        action = "off" if bare else reader.choice(value, f"monitors: {name}", MONITOR_ACTIONS)
        unable = [r.name for r in robots if action not in ("off", "log", *actions_of(r, targets))]
        if action is not None and unable:
            message = f"monitors: {name} is {action!r}, which these robots cannot do: {', '.join(unable)}"
            reader.report("F005", message, value, "use `stop`: each robot stops in its own way, and a quad lands")
        elif action is not None:
            found[name] = action
    return found


def own_classes(fleet: Fleet, targets: Mapping[str, Target]) -> dict[str, DriverClass]:
    """Return the user's own classes that settings of robots name, by the path of their file."""
    found: dict[str, DriverClass] = {}
    for robot in fleet.robots:
        for key, setting in targets[robot.target].settings.items() if robot.inner is None else ():
            driver = as_driver(str(robot.settings[key])) if setting.methods else None
            if driver is not None:
                found[driver.path] = driver
    return found
