"""What the builders of all constructs share: refusals, places, and picking nodes among a rule's children."""

from __future__ import annotations

from typing import Any

from koordgen.diagnostics import Diagnostic
from koordgen.source import Span

Children = list[Any]  # of tokens (tuples of four), nodes, and blocks (tuples of statements)


class Refused(Exception):
    """A rule whose children cannot be accepted."""

    def __init__(self, diagnostic: Diagnostic) -> None:
        super().__init__(diagnostic.message)
        self.diagnostic = diagnostic


def refused(code: str, message: str, span: Span, help: str = "") -> Refused:
    """To be raised."""
    return Refused(Diagnostic(code, "error", message, span, help=help))


def token_span(token: tuple[str, str, int, int]) -> Span:
    """Where a token stands."""
    _, text, line, column = token
    return Span(line, column, line, column + len(text))


def reach(first: Any, last: Any) -> Span:
    """From the beginning of one token or node to the end of another."""
    if first.__class__ is tuple:
        line, column = first[2], first[3]
    else:
        start = first.span
        line, column = start.line, start.column
    if last.__class__ is tuple:
        return Span(line, column, last[2], last[3] + len(last[1]))
    end = last.span
    return Span(line, column, end.end_line, end.end_column)


def across(first: Any, last: Any) -> Span:
    """From the beginning of one node to the end of another."""
    start, end = first.span, last.span
    return Span(start.line, start.column, end.end_line, end.end_column)


def nodes(children: Children) -> tuple[Any, ...]:
    """The children that are neither tokens nor blocks."""
    return tuple([c for c in children if c.__class__ is not tuple])
