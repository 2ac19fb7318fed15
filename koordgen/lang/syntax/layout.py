"""Tokeniser: text to tokens, split into sections. A line at the left margin begins a section.

Resolves lines, indentation, brackets, comments and continuation lines, so the grammar sees only NEWLINE, INDENT and
DEDENT. Sections are parsed separately, so an error in one does not affect the others.
"""

from __future__ import annotations

import re

from koordgen.lang.diagnostics import Diagnostic, Label
from koordgen.lang.source import Source, Span

# type, text, line, column. The type of a keyword or mark is its own text; the others are NAME GENERIC INT FLOAT STRING
# NEWLINE INDENT DEDENT BAD $END.
Token = tuple[str, str, int, int]

DEEPEST_BRACKETS = 100
DEEPEST_BLOCKS = 30

# Reserved words: they can never be names.
KEYWORDS = frozenset(
    (
        "using", "sensors", "actuators", "assume", "param", "allread", "allwrite", "local", "init", "pre", "eff",
        "def", "fun", "extern", "spec", "axiom", "invariant", "initially", "forall", "exists",
        "if", "elif", "else", "for", "while", "break", "continue", "return", "atomic", "pass", "stop",
        "and", "or", "not", "in", "True", "False",
    )
)  # fmt: skip
GENERICS = frozenset(("List", "Map", "Set", "Queue"))
# Soft keywords: keywords in one place each, names elsewhere.
_SOFT = frozenset(
    (
        "max", "type", "requires", "ensures", "priority", "as", "at", "clears", "export", "import", "write",
        "guarantee", "provides",
    )
)  # fmt: skip
_MARKS = frozenset(
    (
        "//=", "**=", "**", "+=", "-=", "*=", "/=", "%=", "//", "<<", "==", "!=", "<=", ">=", "&&", "||", "->",
        *"-+*/%<>=:.,()[]{}!",
    )
)  # fmt: skip
_BEFORE_PRIME = frozenset("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_])'")

# Without groups, so that `findall` returns texts. A text alone determines its kind, except for a single quote: see
# `kind_of`.
TOKEN = re.compile(
    r"[A-Za-z_][A-Za-z0-9_]*"
    r"|[ \t]+"
    r"|\n"
    r"|(?:[0-9]+\.[0-9]+(?:[eE][+-]?[0-9]+)?|[0-9]+[eE][+-]?[0-9]+|\.[0-9]+(?:[eE][+-]?[0-9]+)?)(?![A-Za-z0-9_])"
    r"|[0-9]+(?![A-Za-z0-9_]|\.[0-9])"
    r"|\"[^\"\\\n]*(?:\\.[^\"\\\n]*)*\"|(?<![A-Za-z0-9_\])'])'[^'\\\n]*(?:\\.[^'\\\n]*)*'"
    r"|//=|\*\*=?|[-+*/%]=|//|<<|[=!<>]=|&&|\|\||->|[-+*/%<>=:.,()\[\]{}!]|(?<=[A-Za-z0-9_\])'])'"
    r"|\#[^\n]*"
    r"|\\[ \t]*\n"
    r"|[0-9][A-Za-z0-9_.]*|[\"'][^\n]*|."  # anything else is an error
)
# Beginnings of lines that cannot stand inside brackets. After such a line an open bracket counts as never closed.
_BEGINS = re.compile(
    r"[ ]*(?:using|sensors|actuators|assume|param|allread|allwrite|local|init|pre|eff|def|fun|extern|spec|axiom"
    r"|invariant|initially|elif|for|while|break|continue|return|atomic|pass|stop)\b"
    r"|[ ]*(?:if\b[^\n]*|else[ \t]*):[ \t]*(?:[\n#])"
    r"|(?:(?:import|provides)[ \t]+)?[A-Za-z_][A-Za-z0-9_]*[ \t]*:[ \t]*(?:[\n#]|pre\b|eff\b)"
)
# Likewise for assignments. But `name =` alone may also be an argument of a call.
_ASSIGNS = re.compile(
    r"[ ]*[A-Za-z_][A-Za-z0-9_]*(?P<more>(?:\.[A-Za-z_][A-Za-z0-9_]*|\[[^\]\n]*\])*(?:[ ]+[A-Za-z_][A-Za-z0-9_]*)?)"
    r"[ \t]*(?:[-+*/%]|//|\*\*)?=(?!=)"
)
_NO_BRACES = "blocks have no braces: end the header with ':' and indent the block's lines"
CONTINUING = frozenset(("and", "or", "&&", "||"))  # a line that begins with one continues the line before
_CLOSES = {")": "(", "]": "[", "}": "{"}
_BRACKETS = frozenset("()[]{}")


def kind_of(token: str) -> str:
    """Return the kind of a text that TOKEN matched.

    Kinds: NAME SPACE NEWLINE CONTINUED COMMENT INT FLOAT STRING MARK BAD. A single quote may also be a MARK, depending
    on the text before it; here it is BAD.
    """
    first = token[0]
    if token in _MARKS:
        return "MARK"
    if token.isascii() and token.isidentifier():
        return "NAME"
    if first in " \t":
        return "SPACE"
    if first == "#":
        return "COMMENT"
    if token[-1] == "\n":
        return "NEWLINE" if token == "\n" else "CONTINUED"
    if first in "\"'":
        inside = token[1:-1]
        escaped = (len(inside) - len(inside.rstrip("\\"))) % 2 == 1
        return "STRING" if len(token) > 1 and token[-1] == first and not escaped else "BAD"
    if first in ".0123456789":
        return "INT" if token.isdigit() else "FLOAT" if _is_float(token) else "BAD"
    return "BAD"


def _is_float(token: str) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return "_" not in token


class _Kinds(dict[str, str | None]):
    """Cache: text of a token -> its type, or None if the token needs more work than to be appended.

    Each source text has its own cache, so that memory is freed with it.
    """

    def __missing__(self, token: str) -> str | None:
        kind = kind_of(token)
        known: str | None = None
        if kind == "NAME":
            known = token if token in KEYWORDS else "GENERIC" if token in GENERICS else kind
            known = None if token in _SOFT else known
        elif kind == "MARK":
            known = None if token in _BRACKETS else token
        elif kind in ("INT", "FLOAT", "STRING") or (kind == "BAD" and token[0] not in "\"'"):
            known = kind
        self[token] = known
        return known


class Chunk:
    """Tokens of one section. The last one is `$END`; INDENT and DEDENT are paired.

    `faults` has the errors of its layout, each at one of its tokens. `long`: a line is so long that its tree may be
    nested too deeply.
    """

    __slots__ = ("faults", "long", "tokens")

    def __init__(self) -> None:
        self.tokens: list[Token] = []
        self.faults: list[Diagnostic] = []
        self.long = False


def sections(source: Source) -> list[Chunk]:
    """Return all sections of a text."""
    layout = _Layout()
    layout.read(source.text)
    return layout.chunks


class _Layout:
    def __init__(self) -> None:
        self.chunks: list[Chunk] = []
        self.chunk = Chunk()
        self.indents = [0]
        self.lines = [1]  # number of the first line of each open block
        self.brackets: list[Token] = []

    def read(self, text: str) -> None:
        line, line_start, column, indent, tab = 1, 0, 1, 0, -1
        fresh = True  # no token of this logical line has been seen
        first = 0  # index of the logical line's first token in the chunk
        kinds = _Kinds()
        append = self.chunk.tokens.append
        for token in TOKEN.findall(text):
            kind = kinds[token]
            if kind is not None and not fresh:
                append((kind, token, line, column))
            elif token[0] in " \t":
                if fresh:
                    indent, tab = len(token), token.find("\t")
            elif token[-1] == "\n":
                if token == "\n" and (not self.brackets or self._is_abandoned(text, line_start + column)):
                    if not fresh:
                        self._end_line(line, column, first)
                    fresh, indent, tab = True, 0, -1
                line, line_start, column = line + 1, line_start + column - 1 + len(token), 1
                continue
            elif token[0] != "#":
                if fresh:
                    fresh = False
                    if token not in CONTINUING or not self._continues(indent):
                        self._start_line(line, indent, tab)
                        first = len(self.chunk.tokens)
                        append = self.chunk.tokens.append
                if kind is None:
                    at = line_start + column - 1
                    kind = self._special(token, text[at - 1 : at], line, column)
                append((kind, token, line, column))
            column += len(token)
        if self.brackets:
            self._never_closed()
        if not fresh:
            self._end_line(line, column, first)
        self._end_chunk(line, 1)

    def _special(self, token: str, before: str, line: int, column: int) -> str:
        """Return the type of a token that its text alone does not determine.

        `before` is the character before it.
        """
        if token in _BRACKETS:
            self._bracket((token, token, line, column))
            return token
        if token in _SOFT:
            return self._soft_keyword(token)
        if token == "'" and before in _BEFORE_PRIME:
            return token
        # Report an unclosed string here: it may hide closing brackets, so the open ones are dropped.
        self._report("K001", "this string is not closed", line, column, f"end it with {token[0]} on the same line")
        self.brackets.clear()
        return "STRING"

    def _start_line(self, line: int, indent: int, tab: int) -> None:
        if tab >= 0:
            self._report("K004", "the indentation contains a tab", line, tab + 1, "indent with spaces")
        if indent == 0:
            self._end_chunk(line, 1)
        elif indent > self.indents[-1]:
            self.indents.append(indent)
            self.lines.append(line)
            if len(self.indents) == DEEPEST_BLOCKS + 2:
                self._report("K007", f"blocks are nested more than {DEEPEST_BLOCKS} deep", line, indent + 1)
            self.chunk.tokens.append(("INDENT", "", line, indent + 1))
        while indent < self.indents[-1]:
            left, begun = self.indents.pop(), self.lines.pop()
            if indent > self.indents[-1]:
                self._report_between(line, indent, begun, left)
                self.indents.append(indent)  # the line counts as part of the inner block
                self.lines.append(line)
                break
            self.chunk.tokens.append(("DEDENT", "", line, indent + 1))

    def _report_between(self, line: int, indent: int, begun: int, left: int) -> None:
        """Report a line whose indentation lies between a block's and its parent's.

        The block begins in line `begun` and is indented by `left` spaces.
        """
        around = self.indents[-1]
        ends = f", or this line by {around} to end the block" if around else ""
        help = f"indent this line by {left} spaces as line {begun}, or line {begun} by {indent}{ends}"
        label = Label(Span(begun, left + 1, begun, left + 2), f"this block stands at {left} spaces")
        self._report("K005", f"{indent} spaces match no enclosing block", line, indent + 1, help, (label,))

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
        self.indents, self.lines = [0], [line]

    def _bracket(self, token: Token) -> None:
        _, text, line, column = token
        if text not in _CLOSES:
            self.brackets.append(token)
            if len(self.brackets) == DEEPEST_BRACKETS + 1:
                self._report("K007", f"brackets are nested more than {DEEPEST_BRACKETS} deep", line, column)
        elif not self.brackets:
            self._report("K006", f"'{text}' has no opening bracket", line, column, _NO_BRACES if text == "}" else "")
        else:
            opened = self.brackets.pop()
            if opened[1] != _CLOSES[text]:
                while any(bracket[1] == _CLOSES[text] for bracket in self.brackets[-DEEPEST_BRACKETS:]):
                    self.brackets.pop()  # the bracket closes an outer one
                label = Label(Span(opened[2], opened[3], opened[2], opened[3] + 1), "opened here")
                self._report("K006", f"'{text}' does not close '{opened[1]}'", line, column, labels=(label,))

    def _is_abandoned(self, text: str, position: int) -> bool:
        """Return whether the text after a line end shows that brackets were never closed; report them if so."""
        if _BEGINS.match(text, position) is None:
            assigns = _ASSIGNS.match(text, position)
            bracket, last = self.brackets[-1][0], self.chunk.tokens[-1][0]
            argument = bracket == "(" and last in ("(", ",")
            if assigns is None or last == "{" or (argument and not assigns["more"]):
                return False
        self._never_closed()
        self.brackets.clear()
        return True

    def _never_closed(self) -> None:
        bracket = self.brackets[0]
        _, text, line, column = bracket
        help = _NO_BRACES if text == "{" and self.chunk.tokens[-1] == bracket else ""
        self._report("K006", f"'{text}' is never closed", line, column, help)

    def _continues(self, indent: int) -> bool:
        """Return whether a line that begins with `and` or `or` continues the one before.

        Remove that line's NEWLINE.
        """
        tokens = self.chunk.tokens
        if not tokens or indent == 0 or indent < self.indents[-1]:
            return False
        tokens.pop()
        return True

    def _soft_keyword(self, text: str) -> str:
        """Return the type of a soft keyword's token."""
        tokens = self.chunk.tokens
        last = tokens[-1][0] if tokens else ""
        if text == "max":  # after `Type name` or `Type name[size]`
            before = tokens[-2][0] if len(tokens) > 1 else ""
            meant = before != "[" if last == "]" else last == "NAME" and before in ("NAME", ">", "]", ")")
        elif text in ("as", "at", "clears"):  # after `Type name` of a port, or after the names of another mark
            before = tokens[-2][0] if len(tokens) > 1 else ""
            named = last == "NAME" and before in ("NAME", ">", "]", ")", ",", "as", "at", "clears")
            meant = named and tokens[0][0] in ("using", "provides")
        elif text == "type":
            meant = last == "extern"
        elif text in ("priority", "export", "import", "provides"):  # at the left margin
            meant = not tokens
        elif text in ("write", "guarantee"):  # at the beginning of a line, or after a header's colon
            meant = last in ("INDENT", "NEWLINE", "DEDENT", ":") and tokens[0][0] in ("export", "import")
        else:  # the contracts of an extern function
            meant = last in ("INDENT", "NEWLINE", "DEDENT", ":") and tokens[0][0] == "extern"
        return text if meant else "NAME"

    def _report(
        self, code: str, message: str, line: int, column: int, help: str = "", labels: tuple[Label, ...] = ()
    ) -> None:
        faults = self.chunk.faults
        if faults and faults[-1].code == code and faults[-1].span.line == line:
            return  # report a repeated error once a line
        span = Span(line, column, line, column + 1)
        faults.append(Diagnostic(code, "error", message, span, labels, help))
