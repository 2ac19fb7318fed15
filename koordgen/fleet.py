"""The fleet file: who is in the fleet, where, and what every robot of it must know. See docs/fleet.md."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from ipaddress import AddressValueError, IPv4Address
from typing import Any

import yaml

from koordgen.located import Reader, Report, YamlNode
from koordgen.manifest import SETTING_TYPES, Setting, Target
from koordgen.mocap import Mocap, read_mocap
from koordgen.node import Node
from koordgen.source import Source

_NAME = re.compile(r"[a-z][a-z0-9_-]{0,31}")
_DRIVER = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)
_ENDPOINT = re.compile(r"[a-z_]+/\S+")
_ADDRESS = re.compile(r"([A-Za-z0-9.-]+|\[[0-9A-Fa-f:.]+\]):(\d{1,5})")
_EXPONENT = re.compile(r"\d+(\.\d*)?[eE]\+?\d+", re.ASCII)
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
MOST_OBSTACLES = 1000
# What may be said of each transport, as koordgen/runtime/settings.py reads it (a test compares them).
NETWORK: dict[str, tuple[str, ...]] = {
    "unicast": (),
    "broadcast": ("group", "port"),
    "multicast": ("group", "port", "interface"),
    "zenoh": ("mode", "listen", "connect"),
}
ZENOH_MODES = ("peer", "router", "client")


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


class Link(Node):
    """The medium that all robots share: what it carries (bits a second), the part of the datagrams that it loses, the
    most bytes of a packet."""

    rate: float = 6e6  # the slowest of 802.11a/g, at which broadcast and multicast go
    loss: float = 0.1
    mtu: int = 1500


class Fleet(Node):
    """A checked fleet file; plain values, as they go into the bundles' JSON. `harness` is keyed by target name;
    `params` are plain values: numbers, bools, texts, lists, tables; `drivers` is keyed by module."""

    application_id: int
    delta: float
    origin: dict[str, float]
    geofence: dict[str, list[float]]
    obstacles: tuple[dict[str, list[float]], ...]
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
    source: Source, targets: Mapping[str, Target], params: Mapping[str, Fits] | None, report: Report
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
    optional += ["planner_budget", "link", "network", "mocap", *harnesses]
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
        geofence=_box(reader, top.get("geofence"), "geofence"),
        obstacles=_obstacles(reader, top.get("obstacles")),
        key=_key(reader, top.get("key"), insecure),
        insecure=insecure,
        params={} if params is None else _params(reader, top.get("params"), params),
        safety=_safety(reader, top.get("safety")),
        planner_budget=reader.number(top.get("planner_budget"), "planner_budget (seconds)", 0.0005, 1.0) or 0.01,
        drivers=_drivers(reader, top.get("modules")),
        robots=_robots(reader, top.get("robots"), targets),
        harness={n: _settings(reader, top[n], n, targets[n].settings) for n in harnesses if n in top},
        link=_link(reader, top.get("link")),
        network=_network(reader, top.get("network")),
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


def _box(reader: Reader, node: YamlNode | None, what: str) -> dict[str, list[float]]:
    corner = reader.table(node, what, ["lo", "hi"], [])
    lo, hi = reader.vector(corner.get("lo"), f"{what}.lo"), reader.vector(corner.get("hi"), f"{what}.hi")
    if lo and hi and any(a >= b for a, b in zip(lo, hi, strict=True)):
        reader.report("F005", f"{what}.lo must be below {what}.hi on every axis", corner["hi"])
    return {"lo": lo or [], "hi": hi or []}


def _obstacles(reader: Reader, node: YamlNode | None) -> tuple[dict[str, list[float]], ...]:
    entries = reader.items(node, "obstacles")
    if node is not None and len(entries) > MOST_OBSTACLES:
        reader.report("F005", f"obstacles lists {len(entries)}; there may be at most {MOST_OBSTACLES}", node)
    return tuple(_box(reader, entry, f"obstacle {i}") for i, entry in enumerate(entries))


def _key(reader: Reader, node: YamlNode | None, insecure: bool) -> str:
    """The key's file name; the key itself is put beside the settings by hand and never enters a bundle."""
    name: str | None = reader.scalar(node, "key", str)
    if name and node is not None and ("/" in name or "\\" in name or name.startswith(".")):
        reader.report("F005", f"key is a file name without folders, not {name!r}", node)
    if insecure and node is not None:
        reader.report("F005", "a fleet has a key or is insecure, not both", node, "leave one of the two out")
    return "" if insecure else name or "fleet.key"


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
        if not _DRIVER.fullmatch(text):
            reader.report("F005", f"{text!r} names no driver class", value, "for example drivers.hvac:Hvac")
        path, _, name = text.partition(":")
        found[module] = Driver(path, name)
    return found


def _safety(reader: Reader, node: YamlNode | None) -> dict[str, Any]:
    found, given = dict(SAFETY), reader.table(node, "safety", [], SAFETY)
    for key, value in given.items():
        what = f"safety.{key}"
        match key:
            case "missed_action":
                found[key] = _choice(reader, value, what, MISSED_ACTIONS)
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


def _link(reader: Reader, node: YamlNode | None) -> Link | None:
    if node is None:
        return None
    given = reader.table(node, "link", [], ["rate", "loss", "mtu"])
    rate = reader.number(_decimal(given.get("rate")), "link.rate (bits a second)", 1e3, 1e12)
    loss = reader.number(given.get("loss"), "link.loss (a part of 1)", 0.0, 0.9)
    mtu = reader.number(given.get("mtu"), "link.mtu (bytes)", 576, 65535, int)
    default = Link()
    return Link(rate or default.rate, default.loss if loss is None else loss, mtu or default.mtu)


def _decimal(node: YamlNode | None) -> YamlNode | None:
    """6e6, which YAML 1.1 takes for a text, as the number that it says."""
    unquoted = isinstance(node, yaml.ScalarNode) and not node.style
    if node is not None and unquoted and _EXPONENT.fullmatch(node.value):
        return yaml.ScalarNode("tag:yaml.org,2002:float", node.value, node.start_mark, node.end_mark)
    return node


def _network(reader: Reader, node: YamlNode | None) -> dict[str, Any]:
    keys = {key for of_transport in NETWORK.values() for key in of_transport}
    given = reader.table(node, "network", [], ["transport", *sorted(keys)])
    named = given.pop("transport", None)
    transport = _choice(reader, named, "network.transport", tuple(NETWORK)) or "unicast"
    found: dict[str, Any] = {"transport": transport}
    if named is not None and transport != getattr(named, "value", None):
        return found  # told already; what the other keys mean depends on it
    for key, value in given.items():
        if key not in NETWORK[transport]:
            takes = f"it takes: {', '.join(NETWORK[transport])}" if NETWORK[transport] else "say which `transport`"
            reader.report("F005", f"network.{key} means nothing to transport {transport}", value, takes)
        elif key == "port":
            found[key] = reader.number(value, "network.port", 1, 65535, int)
        elif key == "mode":
            found[key] = _choice(reader, value, "network.mode", ZENOH_MODES)
        elif key in ("listen", "connect"):
            found[key] = [_endpoint(reader, entry, key) for entry in reader.items(value, f"network.{key}")]
        else:
            found[key] = reader.scalar(value, f"network.{key}", str)
    if node is not None and "group" in NETWORK[transport] and found.get("group", "") is not None:
        _group(reader, transport, found.get("group", ""), given.get("group", node))
    return found


def _choice(reader: Reader, node: YamlNode | None, what: str, known: tuple[str, ...]) -> str | None:
    text: str | None = reader.scalar(node, what, str)
    if text is None or node is None or text in known:
        return text
    reader.report("F005", f"{what} is {text!r}", node, f"there are: {', '.join(known)}")
    return None


def _group(reader: Reader, transport: str, text: str, node: YamlNode) -> None:
    try:
        right = IPv4Address(text).is_multicast == (transport == "multicast")
    except AddressValueError:
        right = False
    if not right:
        example = "239.255.71.1" if transport == "multicast" else "192.168.1.255"
        reader.report("F005", f"transport {transport} needs a group: an IPv4 {transport} address", node,
                      f"for example `group: {example}`")  # fmt: skip


def _endpoint(reader: Reader, node: YamlNode, key: str) -> str:
    text: str = reader.scalar(node, f"an endpoint of network.{key}", str) or ""
    if text and not _ENDPOINT.fullmatch(text):
        reader.report("F005", f"{text!r} is no endpoint of Zenoh", node, "for example udp/192.168.1.20:7447")
    return text


def _robots(reader: Reader, node: YamlNode | None, targets: Mapping[str, Target]) -> tuple[Robot, ...]:
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
        settings = _settings(reader, keys.get("settings"), f"{what}'s settings", target.settings) if target else {}
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


def _settings(reader: Reader, node: YamlNode | None, what: str, known: Mapping[str, Setting]) -> dict[str, Any]:
    """All settings of a target: what the file says over the manifest's defaults."""
    given = reader.table(node, what, [], known)
    values: dict[str, Any] = {key: setting.default for key, setting in known.items()}
    for key, value in given.items():
        setting, kind = known[key], SETTING_TYPES[known[key].type]
        if isinstance(value, yaml.ScalarNode) and value.value in setting.words:
            found = value.value
        elif kind in (int, float):
            found = reader.number(value, key, setting.least, setting.most, kind)
        else:
            found = reader.scalar(value, key, kind)
        if found is not None:
            values[key] = found
    return values
