"""Statements -> the formatted text: indentation, continuation lines, blank lines, comments."""

from __future__ import annotations

from koordgen.lang.syntax.layout import GENERICS, GOES_ON, KEYWORDS, TOKEN, kind_of

# Where a space stands between two neighbouring tokens of one statement.

_OPENING = frozenset("([{")
_CLOSING = frozenset(")]}")
_OPERATORS = frozenset(
    (
        "+", "-", "*", "/", "//", "%", "**", "<<", "==", "!=", "<", "<=", ">", ">=", "=", "+=", "-=", "*=", "/=",
        "//=", "%=", "**=", "->", "&&", "||", "!", ".", ",", ":",
    )
)  # fmt: skip
_NO_VALUES = (KEYWORDS - {"True", "False"}) | _OPERATORS | _OPENING
# The open bracket is the index of a value, or the type arguments of a generic type.
INDEX, TYPES = "x[", "<"


class Spacer:
    """Takes the tokens of one statement in order. `brackets` are those that are open, outermost first."""

    def __init__(self) -> None:
        self.brackets: list[str] = []
        self._last = ""
        self._after_value = False  # the last token ends a value (or a type or a name)
        self._tight = True  # nothing may stand between the last token and the next one

    def take(self, token: str) -> bool:
        """Whether a space stands before this token."""
        closes_types = token == ">" and self._inside(TYPES)
        unary = token == "!" or (token == "-" and not self._after_value)
        space = not self._tight and not self._clings(token, closes_types)
        tight = unary or token in _OPENING or token == "."
        if token in _CLOSING or closes_types:
            self._close(closes_types)
        elif token == "<" and self._last in GENERICS:
            self.brackets.append(TYPES)
            tight = True
        elif token in _OPENING:
            self.brackets.append(INDEX if token == "[" and self._after_value else token)
        elif (token == ":" and self._inside(INDEX)) or (token == "=" and self._inside("(")):
            tight = True
        # Behind a declared name, `max` is a word of the language, and what follows it is no argument.
        capacity = token == "max" and self._after_value
        self._after_value = closes_types or not (token in _NO_VALUES or capacity)
        self._last, self._tight = token, tight
        return space

    def _clings(self, token: str, closes_types: bool) -> bool:
        """Whether this token follows the last one without a space."""
        if token in _CLOSING or token in (",", ".", ":", "'") or closes_types:
            return True
        if token in ("(", "["):
            return self._after_value
        if token == "<":
            return self._last in GENERICS
        return token == "=" and self._inside("(")

    def _inside(self, bracket: str) -> bool:
        return bool(self.brackets) and self.brackets[-1] == bracket

    def _close(self, types: bool) -> None:
        while not types and self._inside(TYPES):  # a generic word without its `>`
            self.brackets.pop()
        if self.brackets:
            self.brackets.pop()


# Text -> rows: its lines with their tokens and comments, and which of them go on with the line before.


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


# Rows -> statements: the rows that belong together, and the level of the block that each stands in.


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
