"""Settings of targets in the fleet file: values over the manifest's defaults, and names of the user's classes."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import yaml

from koordgen.fleet.manifest import SETTING_TYPES, Setting
from koordgen.fleet.yaml_reader import YamlNode, YamlReader
from koordgen.lang.node import Node

_DRIVER = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)

# Returns the reason why a value does not fit, or "".
ValueCheck = Callable[[Any], str]


class DriverClass(Node):
    """A user's Python class. `module`: dotted name of its module. `path`: relative path of that module's file."""

    module: str
    name: str

    @property
    def path(self) -> str:
        return f"{self.module.replace('.', '/')}.py"


def _anything(value: Any) -> str:
    return ""


def _any_list(variable: str, position: str) -> str:
    return ""


def _any_class(driver: DriverClass, methods: tuple[str, ...]) -> str:
    return ""


class NameChecks(Node):
    """Checks of names in the fleet file against the program. Each returns the reason why a name does not fit, or "".

    avoid: checks the name of a variable. markers: checks the name of a list, and of the field with the position of its
    elements. own_class: checks that a user's class has the given methods and a constructor with one argument.
    properties: names that `monitors` may have; None accepts every name.
    """

    avoid: ValueCheck = _anything
    markers: Callable[[str, str], str] = _any_list
    own_class: Callable[[DriverClass, tuple[str, ...]], str] = _any_class
    properties: tuple[str, ...] | None = None


def read_settings(
    reader: YamlReader, node: YamlNode | None, what: str, offered: Mapping[str, Setting], known: NameChecks
) -> dict[str, Any]:
    """Read all settings of a target; the manifest has the defaults of those that the file leaves out."""
    given = read_given(reader, reader.table(node, what, [], offered), offered, known)
    return {**{key: setting.default for key, setting in offered.items()}, **given}


def read_given(
    reader: YamlReader, given: Mapping[str, YamlNode], offered: Mapping[str, Setting], known: NameChecks
) -> dict[str, Any]:
    """Read the settings that the file has, without defaults."""
    values: dict[str, Any] = {}
    for key, value in given.items():
        setting, kind = offered[key], SETTING_TYPES[offered[key].type]
        if isinstance(value, yaml.ScalarNode) and value.value in setting.words:
            found = value.value
        elif kind in (int, float):
            found = reader.number(value, key, setting.least, setting.most, kind)
        else:
            found = reader.scalar(value, key, kind)
            if setting.words and found is not None:
                _strange(reader, value, key, found, setting, known)
        if found is not None:
            values[key] = found
    return values


def _strange(reader: YamlReader, node: YamlNode, key: str, text: str, setting: Setting, known: NameChecks) -> None:
    """Check the text of a setting with words: one of the words or, if the setting has methods, a user's class."""
    driver = as_driver(text) if setting.methods else None
    if driver is None:
        own = ", or MODULE:CLASS for a class of your own" if setting.methods else ""
        reader.report("F005", f"{key} cannot be {text!r}", node, f"possible values: {', '.join(setting.words)}{own}")
    elif misfit := known.own_class(driver, setting.methods):
        reader.report("F005", misfit, node)


def as_driver(text: str) -> DriverClass | None:
    """Parse `module:Class`; None for another text."""
    if not _DRIVER.fullmatch(text):
        return None
    module, _, name = text.partition(":")
    return DriverClass(module, name)
