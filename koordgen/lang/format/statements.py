"""Rows -> statements: the rows that belong together, and the level of the block that each stands in."""

from __future__ import annotations

from koordgen.lang.format.rows import Row
from koordgen.lang.syntax.layout import KEYWORDS


class Statement:
    """The rows of one statement, or header, or of one comment that stands alone. `level` counts blocks from 0.
    Comments below the one behind its last row, in the same column, are rows of it."""

    __slots__ = ("level", "rows")

    def __init__(self, row: Row, level: int) -> None:
        self.rows = [row]
        self.level = level

    @property
    def is_comment(self) -> bool:
        return not self.rows[0].tokens

    @property
    def kind(self) -> str:
        """Of the section that it begins, when its level is 0."""
        first = self.rows[0].tokens[0]
        return first if first in KEYWORDS else "event"


def statements(rows: list[Row]) -> list[Statement]:
    """All rows, grouped and levelled."""
    result: list[Statement] = []
    indents = [0]
    for row, following in zip(rows, _following(rows), strict=True):
        if row.inside or (result and _goes_on(row, result[-1], following)):
            result[-1].rows.append(row)
        elif row.tokens:
            while row.indent < indents[-1]:
                indents.pop()
            if row.indent > indents[-1]:
                indents.append(row.indent)
            result.append(Statement(row, len(indents) - 1))
        else:
            level = _comment_level(row, following, indents)
            if result and result[-1].is_comment:  # what follows a comment of an outer block is no longer in the inner
                level = min(level, result[-1].level)
            result.append(Statement(row, level))
    return result


def _following(rows: list[Row]) -> list[int]:
    """For each row the indentation of the first statement behind it; 0 at the end."""
    result = [0] * len(rows)
    for i in range(len(rows) - 2, -1, -1):
        after = rows[i + 1]
        result[i] = after.indent if after.tokens and not after.inside else result[i + 1]
    return result


def _goes_on(row: Row, above: Statement, following: int) -> bool:
    """Whether a comment line goes on with the comment behind the code above it."""
    last = above.rows[-1]
    beside = not above.is_comment and last.comment and last.column == row.column
    return bool(beside and not row.tokens and not row.blank_before and row.column != following)


def _comment_level(row: Row, following: int, indents: list[int]) -> int:
    """A comment stands like the next statement; before one that ends blocks, it may still belong to one of these."""
    least = sum(1 for indent in indents if indent < following)
    return max([least, *(k for k, indent in enumerate(indents) if following <= indent <= row.column)])
