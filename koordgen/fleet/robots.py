"""Robots of a fleet file: names, targets, addresses, starts and settings."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from koordgen.fleet.address import control_port, read_address
from koordgen.fleet.deployment import Login, read_login
from koordgen.fleet.manifest import ACTIONS, Target
from koordgen.fleet.settings import NameChecks, read_given, read_settings
from koordgen.fleet.squads import RESERVED, SquadEntry, is_squad, read_squad
from koordgen.fleet.yaml_reader import YamlNode, YamlReader
from koordgen.lang.ir.types import MOST_ROBOTS
from koordgen.lang.node import Node

_NAME = re.compile(r"[a-z][a-z0-9_-]{0,31}")
_OPTIONAL = ("control", "host", "start", "settings")


class FleetRobot(Node):
    """One robot. `start`: `position` (m, ENU) and `yaw` (rad) at which the simulator places it.

    A robot with `inner` is a squad, a fleet as one robot: it has no target, start, settings and login. Its host and
    port are those of its first inner robot for this fleet; "" and 0 before the inner fleet file is read.
    """

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
    inner: SquadEntry | None = None


class Roster(Node):
    """Robots, and the YAML node of each robot's `start`; None if it has none."""

    robots: tuple[FleetRobot, ...] = ()
    starts: tuple[YamlNode | None, ...] = ()


def read_robots(reader: YamlReader, node: YamlNode | None, targets: Mapping[str, Target], known: NameChecks) -> Roster:
    """Read the fleet file's `robots`. Names, addresses and control ports must be unique."""
    entries = reader.items(node, "robots")
    if node is not None and not 1 <= len(entries) <= MOST_ROBOTS:
        reader.report("F005", f"robots has {len(entries)} entries; a fleet has 1 to {MOST_ROBOTS} robots", node)
    robots: list[FleetRobot] = []
    starts: list[YamlNode | None] = []
    seen: dict[object, str] = {}
    for pid, entry in enumerate(entries):
        robot, keys = (
            _squad(reader, entry, pid, targets) if is_squad(entry) else _robot(reader, entry, pid, targets, known)
        )
        robots.append(robot)
        starts.append(keys.get("start"))
        _check_unique(reader, entry, robot, keys, seen)
    return Roster(tuple(robots), tuple(starts))


def _robot(
    reader: YamlReader, entry: YamlNode, pid: int, targets: Mapping[str, Target], known: NameChecks
) -> tuple[FleetRobot, dict[str, YamlNode]]:
    """Return a robot with a target, and the keys of its entry."""
    what, harnesses = f"robot {pid}", _harnesses(targets)
    keys = reader.table(entry, what, ["name", "target", "address"], [*_OPTIONAL, *harnesses])
    name = _name(reader, keys.get("name"), targets)
    host, port = read_address(reader, keys.get("address"), "address")
    control = reader.number(keys.get("control"), "control", 1, 65535, int) or control_port(port)
    target = _target(reader, keys.get("target"), targets)
    settings = {}
    if target:
        settings = read_settings(reader, keys.get("settings"), f"{what}'s settings", target.settings, known)
    start = _start(reader, keys.get("start"), what)
    own = {n: _in_harness(reader, keys[n], f"{what}'s {n}", t, known) for n, t in harnesses.items() if n in keys}
    login, kind = read_login(reader, keys.get("host")), target.name if target else ""
    return FleetRobot(name or "", pid, kind, host, port, control, start, settings, own, login), keys


def _squad(
    reader: YamlReader, entry: YamlNode, pid: int, targets: Mapping[str, Target]
) -> tuple[FleetRobot, dict[str, YamlNode]]:
    """Return a squad, and the keys of its entry."""
    refused = ("target", "address", *_OPTIONAL, *_harnesses(targets))
    inner, keys = read_squad(reader, entry, f"robot {pid}", refused)
    name = _name(reader, keys.get("name"), targets)
    if name in RESERVED:
        message = f"{name!r} cannot be the name of a squad: it is a folder of each run"
        reader.report("F005", message, keys["name"], "give the squad another name")
    host, port = inner.addresses[0] if inner.addresses else ("", 0)
    return FleetRobot(
        name or "", pid, "", host, port, control_port(port), _start(reader, None, ""), {}, {}, None, inner
    ), keys


def _harnesses(targets: Mapping[str, Target]) -> dict[str, Target]:
    return {name: target for name, target in sorted(targets.items()) if target.kind == "harness"}


def _check_unique(
    reader: YamlReader, entry: YamlNode, robot: FleetRobot, keys: Mapping[str, YamlNode], seen: dict[object, str]
) -> None:
    """Report a name, address or control port that an earlier robot has. `seen`: those of all earlier robots.

    Addresses of squads are compared later, when their fleet files are read.
    """
    what, address = f"robot {robot.pid}", (robot.host, robot.port)
    taken: list[tuple[str, object, str]] = [("name", robot.name, robot.name)] if robot.name else []
    if robot.port and robot.inner is None:
        shown = f"{robot.host}:{robot.port}"
        repeated = address in seen  # the default control port then repeats as well: report only the address
        taken.append(("address", address, shown))
        control = (robot.host, robot.control)
        taken += [("control", control, f"{robot.host}:{robot.control}")] if not repeated else []
    for key, value, shown in taken:
        if seen.setdefault(value, f"{what}'s {key}") != f"{what}'s {key}":
            help = f"give it another {key}"
            if key not in keys:
                help = "write `control: PORT` for another port for emergency stop and status"
            reader.report("F006", f"{key} {shown} is already {seen[value]}", keys.get(key, entry), help)


def actions_of(robot: FleetRobot, targets: Mapping[str, Target]) -> tuple[str, ...]:
    """Return what a robot can do when a property is violated."""
    return targets[robot.target].actions if robot.inner is None else ACTIONS


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
