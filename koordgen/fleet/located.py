"""Typed access to YAML in which every value knows its place: getters report each mistake at its line and column.

A text is limited in depth and size before it becomes a tree: the parser of libyaml recurses on the C stack, and aliases
of aliases stand for more values than any memory holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import yaml

from koordgen.fleet.yaml_mistakes import mistake
from koordgen.lang.source import Source, Span

# The C parser of libyaml is ten times faster; wheels of PyYAML have it, some distributions do not.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_CONSTRUCT = yaml.constructor.SafeConstructor()

DEEPEST = 100  # collections within one another
MOST_VALUES = 200_000  # of a text, with those that its aliases stand for
LONGEST_NUMBER = 32  # characters

YamlNode = yaml.Node
Report = Callable[[str, str, Span, str], None]  # code, message, place, help


class Reader:
    """Typed access to one YAML text. A getter that finds a mistake reports it and returns None: its caller goes on,
    so that one run tells all mistakes."""

    def __init__(self, source: Source, report: Report) -> None:
        self._source = source
        self._report = report

    def document(self) -> YamlNode | None:
        """The only document of the file."""
        try:
            if self._is_too_large():
                return None
            node = yaml.compose(self._source.text, Loader=_LOADER)
        except yaml.YAMLError as error:
            line, column, message, help = mistake(error, self._source.text)
            self._report("F001", message, Span(line, column, line, column + 1), help)
            return None
        except RecursionError:
            self._report("F001", "collections stand within one another too deep", Span(1, 1, 1, 2), "")
            return None
        if node is None:
            self._report("F001", "the file is empty", Span(1, 1, 1, 2), "")
        return node

    def _is_too_large(self) -> bool:
        """Return whether the text exceeds a limit, which is reported then. Raises yaml.YAMLError."""
        sizes: list[tuple[str | None, int]] = [(None, 0)]  # of the collections around: anchor, values so far
        anchors: dict[str, int] = {}
        for event in yaml.parse(self._source.text, Loader=_LOADER):
            anchor, size, what = getattr(event, "anchor", None), 0, ""
            if isinstance(event, yaml.CollectionStartEvent):
                sizes.append((anchor, 1))
            elif isinstance(event, yaml.CollectionEndEvent):
                anchor, size = sizes.pop()
            elif isinstance(event, yaml.ScalarEvent):
                size = 1
            elif isinstance(event, yaml.AliasEvent):
                size, anchor = anchors.get(str(event.anchor), 0), None  # that of an unknown one is told when composing
                if event.anchor in [around for around, _ in sizes]:
                    what = f"*{event.anchor} stands within its own value"
            if anchor is not None and size:
                anchors[anchor] = size
            sizes[-1] = sizes[-1][0], sizes[-1][1] + size
            if len(sizes) > DEEPEST + 1:
                what = f"collections stand within one another more than {DEEPEST} deep"
            elif sizes[-1][1] > MOST_VALUES:
                what = f"it has more than {MOST_VALUES:,} values, with those that aliases stand for"
            if what:
                mark = event.start_mark
                line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
                self._report("F001", what, Span(line, column, line, column + 1), "")
                return True
        return False

    def report(self, code: str, message: str, node: YamlNode, help: str = "") -> None:
        """A mistake of the caller's own finding, at a node's place."""
        start, end = node.start_mark, node.end_mark
        if end.line != start.line:  # a block: point at its first line only
            end_line, end_column = start.line, max(start.column + 1, len(self._source.line(start.line + 1)))
        else:
            end_line, end_column = end.line, max(end.column, start.column + 1)
        self._report(code, message, Span(start.line + 1, start.column + 1, end_line + 1, end_column + 1), help)

    def table(
        self, node: YamlNode | None, what: str, required: Iterable[str], optional: Iterable[str]
    ) -> dict[str, YamlNode]:
        """The values of a mapping by key; unknown, repeated and missing keys are reported."""
        found: dict[str, YamlNode] = {}
        if node is None:
            return found
        if not isinstance(node, yaml.MappingNode):
            self.report("F004", f"{what} must be a mapping (key: value)", node)
            return found
        known = [*required, *optional]
        meant = set()  # a misspelt key is one mistake, not also a missing one
        for key_node, value in node.value:
            key = key_node.value if isinstance(key_node, yaml.ScalarNode) else None
            if key not in known:
                guess = _nearest(str(key), known)
                meant.add(guess)
                help = f"did you mean {guess!r}?" if guess else f"known here: {', '.join(sorted(known)) or 'nothing'}"
                self.report("F002", f"unknown key {key!r} in {what}", key_node, help)
            elif key in found:
                self.report("F006", f"{key!r} stands twice in {what}", key_node)
            else:
                found[key] = value
        for key in required:
            if key not in found and key not in meant:
                self.report("F003", f"{what} lacks {key!r}", node)
        return found

    def items(self, node: YamlNode | None, what: str) -> list[YamlNode]:
        """The elements of a sequence."""
        if node is None:
            return []
        if not isinstance(node, yaml.SequenceNode):
            self.report("F004", f"{what} must be a list", node)
            return []
        return list(node.value)

    def scalar(self, node: YamlNode | None, what: str, kind: type) -> Any:
        """A string, bool, int or float (an int serves as float; NaN and infinity never do)."""
        if node is None:
            return None
        value = _constructed(node)
        if kind is float and type(value) is int and abs(value) < 2**53:
            value = float(value)
        if type(value) is not kind or (isinstance(value, float) and not math.isfinite(value)):
            shown = f", not {_short(node.value)!r}" if isinstance(node, yaml.ScalarNode) else ""
            self.report("F004", f"{what} must be {_KIND_WORDS[kind]}{shown}", node)
            return None
        return value

    def number(
        self, node: YamlNode | None, what: str, least: float | None, most: float | None, kind: type = float
    ) -> Any:
        """A number within [least, most]; None bounds nothing."""
        value = self.scalar(node, what, kind)
        if value is None or node is None:
            return None
        if (least is not None and value < least) or (most is not None and value > most):
            bounds = (
                f"at least {least:g}"
                if most is None
                else f"at most {most:g}"
                if least is None
                else f"{least:g} to {most:g}"
            )
            self.report("F005", f"{what} is {value:g}; it must be {bounds}", node)
            return None
        return value

    def choice(self, node: YamlNode | None, what: str, known: tuple[str, ...]) -> str | None:
        """One of these texts."""
        text: str | None = self.scalar(node, what, str)
        if text is None or node is None or text in known:
            return text
        self.report("F005", f"{what} is {text!r}", node, f"there are: {', '.join(known)}")
        return None

    def vector(self, node: YamlNode | None, what: str) -> list[float] | None:
        """Three metres, [x, y, z] in local ENU."""
        if node is None:
            return None
        elements = self.items(node, what)
        if len(elements) != 3:
            if isinstance(node, yaml.SequenceNode):
                self.report("F004", f"{what} must be [x, y, z], three numbers in metres", node)
            return None
        values = [self.number(e, f"{what}'s {axis}", -1e5, 1e5) for e, axis in zip(elements, "xyz", strict=True)]
        return values if None not in values else None

    def plain(self, node: YamlNode, what: str) -> Any:
        """A value of whatever form: lists, tables, and scalars that are no dates and no null."""
        if isinstance(node, yaml.SequenceNode):
            return [self.plain(item, what) for item in node.value]
        if isinstance(node, yaml.MappingNode):
            pairs = [(self.plain(key, what), self.plain(value, what)) for key, value in node.value]
            return {key if not isinstance(key, (list, dict)) else str(key): value for key, value in pairs}
        value = _constructed(node)
        if type(value) not in _KIND_WORDS:
            self.report("F004", f"{what} must be a number, a bool, a text, or lists and tables of these", node)
            return ""
        return value


def _constructed(node: YamlNode) -> Any:
    """The value of a scalar, None of anything else. Numbers that are too long are none, nor are those to the base of
    60, which YAML 1.1 takes `1:30` for."""
    if not isinstance(node, yaml.ScalarNode):
        return None
    is_number = node.tag in ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
    if is_number and (len(node.value) > LONGEST_NUMBER or ":" in node.value):
        return None
    try:
        return _CONSTRUCT.construct_object(node)
    except (yaml.YAMLError, ValueError):
        return None


def _short(text: str) -> str:
    return text if len(text) <= 2 * LONGEST_NUMBER else f"{text[:LONGEST_NUMBER]}..."


_KIND_WORDS = {str: "a text", bool: "true or false", int: "a whole number", float: "a finite number"}


def _nearest(word: str, known: list[str]) -> str | None:
    from difflib import get_close_matches

    return next(iter(get_close_matches(word, known, 1)), None)
