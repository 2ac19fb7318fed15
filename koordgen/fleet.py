"""The fleet file: who is in the fleet, where, and what every robot of it must know. See docs/fleet.md."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml

from koordgen.located import Reader, Report, YamlNode
from koordgen.manifest import SETTING_TYPES, Setting, Target
from koordgen.medium import Link, read_link, read_network
from koordgen.mocap import Mocap, read_mocap
from koordgen.node import Node
from koordgen.obstacles import Obstacle, read_box, read_obstacles
from koordgen.source import Source

_NAME = re.compile(r"[a-z][a-z0-9_-]{0,31}")
_DRIVER = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)
_ADDRESS = re.compile(r"([A-Za-z0-9.-]+|\[[0-9A-Fa-f:.]+\]):(\d{1,5})")
# Thresholds of the safety layer, with the defaults of koordgen/runtime/settings.py (a test compares them).
SAFETY: dict[str, Any] = {
    "position_stale": 0.5,
    "position_lost": 2.0,
    "missed_rounds": 10,
    "missed_action": "hold",
    "peer_timeout": 10,
    "outside_fence": 0.5,
}
MISSED_ACTIONS = ("hold", "rest")  # as there (a test compares them)
LEAST_TIMEOUT = 3  # rounds: what is lost is asked for in the round after, and some of that is lost again
GOING_ON = 5  # rounds after `peer_timeout` by which the others have gone on
MOST_ROBOTS = 128  # as koordgen/runtime/wire.py allows (a test compares them)


# What is wrong with a value for one param of the program; "" for one that fits.
Fits = Callable[[Any], str]


class Robot(Node):
    """One robot. `start` holds `position` (m, ENU) and `yaw` (rad): where the simulator puts it."""

    name: str
    pid: int
    target: str
    host: str
    port: int
    control: int  # port of emergency stop and status, at the same host
    start: dict[str, Any]
    settings: dict[str, Any]


class Driver(Node):
    """The class `name` that serves a module; `module` is its Python module, dotted, `path` the file of that."""

    module: str
    name: str

    @property
    def path(self) -> str:
        return f"{self.module.replace('.', '/')}.py"


def _anything(value: Any) -> str:
    return ""


def _any_class(driver: Driver, methods: tuple[str, ...]) -> str:
    return ""


class Known(Node):
    """What the file's names must fit: `avoid` tells of a variable's name, `own_class` of a class with these methods,
    made with one argument, what is wrong with it, or ""."""

    avoid: Fits = _anything
    own_class: Callable[[Driver, tuple[str, ...]], str] = _any_class


class Fleet(Node):
    """A checked fleet file; plain values, as they go into the bundles' JSON. `harness` is keyed by target name;
    `params` are plain values: numbers, bools, texts, lists, tables; `drivers` is keyed by module."""

    application_id: int
    delta: float
    origin: dict[str, float]
    geofence: dict[str, list[float]]
    obstacles: tuple[Obstacle, ...]
    avoid: str  # the allread variable in which robots publish their paths; empty without one
    key: str  # file name; empty without one
    insecure: bool
    params: dict[str, Any]
    safety: dict[str, Any]
    planner_budget: float  # seconds that a planner may take within an event
    drivers: dict[str, Driver]
    robots: tuple[Robot, ...]
    harness: dict[str, dict[str, Any]]
    link: Link | None  # None: nothing is said of it
    network: dict[str, Any]  # `transport`, and what the file says of it
    mocap: Mocap


def read(
    source: Source,
    targets: Mapping[str, Target],
    params: Mapping[str, Fits] | None,
    report: Report,
    known: Known = Known(),  # noqa: B008  (it does not change)
) -> Fleet | None:
    """Check a fleet file against the targets there are and the program's params (None: whatever they are); None after
    anything was reported."""
    mistakes = 0

    def counted(code: str, message: str, span: Any, help: str) -> None:
        nonlocal mistakes
        mistakes += 1
        report(code, message, span, help)

    reader = Reader(source, counted)
    harnesses = sorted(name for name, t in targets.items() if t.kind == "harness")
    optional = ["application_id", "key", "insecure", "params", "safety", "obstacles", "modules"]
    optional += ["planner_budget", "avoid", "link", "network", "mocap", *harnesses]
    top = reader.table(reader.document(), "the fleet file", ["delta", "origin", "geofence", "robots"], optional)
    origin = reader.table(top.get("origin"), "origin", ["latitude", "longitude", "altitude"], [])
    insecure = bool(reader.scalar(top.get("insecure"), "insecure", bool))
    fleet = Fleet(
        application_id=reader.number(top.get("application_id"), "application_id", 0, 65535, int) or 0,
        delta=reader.number(top.get("delta"), "delta", 0.005, 60.0),
        origin={
            "latitude": reader.number(origin.get("latitude"), "latitude (degrees)", -90, 90),
            "longitude": reader.number(origin.get("longitude"), "longitude (degrees)", -180, 180),
            "altitude": reader.number(origin.get("altitude"), "altitude (metres)", -1000, 10000),
        },
        geofence=read_box(reader, top.get("geofence"), "geofence"),
        obstacles=read_obstacles(reader, top.get("obstacles"), Path(source.path).parent),
        avoid=_avoid(reader, top.get("avoid"), known.avoid),
        key=_key(reader, top.get("key"), insecure),
        insecure=insecure,
        params={} if params is None else _params(reader, top.get("params"), params),
        safety=_safety(reader, top.get("safety")),
        planner_budget=reader.number(top.get("planner_budget"), "planner_budget (seconds)", 0.0005, 1.0) or 0.01,
        drivers=_drivers(reader, top.get("modules")),
        robots=_robots(reader, top.get("robots"), targets, known),
        harness={n: _settings(reader, top[n], n, targets[n].settings, known) for n in harnesses if n in top},
        link=read_link(reader, top.get("link")),
        network=read_network(reader, top.get("network")),
        mocap=read_mocap(reader, top.get("mocap")),
    )
    return None if mistakes else fleet


def parse_address(text: str) -> tuple[str, int]:
    """Host and port of HOST:PORT; ("", 0) for what is none."""
    found = _ADDRESS.fullmatch(text)
    if not found or not 1 <= int(found[2]) <= 65535:
        return "", 0
    return found[1].strip("[]"), int(found[2])


def control_port(port: int) -> int:
    """Where a robot takes orders by default, as koordgen/runtime/settings.py has it (a test compares them)."""
    return port + 1000 if port + 1000 <= 65535 else port - 1000


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


def _robots(reader: Reader, node: YamlNode | None, targets: Mapping[str, Target], known: Known) -> tuple[Robot, ...]:
    entries = reader.items(node, "robots")
    if node is not None and not 1 <= len(entries) <= MOST_ROBOTS:
        reader.report("F005", f"robots lists {len(entries)}; a fleet has 1 to {MOST_ROBOTS}", node)
    robots: list[Robot] = []
    seen: dict[object, str] = {}
    for pid, entry in enumerate(entries):
        what = f"robot {pid}"
        keys = reader.table(entry, what, ["name", "target", "address"], ["control", "start", "settings"])
        name = _name(reader, keys.get("name"), targets)
        host, port = _address(reader, keys.get("address"))
        control = reader.number(keys.get("control"), "control", 1, 65535, int) or control_port(port)
        taken: list[tuple[str, object, str | None]] = [("name", name, name)]
        if port:
            repeated = (host, port) in seen  # then so is its usual control port: one mistake
            taken.append(("address", (host, port), f"{host}:{port}"))
            taken += [("control", (host, control), f"{host}:{control}")] if not repeated else []
        for key, value, shown in taken:
            if value is not None and seen.setdefault(value, f"{what}'s {key}") != f"{what}'s {key}":
                help = "" if key in keys else "`control: PORT` sets another port for emergency stop and status"
                reader.report("F006", f"{key} {shown} is already {seen[value]}", keys.get(key, entry), help)
        target = _target(reader, keys.get("target"), targets)
        settings = {}
        if target:
            settings = _settings(reader, keys.get("settings"), f"{what}'s settings", target.settings, known)
        start = _start(reader, keys.get("start"), what)
        robots.append(Robot(name or "", pid, target.name if target else "", host, port, control, start, settings))
    return tuple(robots)


def _name(reader: Reader, node: YamlNode | None, targets: Mapping[str, Target]) -> str | None:
    name: str | None = reader.scalar(node, "name", str)
    if name is None or node is None:
        return None
    # Names become folders beside these.
    if not _NAME.fullmatch(name) or name in ("fleet", "state") or name in targets:
        reader.report(
            "F005", f"{name!r} cannot name a robot", node,
            "a letter, then letters, digits, - or _, all lower case, at most 32; not fleet, state or a target's name",
        )  # fmt: skip
        return None
    return name


def _address(reader: Reader, node: YamlNode | None) -> tuple[str, int]:
    text: str | None = reader.scalar(node, "address", str)
    if text is None or node is None:
        return "", 0
    host, port = parse_address(text)
    if not port:
        reader.report("F005", f"address {text!r} is not HOST:PORT", node, "for example 192.168.1.20:47100")
        return "", 0
    if host in ("0.0.0.0", "::"):
        reader.report("F005", f"nothing can be sent to {host}", node, "name the address at which the peers reach it")
        return "", 0
    return host, port


def _target(reader: Reader, node: YamlNode | None, targets: Mapping[str, Target]) -> Target | None:
    name: str | None = reader.scalar(node, "target", str)
    if name is None or node is None:
        return None
    agents = sorted(n for n, t in targets.items() if t.kind == "agent")
    if name not in agents:
        reader.report("F007", f"no target {name!r} that a robot could be", node, f"there are: {', '.join(agents)}")
        return None
    return targets[name]


def _start(reader: Reader, node: YamlNode | None, what: str) -> dict[str, Any]:
    keys = reader.table(node, f"{what}'s start", ["position"], ["yaw"])
    position = reader.vector(keys.get("position"), f"{what}'s start position")
    yaw = reader.number(keys.get("yaw"), f"{what}'s yaw (radians)", -6.3, 6.3)
    return {"position": position or [0.0, 0.0, 0.0], "yaw": yaw or 0.0}


def _settings(
    reader: Reader, node: YamlNode | None, what: str, offered: Mapping[str, Setting], known: Known
) -> dict[str, Any]:
    """All settings of a target: what the file says over the manifest's defaults."""
    given = reader.table(node, what, [], offered)
    values: dict[str, Any] = {key: setting.default for key, setting in offered.items()}
    for key, value in given.items():
        setting, kind = offered[key], SETTING_TYPES[offered[key].type]
        if isinstance(value, yaml.ScalarNode) and value.value in setting.words:
            found = value.value
        elif kind in (int, float):
            found = reader.number(value, key, setting.least, setting.most, kind)
        else:
            found = reader.scalar(value, key, kind)
            if setting.words and found is not None:
                _strange(reader, value, key, found, setting, known)
        if found is not None:
            values[key] = found
    return values


def _strange(reader: Reader, node: YamlNode, key: str, text: str, setting: Setting, known: Known) -> None:
    """None of the setting's words: a class of the user's own, where it takes one."""
    driver = as_driver(text) if setting.methods else None
    if driver is None:
        own = ", or module:Class of your own" if setting.methods else ""
        reader.report("F005", f"{key} is {text!r}", node, f"there are: {', '.join(setting.words)}{own}")
    elif misfit := known.own_class(driver, setting.methods):
        reader.report("F005", misfit, node)


def as_driver(text: str) -> Driver | None:
    """The class that `module:Class` names; None for what does not."""
    if not _DRIVER.fullmatch(text):
        return None
    module, _, name = text.partition(":")
    return Driver(module, name)


def own_classes(fleet: Fleet, targets: Mapping[str, Target]) -> dict[str, Driver]:
    """The classes of the user's own that settings of robots name, by their file."""
    found: dict[str, Driver] = {}
    for robot in fleet.robots:
        for key, setting in targets[robot.target].settings.items():
            driver = as_driver(str(robot.settings[key])) if setting.methods else None
            if driver is not None:
                found[driver.path] = driver
    return found
