"""Position of a syntax error: the rejected token, its line, and the tokens that would fit."""

from __future__ import annotations

from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.source import Span
from koordgen.lang.syntax.layout import Token

_ENDS = ("NEWLINE", "INDENT", "DEDENT", "$END")
_OPENS = ("(", "[", "{")
_CLOSES = (")", "]", "}")


class ErrorSite:
    """Position of a syntax error: `tokens[position]` is rejected; types in `expected` would fit."""

    def __init__(self, tokens: list[Token], position: int, expected: set[str]) -> None:
        self.tokens = tokens
        self.position = position
        self.expected = expected
        self.kind, self.text = tokens[position][:2]  # a BROKEN token of recover.py has more than four items
        self.start = start_of_line(tokens, position)
        self.before = tokens[position - 1] if position > self.start else None
        end = position
        while tokens[end][0] not in _ENDS:
            end += 1
        self.head = tokens[self.start : position]  # tokens of the logical line before the rejected one
        self.following = tokens[position + 1 : end]  # tokens of the logical line after the rejected one
        self.first = tokens[self.start]
        self.next = tokens[position + 1][0] if position + 1 < len(tokens) else "$END"

    @property
    def span(self) -> Span:
        """Span of the rejected token; if the line ends too early, the column after its last token."""
        _, text, line, column = self.tokens[self.position][:4]
        if self.kind in _ENDS and self.before is not None:
            return column_after(self.before)
        return Span(line, column, line, column + max(1, len(text)))

    @property
    def ends(self) -> bool:
        """True if the rejected token is the end of the line."""
        return self.kind in _ENDS

    @property
    def wants_expression(self) -> bool:
        """True if an expression could begin here."""
        return {"NAME", "INT", "("} <= self.expected

    @property
    def bracket(self) -> str:
        """The innermost open bracket, or an empty string."""
        closed = 0
        for token in reversed(self.head):
            if token[0] in _CLOSES:
                closed += 1
            elif token[0] in _OPENS:
                if not closed:
                    return token[0]
                closed -= 1
        return ""

    def before_is(self, *kinds: str) -> bool:
        """Return whether the previous token on the line is one of these types."""
        return self.before is not None and self.before[0] in kinds

    def touches(self, *kinds: str) -> bool:
        """Return whether the previous token is one of these types, without a space between."""
        line, column = self.tokens[self.position][2:4]
        return self.before is not None and self.before_is(*kinds) and _end(self.before) == (line, column)

    def touched_by(self, kind: str) -> bool:
        """Return whether the next token has this type, without a space between."""
        end = _end(self.tokens[self.position])
        return bool(self.following) and self.following[0][0] == kind and self.following[0][2:4] == end

    def level(self) -> int:
        """Return the number of blocks around the line."""
        kinds = [token[0] for token in self.tokens[: self.start]]
        return kinds.count("INDENT") - kinds.count("DEDENT")

    def error(self, message: str, help: str = "", span: Span | None = None, code: str = "K001") -> Diagnostic:
        """Make an error diagnostic, at the rejected token unless a span is given."""
        return Diagnostic(code, "error", message, self.span if span is None else span, help=help)


def start_of_line(tokens: list[Token], position: int) -> int:
    """Return the index of the first token of a token's logical line."""
    while position and tokens[position - 1][0] not in ("NEWLINE", "INDENT", "DEDENT"):
        position -= 1
    return position


def place(first: Token, last: Token) -> Span:
    """Return the span from one token to another."""
    return Span(first[2], first[3], *_end(last))


def column_after(token: Token) -> Span:
    """Return the span of the column after a token."""
    line, column = _end(token)
    return Span(line, column, line, column + 1)


def shown(text: str) -> str:
    """Return a token's text, shortened for a message."""
    return text if len(text) <= 40 else f"{text[:36]}..."


def _end(token: Token) -> tuple[int, int]:
    return token[2], token[3] + len(token[1])
