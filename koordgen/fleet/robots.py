"""Robots of a fleet file: names, targets, addresses, starts and settings."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from koordgen.fleet.deployment import Login, read_login
from koordgen.fleet.manifest import Target
from koordgen.fleet.settings import NameChecks, read_given, read_settings
from koordgen.fleet.yaml_reader import YamlNode, YamlReader
from koordgen.lang.ir.types import MOST_ROBOTS
from koordgen.lang.node import Node

_NAME = re.compile(r"[a-z][a-z0-9_-]{0,31}")
_ADDRESS = re.compile(r"([A-Za-z0-9.-]+|\[[0-9A-Fa-f:.]+\]):(\d{1,5})")


class FleetRobot(Node):
    """One robot. `start`: `position` (m, ENU) and `yaw` (rad) at which the simulator places it."""

    name: str
    pid: int
    target: str
    host: str
    port: int
    control: int  # port for emergency stop and status, on the same host
    start: dict[str, Any]
    settings: dict[str, Any]
    harness: dict[str, dict[str, Any]]  # settings of this robot in each harness, without defaults
    login: Login | None  # `host` of the fleet file: the computer on which its agent runs


class Roster(Node):
    """Robots, and the YAML node of each robot's `start`; None if it has none."""

    robots: tuple[FleetRobot, ...] = ()
    starts: tuple[YamlNode | None, ...] = ()


def parse_address(text: str) -> tuple[str, int]:
    """Parse HOST:PORT into host and port; ("", 0) for another text."""
    found = _ADDRESS.fullmatch(text)
    if not found or not 1 <= int(found[2]) <= 65535:
        return "", 0
    return found[1].strip("[]"), int(found[2])


def control_port(port: int) -> int:
    """Return the default port for emergency stop and status; equal to that of runtime/config/settings.py (tested)."""
    return port + 1000 if port + 1000 <= 65535 else port - 1000


def read_robots(reader: YamlReader, node: YamlNode | None, targets: Mapping[str, Target], known: NameChecks) -> Roster:
    """Read the fleet file's `robots`. Names, addresses and control ports must be unique."""
    entries = reader.items(node, "robots")
    if node is not None and not 1 <= len(entries) <= MOST_ROBOTS:
        reader.report("F005", f"robots has {len(entries)} entries; a fleet has 1 to {MOST_ROBOTS} robots", node)
    robots: list[FleetRobot] = []
    starts: list[YamlNode | None] = []
    harnesses = {name: target for name, target in targets.items() if target.kind == "harness"}
    optional = ["control", "host", "start", "settings", *sorted(harnesses)]
    seen: dict[object, str] = {}
    for pid, entry in enumerate(entries):
        what = f"robot {pid}"
        keys = reader.table(entry, what, ["name", "target", "address"], optional)
        name = _name(reader, keys.get("name"), targets)
        host, port = _address(reader, keys.get("address"))
        control = reader.number(keys.get("control"), "control", 1, 65535, int) or control_port(port)
        taken: list[tuple[str, object, str | None]] = [("name", name, name)]
        if port:
            repeated = (host, port) in seen  # then the default control port repeats, too: report the address only
            taken.append(("address", (host, port), f"{host}:{port}"))
            taken += [("control", (host, control), f"{host}:{control}")] if not repeated else []
        for key, value, shown in taken:
            if value is not None and seen.setdefault(value, f"{what}'s {key}") != f"{what}'s {key}":
                help = f"give it another {key}"
                if key not in keys:
                    help = "write `control: PORT` for another port for emergency stop and status"
                reader.report("F006", f"{key} {shown} is already {seen[value]}", keys.get(key, entry), help)
        target = _target(reader, keys.get("target"), targets)
        settings = {}
        if target:
            settings = read_settings(reader, keys.get("settings"), f"{what}'s settings", target.settings, known)
        start = _start(reader, keys.get("start"), what)
        own = {n: _in_harness(reader, keys[n], f"{what}'s {n}", t, known) for n, t in harnesses.items() if n in keys}
        login, kind = read_login(reader, keys.get("host")), target.name if target else ""
        robots.append(FleetRobot(name or "", pid, kind, host, port, control, start, settings, own, login))
        starts.append(keys.get("start"))
    return Roster(tuple(robots), tuple(starts))


def _in_harness(reader: YamlReader, node: YamlNode, what: str, harness: Target, known: NameChecks) -> dict[str, Any]:
    """Read the settings of one robot in a harness, in the groups of its manifest."""
    groups = {key: offered for key, offered in harness.robot.items() if isinstance(offered, dict)}
    single = {key: offered for key, offered in harness.robot.items() if not isinstance(offered, dict)}
    given = reader.table(node, what, [], harness.robot)
    found = read_given(reader, {key: value for key, value in given.items() if key in single}, single, known)
    for key, offered in groups.items():
        if key in given:
            found[key] = read_given(reader, reader.table(given[key], f"{what}.{key}", [], offered), offered, known)
    return found


def _name(reader: YamlReader, node: YamlNode | None, targets: Mapping[str, Target]) -> str | None:
    name: str | None = reader.scalar(node, "name", str)
    if name is None or node is None:
        return None
    # The name becomes a folder beside the folders `fleet`, `state` and those of targets.
    if not _NAME.fullmatch(name) or name in ("fleet", "state") or name in targets:
        reader.report(
            "F005", f"{name!r} cannot be a robot's name", node,
            "write a lower-case letter, then lower-case letters, digits, - or _, at most 32 characters; not fleet, "
            "state or a target's name",
        )  # fmt: skip
        return None
    return name


def _address(reader: YamlReader, node: YamlNode | None) -> tuple[str, int]:
    text: str | None = reader.scalar(node, "address", str)
    if text is None or node is None:
        return "", 0
    host, port = parse_address(text)
    if not port:
        reader.report("F005", f"address {text!r} is not HOST:PORT", node, "for example 192.168.1.20:47100")
        return "", 0
    if host in ("0.0.0.0", "::"):
        help = "write the address at which the other robots reach this one"
        reader.report("F005", f"other robots cannot send to {host}", node, help)
        return "", 0
    return host, port


def _target(reader: YamlReader, node: YamlNode | None, targets: Mapping[str, Target]) -> Target | None:
    name: str | None = reader.scalar(node, "target", str)
    if name is None or node is None:
        return None
    agents = sorted(n for n, t in targets.items() if t.kind == "agent")
    if name not in agents:
        reader.report("F007", f"there is no robot target {name!r}", node, f"possible targets: {', '.join(agents)}")
        return None
    return targets[name]


def _start(reader: YamlReader, node: YamlNode | None, what: str) -> dict[str, Any]:
    keys = reader.table(node, f"{what}'s start", ["position"], ["yaw"])
    position = reader.vector(keys.get("position"), f"{what}'s start position")
    yaw = reader.number(keys.get("yaw"), f"{what}'s yaw (radians)", -6.3, 6.3)
    return {"position": position or [0.0, 0.0, 0.0], "yaw": yaw or 0.0}
