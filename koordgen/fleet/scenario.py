"""A harness's scenario file: YAML whose meaning the harness knows, and whose every value still knows its place.

What is wrong with it the harness tells by paths of keys and numbers; here they become lines and columns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

import yaml

from koordgen.fleet.located import Reader, Report, YamlNode
from koordgen.lang.source import Source

Path = tuple[str | int, ...]


class Mistake(Protocol):
    """What a harness finds wrong: `path` leads to it (`at_key`: its key is), `code` is one of the catalogue's."""

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


def read(source: Source, check: Callable[[Any], Sequence[Mistake]], report: Report) -> Any:
    """The file's plain value, as for JSON. None after anything was reported."""
    mistakes: list[tuple[str, str, Any, str]] = []
    reader = Reader(source, lambda *mistake: mistakes.append(mistake))
    root = reader.document()
    plain = None
    if root is not None:
        for key in _repeated(root):
            reader.report("F006", f"{key.value!r} stands twice", key)
        plain = reader.plain(root, "a value")
        if not mistakes:
            for found in check(plain):
                reader.report(found.code, found.message, _place(root, found.path, found.at_key), found.hint)
    for mistake in sorted(mistakes, key=lambda m: (m[2].line, m[2].column)):
        report(*mistake)
    return None if mistakes else plain


def _repeated(node: YamlNode) -> Iterator[YamlNode]:
    """The keys that stand in one mapping a second time."""
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
    """Where a path leads; as far as it does, if it ends in nothing."""
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
