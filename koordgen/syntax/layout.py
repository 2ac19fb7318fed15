"""Text -> tokens, split into sections: what stands at the left margin begins one.

Lines, indentation, brackets, comments and continuation lines are settled here, so the grammar sees NEWLINE, INDENT
and DEDENT only. A mistake in one section leaves the others readable.
"""

from __future__ import annotations

import re

from koordgen.diagnostics import Diagnostic, Label
from koordgen.source import Source, Span

# type (a literal's own text, or NAME GENERIC INT FLOAT STRING NEWLINE INDENT DEDENT BAD $END), text, line, column
Token = tuple[str, str, int, int]

DEEPEST_BRACKETS = 100
DEEPEST_BLOCKS = 30

# Words of the language: they never become names.
KEYWORDS = frozenset(
    (
        "using", "sensors", "actuators", "assume", "param", "allread", "allwrite", "local", "init", "pre", "eff",
        "def", "fun", "extern", "spec", "axiom", "invariant", "initially", "forall", "exists",
        "if", "elif", "else", "for", "while", "break", "continue", "return", "atomic", "pass", "stop",
        "and", "or", "not", "in", "True", "False",
    )
)  # fmt: skip
GENERICS = frozenset(("List", "Map", "Set", "Queue"))
_SOFT = frozenset(("max", "type", "requires", "ensures"))  # words of the language in one place each, names elsewhere
_WORDS = KEYWORDS | GENERICS | _SOFT

_TOKEN = re.compile(
    r"(?P<NAME>[A-Za-z_][A-Za-z0-9_]*)"
    r"|(?P<SPACE>[ \t]+)"
    r"|(?P<NEWLINE>\n)"
    r"|(?P<FLOAT>(?:[0-9]+\.[0-9]+(?:[eE][+-]?[0-9]+)?|[0-9]+[eE][+-]?[0-9]+|\.[0-9]+(?:[eE][+-]?[0-9]+)?)"
    r"(?![A-Za-z0-9_]))"
    r"|(?P<INT>[0-9]+(?![A-Za-z0-9_]|\.[0-9]))"
    r"|(?P<STRING>\"[^\"\\\n]*(?:\\.[^\"\\\n]*)*\"|(?<![A-Za-z0-9_\])'])'[^'\\\n]*(?:\\.[^'\\\n]*)*')"
    r"|(?P<MARK>//=|\*\*=?|[-+*/%]=|//|<<|[=!<>]=|&&|\|\||->|[-+*/%<>=:.,()\[\]{}!]|(?<=[A-Za-z0-9_\])'])')"
    r"|(?P<COMMENT>\#[^\n]*)"
    r"|(?P<CONTINUED>\\[ \t]*\n)"
    r"|(?P<BAD>[0-9][A-Za-z0-9_.]*|[\"'][^\n]*|.)"
)
# What begins a line that no bracket reaches: the one before was not closed.
_BEGINS = re.compile(
    r"[ ]*(?:using|sensors|actuators|assume|param|allread|allwrite|local|init|pre|eff|def|fun|extern|spec|axiom"
    r"|invariant|initially|elif|for|while|break|continue|return|atomic|pass|stop)\b"
    r"|[ ]*(?:if\b[^\n]*|else[ \t]*):[ \t]*(?:[\n#])"
    r"|[A-Za-z_][A-Za-z0-9_]*[ \t]*:[ \t]*(?:[\n#]|pre\b|eff\b)"
)
_NO_BRACES = "a block stands in no braces: its header ends with ':' and its lines are indented"
_GOES_ON = frozenset(("and", "or", "&&", "||"))  # no line begins with one
_CLOSES = {")": "(", "]": "[", "}": "{"}


class Chunk:
    """The tokens of one section, `$END` last, INDENT and DEDENT paired; `faults` of its layout, each at a token of
    it; `long` when a line of it is long enough to hold a tree too deep."""

    __slots__ = ("faults", "long", "tokens")

    def __init__(self) -> None:
        self.tokens: list[Token] = []
        self.faults: list[Diagnostic] = []
        self.long = False


def sections(source: Source) -> list[Chunk]:
    """All sections of a text."""
    layout = _Layout()
    layout.read(source.text)
    return layout.chunks


class _Layout:
    def __init__(self) -> None:
        self.chunks: list[Chunk] = []
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
                if kind == "NEWLINE" and (not self.brackets or self._abandoned(text, match.end())):
                    if not fresh:
                        self._end_line(line, column, first)
                    fresh, indent, tab = True, 0, -1
                line, line_start = line + 1, match.end()
                continue
            token = match[0]
            if fresh:
                fresh = False
                if token not in _GOES_ON or not self._goes_on(indent):
                    self._start_line(line, indent, tab)
                    first = len(self.chunk.tokens)
            if kind == "MARK":
                if token in "()[]{}":
                    self._bracket((token, token, line, column))
                kind = token
            elif kind == "NAME" and token in _WORDS:
                kind = self._word(token)
            elif kind == "BAD" and token[0] in "\"'":
                kind, token = self._open_string(token, line, column)
            self.chunk.tokens.append((str(kind), token, line, column))
        if self.brackets:
            self._never_closed()
        if not fresh:
            self._end_line(line, len(text) - line_start + 1, first)
        self._end_chunk(line, 1)

    def _start_line(self, line: int, indent: int, tab: int) -> None:
        if tab >= 0:
            self._report("K004", "a tab stands in the indentation", line, tab + 1, "indent with spaces")
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
                self.indents.append(indent)  # the innermost block goes on here
                break
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
            self._report("K006", f"'{text}' closes nothing", line, column, _NO_BRACES if text == "}" else "")
        else:
            opened = self.brackets.pop()
            if opened[1] != _CLOSES[text]:
                while any(bracket[1] == _CLOSES[text] for bracket in self.brackets[-DEEPEST_BRACKETS:]):
                    self.brackets.pop()  # it closes an outer one
                label = Label(Span(opened[2], opened[3], opened[2], opened[3] + 1), "opened here")
                self._report("K006", f"'{text}' does not close '{opened[1]}'", line, column, labels=(label,))

    def _abandoned(self, text: str, position: int) -> bool:
        """Whether what follows a line end shows that the open brackets were forgotten; they are told then."""
        if _BEGINS.match(text, position) is None:
            return False
        self._never_closed()
        self.brackets.clear()
        return True

    def _never_closed(self) -> None:
        bracket = self.brackets[0]
        _, text, line, column = bracket
        help = _NO_BRACES if text == "{" and self.chunk.tokens[-1] == bracket else ""
        self._report("K006", f"'{text}' is never closed", line, column, help)

    def _goes_on(self, indent: int) -> bool:
        """Whether a line that begins with `and` or `or` belongs to the one before; its end is taken back then."""
        tokens = self.chunk.tokens
        if not tokens or indent == 0 or indent < self.indents[-1]:
            return False
        tokens.pop()
        return True

    def _word(self, text: str) -> str:
        """The type of the token of a word of the language."""
        if text in KEYWORDS:
            return text
        if text in GENERICS:
            return "GENERIC"
        tokens = self.chunk.tokens
        last = tokens[-1][0] if tokens else ""
        if text == "max":  # behind `Type name` or `Type name[size]`
            before = tokens[-2][0] if len(tokens) > 1 else ""
            meant = before != "[" if last == "]" else last == "NAME" and before in ("NAME", ">", "]", ")")
        elif text == "type":
            meant = last == "extern"
        else:  # the contracts of an extern function
            meant = last in ("INDENT", "NEWLINE", "DEDENT", ":") and tokens[0][0] == "extern"
        return text if meant else "NAME"

    def _open_string(self, text: str, line: int, column: int) -> tuple[str, str]:
        """A string that its line does not close is told here: it may hide closing brackets."""
        self._report("K001", "this string is not closed", line, column, f"a string ends with {text[0]} on its line")
        self.brackets.clear()
        return "STRING", text

    def _report(
        self, code: str, message: str, line: int, column: int, help: str = "", labels: tuple[Label, ...] = ()
    ) -> None:
        span = Span(line, column, line, column + 1)
        self.chunk.faults.append(Diagnostic(code, "error", message, span, labels, help))
