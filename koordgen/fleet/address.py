"""Addresses of robots in a fleet file: HOST:PORT, and the default ports that follow from one."""

from __future__ import annotations

import re

from koordgen.fleet.yaml_reader import YamlNode, YamlReader

Address = tuple[str, int]  # host and port
_ADDRESS = re.compile(r"([A-Za-z0-9.-]+|\[[0-9A-Fa-f:.]+\]):(\d{1,5})")


def parse_address(text: str) -> Address:
    """Parse HOST:PORT into host and port; ("", 0) for another text."""
    found = _ADDRESS.fullmatch(text)
    if not found or not 1 <= int(found[2]) <= 65535:
        return "", 0
    return found[1].strip("[]"), int(found[2])


def read_address(reader: YamlReader, node: YamlNode | None, what: str) -> Address:
    """Read the address at which other robots reach a robot; ("", 0) for none, or for one that was reported."""
    text: str | None = reader.scalar(node, what, str)
    if text is None or node is None:
        return "", 0
    host, port = parse_address(text)
    if not port:
        reader.report("F005", f"{what} {text!r} is not HOST:PORT", node, "for example 192.168.1.20:47100")
        return "", 0
    if host in ("0.0.0.0", "::"):
        help = "write the address at which the other robots reach this one"
        reader.report("F005", f"other robots cannot send to {host}", node, help)
        return "", 0
    return host, port


def control_port(port: int) -> int:
    """Return the default port for emergency stop and status; equal to that of runtime/config/settings.py (tested)."""
    return _away(port, 1000)


def outer_port(port: int) -> int:
    """Return the default port of an inner robot for the outer fleet. `port`: its port in its own fleet."""
    return _away(port, 2000)


def _away(port: int, distance: int) -> int:
    return port + distance if port + distance <= 65535 else port - distance
