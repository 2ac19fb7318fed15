"""The fleet file: who is in the fleet, where, and what every robot of it must know. See docs/reference/fleet.md."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from koordgen.fleet.deployment import Deployment, read_deployment
from koordgen.fleet.located import Reader, Report, YamlNode
from koordgen.fleet.manifest import Target
from koordgen.fleet.medium import Link, read_link, read_network
from koordgen.fleet.mocap import Mocap, read_mocap
from koordgen.fleet.obstacles import Obstacle, read_box, read_obstacles
from koordgen.fleet.offered import Driver, Fits, Known, as_driver, read_settings
from koordgen.fleet.robots import Robot, read_robots
from koordgen.fleet.starts import check_starts
from koordgen.fleet.world import World, read_world
from koordgen.lang.node import Node
from koordgen.lang.source import Source, Span

# Thresholds of the safety layer, with the defaults of koordgen/runtime/config/settings.py (a test compares them).
SAFETY: dict[str, Any] = {
    "position_stale": 0.5,
    "position_lost": 2.0,
    "missed_rounds": 10,
    "missed_action": "hold",
    "peer_timeout": 10,
    "outside_fence": 0.5,
}
MISSED_ACTIONS = ("hold", "rest")  # as there (a test compares them)
MONITOR_ACTIONS = ("off", "log", "hold", "land", "stop")  # as there (a test compares them)
LEAST_TIMEOUT = 3  # rounds: what is lost is asked for in the round after, and some of that is lost again
GOING_ON = 5  # rounds after `peer_timeout` by which the others have gone on


class Fleet(Node):
    """A checked fleet file; plain values, as they go into the bundles' JSON. `harness` is keyed by target name;
    `params` are plain values: numbers, bools, texts, lists, tables; `drivers` is keyed by module."""

    application_id: int
    delta: float
    origin: dict[str, float]
    geofence: dict[str, list[float]]
    obstacles: tuple[Obstacle, ...]  # the world's walls behind those that the file lists
    world: World
    avoid: str  # the allread variable in which robots publish their paths; empty without one
    key: str  # file name; empty without one
    insecure: bool
    params: dict[str, Any]
    safety: dict[str, Any]
    monitors: dict[str, str]  # what robots do when a property is violated, by its name
    planner_budget: float | None  # seconds that a planner may take within an event; None: see bundle/calls.py
    drivers: dict[str, Driver]
    robots: tuple[Robot, ...]
    harness: dict[str, dict[str, Any]]
    link: Link | None  # None: nothing is said of it
    network: dict[str, Any]  # `transport`, and what the file says of it
    mocap: Mocap
    deployment: Deployment


def read(
    source: Source,
    targets: Mapping[str, Target],
    params: Mapping[str, Fits] | None,
    report: Report,
    known: Known = Known(),  # noqa: B008  (it does not change)
) -> Fleet | None:
    """Check a fleet file against the targets there are and the program's params (None: whatever they are); None after
    anything was reported."""
    mistakes: list[tuple[str, str, Span, str]] = []
    fleet = _read(Reader(source, lambda *mistake: mistakes.append(mistake)), source, targets, params, known, mistakes)
    for mistake in sorted(mistakes, key=lambda m: (m[2].line, m[2].column)):
        report(*mistake)
    return None if mistakes else fleet


def _read(
    reader: Reader,
    source: Source,
    targets: Mapping[str, Target],
    params: Mapping[str, Fits] | None,
    known: Known,
    mistakes: list[Any],
) -> Fleet:
    harnesses = sorted(name for name, t in targets.items() if t.kind == "harness")
    optional = ["application_id", "key", "insecure", "params", "safety", "obstacles", "modules"]
    optional += ["monitors", "planner_budget", "avoid", "link", "network", "mocap", "world", "deploy", *harnesses]
    top = reader.table(reader.document(), "the fleet file", ["delta", "origin", "geofence", "robots"], optional)
    origin = reader.table(top.get("origin"), "origin", ["latitude", "longitude", "altitude"], [])
    geofence = read_box(reader, top.get("geofence"), "geofence")
    obstacles = read_obstacles(reader, top.get("obstacles"), Path(source.path).parent)
    world = read_world(reader, top.get("world"), known)
    roster = read_robots(reader, top.get("robots"), targets, known)
    if not mistakes:
        check_starts(reader, roster, targets, geofence, world, obstacles)
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
        params={} if params is None else _params(reader, top.get("params"), params),
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
    )


def _key(reader: Reader, node: YamlNode | None, insecure: bool) -> str:
    """The key's file name; the key itself is put beside the settings by hand and never enters a bundle."""
    name: str | None = reader.scalar(node, "key", str)
    if name and node is not None and ("/" in name or "\\" in name or name.startswith(".")):
        reader.report("F005", f"key is a file name without folders, not {name!r}", node)
    if insecure and node is not None:
        reader.report("F005", "a fleet has a key or is insecure, not both", node, "leave one of the two out")
    return "" if insecure else name or "fleet.key"


def _avoid(reader: Reader, node: YamlNode | None, fits: Fits) -> str:
    name: str | None = reader.scalar(node, "avoid", str)
    if name is None or node is None:
        return ""
    if misfit := fits(name):
        reader.report("F005", misfit, node)
    return name


def _params(reader: Reader, node: YamlNode | None, known: Mapping[str, Fits]) -> dict[str, Any]:
    found = {}
    for name, value in reader.table(node, "params", [], known).items():
        found[name] = reader.plain(value, f"param {name}")
        misfit = known[name](found[name])
        if misfit:
            reader.report("F004", misfit, value)
    return found


def _drivers(reader: Reader, node: YamlNode | None) -> dict[str, Driver]:
    found: dict[str, Driver] = {}
    named = [key.value for key, _ in node.value] if isinstance(node, yaml.MappingNode) else []
    for module, value in reader.table(node, "modules", [], named).items():
        text: str = reader.scalar(value, f"the driver of {module}", str) or "a:A"
        driver = as_driver(text)
        if driver is None:
            reader.report("F005", f"{text!r} names no driver class", value, "for example drivers.hvac:Hvac")
        else:
            found[module] = driver
    return found


def _safety(reader: Reader, node: YamlNode | None) -> dict[str, Any]:
    found, given = dict(SAFETY), reader.table(node, "safety", [], SAFETY)
    for key, value in given.items():
        what = f"safety.{key}"
        match key:
            case "missed_action":
                found[key] = reader.choice(value, what, MISSED_ACTIONS)
            case "missed_rounds":
                found[key] = reader.number(value, f"{what} (rounds)", 1, 10000, int)
            case "peer_timeout":
                found[key] = reader.number(value, f"{what} (rounds)", LEAST_TIMEOUT, 10000, int)
            case _:
                found[key] = reader.number(value, f"{what} (seconds)", 0.05, 10000.0)
    if None in found.values() or found["missed_action"] != "rest":
        return found
    patience, missed = found["peer_timeout"] + GOING_ON, found["missed_rounds"]
    if missed <= patience:
        message = (
            f"missed_action rest after {missed} rounds would bring all robots to rest when one is gone: they miss up "
            f"to peer_timeout + {GOING_ON} = {patience} rounds before they go on without it"
        )
        help = f"say `missed_rounds: {patience + 1}` or more, or a shorter peer_timeout"
        reader.report("F005", message, given["missed_action"], help)
    return found


def _monitors(
    reader: Reader, node: YamlNode | None, known: Known, robots: tuple[Robot, ...], targets: Mapping[str, Target]
) -> dict[str, str]:
    named = [key.value for key, _ in node.value] if isinstance(node, yaml.MappingNode) else []
    there = named if known.properties is None else known.properties
    found = {}
    for name, value in reader.table(node, "monitors", [], ["default", *there]).items():
        # YAML 1.1 reads a bare `off` as false.
        bare = isinstance(value, yaml.ScalarNode) and value.value == "off"
        action = "off" if bare else reader.choice(value, f"monitors: {name}", MONITOR_ACTIONS)
        unable = [r.name for r in robots if action not in ("off", "log", *targets[r.target].actions)]
        if action is not None and unable:
            message = f"monitors: {name} is {action!r}, which {', '.join(unable)} cannot"
            reader.report("F005", message, value, "`stop` brings each robot to rest in its own way: a quad lands")
        elif action is not None:
            found[name] = action
    return found


def own_classes(fleet: Fleet, targets: Mapping[str, Target]) -> dict[str, Driver]:
    """The classes of the user's own that settings of robots name, by their file."""
    found: dict[str, Driver] = {}
    for robot in fleet.robots:
        for key, setting in targets[robot.target].settings.items():
            driver = as_driver(str(robot.settings[key])) if setting.methods else None
            if driver is not None:
                found[driver.path] = driver
    return found
