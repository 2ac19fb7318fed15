"""What a target offers to be set, and what a fleet file sets of it: numbers, words, classes of the user's own."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import yaml

from koordgen.fleet.located import Reader, YamlNode
from koordgen.fleet.manifest import SETTING_TYPES, Setting
from koordgen.lang.node import Node

_DRIVER = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)

# What is wrong with a value for one param of the program; "" for one that fits.
Fits = Callable[[Any], str]


class Driver(Node):
    """The class `name` that serves a module; `module` is its Python module, dotted, `path` the file of that."""

    module: str
    name: str

    @property
    def path(self) -> str:
        return f"{self.module.replace('.', '/')}.py"


def _anything(value: Any) -> str:
    return ""


def _any_list(variable: str, position: str) -> str:
    return ""


def _any_class(driver: Driver, methods: tuple[str, ...]) -> str:
    return ""


class Known(Node):
    """What the file's names must fit: `avoid` tells of a variable's name, `markers` of the name of a list and of the
    field in which its elements have their places, `own_class` of a class with these methods, made with one argument,
    what is wrong with it, or "". `properties` are the names that `monitors` may give; None: any."""

    avoid: Fits = _anything
    markers: Callable[[str, str], str] = _any_list
    own_class: Callable[[Driver, tuple[str, ...]], str] = _any_class
    properties: tuple[str, ...] | None = None


def read_settings(
    reader: Reader, node: YamlNode | None, what: str, offered: Mapping[str, Setting], known: Known
) -> dict[str, Any]:
    """All settings of a target: what the file says over the manifest's defaults."""
    given = read_given(reader, reader.table(node, what, [], offered), offered, known)
    return {**{key: setting.default for key, setting in offered.items()}, **given}


def read_given(
    reader: Reader, given: Mapping[str, YamlNode], offered: Mapping[str, Setting], known: Known
) -> dict[str, Any]:
    """What the file says, and nothing else."""
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


def _strange(reader: Reader, node: YamlNode, key: str, text: str, setting: Setting, known: Known) -> None:
    """None of the setting's words: a class of the user's own, where it takes one."""
    driver = as_driver(text) if setting.methods else None
    if driver is None:
        own = ", or module:Class of your own" if setting.methods else ""
        reader.report("F005", f"{key} is {text!r}", node, f"there are: {', '.join(setting.words)}{own}")
    elif misfit := known.own_class(driver, setting.methods):
        reader.report("F005", misfit, node)


def as_driver(text: str) -> Driver | None:
    """The class that `module:Class` names; None for what does not."""
    if not _DRIVER.fullmatch(text):
        return None
    module, _, name = text.partition(":")
    return Driver(module, name)
