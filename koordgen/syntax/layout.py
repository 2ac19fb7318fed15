"""Text -> tokens, split into sections: what stands at the left margin begins one.

Lines, indentation, brackets, comments and continuation lines are settled here, so the grammar sees NEWLINE, INDENT
and DEDENT only. A mistake in one section leaves the others readable.
"""

from __future__ import annotations

import re

from koordgen.diagnostics import Diagnostic, Label
from koordgen.source import Source, Span

# type (a literal's own text, or NAME INT FLOAT NEWLINE INDENT DEDENT STRING BAD $END), text, line, column
Token = tuple[str, str, int, int]

DEEPEST_BRACKETS = 100
DEEPEST_BLOCKS = 30

# Words of the whole language, also those whose meaning this version lacks: they never become names.
KEYWORDS = frozenset(
    (
        "using",
        "sensors",
        "actuators",
        "param",
        "allread",
        "allwrite",
        "local",
        "init",
        "pre",
        "eff",
        "if",
        "elif",
        "else",
        "pass",
        "stop",
        "and",
        "or",
        "not",
        "True",
        "False",
    )
)
LATER = frozenset(
    (
        "atomic", "for", "while", "in", "break", "continue", "return", "def", "fun", "extern", "spec", "axiom",
        "invariant", "initially", "assume", "forall", "exists",
    )
)  # fmt: skip

_TOKEN = re.compile(
    r"(?P<NAME>[A-Za-z_][A-Za-z0-9_]*)"
    r"|(?P<SPACE>[ \t]+)"
    r"|(?P<NEWLINE>\n)"
    r"|(?P<FLOAT>[0-9]+\.[0-9]+(?:[eE][+-]?[0-9]+)?|[0-9]+[eE][+-]?[0-9]+|\.[0-9]+(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<INT>[0-9]+)"
    r"|(?P<MARK>//=|\*\*|[-+*/%]=|//|[=!<>]=|&&|\|\||->|[-+*/%<>=:.,()\[\]{}!'])"
    r"|(?P<COMMENT>\#[^\n]*)"
    r"|(?P<CONTINUED>\\[ \t]*\n)"
    r'|(?P<STRING>"[^"\n]*")'
    r"|(?P<BAD>.)"
)
_CLOSES = {")": "(", "]": "[", "}": "{"}
_WORDS = KEYWORDS | LATER


class Chunk:
    """The tokens of one section, `$END` last; `sound` when the layout found no fault in it, `long` when a
    line of it is long enough to hold a tree too deep."""

    __slots__ = ("long", "sound", "tokens")

    def __init__(self) -> None:
        self.tokens: list[Token] = []
        self.sound = True
        self.long = False


def sections(source: Source) -> tuple[list[Chunk], list[Diagnostic]]:
    """All sections of a text, and the mistakes of its layout."""
    layout = _Layout()
    layout.read(source.text)
    return layout.chunks, layout.found


class _Layout:
    def __init__(self) -> None:
        self.chunks: list[Chunk] = []
        self.found: list[Diagnostic] = []
        self.chunk = Chunk()
        self.indents = [0]
        self.brackets: list[Token] = []

    def read(self, text: str) -> None:
        line, line_start, indent, tab = 1, 0, 0, -1
        fresh = True  # nothing of this logical line has been seen
        first = 0  # where in the chunk the logical line starts
        for match in _TOKEN.finditer(text):
            kind = match.lastgroup
            if kind == "SPACE":
                if fresh:
                    indent = match.end() - match.start()
                    tab = match[0].find("\t")
                continue
            if kind == "COMMENT":
                continue
            column = match.start() - line_start + 1
            if kind == "NEWLINE" or kind == "CONTINUED":
                if kind == "NEWLINE" and not self.brackets:
                    if not fresh:
                        self._end_line(line, column, first)
                    fresh, indent, tab = True, 0, -1
                line, line_start = line + 1, match.end()
                continue
            token = match[0]
            if fresh:
                fresh = False
                self._start_line(line, indent, tab)
                first = len(self.chunk.tokens)
            if kind == "MARK":
                if token in "()[]{}":
                    self._bracket((token, token, line, column))
                kind = token
            elif kind == "NAME" and token in _WORDS:
                kind = token
            self.chunk.tokens.append((str(kind), token, line, column))
        if self.brackets:
            bracket = self.brackets[0]
            self._report("K006", f"'{bracket[1]}' is never closed", bracket[2], bracket[3])
        if not fresh:
            self._end_line(line, len(text) - line_start + 1, first)
        self._end_chunk(line, 1)

    def _start_line(self, line: int, indent: int, tab: int) -> None:
        if tab >= 0:
            self._report("K004", "a tab stands in the indentation", line, tab + 1, "indent with spaces")
            return
        if indent == 0:
            self._end_chunk(line, 1)
        elif indent > self.indents[-1]:
            self.indents.append(indent)
            if len(self.indents) == DEEPEST_BLOCKS + 2:
                self._report("K007", f"blocks are nested more than {DEEPEST_BLOCKS} deep", line, indent + 1)
            self.chunk.tokens.append(("INDENT", "", line, indent + 1))
        while indent < self.indents[-1]:
            self.indents.pop()
            if indent > self.indents[-1]:
                levels = ", ".join(map(str, self.indents))
                help = f"the blocks around this line stand at {levels} spaces"
                self._report("K005", f"{indent} spaces match no enclosing block", line, indent + 1, help)
                self.indents.append(indent)
            self.chunk.tokens.append(("DEDENT", "", line, indent + 1))

    def _end_line(self, line: int, column: int, first: int) -> None:
        tokens = self.chunk.tokens
        if len(tokens) - first > DEEPEST_BRACKETS:
            self.chunk.long = True
        tokens.append(("NEWLINE", "", line, column))

    def _end_chunk(self, line: int, column: int) -> None:
        chunk = self.chunk
        if chunk.tokens:
            chunk.tokens.extend([("DEDENT", "", line, column)] * (len(self.indents) - 1))
            chunk.tokens.append(("$END", "", line, column))
            self.chunks.append(chunk)
            self.chunk = Chunk()
        self.indents = [0]

    def _bracket(self, token: Token) -> None:
        _, text, line, column = token
        if text not in _CLOSES:
            self.brackets.append(token)
            if len(self.brackets) == DEEPEST_BRACKETS + 1:
                self._report("K007", f"brackets are nested more than {DEEPEST_BRACKETS} deep", line, column)
        elif not self.brackets:
            self._report("K006", f"'{text}' closes nothing", line, column)
        else:
            opened = self.brackets.pop()
            if opened[1] != _CLOSES[text]:
                label = Label(Span(opened[2], opened[3], opened[2], opened[3] + 1), "opened here")
                self._report("K006", f"'{text}' does not close '{opened[1]}'", line, column, labels=(label,))

    def _report(
        self, code: str, message: str, line: int, column: int, help: str = "", labels: tuple[Label, ...] = ()
    ) -> None:
        if self.chunk.sound:  # what follows in this section may be an echo
            span = Span(line, column, line, column + 1)
            self.found.append(Diagnostic(code, "error", message, span, labels, help))
        self.chunk.sound = False
