"""Mistakes in the form of a YAML text, in words for people who write fleet files: where they are, and what to write.

The parser of libyaml and that of PyYAML name the same mistakes differently; both are understood.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import yaml

_BEGINS = re.compile(r"( *)((?:- +)*)")


class Mistake(NamedTuple):
    """Line and column from 1; `help` may be empty."""

    line: int
    column: int
    message: str
    help: str


class Place(NamedTuple):
    """Line and column from 0, as PyYAML counts."""

    line: int
    column: int


def mistake(error: yaml.YAMLError, text: str) -> Mistake:
    """Return the mistake that an error of PyYAML stands for."""
    lines = text.splitlines()
    if isinstance(error, yaml.reader.ReaderError):
        before = text[: error.position]
        line = before.count("\n")
        column = len(before) - before.rfind("\n")
        code = ord(error.character) if isinstance(error.character, str) else error.character
        return Mistake(line + 1, column, f"the character with the code {code} has no place in YAML", "delete it")
    if not isinstance(error, yaml.MarkedYAMLError):
        return Mistake(1, 1, f"not YAML: {str(error).splitlines()[0]}", "")
    mark = error.problem_mark or error.context_mark
    here = Place(mark.line, mark.column) if mark else Place(0, 0)
    begin = Place(error.context_mark.line, error.context_mark.column) if error.context_mark else here
    context, problem = error.context or "", error.problem or error.context or ""
    place, message, help = _told(context, problem, here, begin, [*lines, *([""] * (here.line + 1 - len(lines)))])
    return Mistake(place.line + 1, place.column + 1, message, help)


def _told(context: str, problem: str, here: Place, begin: Place, lines: list[str]) -> tuple[Place, str, str]:
    line = lines[here.line]
    character = line[here.column : here.column + 1]
    if "expected" in problem and context.startswith("while parsing a block") and "content" not in problem:
        return (here, *_block(here, lines))
    if "mapping values are not allowed" in problem:
        return (here, *_second_colon(here, lines))
    if "tab character" in problem or (character == "\t" and "cannot start" in problem):
        return here, "a tab stands in the indentation", "indent with spaces"
    if "cannot start any token" in problem:
        return here, f"a value cannot begin with '{character}'", "write the value in quotes"
    if "could not find expected ':'" in problem:
        return begin, "this line has no ': '", "write 'key: value'; a list's line begins with '- '"
    for close, open in (("]", "["), ("}", "{")):
        if f"',' or '{close}'" in problem:
            if here.line == begin.line:
                return here, f"a ',' or '{close}' is missing before this", ""
            return begin, f"this '{open}' is not closed", f"write '{close}' behind the last value"
    if "unexpected end of stream" in problem:
        return begin, "this quote is not closed", "a text in quotes ends with the same quote"
    if "undefined alias" in problem:
        return here, "undefined alias", "write a text that begins with '*' in quotes"
    if "node content" in problem:
        return here, "a value is expected here", ""
    if "unknown escape" in problem:
        return here, "this '\\' begins no known escape", "write the text in single quotes"
    if "another document" in problem:
        return here, "a second document begins here", "a file holds one document: leave out the line '---'"
    return here, f"not YAML: {problem}", ""


def _block(here: Place, lines: list[str]) -> tuple[str, str]:
    """The words for a line that does not go on with the list or table around it."""
    line = lines[here.line]
    if line[: here.column].strip(" -"):
        shown = line[here.column :].strip()
        help = "write a text that holds quotes in quotes of the other kind"
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
                f"this {kind} stands at column {column + 1}, the one above it, in line {number + 1}, at {other + 1}"
            )
            return message, f"indent it by {other} space{'s' * (other != 1)}"
        break
    if is_entry:
        return "a '-' begins a list entry, but the lines around it are keys", "write 'key: value', or indent the list"
    return (
        "this key stands among list entries",
        "begin the line with '- ', or indent it like the keys of the entry above",
    )


class _Begin(NamedTuple):
    """The columns of a line's first '-' (or first character), and of what follows its '-'."""

    entry: int
    key: int


def _begins(line: str) -> _Begin:
    found = _BEGINS.match(line)
    assert found is not None
    return _Begin(len(found[1]), found.end())


def _second_colon(here: Place, lines: list[str]) -> tuple[str, str]:
    """The words for a ': ' where no key can stand."""
    if ": " in lines[here.line][: here.column]:
        return "a second ': ' stands in this line", "write a text that contains ': ' in quotes"
    for number in range(here.line - 1, -1, -1):
        above = lines[number].split(" #")[0].strip()
        if above and not above.startswith("#"):
            name, colon, value = above.removeprefix("- ").partition(":")
            if colon and value and not value.startswith(" "):
                return f"line {number + 1} has no space behind its ':'", f"write '{name}: {value}'"
            return f"this key is indented below line {number + 1}, which has a value already", "indent keys alike"
    return "no key can stand here", ""
