"""Network sections of the fleet file: `link`, the medium that robots share, and `network`, the transport."""

from __future__ import annotations

import re
from ipaddress import AddressValueError, IPv4Address
from typing import Any

import yaml

from koordgen.fleet.yaml_reader import YamlNode, YamlReader
from koordgen.lang.node import Node

_ENDPOINT = re.compile(r"[a-z_]+/\S+")
_EXPONENT = re.compile(r"\d+(\.\d*)?[eE]\+?\d+", re.ASCII)
# Settings of each transport, equal to those of koordgen/runtime/config/settings.py (a test compares them).
NETWORK: dict[str, tuple[str, ...]] = {
    "unicast": (),
    "broadcast": ("group", "port"),
    "multicast": ("group", "port", "interface"),
    "zenoh": ("mode", "listen", "connect"),
}
ZENOH_MODES = ("peer", "router", "client")


class Medium(Node):
    """Medium that all robots share.

    rate: bit/s. loss: share of datagrams that are lost, below 1. mtu: most bytes of a packet.
    """

    rate: float = 6e6  # the slowest rate of 802.11a/g, which broadcast and multicast use
    loss: float = 0.1
    mtu: int = 1500


def read_link(reader: YamlReader, node: YamlNode | None) -> Medium | None:
    """Read the fleet file's `link`; None if there is none."""
    if node is None:
        return None
    given = reader.table(node, "link", [], ["rate", "loss", "mtu"])
    rate = reader.number(_decimal(given.get("rate")), "link.rate (bits a second)", 1e3, 1e12)
    loss = reader.number(given.get("loss"), "link.loss (a share of 1)", 0.0, 0.9)
    mtu = reader.number(given.get("mtu"), "link.mtu (bytes)", 576, 65535, int)
    default = Medium()
    return Medium(rate or default.rate, default.loss if loss is None else loss, mtu or default.mtu)


def _decimal(node: YamlNode | None) -> YamlNode | None:
    """Return `6e6`, which is a text in YAML 1.1, as a number."""
    unquoted = isinstance(node, yaml.ScalarNode) and not node.style
    if node is not None and unquoted and _EXPONENT.fullmatch(node.value):
        return yaml.ScalarNode("tag:yaml.org,2002:float", node.value, node.start_mark, node.end_mark)
    return node


def read_network(reader: YamlReader, node: YamlNode | None) -> dict[str, Any]:
    """Read the fleet file's `network`: `transport`, and its settings."""
    keys = {key for of_transport in NETWORK.values() for key in of_transport}
    given = reader.table(node, "network", [], ["transport", *sorted(keys)])
    named = given.pop("transport", None)
    transport = reader.choice(named, "network.transport", tuple(NETWORK)) or "unicast"
    found: dict[str, Any] = {"transport": transport}
    if named is not None and transport != getattr(named, "value", None):
        return found  # an unknown transport was reported; other keys depend on it
    for key, value in given.items():
        if key not in NETWORK[transport]:
            keys_ = ", ".join(NETWORK[transport])
            help = f"possible keys: {keys_}" if keys_ else "remove it, or choose another `transport`"
            reader.report("F005", f"transport {transport} has no setting {key}", value, help)
        elif key == "port":
            found[key] = reader.number(value, "network.port", 1, 65535, int)
        elif key == "mode":
            found[key] = reader.choice(value, "network.mode", ZENOH_MODES)
        elif key in ("listen", "connect"):
            found[key] = [_endpoint(reader, entry, key) for entry in reader.items(value, f"network.{key}")]
        else:
            found[key] = reader.scalar(value, f"network.{key}", str)
    if node is not None and "group" in NETWORK[transport] and found.get("group", "") is not None:
        _group(reader, transport, found.get("group", ""), given.get("group", node))
    return found


def _group(reader: YamlReader, transport: str, text: str, node: YamlNode) -> None:
    try:
        right = IPv4Address(text).is_multicast == (transport == "multicast")
    except AddressValueError:
        right = False
    if not right:
        example = "239.255.71.1" if transport == "multicast" else "192.168.1.255"
        reader.report("F005", f"transport {transport} needs a group: an IPv4 {transport} address", node,
                      f"for example `group: {example}`")  # fmt: skip


def _endpoint(reader: YamlReader, node: YamlNode, key: str) -> str:
    text: str = reader.scalar(node, f"an endpoint of network.{key}", str) or ""
    if text and not _ENDPOINT.fullmatch(text):
        reader.report("F005", f"{text!r} is not a Zenoh endpoint", node, "for example udp/192.168.1.20:7447")
    return text
