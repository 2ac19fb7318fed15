"""Typed access to YAML with line numbers: getters report each error at its line and column.

Depth and size of a text are checked before it is parsed into a tree: the parser of libyaml recurses on the C stack, and
nested aliases can stand for more values than fit into memory.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import yaml

from koordgen.fleet.yaml_errors import mistake
from koordgen.lang.source import Source, Span

# The C parser of libyaml is ten times faster. Wheels of PyYAML contain it; packages of some distributions do not.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_CONSTRUCT = yaml.constructor.SafeConstructor()

DEEPEST = 100  # levels of nested lists and tables
MOST_VALUES = 200_000  # limit on the values in a text; the values of an alias count each time the alias is used
LONGEST_NUMBER = 32  # characters

YamlNode = yaml.Node
Report = Callable[[str, str, Span, str], None]  # code, message, place, help


class YamlReader:
    """Typed access to one YAML text.

    A getter that finds an error reports it and returns None. The caller continues, so one run reports all errors.
    """

    def __init__(self, source: Source, report: Report) -> None:
        self._source = source
        self._report = report

    def document(self) -> YamlNode | None:
        """Return the root of the file's only document; None after an error."""
        try:
            if self._is_too_large():
                return None
            node = yaml.compose(self._source.text, Loader=_LOADER)
        except yaml.YAMLError as error:
            line, column, message, help = mistake(error, self._source.text)
            self._report("F001", message, Span(line, column, line, column + 1), help)
            return None
        except RecursionError:
            self._report("F001", "lists and tables are nested too deep", Span(1, 1, 1, 2), "")
            return None
        if node is None:
            self._report("F001", "the file is empty", Span(1, 1, 1, 2), "")
        return node

    def _is_too_large(self) -> bool:
        """Return whether the text exceeds a limit, and report it. Raises yaml.YAMLError."""
        sizes: list[tuple[str | None, int]] = [(None, 0)]  # anchor and number of values of each enclosing collection
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
                size, anchor = anchors.get(str(event.anchor), 0), None  # `compose` reports an undefined alias
                if event.anchor in [around for around, _ in sizes]:
                    what = f"the alias *{event.anchor} is a part of its own value"
            if anchor is not None and size:
                anchors[anchor] = size
            sizes[-1] = sizes[-1][0], sizes[-1][1] + size
            if len(sizes) > DEEPEST + 1:
                what = f"lists and tables are nested more than {DEEPEST} deep"
            elif sizes[-1][1] > MOST_VALUES:
                what = f"the file has more than {MOST_VALUES:,} values, with those of its aliases"
            if what:
                mark = event.start_mark
                line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
                self._report("F001", what, Span(line, column, line, column + 1), "")
                return True
        return False

    def report(self, code: str, message: str, node: YamlNode, help: str = "") -> None:
        """Report an error that the caller found, at the place of a node."""
        self._report(code, message, self.span(node), help)

    def span(self, node: YamlNode) -> Span:
        """Return the place of a node; for a block of several lines, that of its first line."""
        start, end = node.start_mark, node.end_mark
        if end.line != start.line:
            end_line, end_column = start.line, max(start.column + 1, len(self._source.line(start.line + 1)))
        else:
            end_line, end_column = end.line, max(end.column, start.column + 1)
        return Span(start.line + 1, start.column + 1, end_line + 1, end_column + 1)

    def table(
        self, node: YamlNode | None, what: str, required: Iterable[str], optional: Iterable[str]
    ) -> dict[str, YamlNode]:
        """Return the values of a mapping by key. Unknown, repeated and missing keys are reported."""
        found: dict[str, YamlNode] = {}
        if node is None:
            return found
        if not isinstance(node, yaml.MappingNode):
            self.report("F004", f"{what} must be a mapping (key: value)", node)
            return found
        known = [*required, *optional]
        meant = set()  # guesses for misspelt keys, which are not reported as missing as well
        for key_node, value in node.value:
            key = key_node.value if isinstance(key_node, yaml.ScalarNode) else None
            if key not in known:
                guess = _nearest(str(key), known)
                meant.add(guess)
                names = ", ".join(sorted(known)) or "none"
                help = f"did you mean {guess!r}?" if guess else f"possible keys: {names}"
                self.report("F002", f"unknown key {key!r} in {what}", key_node, help)
            elif key in found:
                self.report("F006", f"{key!r} appears twice in {what}", key_node, "remove one of the two")
            else:
                found[key] = value
        for key in required:
            if key not in found and key not in meant:
                self.report("F003", f"{what} lacks {key!r}", node)
        return found

    def items(self, node: YamlNode | None, what: str) -> list[YamlNode]:
        """Return the elements of a list."""
        if node is None:
            return []
        if not isinstance(node, yaml.SequenceNode):
            self.report("F004", f"{what} must be a list", node)
            return []
        return list(node.value)

    def scalar(self, node: YamlNode | None, what: str, kind: type) -> Any:
        """Return a text, bool, int or float. An int is accepted as a float; NaN and infinity are not."""
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
        """Return a number within [least, most]; None stands for no bound."""
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

    def choice(
        self, node: YamlNode | None, what: str, known: tuple[str, ...], renamed: Mapping[str, str] | None = None
    ) -> str | None:
        """Return a text that is one of `known`. `renamed` maps names of earlier versions to those of today."""
        text: str | None = self.scalar(node, what, str)
        if text is None or node is None or text in known:
            return text
        now = renamed.get(text) if renamed else None
        help = f"{text!r} is called {now!r} now: write {now}" if now else f"possible values: {', '.join(known)}"
        self.report("F005", f"{what} cannot be {text!r}", node, help)
        return None

    def vector(self, node: YamlNode | None, what: str) -> list[float] | None:
        """Return a point [x, y, z] in metres, local ENU."""
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
        """Return a value of any structure: lists, tables, numbers, bools and texts; dates and null are errors."""
        if isinstance(node, yaml.SequenceNode):
            return [self.plain(item, what) for item in node.value]
        if isinstance(node, yaml.MappingNode):
            pairs = [(self.plain(key, what), self.plain(value, what)) for key, value in node.value]
            return {key if not isinstance(key, (list, dict)) else str(key): value for key, value in pairs}
        value = _constructed(node)
        if type(value) not in _KIND_WORDS:
            self.report("F004", f"{what} must be a number, a bool, a text, or a list or table of these", node)
            return ""
        return value


def value_of(node: YamlNode | None, key: str) -> YamlNode | None:
    """Return the value of a key in a node that need not be a mapping; None if there is none."""
    if not isinstance(node, yaml.MappingNode):
        return None
    return next((value for name, value in node.value if name.value == key), None)


def _constructed(node: YamlNode) -> Any:
    """Return the value of a scalar; None for other nodes, for too long numbers and for numbers to the base of 60.

    YAML 1.1 reads `1:30` as such a number.
    """
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
