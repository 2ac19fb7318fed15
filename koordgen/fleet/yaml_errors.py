"""YAML syntax errors, as messages for authors of fleet files: the place of the error, and what to write instead.

The parsers of libyaml and PyYAML have different messages for the same error; this module understands both.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import yaml

_BEGINS = re.compile(r"( *)((?:- +)*)")


class YamlMistake(NamedTuple):
    """Syntax error. Line and column count from 1; `help` may be empty."""

    line: int
    column: int
    message: str
    help: str


class TextPlace(NamedTuple):
    """Line and column, counted from 0 as in PyYAML."""

    line: int
    column: int


def mistake(error: yaml.YAMLError, text: str) -> YamlMistake:
    """Convert an error of PyYAML."""
    lines = text.splitlines()
    if isinstance(error, yaml.reader.ReaderError):
        before = text[: error.position]
        line = before.count("\n")
        column = len(before) - before.rfind("\n")
        code = ord(error.character) if isinstance(error.character, str) else error.character
        return YamlMistake(line + 1, column, f"YAML does not allow the character with the code {code}", "delete it")
    if not isinstance(error, yaml.MarkedYAMLError):
        return YamlMistake(1, 1, f"not YAML: {str(error).splitlines()[0]}", "")
    mark = error.problem_mark or error.context_mark
    here = TextPlace(mark.line, mark.column) if mark else TextPlace(0, 0)
    begin = TextPlace(error.context_mark.line, error.context_mark.column) if error.context_mark else here
    context, problem = error.context or "", error.problem or error.context or ""
    place, message, help = _explained(context, problem, here, begin, [*lines, *([""] * (here.line + 1 - len(lines)))])
    return YamlMistake(place.line + 1, place.column + 1, message, help)


def _explained(
    context: str, problem: str, here: TextPlace, begin: TextPlace, lines: list[str]
) -> tuple[TextPlace, str, str]:
    line = lines[here.line]
    character = line[here.column : here.column + 1]
    if "expected" in problem and context.startswith("while parsing a block") and "content" not in problem:
        return (here, *_block(here, lines))
    if "mapping values are not allowed" in problem:
        return (here, *_second_colon(here, lines))
    if "tab character" in problem or (character == "\t" and "cannot start" in problem):
        return here, "the indentation contains a tab", "indent with spaces"
    if "cannot start any token" in problem:
        return here, f"a value cannot begin with '{character}'", "write the value in quotes"
    if "could not find expected ':'" in problem:
        return begin, "this line has no ': '", "write 'key: value'; an entry of a list begins with '- '"
    for close, open in (("]", "["), ("}", "{")):
        if f"',' or '{close}'" in problem:
            if here.line == begin.line:
                return here, f"a ',' or '{close}' is missing before this", ""
            return begin, f"this '{open}' is not closed", f"write '{close}' after the last value"
    if "unexpected end of stream" in problem:
        return begin, "this quote is not closed", "end the text with the same quote"
    if "undefined alias" in problem:
        return here, "undefined alias", "write a text that begins with '*' in quotes"
    if "node content" in problem:
        return here, "a value is expected here", ""
    if "unknown escape" in problem:
        return here, "this '\\' does not begin a known escape", "write the text in single quotes"
    if "another document" in problem:
        return here, "a second document begins here", "a file has one document: remove the line '---'"
    return here, f"not YAML: {problem}", ""


def _block(here: TextPlace, lines: list[str]) -> tuple[str, str]:
    """Return message and help for a line that does not continue the list or table around it."""
    line = lines[here.line]
    if line[: here.column].strip(" -"):
        shown = line[here.column :].strip()
        help = "write a text that contains quotes in quotes of the other kind"
        return f"the value ends before this: {shown[:40]}", help
    own = _begins(line)
    is_entry = line.lstrip().startswith("-")
    kind, column = ("list entry", own.entry) if is_entry else ("key", own.key)
    for number in range(here.line - 1, -1, -1):
        above = lines[number]
        if not above.strip() or above.lstrip().startswith("#") or (is_entry and not above.lstrip().startswith("-")):
            continue
        other = _begins(above).entry if is_entry else _begins(above).key
        if other != column:
            message = (
                f"this {kind} is at column {column + 1}, but the one above it, in line {number + 1}, at {other + 1}"
            )
            return message, f"indent it by {other} space{'s' * (other != 1)}"
        break
    if is_entry:
        return "a '-' begins a list entry, but the lines around it are keys", "write 'key: value', or indent the list"
    return (
        "this key is among list entries",
        "begin the line with '- ', or indent it like the keys of the entry above",
    )


class _Begin(NamedTuple):
    """Columns, from 0, of a line's first character (`entry`) and of its first character after each '-' (`key`)."""

    entry: int
    key: int


def _begins(line: str) -> _Begin:
    found = _BEGINS.match(line)
    assert found is not None
    return _Begin(len(found[1]), found.end())


def _second_colon(here: TextPlace, lines: list[str]) -> tuple[str, str]:
    """Return message and help for a ': ' where no key is possible."""
    if ": " in lines[here.line][: here.column]:
        return "this line has a second ': '", "write a text that contains ': ' in quotes"
    for number in range(here.line - 1, -1, -1):
        above = lines[number].split(" #")[0].strip()
        if above and not above.startswith("#"):
            name, colon, value = above.removeprefix("- ").partition(":")
            if colon and value and not value.startswith(" "):
                return f"line {number + 1} has no space after its ':'", f"write '{name}: {value}'"
            message = f"this key is indented below line {number + 1}, which already has a value"
            return message, "indent the keys of one table alike"
    return "a key is not possible here", ""
