"""Text -> rows: its lines with their tokens and comments, and which of them go on with the line before."""

from __future__ import annotations

from koordgen.lang.syntax.layout import GOES_ON, TOKEN, kind_of


class Row:
    """One line of the text as it was written; columns count from 0."""

    __slots__ = ("blank_before", "column", "comment", "continued", "indent", "inside", "tokens")

    def __init__(self) -> None:
        self.tokens: list[str] = []
        self.indent = 0  # of its first token
        self.comment = ""
        self.column = 0  # of its comment
        self.continued = False  # ends with a backslash
        self.inside = False  # goes on with the statement of the row before
        self.blank_before = False


def rows(text: str) -> list[Row]:
    """The rows of a text without layout mistakes. Blank ones are left out, and backslashes that continue nothing."""
    found: list[Row] = []
    row = Row()
    depth, indent, line_start = 0, 0, 0
    fresh = True  # nothing of this statement has been seen
    for match in TOKEN.finditer(text):
        token = match[0]
        kind = kind_of(token)
        if kind == "SPACE":
            if fresh:
                indent = len(token)
        elif kind == "COMMENT":
            row.comment, row.column = token.rstrip(), match.start() - line_start
        elif kind == "NEWLINE" or kind == "CONTINUED":
            line_start = match.end()
            row.continued = kind == "CONTINUED"
            _end(row, found)
            goes_on = row.continued or depth > 0
            if not goes_on:
                fresh, indent = True, 0
            blank = not row.tokens and not row.comment and (not row.continued or row.blank_before)
            row = Row()
            row.blank_before = blank
            row.inside = goes_on and not fresh
        else:
            if fresh:
                row.indent, fresh = indent, False
            row.tokens.append(token)
            depth += 1 if token in "([{" else -1 if token in ")]}" else 0
    _end(row, found)
    _join(found)
    return found


def _end(row: Row, found: list[Row]) -> None:
    if row.tokens or (row.comment and not (row.inside and found[-1].continued)):
        found.append(row)
    elif row.comment:  # behind a backslash that continues nothing
        found[-1].comment, found[-1].column = row.comment, row.column
        found[-1].continued = False
    elif not row.continued and found:
        found[-1].continued = False


def _join(found: list[Row]) -> None:
    """A row that begins with `and` or `or` goes on with the statement before, and so do comments between them."""
    for i, row in enumerate(found):
        if row.tokens and row.tokens[0] in GOES_ON:
            row.inside = True
            for before in reversed(found[:i]):
                if before.tokens:
                    break
                before.inside = True
