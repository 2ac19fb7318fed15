"""What a target says of itself: `targets/<name>/manifest.toml`, typed. A new target is one dropped folder."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

from koordgen.lang import resources
from koordgen.lang.ir.decl import Meaning
from koordgen.lang.ir.ports import declared
from koordgen.lang.node import Node

# The Platform interface of koordgen/runtime/vehicle/platform.py that this compiler's runtime offers.
API = 1
ACTIONS = ("hold", "stop")  # of every robot
SETTING_TYPES = {"string": str, "float": float, "int": int, "bool": bool}


class ManifestError(Exception):
    """A target's folder that cannot be used; the message names the file and the key."""


class Setting(Node):
    """One key that `settings:` of a robot, or the harness's section, may have in the fleet file. `words` may stand for
    a number, or are all that a text may be; with `methods` a text may also name a user's class that has these."""

    type: Literal["string", "float", "int", "bool"]
    default: str | float | int | bool
    least: float | None
    most: float | None
    doc: str
    words: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()

    def misfit(self, value: Any) -> str:
        """What is wrong with a value from elsewhere than a fleet file; "" for one that fits."""
        if value in self.words:
            return ""
        wanted = (int, float) if self.type == "float" else SETTING_TYPES[self.type]
        if not isinstance(value, wanted) or (isinstance(value, bool) and self.type != "bool"):
            return f"it must be a {self.type}"
        if isinstance(value, (int, float)):
            least, most = -math.inf if self.least is None else self.least, math.inf if self.most is None else self.most
            return "" if least <= value <= most else f"it must be {least:g} to {most:g}"
        return f"there are: {', '.join(self.words)}" if self.words and not self.methods else ""


Offered = dict[str, Setting | dict[str, Setting]]


class Feed(Node):
    """How robots of a target are told their poses: at the address in the setting `setting`, unless their settings are
    as `unless` says."""

    setting: str
    unless: dict[str, Any]


class Target(Node):
    """One target. `kind` "agent" runs one robot (`entry` is its Platform class), "harness" a whole fleet on one host
    (`entry` is its main function), both as "module:name". `sensors`, `actuators` and `callables` are keyed by
    "Module.port" and say the Koord type, `meanings` what such a port means. `simulation` names the body and the
    device that stand in for the real ones; `feed` how a base station finds it; `also` the other folders of targets/
    whose files this one's code imports.
    `one_of` names packages among `requirements` of which one is enough.
    `actions` are what its robots can do when a property is violated: hold, come to rest (stop), land.
    `robot` is what a harness lets the file say of each robot, single settings and groups of them, without defaults: the
    harness has these. `footprint` names the settings (m) that tell how much room the body takes: `radius` about its
    reference point, or `length`, `width` and `behind`, which is how much of the length is behind that; and `height`, if
    not the radius. `alone` of a harness is the target of the one robot that it runs without a fleet file."""

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
    feed: Feed | None
    also: tuple[str, ...]
    folder: Path
    robot: Offered
    footprint: dict[str, str]
    actions: tuple[str, ...] = ACTIONS
    alone: str = ""
    one_of: tuple[str, ...] = ()

    @property
    def goal(self) -> tuple[str, str, str] | None:
        """A module, its sensor of the robot's own position, and its actuator that holds there until it is written."""
        for name, meaning in self.meanings.items():
            module, _, port = name.partition(".")
            held = self.meanings.get(f"{module}.{meaning.held}")
            if held is not None and held.is_position:
                return module, meaning.held, port
        return None

    @property
    def modules(self) -> set[str]:
        """The modules that a program may use on this target."""
        return {name.partition(".")[0] for name in (*self.sensors, *self.actuators, *self.callables)}


def available() -> list[str]:
    """The names of all targets, sorted."""
    return sorted(p.parent.name for p in resources.targets().glob("*/manifest.toml"))


def load(name: str) -> Target:
    """The target of that name, which must be among `available()`. Raises ManifestError."""
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
        raise ValueError(f"name is {raw['name']!r} but the folder is {path.parent.name!r}")
    if raw["api"] != API:
        raise ValueError(f"api is {raw['api']}, this koordgen offers {API}")
    if raw["kind"] not in ("agent", "harness"):
        raise ValueError(f"kind is {raw['kind']!r}; it is 'agent' or 'harness'")
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
        feed=Feed(raw["feed"]["setting"], raw["feed"].get("unless", {})) if "feed" in raw else None,
        also=tuple(raw.get("also", ())),
        folder=path.parent,
        robot={key: _offered(key, value) for key, value in raw.get("robot", {}).items()},
        footprint=raw.get("footprint", {}),
        actions=(*ACTIONS, "land") if raw.get("lands", False) else ACTIONS,
        alone=raw.get("alone", ""),
        one_of=tuple(raw.get("one_of", ())),
    )


def _offered(key: str, raw: dict[str, Any]) -> Setting | dict[str, Setting]:
    """One setting, or a group of them; their defaults are not the file's to know."""
    if not isinstance(raw.get("type"), str):
        return {name: _setting(f"{key}.{name}", {"default": 0, **value}) for name, value in raw.items()}
    return _setting(key, {"default": 0, **raw})


def _setting(key: str, raw: dict[str, Any]) -> Setting:
    if raw["type"] not in SETTING_TYPES:
        raise ValueError(f"settings.{key}: type {raw['type']!r} is none of {', '.join(SETTING_TYPES)}")
    default = SETTING_TYPES[raw["type"]](raw["default"])
    words, methods = tuple(raw.get("words", ())), tuple(raw.get("methods", ()))
    return Setting(raw["type"], default, raw.get("min"), raw.get("max"), raw["doc"], words, methods)
