"""The place at which the parser cannot go on: what stands there, on its line and above, and what could stand there."""

from __future__ import annotations

from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.source import Span
from koordgen.lang.syntax.layout import Token

_ENDS = ("NEWLINE", "INDENT", "DEDENT", "$END")
_OPENS = ("(", "[", "{")
_CLOSES = (")", "]", "}")


class Spot:
    """`tokens[position]` is refused; `expected` are the types of tokens with which the parser could go on."""

    def __init__(self, tokens: list[Token], position: int, expected: set[str]) -> None:
        self.tokens = tokens
        self.position = position
        self.expected = expected
        self.kind, self.text = tokens[position][:2]  # recover.py makes longer ones
        self.start = start_of_line(tokens, position)
        self.before = tokens[position - 1] if position > self.start else None
        end = position
        while tokens[end][0] not in _ENDS:
            end += 1
        self.head = tokens[self.start : position]  # of its logical line, before it
        self.rest = tokens[position + 1 : end]  # of its logical line, behind it
        self.first = tokens[self.start]
        self.next = tokens[position + 1][0] if position + 1 < len(tokens) else "$END"

    @property
    def span(self) -> Span:
        """The refused token's place; behind the last visible one where a line ends too early."""
        _, text, line, column = self.tokens[self.position][:4]
        if self.kind in _ENDS and self.before is not None:
            return behind(self.before)
        return Span(line, column, line, column + max(1, len(text)))

    @property
    def ends(self) -> bool:
        """Whether the line ends here."""
        return self.kind in _ENDS

    @property
    def wants_expression(self) -> bool:
        """Whether an expression could begin here."""
        return {"NAME", "INT", "("} <= self.expected

    @property
    def bracket(self) -> str:
        """The innermost bracket that is open here, or nothing."""
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
        """Whether the token before, on the same line, is one of these."""
        return self.before is not None and self.before[0] in kinds

    def touches(self, *kinds: str) -> bool:
        """Whether one of these stands before, without a space between."""
        line, column = self.tokens[self.position][2:4]
        return self.before is not None and self.before_is(*kinds) and _end(self.before) == (line, column)

    def touched_by(self, kind: str) -> bool:
        """Whether this one stands behind, without a space between."""
        end = _end(self.tokens[self.position])
        return bool(self.rest) and self.rest[0][0] == kind and self.rest[0][2:4] == end

    def level(self) -> int:
        """How many blocks the line stands in."""
        kinds = [token[0] for token in self.tokens[: self.start]]
        return kinds.count("INDENT") - kinds.count("DEDENT")

    def error(self, message: str, help: str = "", span: Span | None = None, code: str = "K001") -> Diagnostic:
        """What is to be told; of the refused token unless another place is given."""
        return Diagnostic(code, "error", message, self.span if span is None else span, help=help)


def start_of_line(tokens: list[Token], position: int) -> int:
    """Where in `tokens` the logical line of a token begins."""
    while position and tokens[position - 1][0] not in ("NEWLINE", "INDENT", "DEDENT"):
        position -= 1
    return position


def place(first: Token, last: Token) -> Span:
    """From one token to another."""
    return Span(first[2], first[3], *_end(last))


def behind(token: Token) -> Span:
    """The column behind a token."""
    line, column = _end(token)
    return Span(line, column, line, column + 1)


def shown(text: str) -> str:
    """A token's text, short enough for a message."""
    return text if len(text) <= 40 else f"{text[:36]}..."


def _end(token: Token) -> tuple[int, int]:
    return token[2], token[3] + len(token[1])
