"""Deployment keys of the fleet file: on which computer each robot runs, and how releases are kept and started there.

Bundles do not depend on these keys.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from koordgen.fleet.located import Reader, YamlNode
from koordgen.lang.node import Node

SERVICES = ("systemd", "none")
WHEELS = ("index", "host")  # or a folder
_LOGIN = re.compile(
    r"([A-Za-z_][A-Za-z0-9_.-]{0,31})@([A-Za-z0-9][A-Za-z0-9.-]{0,252}|\[[0-9A-Fa-f:.]+\])(?::(\d{1,5}))?"
)
_PLACE = re.compile(r"[A-Za-z0-9._/][A-Za-z0-9._/-]{0,199}")  # unit files and shells take these as they are


class Login(Node):
    """SSH address of a computer. `port` is None where the fleet file names none: SSH's own configuration, or
    22, holds then."""

    user: str
    name: str
    port: int | None

    @property
    def text(self) -> str:
        """The login as the fleet file spells it."""
        name = f"[{self.name}]" if ":" in self.name else self.name
        return f"{self.user}@{name}" + (f":{self.port}" if self.port else "")


class Deployment(Node):
    """Folder of the releases on hosts, and the way of running them.

    folder: relative to the home folder, or absolute.
    python: the interpreter on the hosts.
    service: one of SERVICES.
    wheels: one of WHEELS, or a folder of wheels, relative to the folder of the fleet file.
    """

    folder: str = "koordgen/fleet"
    python: str = "python3"
    service: str = "systemd"
    wheels: str = "index"


def read_deployment(reader: Reader, node: YamlNode | None) -> Deployment:
    """Read the fleet file's `deploy`."""
    given = reader.table(node, "deploy", [], ["folder", "python", "service", "wheels"])
    default = Deployment()
    return Deployment(
        _text(reader, given.get("folder"), "deploy.folder", _folder_misfit) or default.folder,
        _text(reader, given.get("python"), "deploy.python", _python_misfit) or default.python,
        reader.choice(given.get("service"), "deploy.service", SERVICES) or default.service,
        _text(reader, given.get("wheels"), "deploy.wheels", _wheels_misfit) or default.wheels,
    )


def read_login(reader: Reader, node: YamlNode | None) -> Login | None:
    """Read the `host` of a robot; None without one, or when it is reported."""
    text: str | None = reader.scalar(node, "host", str)
    if text is None or node is None:
        return None
    found = _LOGIN.fullmatch(text)
    if found is None or not (found[3] is None or 1 <= int(found[3]) <= 65535):
        reader.report("F005", f"host {text!r} is not USER@NAME or USER@NAME:PORT", node, "for example pi@alice.local")
        return None
    return Login(found[1], found[2].strip("[]"), int(found[3]) if found[3] else None)


def _text(reader: Reader, node: YamlNode | None, what: str, misfit: Callable[[str], str]) -> str:
    text: str | None = reader.scalar(node, what, str)
    if text is None or node is None:
        return ""
    if help := misfit(text):
        reader.report("F005", f"{what} is {text!r}", node, help)
        return ""
    return text


def _folder_misfit(text: str) -> str:
    if text.startswith("~"):
        return "leave `~/` out: a relative folder is in the home folder of the host's user"
    parts = text.strip("/").split("/")
    if not _PLACE.fullmatch(text) or not parts[0] or "." in parts or ".." in parts or "" in parts:
        return "letters, digits, `.`, `_`, `-` and `/`, for example koordgen/lineform, without `..`"
    return ""


def _python_misfit(text: str) -> str:
    return "" if _PLACE.fullmatch(text) else "a command or an absolute path, for example python3.11 or /opt/bin/python3"


def _wheels_misfit(text: str) -> str:
    if text in WHEELS or ("/" in text and text.isprintable()):
        return ""
    return f"there are: {', '.join(WHEELS)}, or a folder on this computer such as ./wheels"
