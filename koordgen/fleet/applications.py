"""Applications of a fleet file: which program runs on which robots, and to what its imports are bound.

Only the form is checked here. Checks against the programs are in koordgen/build/composition.py.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import yaml

from koordgen.fleet.yaml_reader import YamlNode, YamlReader, value_of
from koordgen.lang.node import Node
from koordgen.lang.source import Source, Span

MOST_INSTANCES = 1024  # an application on a robot is one; as in koordgen/runtime/net/wire.py (a test compares both)
# The name becomes a part of the names of Python modules in a bundle.
_NAME = re.compile(r"[a-z][a-z0-9_]{0,31}")
_BAD_NAME = "write a lower-case letter, then lower-case letters, digits or _, at most 32 characters"


class ApplicationSettings(Node):
    """One entry of `applications`.

    `program`: path of the program as the file has it, relative to the file's folder. `members`: the robots that run it,
    by their places in the fleet file, ascending. `share`: part of half a round that its events may take; None if the
    file has none. `imports`: name of an import of the program -> name of the application to which it is bound.
    `params`: values of the program's params. `spans`: places of the values, by their keys, such as "name" or
    "import.Mapping".
    """

    name: str
    program: str
    members: tuple[int, ...]
    share: float | None
    imports: tuple[tuple[str, str], ...]
    params: dict[str, Any]
    spans: dict[str, Span]


def named_programs(source: Source) -> dict[str, str]:
    """Return application -> program of a fleet file, before the file is checked.

    Wrong entries are left out: `read_applications` reports them.
    """
    entries = value_of(YamlReader(source, lambda *mistake: None).document(), "applications")
    found = {}
    for entry in entries.value if isinstance(entries, yaml.SequenceNode) else []:
        name, program = value_of(entry, "name"), value_of(entry, "program")
        if isinstance(name, yaml.ScalarNode) and isinstance(program, yaml.ScalarNode):
            found[name.value] = program.value
    return found


def read_applications(
    reader: YamlReader, node: YamlNode | None, robots: Sequence[str]
) -> tuple[ApplicationSettings, ...]:
    """Read `applications`; empty if the file has none. `robots`: the names of all robots, by place.

    Names of applications are unique, the shares on a robot are at most 1, and each robot runs an application.
    """
    entries = reader.items(node, "applications")
    if node is not None and not entries:
        reader.report("F005", "applications is empty", node, "list an application, or remove `applications`")
    found = [_application(reader, entry, f"application {index}", robots) for index, entry in enumerate(entries)]
    seen: dict[str, int] = {}
    for index, (application, entry) in enumerate(zip(found, entries, strict=True)):
        if application.name and seen.setdefault(application.name, index) != index:
            message = f"application {seen[application.name]} is called {application.name} as well"
            reader.report("F006", message, value_of(entry, "name") or entry, "give it another name")
    if node is not None and found:
        _check_robots(reader, node, found, entries, robots)
        _check_instances(reader, found, entries)
    return tuple(found)


def _application(reader: YamlReader, entry: YamlNode, what: str, robots: Sequence[str]) -> ApplicationSettings:
    keys = reader.table(entry, what, ["name", "program"], ["robots", "share", "import", "params"])
    name: str = reader.scalar(keys.get("name"), f"{what}'s name", str) or ""
    if name and not _NAME.fullmatch(name):
        reader.report("F005", f"{name!r} cannot be an application's name", keys["name"], _BAD_NAME)
    what = f"application {name}" if name else what
    bound, params = _table(keys.get("import")), _table(keys.get("params"))
    for key in ("import", "params"):
        reader.table(keys.get(key), f"{what}'s {key}", [], [*bound, *params])
    imports = {key: reader.scalar(value, f"{what}'s import of {key}", str) or "" for key, value in bound.items()}
    share = reader.number(keys.get("share"), f"{what}'s share", 0.0, 1.0)
    if share == 0.0:
        reader.report("F005", f"{what}'s share is 0: it would run no event", keys["share"], "write a share above 0")
    spans = {key: reader.span(value) for key, value in keys.items()}
    spans |= {f"import.{key}": reader.span(value) for key, value in bound.items()}
    spans |= {f"params.{key}": reader.span(value) for key, value in params.items()}
    return ApplicationSettings(
        name=name,
        program=reader.scalar(keys.get("program"), f"{what}'s program", str) or "",
        members=_members(reader, keys.get("robots"), what, robots),
        share=share,
        imports=tuple(imports.items()),
        params={key: reader.plain(value, f"param {key}") for key, value in params.items()},
        spans={"": reader.span(entry), **spans},
    )


def _table(node: YamlNode | None) -> dict[str, YamlNode]:
    pairs = node.value if isinstance(node, yaml.MappingNode) else []
    return {key.value: value for key, value in pairs if isinstance(key, yaml.ScalarNode)}


def _members(reader: YamlReader, node: YamlNode | None, what: str, robots: Sequence[str]) -> tuple[int, ...]:
    """Return the places of the robots that run an application: all robots if it has no `robots`."""
    if node is None:
        return tuple(range(len(robots)))
    places: set[int] = set()
    entries = reader.items(node, f"{what}'s robots")
    if isinstance(node, yaml.SequenceNode) and not entries:
        reader.report("F005", f"{what} has no robots", node, "name a robot, or remove the application")
    for entry in entries:
        name: str | None = reader.scalar(entry, f"a robot of {what}", str)
        if name is None:
            continue
        if name not in robots:
            known = ", ".join(filter(None, robots))
            reader.report("F005", f"{what} names {name!r}, which is no robot of the fleet", entry, f"robots: {known}")
        elif robots.index(name) in places:
            reader.report("F006", f"{what} names the robot {name} twice", entry, "remove one of the two")
        else:
            places.add(robots.index(name))
    return tuple(sorted(places))


def _check_instances(reader: YamlReader, found: Sequence[ApplicationSettings], entries: Sequence[YamlNode]) -> None:
    """Report the application with which the fleet has too many instances."""
    total = 0
    for application, entry in zip(found, entries, strict=True):
        total += len(application.members)
        if total > MOST_INSTANCES:
            message = f"with application {application.name}, the robots run {total} instances of applications"
            help = "give robots fewer applications with `robots`, or put two applications into one program"
            reader.report("F005", f"{message}; at most {MOST_INSTANCES} are possible", entry, help)
            return


def _check_robots(
    reader: YamlReader,
    node: YamlNode,
    found: Sequence[ApplicationSettings],
    entries: Sequence[YamlNode],
    robots: Sequence[str],
) -> None:
    """Report robots without an application, and robots whose applications have too large shares."""
    reported = set[tuple[int, ...]]()
    for place, robot in enumerate(robots):
        here = tuple(index for index, application in enumerate(found) if place in application.members)
        if not here:
            help = f"add {robot} to the robots of an application, or remove it from the fleet"
            reader.report("F005", f"the robot {robot} runs no application", node, help)
        given = [found[index].share for index in here]
        total = sum(share for share in given if share is not None)
        excess = total > 1 + 1e-9
        if here in reported or not (excess or (total > 1 - 1e-9 and None in given)):
            continue
        reported.add(here)
        names = " and ".join(found[index].name for index in here if found[index].share is not None)
        last = max(index for index in here if found[index].share is not None)
        message = f"the shares on {robot}, those of {names}, add up to {total:g}"
        message += "; at most 1 is possible" if excess else ", which leaves nothing for an application without `share`"
        reader.report("F005", message, value_of(entries[last], "share") or node, "write smaller shares")
