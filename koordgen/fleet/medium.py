"""What the fleet file says of the network: the medium that robots share, and how datagrams go from robot to robot."""

from __future__ import annotations

import re
from ipaddress import AddressValueError, IPv4Address
from typing import Any

import yaml

from koordgen.fleet.located import Reader, YamlNode
from koordgen.lang.node import Node

_ENDPOINT = re.compile(r"[a-z_]+/\S+")
_EXPONENT = re.compile(r"\d+(\.\d*)?[eE]\+?\d+", re.ASCII)
# What may be said of each transport, as koordgen/runtime/config/settings.py reads it (a test compares them).
NETWORK: dict[str, tuple[str, ...]] = {
    "unicast": (),
    "broadcast": ("group", "port"),
    "multicast": ("group", "port", "interface"),
    "zenoh": ("mode", "listen", "connect"),
}
ZENOH_MODES = ("peer", "router", "client")


class Link(Node):
    """The medium that all robots share: what it carries (bits a second), the part of the datagrams that it loses, the
    most bytes of a packet."""

    rate: float = 6e6  # the slowest of 802.11a/g, at which broadcast and multicast go
    loss: float = 0.1
    mtu: int = 1500


def read_link(reader: Reader, node: YamlNode | None) -> Link | None:
    """What robots share to send on; None: nothing is said of it."""
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


def read_network(reader: Reader, node: YamlNode | None) -> dict[str, Any]:
    """`transport`, and what the file says of it."""
    keys = {key for of_transport in NETWORK.values() for key in of_transport}
    given = reader.table(node, "network", [], ["transport", *sorted(keys)])
    named = given.pop("transport", None)
    transport = reader.choice(named, "network.transport", tuple(NETWORK)) or "unicast"
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
            found[key] = reader.choice(value, "network.mode", ZENOH_MODES)
        elif key in ("listen", "connect"):
            found[key] = [_endpoint(reader, entry, key) for entry in reader.items(value, f"network.{key}")]
        else:
            found[key] = reader.scalar(value, f"network.{key}", str)
    if node is not None and "group" in NETWORK[transport] and found.get("group", "") is not None:
        _group(reader, transport, found.get("group", ""), given.get("group", node))
    return found


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
