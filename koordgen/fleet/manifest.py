"""Target manifests: typed content of `targets/<name>/manifest.toml`. Adding a target means adding one folder."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

from koordgen.lang import resources
from koordgen.lang.ir.decl import Meaning
from koordgen.lang.ir.ports import declared
from koordgen.lang.node import Node

# Version of the Platform interface of koordgen/runtime/vehicle/platform.py.
API = 1
ACTIONS = ("hold", "stop")  # every robot can do these when a property is violated
SETTING_TYPES = {"string": str, "float": float, "int": int, "bool": bool}


class ManifestError(Exception):
    """Raised for a target with a wrong manifest. The message names the file and the key."""


class Setting(Node):
    """Setting of a robot (under `settings:`) or of a harness (in its section) in the fleet file.

    words: texts that are accepted instead of a number; for a text, its only possible values.
    methods: if not empty, the text may also name a user's class that has these methods.
    """

    type: Literal["string", "float", "int", "bool"]
    default: str | float | int | bool
    least: float | None
    most: float | None
    doc: str
    words: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()

    def misfit(self, value: Any) -> str:
        """Return the reason why a value does not fit, or "". For values that do not come from a fleet file."""
        if value in self.words:
            return ""
        wanted = (int, float) if self.type == "float" else SETTING_TYPES[self.type]
        if not isinstance(value, wanted) or (isinstance(value, bool) and self.type != "bool"):
            return f"it must be a {self.type}"
        if isinstance(value, (int, float)):
            least, most = -math.inf if self.least is None else self.least, math.inf if self.most is None else self.most
            return "" if least <= value <= most else f"it must be {least:g} to {most:g}"
        return f"possible values: {', '.join(self.words)}" if self.words and not self.methods else ""


Offered = dict[str, Setting | dict[str, Setting]]


class PoseFeed(Node):
    """Address at which a robot receives its pose from a base station: the value of its setting `setting`.

    unless: values of settings; a robot with all of these values receives no pose.
    """

    setting: str
    unless: dict[str, Any]


class Target(Node):
    """One target: a kind of robot, or a harness, which runs a whole fleet on one host.

    kind: "agent" for a robot, "harness" for a harness.
    entry: "module:name" of the Platform class of an agent, or of the main function of a harness.
    sensors, actuators, callables: Koord types of ports, by "Module.port". meanings: the meaning of each port.
    simulation: names of the simulated body and device. feed: address at which a base station sends poses.
    also: other folders of targets/ from which the code imports.
    one_of: packages in `requirements`, of which one is enough.
    actions: what its robots can do when a property is violated: hold, stop, land.
    robot: settings that a harness accepts for each robot, single or in groups; the harness has their defaults.
    footprint: names of the settings (m) with the size of the body. Either `radius` around the reference point, or
        `length`, `width` and `behind` (part of the length behind the reference point). `height` defaults to the radius.
    alone: for a harness, the target of the single robot that it runs without a fleet file.
    """

    name: str
    summary: str
    kind: Literal["agent", "harness"]
    entry: str
    requirements: tuple[str, ...]
    sensors: dict[str, str]
    actuators: dict[str, str]
    callables: dict[str, str]
    meanings: dict[str, Meaning]
    settings: dict[str, Setting]
    simulation: dict[str, str]
    feed: PoseFeed | None
    also: tuple[str, ...]
    folder: Path
    robot: Offered
    footprint: dict[str, str]
    actions: tuple[str, ...] = ACTIONS
    alone: str = ""
    one_of: tuple[str, ...] = ()

    @property
    def goal(self) -> tuple[str, str, str] | None:
        """Return (module, position sensor, goal actuator); None if the target has no such ports.

        The actuator's value is the position of the robot until the program writes it.
        """
        for name, meaning in self.meanings.items():
            module, _, port = name.partition(".")
            held = self.meanings.get(f"{module}.{meaning.held}")
            if held is not None and held.is_position:
                return module, meaning.held, port
        return None

    @property
    def modules(self) -> set[str]:
        """Names of the modules that a program may use on this target."""
        return {name.partition(".")[0] for name in (*self.sensors, *self.actuators, *self.callables)}


def available() -> list[str]:
    """Return the names of all targets, sorted."""
    return sorted(p.parent.name for p in resources.targets().glob("*/manifest.toml"))


def load(name: str) -> Target:
    """Return the target `name`, which must be in `available()`. Raises ManifestError."""
    import tomllib

    path = resources.targets() / name / "manifest.toml"
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise ManifestError(f"{path}: {error}") from None
    try:
        return _target(raw, path)
    except KeyError as error:
        raise ManifestError(f"{path}: the key {error} is missing") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise ManifestError(f"{path}: {error}") from None


def _target(raw: dict[str, Any], path: Path) -> Target:
    if raw["name"] != path.parent.name:
        raise ValueError(f"name is {raw['name']!r}, but the folder is {path.parent.name!r}; they must be equal")
    if raw["api"] != API:
        raise ValueError(f"api is {raw['api']}, but this koordgen supports {API}")
    if raw["kind"] not in ("agent", "harness"):
        raise ValueError(f"kind is {raw['kind']!r}; it must be 'agent' or 'harness'")
    ports: dict[str, dict[str, str]] = {"sensors": {}, "actuators": {}, "callables": {}}
    meanings = {}
    for module, directions in raw.get("modules", {}).items():
        for direction, offered in directions.items():
            for port, text in offered.items():
                name = f"{module}.{port}"
                ports[direction][name], meanings[name] = declared(text)
    return Target(
        name=raw["name"],
        summary=raw["summary"],
        kind=raw["kind"],
        entry=raw["entry"],
        requirements=tuple(raw["requirements"]),
        sensors=ports["sensors"],
        actuators=ports["actuators"],
        callables=ports["callables"],
        meanings=meanings,
        settings={key: _setting(key, value) for key, value in raw.get("settings", {}).items()},
        simulation=raw.get("simulation", {}),
        feed=PoseFeed(raw["feed"]["setting"], raw["feed"].get("unless", {})) if "feed" in raw else None,
        also=tuple(raw.get("also", ())),
        folder=path.parent,
        robot={key: _offered(key, value) for key, value in raw.get("robot", {}).items()},
        footprint=raw.get("footprint", {}),
        actions=(*ACTIONS, "land") if raw.get("lands", False) else ACTIONS,
        alone=raw.get("alone", ""),
        one_of=tuple(raw.get("one_of", ())),
    )


def _offered(key: str, raw: dict[str, Any]) -> Setting | dict[str, Setting]:
    """Return one setting, or a group of settings. The harness has their defaults, so they are 0 here."""
    if not isinstance(raw.get("type"), str):
        return {name: _setting(f"{key}.{name}", {"default": 0, **value}) for name, value in raw.items()}
    return _setting(key, {"default": 0, **raw})


def _setting(key: str, raw: dict[str, Any]) -> Setting:
    if raw["type"] not in SETTING_TYPES:
        raise ValueError(f"settings.{key}: type is {raw['type']!r}; it must be one of {', '.join(SETTING_TYPES)}")
    default = SETTING_TYPES[raw["type"]](raw["default"])
    words, methods = tuple(raw.get("words", ())), tuple(raw.get("methods", ()))
    return Setting(raw["type"], default, raw.get("min"), raw.get("max"), raw["doc"], words, methods)
