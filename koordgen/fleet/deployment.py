"""Deployment keys of the fleet file: the computer of each robot, and how releases are stored and started there.

Bundles do not depend on these keys.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from koordgen.fleet.yaml_reader import YamlNode, YamlReader
from koordgen.lang.node import Node

SERVICES = ("systemd", "none")
WHEELS = ("index", "host")  # sources of Python wheels; the setting may also be the path of a folder
_LOGIN = re.compile(
    r"([A-Za-z_][A-Za-z0-9_.-]{0,31})@([A-Za-z0-9][A-Za-z0-9.-]{0,252}|\[[0-9A-Fa-f:.]+\])(?::(\d{1,5}))?"
)
_PLACE = re.compile(r"[A-Za-z0-9._/][A-Za-z0-9._/-]{0,199}")  # characters that need no quotes in unit files and shells


class Login(Node):
    """SSH address of a computer.

    port: None if the fleet file names none. Then SSH uses its own configuration, or 22.
    """

    user: str
    name: str
    port: int | None

    @property
    def text(self) -> str:
        """The login as the fleet file spells it."""
        name = f"[{self.name}]" if ":" in self.name else self.name
        return f"{self.user}@{name}" + (f":{self.port}" if self.port else "")


class DeploymentSettings(Node):
    """Settings of releases on the hosts: their folder, and how they run.

    folder: relative to the home folder, or absolute.
    python: the interpreter on the hosts.
    service: one of SERVICES.
    wheels: one of WHEELS, or a folder of wheels, relative to the folder of the fleet file.
    """

    folder: str = "koordgen/fleet"
    python: str = "python3"
    service: str = "systemd"
    wheels: str = "index"


def read_deployment(reader: YamlReader, node: YamlNode | None) -> DeploymentSettings:
    """Read the fleet file's `deploy`."""
    given = reader.table(node, "deploy", [], ["folder", "python", "service", "wheels"])
    default = DeploymentSettings()
    return DeploymentSettings(
        _text(reader, given.get("folder"), "deploy.folder", _folder_misfit) or default.folder,
        _text(reader, given.get("python"), "deploy.python", _python_misfit) or default.python,
        reader.choice(given.get("service"), "deploy.service", SERVICES) or default.service,
        _text(reader, given.get("wheels"), "deploy.wheels", _wheels_misfit) or default.wheels,
    )


def read_login(reader: YamlReader, node: YamlNode | None) -> Login | None:
    """Read the `host` of a robot. None if there is none, or if it was reported as wrong."""
    text: str | None = reader.scalar(node, "host", str)
    if text is None or node is None:
        return None
    found = _LOGIN.fullmatch(text)
    if found is None or not (found[3] is None or 1 <= int(found[3]) <= 65535):
        reader.report("F005", f"host {text!r} is not USER@NAME or USER@NAME:PORT", node, "for example pi@alice.local")
        return None
    return Login(found[1], found[2].strip("[]"), int(found[3]) if found[3] else None)


def _text(reader: YamlReader, node: YamlNode | None, what: str, misfit: Callable[[str], str]) -> str:
    text: str | None = reader.scalar(node, what, str)
    if text is None or node is None:
        return ""
    if help := misfit(text):
        reader.report("F005", f"{what} cannot be {text!r}", node, help)
        return ""
    return text


def _folder_misfit(text: str) -> str:
    if text.startswith("~"):
        return "remove `~/`: a relative path starts in the home folder of the host's user"
    parts = text.strip("/").split("/")
    if not _PLACE.fullmatch(text) or not parts[0] or "." in parts or ".." in parts or "" in parts:
        return "use letters, digits, `.`, `_`, `-` and `/`, without `..`; for example koordgen/lineform"
    return ""


def _python_misfit(text: str) -> str:
    help = "write a command or an absolute path, for example python3.11 or /opt/bin/python3"
    return "" if _PLACE.fullmatch(text) else help


def _wheels_misfit(text: str) -> str:
    if text in WHEELS or ("/" in text and text.isprintable()):
        return ""
    return f"possible values: {', '.join(WHEELS)}, or a folder on this computer such as ./wheels"
