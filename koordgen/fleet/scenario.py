"""Scenario files of harnesses: YAML that the harness checks, with errors at lines and columns.

The harness reports an error with a path of keys and list indices; this module finds its line and column.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

import yaml

from koordgen.fleet.yaml_reader import Report, YamlNode, YamlReader
from koordgen.lang.source import Source

Path = tuple[str | int, ...]


class ScenarioMistake(Protocol):
    """Error in a scenario. `path`: keys and indices to the value; `at_key`: the key is wrong, not the value."""

    @property
    def code(self) -> str: ...

    @property
    def path(self) -> Path: ...

    @property
    def message(self) -> str: ...

    @property
    def hint(self) -> str: ...

    @property
    def at_key(self) -> bool: ...


def read(source: Source, check: Callable[[Any], Sequence[ScenarioMistake]], report: Report) -> Any:
    """Read and check a scenario file. Return its content as JSON values; None if an error was reported."""
    mistakes: list[tuple[str, str, Any, str]] = []
    reader = YamlReader(source, lambda *mistake: mistakes.append(mistake))
    root = reader.document()
    plain = None
    if root is not None:
        for key in _repeated(root):
            reader.report("F006", f"{key.value!r} appears twice", key, "remove one of the two")
        plain = reader.plain(root, "a value")
        if not mistakes:
            for found in check(plain):
                reader.report(found.code, found.message, _place(root, found.path, found.at_key), found.hint)
    for mistake in sorted(mistakes, key=lambda m: (m[2].line, m[2].column)):
        report(*mistake)
    return None if mistakes else plain


def _repeated(node: YamlNode) -> Iterator[YamlNode]:
    """Yield each key that appears in the same mapping a second time."""
    if isinstance(node, yaml.SequenceNode):
        for item in node.value:
            yield from _repeated(item)
    elif isinstance(node, yaml.MappingNode):
        seen = set()
        for key, value in node.value:
            if key.value in seen:
                yield key
            seen.add(key.value if isinstance(key.value, str) else None)
            yield from _repeated(value)


def _place(root: YamlNode, path: Path, at_key: bool) -> YamlNode:
    """Return the node at a path; if a step does not exist, the node before that step."""
    node = root
    for depth, step in enumerate(path):
        if isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
            node = node.value[step]
        elif isinstance(node, yaml.MappingNode):
            pairs = [(key, value) for key, value in node.value if str(step) == key.value]
            if not pairs:
                return node
            key, value = pairs[0]
            node = key if at_key and depth == len(path) - 1 else value
    return node
