"""Statements -> the formatted text: indentation, continuation lines, blank lines, comments."""

from __future__ import annotations

from koordgen.lang.format.rows import Row, rows
from koordgen.lang.format.spacing import Spacer
from koordgen.lang.format.statements import Statement, statements

LEVEL = 2  # spaces a block
FURTHER = 4  # spaces that a continuation line stands deeper
APART = 2  # spaces between code and a comment behind it


class _Line:
    """One line of the result. `column` is where its comment stood, -1 when it is not `beside` code."""

    __slots__ = ("blank", "code", "column", "comment")

    def __init__(self, code: str, row: Row, beside: bool) -> None:
        self.code = code
        self.comment = row.comment
        self.column = row.column if beside else -1
        self.blank = row.blank_before


def arranged(text: str) -> str:
    """The text in the one style. It must be free of mistakes of layout and syntax; `\\n` ends its lines."""
    found = statements(rows(text))
    lines: list[_Line] = []
    for statement, blank in zip(found, _blanks(found), strict=True):
        first = len(lines)
        lines += _lines(statement)
        lines[first].blank = blank
    pairs = zip(lines, _starts(lines), strict=True)
    return "".join("\n" * line.blank + start + line.comment + "\n" for line, start in pairs)


def _blanks(found: list[Statement]) -> list[bool]:
    """Whether a blank line stands before each statement. One does between sections, but sections of one line and one
    kind stand as close as they were written. Within a section one is kept, but not below a header."""
    result = [False] * len(found)
    section = 0  # where the last section began
    for i in range(1, len(found)):
        statement, before = found[i], found[i - 1]
        result[i] = statement.rows[0].blank_before and statement.level <= before.level
        if not before.is_comment and before.level == 0:
            section = i - 1
        if statement.level == 0 and not (before.is_comment and before.level == 0):
            following = next((k for k in range(i, len(found)) if not found[k].is_comment), None)
            if following is not None and not (
                section == i - 1
                and found[section].kind == found[following].kind
                and (following + 1 == len(found) or found[following + 1].level == 0)
            ):
                result[i] = True
    return result


def _lines(statement: Statement) -> list[_Line]:
    """The lines of one statement. One that goes on with another stands deeper than the line whose bracket it is in;
    one that begins with closing brackets stands like the line that opened them."""
    result: list[_Line] = []
    spacer = Spacer()
    margin = statement.level * LEVEL
    opened: list[int] = []  # the margin of the line of each open bracket
    for row in statement.rows:
        indent = margin
        if row.inside:
            closing = next((k for k, token in enumerate(row.tokens) if token not in ")]}"), len(row.tokens))
            indent = opened[-closing] if closing else (opened[-1] if opened else margin) + FURTHER
        words: list[str] = []
        for token in row.tokens:
            if spacer.take(token) and words:
                words.append(" ")
            words.append(token)
            del opened[len(spacer.brackets) :]
            opened += [indent] * (len(spacer.brackets) - len(opened))
        alone = not row.tokens and (row.inside or statement.is_comment)
        code = "".join(words) + " \\" * row.continued
        result.append(_Line(" " * indent + code if code or alone else "", row, bool(row.comment) and not alone))
    return result


def _starts(lines: list[_Line]) -> list[str]:
    """What stands before the comment of each line. Comments beside code on consecutive lines that stood in one column
    do so again."""
    result: list[str] = []
    while len(result) < len(lines):
        first = end = len(result)
        while end < len(lines) and lines[end].column == lines[first].column and (end == first or not lines[end].blank):
            end += 1
        run = lines[first:end]
        width = max(len(line.code) for line in run) + APART
        result += [line.code.ljust(width) if line.column >= 0 else line.code for line in run]
    return result
