"""Formatting of a text: spaces, indentation, continuation lines, blank lines, comments."""

from __future__ import annotations

from koordgen.lang.syntax.layout import CONTINUING, GENERICS, KEYWORDS, TOKEN, kind_of

# Spaces between neighbouring tokens of a statement

_OPENING = frozenset("([{")
_CLOSING = frozenset(")]}")
_OPERATORS = frozenset(
    (
        "+", "-", "*", "/", "//", "%", "**", "<<", "==", "!=", "<", "<=", ">", ">=", "=", "+=", "-=", "*=", "/=",
        "//=", "%=", "**=", "->", "&&", "||", "!", ".", ",", ":",
    )
)  # fmt: skip
_NO_VALUES = (KEYWORDS - {"True", "False"}) | _OPERATORS | _OPENING
# Kinds of open brackets: the index of a value, and the type arguments of a container type.
INDEX, TYPES = "x[", "<"


class Spacer:
    """Spacing of the tokens of one statement, which it gets in order.

    `brackets` has the open ones, outermost first.
    """

    def __init__(self) -> None:
        self.brackets: list[str] = []
        self._last = ""
        self._after_value = False  # the last token ends a value, a type or a name
        self._tight = True  # no space may follow the last token

    def space_before(self, token: str) -> bool:
        """Add a token, and return whether a space stands before it."""
        closes_types = token == ">" and self._inside(TYPES)
        unary = token == "!" or (token == "-" and not self._after_value)
        space = not self._tight and not self._is_attached(token, closes_types)
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
        # After a declared name, `max` is a keyword and not a function, so a bracket after it is not a call.
        capacity = token == "max" and self._after_value
        self._after_value = closes_types or not (token in _NO_VALUES or capacity)
        self._last, self._tight = token, tight
        return space

    def _is_attached(self, token: str, closes_types: bool) -> bool:
        """Return whether a token follows the last one without a space."""
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
        while not types and self._inside(TYPES):  # a container type without its `>`
            self.brackets.pop()
        if self.brackets:
            self.brackets.pop()


# Text to rows: lines with their tokens and comments, and whether they continue the line before


class SourceRow:
    """One line of the original text. Columns count from 0."""

    __slots__ = ("blank_before", "column", "comment", "continued", "indent", "inside", "tokens")

    def __init__(self) -> None:
        self.tokens: list[str] = []
        self.indent = 0  # column of the first token
        self.comment = ""
        self.column = 0  # column of the comment
        self.continued = False  # the line ends with a backslash
        self.inside = False  # the line continues the statement of the row before
        self.blank_before = False


def rows(text: str) -> list[SourceRow]:
    """Return the rows of a text without layout errors, without blank rows and superfluous backslashes."""
    found: list[SourceRow] = []
    row = SourceRow()
    depth, indent, line_start = 0, 0, 0
    fresh = True  # no token of this statement has been seen
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
            row = SourceRow()
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


def _end(row: SourceRow, found: list[SourceRow]) -> None:
    if row.tokens or (row.comment and not (row.inside and found[-1].continued)):
        found.append(row)
    elif row.comment:  # after a superfluous backslash
        found[-1].comment, found[-1].column = row.comment, row.column
        found[-1].continued = False
    elif not row.continued and found:
        found[-1].continued = False


def _join(found: list[SourceRow]) -> None:
    """Mark rows that begin with `and` or `or`, and comments before them, as parts of the statement before."""
    for i, row in enumerate(found):
        if row.tokens and row.tokens[0] in CONTINUING:
            row.inside = True
            for before in reversed(found[:i]):
                if before.tokens:
                    break
                before.inside = True


# Rows to statements: rows that belong together, and the level of their block


class Statement:
    """Rows of one statement or header, or one comment on a line of its own.

    `level` is the number of enclosing blocks.

    A comment after the last row may continue on the following lines, in the same column; these are rows, too.
    """

    __slots__ = ("level", "rows")

    def __init__(self, row: SourceRow, level: int) -> None:
        self.rows = [row]
        self.level = level

    @property
    def is_comment(self) -> bool:
        return not self.rows[0].tokens

    @property
    def kind(self) -> str:
        """Kind of the section that the statement begins, if its level is 0."""
        first = self.rows[0].tokens[0]
        return first if first in KEYWORDS else "event"


def statements(rows: list[SourceRow]) -> list[Statement]:
    """Return all rows, grouped into statements with their levels."""
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
            if result and result[-1].is_comment:  # after a comment of an outer block the inner block has ended
                level = min(level, result[-1].level)
            result.append(Statement(row, level))
    return result


def _following(rows: list[SourceRow]) -> list[int]:
    """Return for each row the indentation of the next statement; 0 at the end."""
    result = [0] * len(rows)
    for i in range(len(rows) - 2, -1, -1):
        after = rows[i + 1]
        result[i] = after.indent if after.tokens and not after.inside else result[i + 1]
    return result


def _goes_on(row: SourceRow, above: Statement, following: int) -> bool:
    """Return whether a comment line continues the comment beside the code above it."""
    last = above.rows[-1]
    beside = not above.is_comment and last.comment and last.column == row.column
    return bool(beside and not row.tokens and not row.blank_before and row.column != following)


def _comment_level(row: SourceRow, following: int, indents: list[int]) -> int:
    """Return the level of a comment: that of the next statement, or of a block that ends before it."""
    least = sum(1 for indent in indents if indent < following)
    return max([least, *(k for k, indent in enumerate(indents) if following <= indent <= row.column)])


LEVEL = 2  # spaces of indentation for each block
FURTHER = 4  # additional spaces of a continuation line
APART = 2  # spaces between code and the comment after it


class _Line:
    """One line of the result.

    `column` is the original column of its comment, -1 if that is not `beside` code.
    """

    __slots__ = ("blank", "code", "column", "comment")

    def __init__(self, code: str, row: SourceRow, beside: bool) -> None:
        self.code = code
        self.comment = row.comment
        self.column = row.column if beside else -1
        self.blank = row.blank_before


def arranged(text: str) -> str:
    """Return the formatted text. The text must have no layout or syntax errors, and `\\n` at line ends."""
    found = statements(rows(text))
    lines: list[_Line] = []
    for statement, blank in zip(found, _blanks(found), strict=True):
        first = len(lines)
        lines += _lines(statement)
        lines[first].blank = blank
    pairs = zip(lines, _starts(lines), strict=True)
    return "".join("\n" * line.blank + start + line.comment + "\n" for line, start in pairs)


def _blanks(found: list[Statement]) -> list[bool]:
    """Return for each statement whether a blank line stands before it.

    Sections are separated by one, except that between sections of one line and the same kind blank lines are kept as
    written. Within a section they are kept, except after a header.
    """
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
    """Return the lines of one statement.

    A continuation line is indented further than the line that opened its bracket. A line that begins with closing
    brackets is indented like the line that opened them.
    """
    result: list[_Line] = []
    spacer = Spacer()
    margin = statement.level * LEVEL
    opened: list[int] = []  # indentation of the line of each open bracket
    for row in statement.rows:
        indent = margin
        if row.inside:
            closing = next((k for k, token in enumerate(row.tokens) if token not in ")]}"), len(row.tokens))
            indent = opened[-closing] if closing else (opened[-1] if opened else margin) + FURTHER
        words: list[str] = []
        for token in row.tokens:
            if spacer.space_before(token) and words:
                words.append(" ")
            words.append(token)
            del opened[len(spacer.brackets) :]
            opened += [indent] * (len(spacer.brackets) - len(opened))
        alone = not row.tokens and (row.inside or statement.is_comment)
        code = "".join(words) + " \\" * row.continued
        result.append(_Line(" " * indent + code if code or alone else "", row, bool(row.comment) and not alone))
    return result


def _starts(lines: list[_Line]) -> list[str]:
    """Return the text before the comment of each line.

    Comments beside code on consecutive lines that were in one column are aligned again.
    """
    result: list[str] = []
    while len(result) < len(lines):
        first = end = len(result)
        while end < len(lines) and lines[end].column == lines[first].column and (end == first or not lines[end].blank):
            end += 1
        run = lines[first:end]
        width = max(len(line.code) for line in run) + APART
        result += [line.code.ljust(width) if line.column >= 0 else line.code for line in run]
    return result
