"""Squads of a fleet file: robots that are fleets themselves, each with a fleet file of its own (ADR 0056).

Only the form is checked here. Checks against the inner fleets and the programs are in koordgen/build/squads.py.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import yaml

from koordgen.fleet.address import Address, read_address
from koordgen.fleet.yaml_reader import YamlNode, YamlReader, value_of
from koordgen.lang.node import Node
from koordgen.lang.source import Source, Span

# Keys of a robot that a squad cannot have -> what to do instead.
_MISPLACED = {
    "target": "remove `target`, or remove `inner`",
    "address": "write the addresses of the inner robots for this fleet as `ports: [HOST:PORT, ...]`, or leave them out",
    "start": "remove it: the inner robots have their own starts in {file}",
    "settings": "remove it: the inner robots have their own settings in {file}",
    "host": "remove it: the inner robots have their own hosts in {file}",
    "control": "remove it: the inner robots have their own control ports in {file}",
}


# No squad may have these names: a run folder has these folders beside a folder for each squad. The simulator has the
# same list (tested).
RESERVED = frozenset(("plots", "robots", "source"))


class SquadEntry(Node):
    """Fleet that is one robot of an outer fleet.

    `file`: path of its fleet file, relative to the folder of the outer fleet file. `addresses`: the addresses of its
    robots for datagrams of the outer fleet, in their order; before the inner fleet file is read, what the entry lists
    under `ports`. `spans`: places of the values by their keys, such as "inner" or "ports.0".
    """

    file: str
    addresses: tuple[Address, ...]
    spans: dict[str, Span]


def is_squad(entry: YamlNode) -> bool:
    """Return whether the entry of a robot names an inner fleet."""
    return value_of(entry, "inner") is not None


def read_squad(
    reader: YamlReader, entry: YamlNode, what: str, refused: tuple[str, ...]
) -> tuple[SquadEntry, dict[str, YamlNode]]:
    """Return the squad that the entry of a robot describes, and all keys of the entry.

    `refused`: the keys that only robots with a target have.
    """
    keys = reader.table(entry, what, ["name", "inner"], ["ports", *refused])
    file: str = reader.scalar(keys["inner"], f"{what}'s inner", str) or ""
    for key in refused:
        if key in keys:
            help = _MISPLACED.get(key, "remove it: the entries of the inner robots have it, in {file}")
            message = f"{what} is a fleet (`inner`), so it cannot have {key!r}"
            reader.report("F002", message, keys[key], help.format(file=file or "their fleet file"))
    spans = {key: reader.span(node) for key, node in keys.items()}
    found: dict[Address, int] = {}
    entries = reader.items(keys.get("ports"), f"{what}'s ports")
    for place, node in enumerate(entries):
        spans[f"ports.{place}"] = reader.span(node)
        address = read_address(reader, node, f"an address in {what}'s ports")
        if address[1] and found.setdefault(address, place) != place:
            message = f"the ports of {what} name {address[0]}:{address[1]} twice"
            reader.report("F006", message, node, "each inner robot needs an address of its own")
    if "ports" in keys and isinstance(keys["ports"], yaml.SequenceNode) and not entries:
        reader.report("F005", f"{what}'s ports is empty", keys["ports"], "remove it, or list an address for each robot")
    return SquadEntry(file, tuple(found), spans), keys


def named_fleets(source: Source) -> dict[str, Span]:
    """Return the inner fleet files that a fleet file names, before it is checked. Wrong entries are left out."""
    reader = YamlReader(source, lambda *mistake: None)
    robots = value_of(reader.document(), "robots")
    found: dict[str, Span] = {}
    for entry in robots.value if isinstance(robots, yaml.SequenceNode) else []:
        inner = value_of(entry, "inner")
        if isinstance(inner, yaml.ScalarNode):
            found.setdefault(inner.value, reader.span(inner))
    return found


def nesting(path: str, read: Callable[[str], Source | None], outer: str) -> list[str]:
    """Return a chain of fleet files in which each one names the next: `outer`, `path`, and what `path` names.

    If there is a chain that comes back to one of its files, return it up to there. `read`: returns the text of a file;
    None if it cannot be read.
    """

    def chains(chain: list[str]) -> list[list[str]]:
        source = read(chain[-1])
        if chain[-1] in chain[:-1] or source is None:
            return [chain]
        named = [os.path.normpath(os.path.join(os.path.dirname(chain[-1]), file)) for file in named_fleets(source)]
        return [found for file in named for found in chains([*chain, file])] or [chain]

    every = chains([os.path.normpath(outer), os.path.normpath(path)])
    return next((chain for chain in every if chain[-1] in chain[:-1]), every[0])
